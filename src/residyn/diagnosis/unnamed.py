"""Torques of any shape: what is left, seen by someone who expects no particular effect.

A test of the residual's whiteness looks everywhere with equal suspicion, and so misses what is
small but all in one place. Here the same question is asked of torques: would one that depends on
the angle in whatever way, or on the rate, or that acted for a moment only, explain more than noise
lets it? If so, something is left, even if no effect of the catalogue is it.

Under noise alone chi-square falls by a chi-square variable of as many degrees of freedom as the
shape has, along any directions that were fixed beforehand: so the answers of an earlier model along
the ladder serve for a later one.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2 as chi_square

from .answers import Answers, Column, seen_from
from .elimination import Solver
from .linear import Near
from .path import Path

_HATS = (5, 13)  # pieces of a law's range: the coarse one is surer, the fine one sees a magnet
_POWERS = (3, 5)  # odd: what a law that stiffens or brakes begins with
_MOMENTS = (8, 24)  # pieces of a recording
_MOST = 60  # moments in all: many recordings have fewer each
_SHARE = 1e-5  # of a column's square that must be left beside the model's own unknowns
_BLIND = 1e-8


class Shape(NamedTuple):
    """A family of torques: columns `first` to `last` of those that `shapes` made."""

    words: str
    """What the torque would be: "depends on the angle of the elbow"."""
    strange: bool
    """Whether no effect of the catalogue is just that."""
    first: int
    last: int


class Law(NamedTuple):
    """What one family of torques would explain."""

    words: str
    drop: float
    """By how much chi-square falls with it."""
    freedom: int
    """How many numbers it has."""


class Unnamed(NamedTuple):
    """How a residual looks to torques of any shape."""

    p: float
    """Probability that noise alone would let the best of them explain as much, corrected for their
    number; 1 if there are none."""
    words: str
    """What the best one would be."""
    drop: float
    """By how much chi-square falls with it."""
    law: Law | None = None
    """The one of no catalogue that explains most for its numbers, each worth the logarithm of the
    number of readings."""


def shapes(near: Near, paths: Sequence[Path]) -> tuple[list[Column], list[Shape]]:
    """Torques of any shape along some motion, as columns, and what they are."""
    columns: list[Column] = []
    found: list[Shape] = []
    for words, strange, torques in _families(near, paths):
        found.append(Shape(words, strange, len(columns), len(columns) + len(torques)))
        columns += torques
    return columns, found


def _families(near: Near, paths: Sequence[Path]) -> Iterator[tuple[str, bool, list[Column]]]:
    none: list[np.ndarray | None] = [None] * len(paths)
    for j, joint in enumerate(near.fit.joints):
        for words, of in (("angle", [p.q for p in paths]), ("rate", [p.v for p in paths])):
            for i, laws in enumerate(_laws([x[:, j] for x in of])):
                yield (
                    f"depends on the {words} of the {joint}",
                    (words, i) != ("angle", 0),  # which is cubic stiffness
                    [Column([_line(*x, j) for x in zip(paths, law, strict=True)], none)
                     for law in laws],
                )  # fmt: skip
        for r, path in enumerate(paths):
            of = f" of {near.fitted[r].recording.name}" if len(paths) > 1 else ""
            for when, pulses in _pulses(path, len(paths)):
                at = near.fitted[r].recording.time[0] + when
                each = [[_line(path, x, j) if i == r else None for i in range(len(paths))]
                        for x in pulses]  # fmt: skip
                words = f"acted on the {joint} about {at:.3g} s{of}"
                yield words, True, [Column(lines, none) for lines in each]


def _laws(of: Sequence[np.ndarray]) -> Iterator[list[list[np.ndarray]]]:
    """Laws of an angle or a rate, (G,) for each recording: families of one or several."""
    every = np.concatenate(of)
    most = float(np.abs(every).max()) or 1.0
    for power in _POWERS:
        yield [[(x / most) ** power for x in of]]
    low, high = float(every.min()), float(every.max())
    for count in _HATS:
        width = (high - low) / (count - 1) or 1.0
        yield [[_hat((x - m) / width) for x in of] for m in np.linspace(low, high, count)]


def _pulses(path: Path, recordings: int) -> Iterator[tuple[float, list[np.ndarray]]]:
    """Moments, s from the first sample, and torques that act about then only."""
    for count in _MOMENTS:
        count = min(count, max(4, _MOST // recordings))
        width = float(path.time[-1]) / count
        for k in range(count):
            when = (k + 0.5) * width
            # Two, half a width apart: a push of any sign at each end.
            yield when, [_hat((path.time - when) / width + side) for side in (0.25, -0.25)]


def unnamed(
    near: Near, slopes: Sequence[np.ndarray], kept: Answers, begin: int, found: Sequence[Shape]
) -> Unnamed:
    """What torques of any shape would explain of a fit's residual; `kept` has their answers from
    column `begin` on, `slopes` are the model's own, as from `near.look`."""
    if not found:
        return Unnamed(1.0, "", 0.0)
    solver = Solver.of(near, seen_from(near, slopes, kept))
    readings = near.readings
    scale = max(1.0, solver.alone / readings)
    best, laws = Unnamed(1.0, "", 0.0), []
    for shape in found:
        which = np.arange(begin + shape.first, begin + shape.last)
        drop, freedom = _drop(solver, which)
        p = float(chi_square.sf(drop / scale, freedom)) if freedom else 1.0
        if shape.strange:
            laws.append(Law(shape.words, drop, freedom))
        if p < best.p:
            best = Unnamed(p, shape.words, drop)
    p = -np.expm1(len(found) * np.log1p(-best.p)) if best.p < 1 else 1.0
    price = scale * math.log(readings)
    return best._replace(p=float(p), law=max(laws, key=lambda x: x.drop - price * x.freedom))


def _line(path: Path, torque: np.ndarray, joint: int) -> np.ndarray:
    """A torque (G,) on one joint as straight lines (2, M, n)."""
    full = np.zeros_like(path.q)
    full[:, joint] = torque
    return path.lines(full)


def _hat(x: np.ndarray) -> np.ndarray:
    return np.maximum(0.0, 1.0 - np.abs(x))


def _drop(solver: Solver, which: np.ndarray) -> tuple[float, int]:
    """By how much chi-square falls with some columns, and how many of them are independent."""
    which = which[np.diag(solver.square)[which] > _SHARE * solver.whole[which]]
    if not len(which):
        return 0.0, 0
    square, slope = solver.square[np.ix_(which, which)], solver.slope[which]
    size = np.sqrt(np.diag(square))
    values, vectors = np.linalg.eigh(square / size / size[:, None])
    use = values > _BLIND * values[-1]
    along = vectors[:, use].T @ (slope / size)
    return float(np.sum(along**2 / values[use])), int(use.sum())
