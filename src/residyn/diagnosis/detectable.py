"""Before any test: from which strength an effect would show, and be told from its rivals.

Along the motion of springs and dampers the model with every candidate is linear (`columns`). So
recordings of effect i with strength s are y = e + Phi_i s, e noise that is drawn, and of each of
them the log evidences of the base model and of every candidate c follow from Gram matrices of the
whitened responses alone: with G of e and Phi, the base model's numbers and first state integrated
out, under a random torque of some intensity,

    base:         const - 1/2 (G_ee + 2 G_ei s + s' G_ii s)
    c over base:  1/2 x_c' (1 + G_cc)^-1 x_c - 1/2 log det (1 + G_cc),   x = G_.e + G_.i s.

Intensities are summed over as in a diagnosis: the rival of a weak effect is not only the base
model, but the base model with a small random torque, which takes up a part of any effect. What
`Posterior.verdict` says of these evidences is then counted over the draws, which are the same for
all strengths.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from scipy.optimize import bisect

from ..effects import AbstractEffect
from ..filtering.law import numbers_of
from ..filtering.trajectory import Scene
from ..physics.modal import modes
from ..recordings.experiment import Experiment, must_be_experiment
from ..runtime.json import finite
from ..runtime.presentation import Result
from .columns import Column, Columns, candidates, nested, strengths
from .evidence import (
    COMPLETE,
    INDISTINGUISHABLE,
    INTENSITIES,
    at_work,
    conditional,
    log_prior_intensity,
    log_prior_model,
    priors_of_columns,
    width_of,
)
from .missing_torque import scene_of, with_rests
from .tried import tried_alone

DRAWS = 200
"""Of recordings: the half of them is then known to 4 %."""
_SHARES = np.geomspace(1e-5, 1.0, 11)
"""Strengths between which half of the recordings are looked for, in the typical size of their
dimension."""


@dataclass(frozen=True)
class Detectable:
    """From which strength one effect shows."""

    effect: str
    """`name` or `name:place`."""
    number: str
    """Which of its numbers is meant; if it has several strengths, all are raised together."""
    unit: str
    shape: dict[str, float]
    """Its shape numbers, by name, as they were taken."""
    shape_units: dict[str, str]
    """Their units."""
    shows: float | None
    """Strength at which it is named in half of all recordings, alone or with look-alikes; None: at
    no strength up to the typical size of its dimension."""
    share: float | None
    """The same as a share of that typical size: of a torque, the spring's at full swing."""
    told: float | None
    """Strength at which, in half of all recordings, it leads every rival by odds of 20 to 1."""
    told_share: float | None
    rival: str | None
    """The strongest of them."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one effect."""
        return finite(vars(self))


@dataclass(frozen=True)
class Atlas(Result, about="detectable"):
    """What an arm, its noise and a length of recording can show. Print it; or `to_dict()`."""

    effects: tuple[Detectable, ...]
    """The weakest that shows first."""
    joints: tuple[str, ...]
    units: tuple[str, ...]
    """Of readings: "rad", "m/s", ...; "" where not known."""
    noise: tuple[float, ...]
    """Of one reading, in `units`."""
    duration: float
    """Of all recordings together, s."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn effects --detectable`."""
        return {
            "noise": dict(zip(self.joints, self.noise, strict=True)),
            "duration": self.duration,
            "effects": [e.to_dict() for e in self.effects],
        }


def detectable(experiment: Experiment, *, effects: Sequence[str | AbstractEffect] = ()) -> Atlas:
    """Which effects these recordings could show, from which strength, and tell from their rivals.

    What counts of the recordings is how the arm moves in them, how long, and their noise: they may
    be simulated (`residyn simulate`), before any test is made.

    **Arguments:**

    - `experiment`: from `residyn.load`, or made of arrays.
    - `effects`: what the model has beside springs and dampers.

    **Raises:** `FitError` if no motion of springs and dampers goes with the readings; `TypeError`
    for what is no experiment; `ValueError` for an effect that does not exist or does not go with
    this one.
    """
    must_be_experiment(experiment)
    if not experiment.fit_recordings:
        raise ValueError('no recording has role = "fit": there is no motion to look at')
    with jax.enable_x64(True):
        scene, base = scene_of(*with_rests(experiment, effects))
        model = tried_alone(scene, base)
        ringing = np.asarray(modes(scene.model(model.best)).frequency_hz)
        known = candidates(scene, tuple(e.label for e in base))
        # A disturbance may have any frequency: one well above all modes stands for them.
        columns = Columns(scene, model.best, known, [1.5 * float(np.nanmax(ringing))])
        rivals = Rivals(columns.rows, *_grams(columns))
    found = [_one(scene, rivals, e) for e in known]
    order = sorted(found, key=lambda d: math.inf if d.share is None else d.share)
    recordings = experiment.fit_recordings
    return Atlas(
        tuple(order),
        experiment.joints,
        experiment.reading_units,
        tuple(map(float, recordings[0].noise)),
        float(sum(r.duration for r in recordings)),
    )


def _grams(columns: Columns) -> tuple[np.ndarray, np.ndarray]:
    """(I,) log normalisers under each random torque, and the (I, C + D, C + D) Gram matrices of the
    C columns and of `DRAWS` recordings of noise."""
    noise = np.sqrt(columns.scene.readings.variance)[..., None]
    noise = noise * np.random.default_rng(0).standard_normal((*noise.shape[:-1], DRAWS))
    totals, each = columns.gram(INTENSITIES, noise)
    bases, rests = conditional(each, len(columns.trajectory.u))
    return totals + bases + 0.5 * rests[:, 0, 0], rests[:, 1:, 1:]


class Rivals:
    """The evidences of the base model and of all candidates, if one of them is there."""

    def __init__(self, rows: Sequence[Column], logs: np.ndarray, grams: np.ndarray):
        """`logs` (I,) log normalisers under each random torque, `grams` (I, C + D, C + D) of the
        columns of all rows and of D recordings of noise."""
        C = sum(len(row.which) for row in rows)
        self.rows, self.gram = rows, grams[:, :C, :C]
        self.effects = list({r.effect.label: r.effect for r in rows}.values())
        self.labels = [e.label for e in self.effects]
        self._across = np.swapaxes(grams[:, C:, :C], 0, 1)  # (D, I, C)
        square = np.diagonal(grams[:, C:, C:], axis1=1, axis2=2).T  # (D, I)
        self._base = logs + log_prior_intensity(INTENSITIES) - 0.5 * square
        # Rows of as many columns at once, and their posteriors whatever the readings.
        self._alike = []
        for size in {len(row.which) for row in rows}:
            own = [i for i, row in enumerate(rows) if len(row.which) == size]
            which = np.array([rows[i].which for i in own])  # (R, k)
            inner = self.gram[:, which[:, :, None], which[:, None, :]]
            covariance = np.linalg.inv(np.eye(size) + inner)  # (I, R, k, k)
            half = 0.5 * np.linalg.slogdet(covariance)[1]
            each = [rows[i].strengths for i in own]
            self._alike.append((own, which, covariance, half, each))
        labels = [row.effect.label for row in rows]
        self._begins = [labels.index(x) for x in self.labels]
        counts = np.diff([*self._begins, len(rows)])
        self._log_shapes = np.log(counts)[:, None, None]
        self._prior = [log_prior_model(m, len(self.labels)) for m in (0, 1)]

    def truth(self, effect: AbstractEffect) -> tuple[np.ndarray, dict[str, float]]:
        """(C,) the columns that one prior width of every strength of an effect is made of, its
        shape being the middle one of its grid; and that shape, by field."""
        own = [r for r in self.rows if r.effect.label == effect.label]
        middle = own[len(own) // 2]
        which = middle.which[:1] if effect.oscillates else middle.which
        made = np.zeros(self.gram.shape[-1])
        made[list(which)] = 1.0
        return made, middle.shape

    def evidences(self, made: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(D, I) log evidence of the base model under each random torque times its prior, and (L,
        D, I) of each label, shapes averaged, where the readings are noise and `made` (C,)."""
        shift = self.gram @ made  # (I, C)
        x = self._across + shift
        base = self._base - self._across @ made - 0.5 * (shift @ made)
        gains = np.empty((len(self.rows), *base.shape))
        for rows, which, covariance, half, each in self._alike:
            own = x[..., which]
            mean = np.einsum("dirk,irkl->dirl", own, covariance)
            gain = 0.5 * np.sum(own * mean, -1) + half
            gain += priors_of_columns(mean, covariance, each)
            gains[rows] = np.moveaxis(gain, 2, 0)
        return base, base + np.logaddexp.reduceat(gains, self._begins) - self._log_shapes

    def counted(self, made: np.ndarray, own: int, others: Sequence[int]):
        """In which share of recordings a label is named, and leads all `others`; and which of them
        is the next to it on average."""
        base, each = self.evidences(made)
        known = np.concatenate([base[None] + self._prior[0], each + self._prior[1]])
        p = np.exp(known - known.max(axis=(0, 2), keepdims=True))
        p /= p.sum(axis=(0, 2), keepdims=True)
        adequate = p[0][:, COMPLETE].sum(-1)
        # In logs: where the base model is far behind, its whole row of p is 0.
        without = np.exp(known[0] - np.logaddexp.reduce(known[0], axis=-1, keepdims=True))
        missing = (p[1:] * at_work(without))[..., COMPLETE].sum((0, 2))
        named = (missing > adequate) & (missing > 1.0 - missing - adequate)
        logs = np.logaddexp.reduce(each, axis=-1)
        mine, rest = logs[own], logs[list(others)]
        named &= mine > logs.max(axis=0) - INDISTINGUISHABLE
        leads = named & (mine > rest.max(axis=0, initial=-np.inf) + INDISTINGUISHABLE)
        best = others[int(np.argmax(rest.mean(axis=1)))] if others else None
        return float(named.mean()), float(leads.mean()), best


def _one(scene: Scene, rivals: Rivals, effect: AbstractEffect) -> Detectable:
    first = strengths(effect)[0]
    width, size = width_of(scene, effect, first), scene.size(effect, first)
    own, known = rivals.labels.index(effect.label), enumerate(rivals.effects)
    others = [i for i, e in known if i != own and not nested(e, effect)]
    truth, shape = rivals.truth(effect)

    @functools.cache
    def told_at(share: float) -> tuple[float, float, int | None]:
        return rivals.counted(truth * (share * size / width), own, others)

    shows = _half(lambda s: told_at(s)[0])
    told = None if shows is None else _half(lambda s: told_at(s)[1])
    at = told or shows
    rival = None if at is None else told_at(at)[2]
    shapes = [x for x in numbers_of(effect) if x.field in shape]
    return Detectable(
        effect=effect.label,
        number=first.name,
        unit=scene.unit(effect, first),
        shape={x.name: float(shape[x.field]) for x in shapes},
        shape_units={x.name: scene.unit(effect, x) for x in shapes},
        shows=shows and float(shows * size),
        share=shows,
        told=told and float(told * size),
        told_share=told,
        rival=None if rival is None else rivals.labels[rival],
    )


def _half(share_of) -> float | None:
    """The least strength at which a share of recordings reaches a half; None: at none."""
    above = next((i for i, s in enumerate(_SHARES) if share_of(s) >= 0.5), None)
    if not above:
        return None if above is None else float(_SHARES[0])
    low, high = np.log(_SHARES[above - 1 : above + 1])
    root: Any = bisect(lambda s: share_of(math.exp(s)) - 0.5, low, high, xtol=0.04)
    return math.exp(root)
