"""The motion as it was, and every candidate's torque along it.

The missing torque's smoother knows the motion without believing the model. Along that path each
effect's torque is known but for its strengths, which enter linearly, and its shapes, which are
tried on a grid. A torque that an integration step should feel is handed over as the straight line
with the same impulse and the same moment in that step.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, median_filter

from ..effects import AbstractEffect
from ..fitting.beginnings import memory_along
from ..kept import kept
from ..model import Model
from ..motion import Motion
from ..parameter import parameters_of
from .missing_torque import MissingTorque

_PARTS = 8  # of an integration step at which torques are taken
_REST = 0.02  # of the rms rate: slower than this a joint may be at rest
_STILL = 3.0  # times that, for a whole period: it does
_MOST_SHAPES = 48
_BESIDE = 0.05  # of a mode's frequency
_ABOVE = 5.0  # times the fastest mode: no disturbance is looked for beyond
_LINES = 8  # frequencies tried of an effect with a frequency of its own
_AROUND = 10.0  # cycles more or less in the longest recording: a line's surroundings
_BETWEEN = 0.25, 0.75  # of the way from where it beats once to where a line is seen
_FINER = 2  # values in place of one of a shape's grid


class Path(NamedTuple):
    """One recording's motion at the middles of the parts of M integration steps, G = 8 M."""

    h: float  # of an integration step, s
    time: np.ndarray  # (G,) s from the first sample
    q: np.ndarray  # (G, n)
    v: np.ndarray
    a: np.ndarray
    direction: np.ndarray  # (G, n) of sliding; what friction needs to hold, where at rest
    rests: np.ndarray  # (G, n) 1 where a joint stays at rest, else 0
    missing: np.ndarray  # (G, n) N m, the missing torque of the base model

    @classmethod
    def of(
        cls, found: MissingTorque, steps: int, period: float, fitted: np.ndarray | None = None
    ) -> "Path":
        """Along a smoothed recording, or along what a model predicts (`fitted`, (N, n)) if that is
        as near; `period` s is that of the slowest mode."""
        known = found.time - found.time[0]
        h = known[-1] / steps
        time = (np.arange(steps * _PARTS) + 0.5) * h / _PARTS
        angle, rate = found.angle, found.rate
        if fitted is not None:
            angle, rate = fitted, CubicSpline(known, fitted)(known, 1)
        q, v, a = _hermite(known, angle, rate, time)
        missing = np.stack([np.interp(time, known, u) for u in found.torque.T], axis=1)
        slow = _REST * np.sqrt(np.mean(v**2, axis=0)) + 1e-300
        slides = np.tanh(v / slow)
        width = max(1, round(period / (time[1] - time[0])))
        most = np.stack([maximum_filter1d(np.abs(x), width) for x in v.T], axis=1)
        rests = (most < _STILL * slow).astype(float)
        direction = slides.copy()
        for j in range(q.shape[1]):
            moving = np.abs(slides[:, j]) > 0.9
            rows = np.stack([q[:, j], v[:, j], slides[:, j]], axis=1)
            level = np.linalg.lstsq(rows[moving], missing[moving, j], rcond=None)[0][2]
            if level > 0:
                held = np.clip(missing[:, j] / level, -1.0, 1.0)
                direction[:, j] += (1.0 - np.abs(slides[:, j])) * held
        direction = np.where(rests > 0, 0.0, direction)
        return cls(h, time, q, v, a, direction, rests, missing)

    def lines(self, torque: np.ndarray) -> np.ndarray:
        """(G, n) torque as (2, M, n): its straight line in each step, left and right end."""
        parts = np.asarray(torque).reshape(-1, _PARTS, torque.shape[-1])
        place = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        mean = parts.mean(axis=1)
        slope = np.einsum("p,mpn->mn", place, parts) / np.sum(place**2)
        return np.stack([mean - slope / 2, mean + slope / 2])

    def motion(self, model: Model, z0: np.ndarray) -> Motion:
        """The motion as a model's effects see it, every scalar an array (G,); `z0` (m,) is what its
        internal states hold at first, beyond what their effects begin with."""
        z = ()
        if model.memory:
            along = (jnp.asarray(x) for x in (self.h / _PARTS, self.q, self.v, z0))
            z = tuple(np.asarray(_memory_along(model, *along)).T)
        q, v, direction = (tuple(x.T) for x in (self.q, self.v, self.direction))
        return Motion(self.time, q, v, direction, z)  # pyright: ignore[reportArgumentType]

    def torque(self, model: Model, z0: np.ndarray) -> np.ndarray:
        """(G, n) torque of a model's effects along the path, N m."""
        return self._stack(model.torque(self.motion(model, z0)))

    def inverse(self, model: Model, z0: np.ndarray) -> np.ndarray:
        """(G, n) drive that a model would need to move along the path, N m."""
        motion, bodies = self.motion(model, z0), model.bodies
        rows, own = bodies.mass_matrix(motion.q), bodies.inertia_torque(motion.q, motion.v)
        felt = model.torque(motion)
        return self._stack(
            tuple(
                sum(m * x for m, x in zip(row, self.a.T, strict=True)) + f + u
                for row, f, u in zip(rows, own, felt, strict=True)
            )
        )

    def _stack(self, parts) -> np.ndarray:
        return np.stack([np.broadcast_to(np.asarray(x, float), self.time.shape) for x in parts], 1)


# Laws without memory are few operations on long arrays: not worth compiling one by one.
_memory_along = kept(like=0)(memory_along)


def _hermite(x: np.ndarray, y: np.ndarray, slope: np.ndarray, at: np.ndarray):
    """Cubic Hermite curve through (N, n) values with slopes, and its first two derivatives."""
    i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    gap = (x[i + 1] - x[i])[:, None]
    s = (at - x[i])[:, None] / gap
    p0, p1, d0, d1 = y[i], y[i + 1], slope[i] * gap, slope[i + 1] * gap
    q = (
        p0 * (2 * s**3 - 3 * s**2 + 1)
        + d0 * (s**3 - 2 * s**2 + s)
        + p1 * (3 * s**2 - 2 * s**3)
        + d1 * (s**3 - s**2)
    )
    v = (p0 - p1) * (6 * s**2 - 6 * s) + d0 * (3 * s**2 - 4 * s + 1) + d1 * (3 * s**2 - 2 * s)
    a = (slope[i + 1] - slope[i]) / gap
    return q, v / gap, a


class Variant(NamedTuple):
    """An effect with given shapes: its strengths enter linearly."""

    effect: AbstractEffect  # silent
    strengths: tuple[str, ...]  # their fields
    sizes: tuple[float, ...]  # typical, one per strength
    phases: tuple[float, ...]  # of its own oscillation, each a column of its own; () if it has none
    joint: int | None

    def at(self, strength: int) -> AbstractEffect:
        """With one strength at its typical size."""
        return with_fields(self.effect, {self.strengths[strength]: self.sizes[strength]})


def with_fields(effect: AbstractEffect, values: dict[str, float]) -> AbstractEffect:
    """The effect with some fields replaced."""
    return dataclasses.replace(effect, **values)  # pyright: ignore


def resonant(frequency, modes: Sequence[float], seconds: float):
    """Whether an oscillation of some Hz is so near a mode that, over so many seconds, it could be
    nothing but a correction of the ringing itself: such a torque mimics much of any effect."""
    near = [np.abs(np.asarray(frequency) - f) < _beats(f, seconds)[1] for f in modes]
    return np.any(near, axis=0) if near else np.zeros(np.shape(frequency), bool)


def one_with(frequency: float, modes: Sequence[float], seconds: float) -> bool:
    """Whether it is nearer still, and mimics nearly all of many an effect."""
    return any(abs(frequency - f) < _beats(f, seconds)[0] for f in modes)


def _beats(mode: float, seconds: float) -> tuple[float, float]:
    """How far off a mode an oscillation beats once against the ringing, and how far so often that
    it mimics little, Hz."""
    return max(_BESIDE * mode, 1.0 / seconds), _BESIDE * mode + 2.0 / seconds


def variants(
    effect: AbstractEffect,
    sizes: dict[str, float],
    paths: Sequence[Path],
    joint: int | None,
    modes: Sequence[float] = (),
) -> list[Variant]:
    """An effect at every combination of its shapes' grid; `sizes` by field, in its own units;
    `joint` is where it acts, if that is one; `modes` in Hz."""
    declared = [p for p in parameters_of(effect) if p.fitted]
    strengths = tuple(p.field for p in declared if p.silent is not None)
    shapes = [p for p in declared if p.silent is None]
    silent = {p.field: p.silent for p in declared if p.silent is not None}
    choices = []
    for p in shapes:
        if p.field == effect.oscillates:
            choices.append(_frequencies(joint or 0, paths, modes))
        else:
            grid = [g * sizes[p.field] for g in _finer(p.grid)]
            choices.append(grid or [float(getattr(effect, p.field))])
    found = list(itertools.islice(itertools.product(*choices), _MOST_SHAPES))
    phases = (0.0, 0.5 * math.pi) if effect.oscillates else ()
    each = tuple(sizes[f] for f in strengths)
    return [
        Variant(
            with_fields(
                effect, {**silent, **dict(zip((p.field for p in shapes), values, strict=True))}
            ),
            strengths,
            each,
            phases,
            joint,
        )
        for values in found
    ]


def _finer(grid: Sequence[float]) -> list[float]:
    """A grid with values in between, geometrically, and one step beyond its lower end."""
    if len(grid) < 2:
        return list(grid)
    inner = [math.sqrt(a * b) for a, b in itertools.pairwise(grid)]
    return sorted([*grid, *inner, grid[0] * grid[0] / inner[0]])


def _frequencies(j: int, paths: Sequence[Path], modes: Sequence[float]) -> list[float]:
    """Frequencies, Hz, of what springs and dampers leave of the missing torque: the strongest of
    joint j, and those that stand out most at any joint."""
    longest = max(p.time[-1] for p in paths)
    # Far above the fastest mode nothing shows but noise, however short the step.
    most = min(max(1 / (3 * p.h) for p in paths), _ABOVE * max(modes, default=np.inf))
    frequency = np.arange(1.0, most * longest, 0.25) / longest
    power = np.sum([_power(path, frequency) for path in paths], axis=0)
    # The noise of a torque grows with frequency: what stands out of its surroundings counts, too,
    # and at every joint, for the sensor of the other one may be the one that sees it.
    around = 1 + 2 * round(_AROUND / (frequency[1] - frequency[0]) / longest)
    level = median_filter(power, (around, 1))
    contrast = np.max(power / np.maximum(level, 1e-300), axis=1)
    beside = resonant(frequency, modes, longest)
    found: list[float] = []
    for seen in (power[:, j], contrast):
        for _ in range(_LINES // 2):
            near = [np.abs(frequency - f) < 2 / longest for f in found]
            left = np.where(np.any([beside, *near], axis=0), 0.0, seen)
            found.append(float(frequency[np.argmax(left)]))
    # Beside a mode there is no line to be seen: the ringing outshines it.
    for mode in modes:
        near, far = _beats(mode, longest)
        found += [mode + s * (near + x * (far - near)) for s in (-1.0, 1.0) for x in _BETWEEN]
    return [f for f in found if 0.0 < f < most and not one_with(f, modes, longest)]


def _power(path: Path, frequency: np.ndarray) -> np.ndarray:
    """(F, n) spectrum of each joint's missing torque, less what its spring and damper could do."""
    # A few thousand instants tell all frequencies that an integration step can follow.
    means = (x.reshape(-1, _PARTS, x.shape[1]).mean(axis=1) for x in (path.missing, path.q, path.v))
    time = path.time.reshape(-1, _PARTS).mean(axis=1)
    window = np.hanning(len(time))
    turn = np.exp(-2j * np.pi * np.outer(frequency, time))
    each = []
    for missing, q, v in zip(*(x.T for x in means), strict=True):
        rows = np.stack([q, v, np.ones_like(q)], axis=1)
        left = missing - rows @ np.linalg.lstsq(rows, missing, rcond=None)[0]
        each.append(np.abs(turn @ (window * left)) ** 2)
    return np.stack(each, axis=1)
