"""What each effect would draw over the missing torque.

Along the smoothed motion every effect's torque is known but for its strength, and a fit without it
has bent springs and dampers to make up for it. So the missing torque is, at best, the effect at
some strength plus a change of springs and dampers: linear least squares, for a few values of each
shape. That draws the curve which the eye should compare with the picture, in its own units. It
names nothing: the torque carries no proof, the trajectory does.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect, catalogue
from ..fitting.beginnings import plain, torque_along
from ..kept import kept
from ..model import Model
from ..parameter import Scales
from .missing_torque import MissingTorque

_MOST_POINTS = 2000
_PER_NUMBER = 0.1
_STUCK = 0.3  # of the rms rate: below, a joint may be at rest, and a step is blurred
_HUBER, _ROUNDS = 1.345, 8
_LONGEST, _HALF = 3, 0.5


class Curve(NamedTuple):
    """An effect beside the missing torque."""

    effect: str
    """`name` or `name:place`."""
    share: float
    """Of what changed springs and dampers leave of the missing torque's mean square, the share
    that it explains, 0 to 1."""
    values: dict[str, tuple[float, str]]
    """Its numbers: value and unit."""
    torque: np.ndarray
    """(N, n) N m: its own torque, at the times of the missing torque."""
    changed: np.ndarray
    """(N, n) N m: what changes of springs and dampers add to it."""


def curves(
    model: Model, missing: MissingTorque, effects: Sequence[AbstractEffect] | None = None
) -> list[Curve]:
    """What effects would draw over a missing torque, the one that explains most first.

    `effects` None takes every effect of the catalogue that can be added to the model and acts on
    the motion. Runs in float64.
    """
    with jax.enable_x64(True):
        chosen = candidates(model) if effects is None else effects
        chosen = [e for e in chosen if not e.senses]
        along = _Along.of(model, missing)
        found = [curve for e in chosen if (curve := along.curve(e)) is not None]
    # Of two that leave as much, the one with fewer numbers.
    return sorted(found, key=lambda c: (1.0 - c.share) * (1.0 + _PER_NUMBER * len(c.values)))


def likeliest(
    models: Sequence[Model],
    missing: Sequence[MissingTorque],
    effects: Sequence[AbstractEffect],
    count: int,
) -> set[str]:
    """Labels of the `count` effects that explain most of what is missing, at least half of it, in
    the longest recordings; one model per recording's pose."""
    order = sorted(range(len(missing)), key=lambda i: missing[i].time[0] - missing[i].time[-1])
    shares: dict[str, list[float]] = {}
    for i in order[:_LONGEST]:
        for curve in curves(models[i], missing[i], effects):
            shares.setdefault(curve.effect, []).append(curve.share)
    mean = {label: float(np.mean(each)) for label, each in shares.items()}
    best = sorted(mean, key=lambda label: -mean[label])[:count]
    return {label for label in best if mean[label] > _HALF}


def candidates(model: Model) -> list[AbstractEffect]:
    """Effects of the catalogue that could be missing from a model, at every place where they can
    act; those without a number to fit cannot."""
    found: list[AbstractEffect] = []
    for kind in catalogue().values():
        try:
            places = kind.places(model.mechanism)
        except ValueError:  # it makes no sense here
            continue
        each = [kind(p) for p in places] if places else [kind()]  # pyright: ignore
        found += [e for e in each if e.label not in model.labels]
    return [e for e in found if Model(model.mechanism, (e,)).fitted]


class _Along(NamedTuple):
    """A missing torque on an even grid of G instants, whitened by its band."""

    model: Model
    missing: MissingTorque
    time: np.ndarray  # (G,) from 0
    angle: np.ndarray  # (G, n)
    rate: np.ndarray
    torque: np.ndarray
    weight: np.ndarray
    base: np.ndarray  # (G * n, B) columns of springs, dampers and a shifted rest, whitened
    scales: list[Scales]

    @classmethod
    def of(cls, model: Model, missing: MissingTorque) -> "_Along":
        span = missing.time[-1] - missing.time[0]
        time = np.linspace(0.0, span, min(len(missing.time), _MOST_POINTS))

        def even(x: np.ndarray) -> np.ndarray:
            at = missing.time - missing.time[0]
            return np.stack([np.interp(time, at, c) for c in x.T], axis=1)

        angle, rate, torque = map(even, (missing.angle, missing.rate, missing.torque))
        std = even(missing.std)
        # A floor: the ends of a recording know their torque no worse than 10 times the best.
        weight = 1.0 / np.clip(std, np.min(std, axis=0), 10 * np.min(std, axis=0) + 1e-300)
        n = angle.shape[1]
        base = np.zeros((len(time), n, 2 * n))
        for j in range(n):
            base[:, j, 2 * j], base[:, j, 2 * j + 1] = angle[:, j], rate[:, j]
        columns = (base * weight[..., None]).reshape(-1, 2 * n)
        inertia = model.mechanism.mass_matrix((0.0,) * n)
        size, pace = angle.std(axis=0), rate.std(axis=0)
        scales = [
            Scales(float(inertia[j][j]), float(pace[j] / max(size[j], 1e-300)), float(size[j]))
            for j in range(n)
        ]
        return cls(model, missing, time, angle, rate, torque, weight, columns, scales)

    def curve(self, effect: AbstractEffect) -> Curve | None:
        """The best of an effect's shapes; None if it has nothing to fit."""
        alone = Model(self.model.mechanism, (effect,))
        linear = [i for i, n in enumerate(alone.fitted) if n.meaning.silent is not None]
        if not linear or any(n.name.startswith("inertia_error") for n in alone.fitted):
            return None
        sizes = np.array(
            [n.meaning.dimension.size(self.scales[-1 if n.joint is None else n.joint])
             for n in alone.fitted]
        )  # fmt: skip
        target = (self.torque * self.weight).reshape(-1)
        slides = np.abs(self.rate) > _STUCK * self.rate.std(axis=0)
        sure = (slides | (not effect.dry)).reshape(-1)
        left = _residual(self.base, target)
        best = None
        for begin in plain(alone, sizes, 1).numbers:
            drawn = [self._torque(alone, begin, i, sizes[i]) for i in linear]
            whole = np.stack([(d * self.weight).reshape(-1) for d in drawn], axis=1)
            if not np.isfinite(whole).all():
                continue
            columns = np.concatenate([self.base, whole], axis=1)
            free = [alone.fitted[i].meaning.sign == "any" for i in linear]
            factors = _robust(columns[sure], target[sure], free)
            changed, own = self.base @ factors[: -len(linear)], whole @ factors[-len(linear) :]
            # Where a joint is stuck, dry friction is whatever it takes to hold it.
            own = np.where(sure, own, np.clip(target - changed, -np.abs(own), np.abs(own)))
            rest = target - changed - own
            share = 1.0 - np.sum(rest**2) / max(np.sum(left**2), 1e-300)
            if best is None or share > best[0]:
                best = share, begin, factors, own, changed
        if best is None:
            return None
        share, begin, factors, own, changed = best
        numbers = begin.copy()
        numbers[linear] = factors[-len(linear) :] * sizes[linear]
        units = self.model.mechanism.units
        values = {
            n.name: (float(x), n.meaning.dimension.unit(units[n.joint or 0] if units else None))
            for n, x in zip(alone.fitted, numbers, strict=True)
        }
        return Curve(effect.label, float(share), values, self._at(own), self._at(changed))

    def _at(self, whitened: np.ndarray) -> np.ndarray:
        """A torque on the grid, at the times of the missing torque."""
        torque = whitened.reshape(self.torque.shape) / self.weight
        at = self.missing.time - self.missing.time[0]
        return np.stack([np.interp(at, self.time, c) for c in torque.T], axis=1)

    def _torque(self, alone: Model, begin: np.ndarray, which: int, size: float) -> np.ndarray:
        """(G, n) torque of one strength at its typical size, the others silent."""
        numbers = begin.copy()
        for i, n in enumerate(alone.fitted):
            if n.meaning.silent is not None:
                numbers[i] = n.meaning.silent + (size if i == which else 0.0)
        model = alone.with_vector(jnp.asarray(numbers))
        dt, z0 = np.asarray(self.time[1] - self.time[0]), np.zeros(len(model.memory))
        return np.asarray(_torque_along(model, dt, self.angle, self.rate, z0), float)


_torque_along = kept(like=0)(torque_along)


def _allowed(columns: np.ndarray, target: np.ndarray, free: Sequence[bool]) -> np.ndarray:
    """Least squares; the last columns that are not `free` take no negative factor."""
    first = columns.shape[1] - len(free)
    used = np.ones(columns.shape[1], bool)
    while True:
        factors = np.zeros(columns.shape[1])
        factors[used] = np.linalg.lstsq(columns[:, used], target, rcond=1e-10)[0]
        wrong = [first + i for i, any_sign in enumerate(free) if not any_sign]
        wrong = [i for i in wrong if factors[i] < 0]
        if not wrong:
            return factors
        used[min(wrong, key=lambda i: factors[i])] = False


def _robust(columns: np.ndarray, target: np.ndarray, free: Sequence[bool]) -> np.ndarray:
    """`_allowed` by Huber's weights: a few instants that nothing draws shall not bend the rest."""
    factors = _allowed(columns, target, free)
    for _ in range(_ROUNDS):
        off = np.abs(target - columns @ factors)
        size = _HUBER * 1.4826 * np.median(off)
        weight = np.sqrt(np.minimum(1.0, size / np.maximum(off, 1e-300)))
        factors = _allowed(columns * weight[:, None], target * weight, free)
    return factors


def _residual(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    return target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0]
