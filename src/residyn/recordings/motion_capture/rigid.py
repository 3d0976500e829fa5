"""What of a chain of markers never changes: where its base stands, and how long its links are.

Labels can be wrong, geometry cannot. In every frame some marker is at the base's place, some marker
is one link's length from there, some other the next link's length from that one. So each of these
is found as the value that most frames have, whatever the markers are called; labels decide only
where the motion is too small to tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError

_FRAMES = 1500  # frames that are looked at to find what most of them have
_PLACES = 400  # places that are tried for the base
_AS_GOOD = 0.05  # a value that so few frames fewer have is as good: labels then decide
# Scatter, of the firmest value's, with which a value is still believed for its label's sake: where
# all frames agree on the label, and where they are split evenly.
_UNANIMOUS, _SPLIT = 4.0, 1.3
_FAR = 0.2  # a link this much (relative) longer or shorter than known is another one
_FLOOR = 3e-5  # of the arm's size: scatter below this is rounding


@dataclass(frozen=True, eq=False)
class Rigid:
    """A chain's constants, in m."""

    base: np.ndarray  # (3,) place of the first joint
    base_sigma: float  # its scatter, one coordinate's
    lengths: np.ndarray  # (n,) of the links
    sigmas: np.ndarray  # (n,) their scatter
    unsure: tuple[int, ...] = ()
    """Joints whose label changes, and that neither the motion nor a known length tells apart."""


def find(markers: np.ndarray, lengths: Sequence[float] | None = None) -> Rigid:
    """The constants of a chain, from labels that may be wrong in any frames.

    **Arguments:** `markers` (N, n + 1, 3) m, base to tip, NaN where lost; `lengths` of the links
    if known, m, to choose between what the motion cannot tell apart.
    """
    seen = np.flatnonzero((~np.isnan(markers[:, :, 0])).sum(axis=1) >= markers.shape[1])
    if len(seen) < 20:
        raise InputError(
            f"only {len(seen)} frames have all of these markers; at least 20 are needed"
        )
    picked = markers[seen[np.linspace(0, len(seen) - 1, min(len(seen), _FRAMES)).astype(int)]]
    rows, joints = np.arange(len(picked)), picked.shape[1]
    size = float(np.median(np.linalg.norm(np.diff(picked, axis=1), axis=2)))
    near = max(6 * _jitter(markers), 2e-3 * size, 1e-9)
    base, sure = _place(picked, near)
    found, unsure = [], [] if sure else [0]
    # The marker at each joint, found from the base outwards.
    free = np.ones(picked.shape[:2], dtype=bool)
    at = np.linalg.norm(picked - base, axis=2).argmin(axis=1)
    for j in range(1, joints):
        free[rows, at] = False
        before = base if j == 1 else picked[rows, at][:, None]  # the base is known better
        away = np.linalg.norm(picked - before, axis=2)
        away[~free] = np.inf
        length, sure = _length(away, j, near, lengths[j - 1] if lengths is not None else None)
        found.append(length)
        unsure += [] if sure else [j]
        at = np.abs(away - length).argmin(axis=1)
    sigma = max(near / 3, _FLOOR * size)
    return Rigid(base, sigma, np.array(found), np.full(joints - 1, sigma), tuple(unsure))


def refine(joints: np.ndarray, before: Rigid) -> Rigid:
    """The same constants from markers (N, n + 1, 3) that are at their joints, NaN where none is."""
    base = np.nanmedian(joints[:, 0], axis=0)
    floor = _FLOOR * float(np.mean(before.lengths))
    links = np.linalg.norm(np.diff(joints, axis=1), axis=2)
    lengths = np.nanmedian(links, axis=0)
    sigmas = np.maximum([_spread(off) for off in (links - lengths).T], floor)
    return Rigid(base, max(_spread(joints[:, 0] - base), floor), lengths, sigmas, before.unsure)


def _spread(x: np.ndarray) -> float:
    """Standard deviation of what is centred on zero, blind to outliers."""
    return 1.4826 * float(np.nanmedian(np.abs(x)))


def _jitter(markers: np.ndarray) -> float:
    """Noise of one coordinate of the quietest marker, m."""
    third = np.diff(markers, 3, axis=0)
    sizes = [_spread(m) for m in third.swapaxes(0, 1) if np.isfinite(m).any()]
    return min(sizes, default=0.0) / 20**0.5  # third differences of white noise


def _place(picked: np.ndarray, near: float) -> tuple[np.ndarray, bool]:
    """Where in most frames some marker is, and whether that is sure; else the first one's."""
    pool = picked.reshape(-1, 3)
    places = pool[np.linspace(0, len(pool) - 1, _PLACES).astype(int)]
    # As many of the first marker's own, so that a tie has its place among the candidates.
    own = picked[np.linspace(0, len(picked) - 1, _PLACES // 4).astype(int), 0]
    values = []
    for place in np.concatenate([places, own]):
        away = np.linalg.norm(picked - place, axis=2)
        here = away < near
        values.append(_Value(place, here, _spread(away[here])))
    best, sure = _most(values, 0)
    return np.median(picked[best.here], axis=0), sure


def _length(away: np.ndarray, j: int, near: float, known: float | None) -> tuple[float, bool]:
    """The same of a distance; else the j-th one's."""
    pool = away[np.isfinite(away)]
    values = []
    for length in np.quantile(pool, np.linspace(0, 1, _PLACES)):
        here = np.abs(away - length) < near
        if not here.any():
            continue
        middle = np.median(away[here])
        values.append(_Value(middle, here, _spread(away[here] - middle)))
    best, sure = _most(values, j, known)
    return float(np.median(away[best.here])), sure


class _Value(NamedTuple):
    """A value that a constant may have."""

    value: Any
    here: np.ndarray  # (frames, n + 1) bool: which markers have it
    scatter: float


def _most(values: list[_Value], label: int, known: float | None = None) -> tuple[_Value, bool]:
    """The value that most frames have, and of those as good, what its label or its scatter says;
    and whether that is sure: none other is about as firm, or frames agree on the label."""
    frames = np.array([each.here.any(axis=1).mean() for each in values])
    good = [v for v, count in zip(values, frames, strict=True) if count >= frames.max() - _AS_GOOD]
    if known is not None:  # decides between what is as good, and cannot make anything so
        good = [each for each in good if abs(each.value - known) < _FAR * known] or good
    own = [float(each.here[:, label].mean()) for each in good]
    named = good[int(np.argmax(own))]
    firm = min(good, key=lambda each: each.scatter)
    # Labels that never change are believed for long; ones that do, hardly more than chance asks.
    share = min(max(own) / max(float(named.here.any(axis=1).mean()), 1e-9), 1.0)
    believed = _SPLIT + (_UNANIMOUS - _SPLIT) * max(2 * share - 1, 0) ** 6
    best = firm if named.scatter > believed * firm.scatter else named
    rivals = [
        each
        for each in good
        if each.scatter < _UNANIMOUS * best.scatter
        and (each.here & best.here).sum() < 0.5 * best.here.sum()
    ]
    return best, not rivals or share > 0.97
