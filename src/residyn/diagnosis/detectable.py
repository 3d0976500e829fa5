"""Before any test: from which strength an effect would show, and be told from its rivals.

Along the motion of springs and dampers, let A (C, C) be the Gram matrix of the candidates' columns,
each scaled by its prior, with the model's own numbers and first state integrated out (`columns`).
If effect i is there with strength s, the columns' projections on the readings are normal,

    x ~ N(A_i s, A),        log evidence of c over nothing = 1/2 x_c' (1 + A_cc)^-1 x_c
                                                             - 1/2 log det (1 + A_cc),

and so every candidate's evidence is known before anything is recorded. Something is missing where
the models with one effect more have more probability together than the one without, as in
`Posterior.verdict`; an effect is named if odds of less than 20 to 1 tell it from the likeliest of
them. For one column, a = A_ii, and no other candidate, the odds against nothing are even where
x^2 / (1 + a) = log(1 + a) + 2 log of the prior odds, and in half of all recordings |x| is larger
than a s. With many candidates, shapes and signs the same is a mean over draws of x, which are the
same for all strengths.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from ..effects import AbstractEffect
from ..filtering.law import numbers_of
from ..filtering.trajectory import Scene
from ..physics.modal import modes
from ..recordings.experiment import Experiment
from ..runtime.json import finite
from ..runtime.presentation import Result
from .columns import Column, Columns, candidates, known_signs, strengths
from .evidence import (
    INDISTINGUISHABLE,
    conditional,
    half_normal,
    log_prior_model,
    width_of,
)
from .missing_torque import scene_of
from .search import nested, tried_alone

DRAWS = 400
"""Of recordings: the half of them is then known to 3 %."""
_SHARES = np.geomspace(1e-5, 1.0, 61)  # strengths, in the typical size of their dimension


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
class Atlas(Result):
    """What an arm, its noise and a length of recording can show. Print it; or `to_dict()`."""

    effects: tuple[Detectable, ...]
    """The weakest that shows first."""
    joints: tuple[str, ...]
    units: tuple[str, ...]
    noise: tuple[float, ...]
    """Of one reading, rad or m."""
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

    **Raises:** `FitError` if no motion of springs and dampers goes with the readings; `ValueError`
    for an effect that does not exist or does not go with this experiment.
    """
    if not experiment.fit_recordings:
        raise ValueError('no recording has role = "fit": there is no motion to look at')
    with jax.enable_x64(True):
        scene, base, _ = scene_of(experiment, effects)
        model = tried_alone(scene, base)
        ringing = np.asarray(modes(scene.model(model.best)).frequency_hz)
        known = candidates(scene, tuple(e.label for e in base))
        # A disturbance may have any frequency: one well above all modes stands for them.
        columns = Columns(scene, model.best, known, [1.5 * float(np.nanmax(ringing))])
        _, (gram,) = columns.gram([0.0])
    _, rest = conditional(gram, len(model.best.u))
    rivals = Rivals(columns.rows, rest[1:, 1:])
    price = log_prior_model(0, len(known)) - log_prior_model(1, len(known))
    found = [_one(scene, rivals, e, price) for e in known]
    order = sorted(found, key=lambda d: math.inf if d.share is None else d.share)
    recordings = experiment.fit_recordings
    return Atlas(
        tuple(order),
        experiment.joints,
        experiment.units or ("",) * scene.n,
        tuple(map(float, recordings[0].noise)),
        float(sum(r.duration for r in recordings)),
    )


class Rivals:
    """All candidates' evidences, if one of them is there."""

    def __init__(self, rows: Sequence[Column], gram: np.ndarray, draws: int = DRAWS):
        """`gram` (C, C) of the columns of all rows."""
        self.rows, self.gram = rows, gram
        self.effects = list({r.effect.label: r.effect for r in rows}.values())
        self.labels = [e.label for e in self.effects]
        values, vectors = np.linalg.eigh(gram)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        self.noise = np.random.default_rng(0).standard_normal((draws, len(gram))) @ root.T
        self._inner = []
        for row in rows:
            c = list(row.which)
            covariance = np.linalg.inv(np.eye(len(c)) + gram[np.ix_(c, c)])
            sides = np.flatnonzero(known_signs(row))
            half = 0.5 * np.linalg.slogdet(covariance)[1]
            self._inner.append((c, covariance, half, sides))

    def truth(self, effect: AbstractEffect) -> tuple[np.ndarray, dict[str, float]]:
        """(C,) what one prior width of every strength of an effect adds to the projections, its
        shape being the middle one of its grid; and that shape, by field."""
        own = [r for r in self.rows if r.effect.label == effect.label]
        middle = own[len(own) // 2]
        which = middle.which[:1] if effect.oscillates else middle.which
        return self.gram[:, list(which)].sum(axis=1), middle.shape

    def gains(self, shift: np.ndarray) -> np.ndarray:
        """(L, draws) log evidence of each label over nothing, shapes averaged, where the
        projections are `shift` (C,) and noise."""
        x = self.noise + shift
        each: dict[str, list[np.ndarray]] = {}
        for row, (c, covariance, half, sides) in zip(self.rows, self._inner, strict=True):
            mean = x[:, c] @ covariance
            gain = 0.5 * np.einsum("di,di->d", x[:, c], mean) + half
            for i in sides:
                gain = gain + half_normal(mean[:, i] / math.sqrt(covariance[i, i]))
            each.setdefault(row.effect.label, []).append(gain)
        shaped = (np.array(each[label]) for label in self.labels)
        return np.array([np.logaddexp.reduce(x, axis=0) - math.log(len(x)) for x in shaped])


def _one(scene: Scene, rivals: Rivals, effect: AbstractEffect, price: float) -> Detectable:
    first = strengths(effect)[0]
    width, size = width_of(scene, effect, first), scene.size(effect, first)
    own, known = rivals.labels.index(effect.label), enumerate(rivals.effects)
    others = [i for i, e in known if i != own and not nested(e, effect)]
    truth, shape = rivals.truth(effect)

    def told_at(share: float) -> tuple[float, float, int | None]:
        """In which share of recordings it is named, and leads; and its best rival then."""
        gains = rivals.gains(truth * (share * size / width))
        mine, rest = gains[own], gains[others]
        missing = np.logaddexp.reduce(gains, axis=0) > price
        named = missing & (mine > gains.max(axis=0) - INDISTINGUISHABLE)
        leads = named & (mine > rest.max(axis=0, initial=-np.inf) + INDISTINGUISHABLE)
        best = others[int(np.argmax(rest.mean(axis=1)))] if others else None
        return float(named.mean()), float(leads.mean()), best

    shows = _half(lambda s: told_at(s)[0])
    told = None if shows is None else _half(lambda s: told_at(s)[1])
    at = told or shows
    rival = None if at is None else told_at(at)[2]
    names = {x.field: x.name for x in numbers_of(effect)}
    return Detectable(
        effect=effect.label,
        number=first.name,
        unit=scene.unit(effect, first),
        shape={names[k]: float(v) for k, v in shape.items()},
        shows=shows and float(shows * size),
        share=shows,
        told=told and float(told * size),
        told_share=told,
        rival=None if rival is None else rivals.labels[rival],
    )


def _half(share_of) -> float | None:
    """The least strength at which a share of recordings reaches a half; None: at none."""
    before = share_of(_SHARES[0])
    for low, high in itertools.pairwise(_SHARES):
        after = share_of(high)
        if after >= 0.5:
            part = (0.5 - before) / max(after - before, 1e-12)
            return float(low * (high / low) ** min(max(part, 0.0), 1.0))
        before = after
    return None
