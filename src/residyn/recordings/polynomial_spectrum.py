"""The polynomial spectrum of a recording: motion is in the low degrees, noise is in all of them.

Cut the readings of a joint into short blocks and express each in polynomials, degree by degree,
orthonormal on the block's own sample times (so uneven sampling and missing readings do not matter).
Motion is smooth: its share falls faster than exponentially with the degree and is gone after a few.
White noise has the same size in every degree. From the degree where the spectrum turns flat only
noise is left, without any model of the motion.
"""

import math
from typing import NamedTuple

import numpy as np

_BLOCK = 32  # readings per block: noise fills most degrees, and a slow motion is longer
_TINY = 1e-100  # motion smaller than this is none


def scaled(column: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Where a joint was read, its readings in units of their range, and that; 0 if none."""
    seen = np.flatnonzero(np.isfinite(column))
    values = column[seen]
    unit = float(np.ptp(values)) if len(seen) else 0.0
    if unit < _TINY:
        return seen, np.zeros(len(seen)), 0.0
    return seen, (values - np.median(values)) / unit, unit


def grid_step(values: np.ndarray) -> float:
    """The grid that readings lie on (an encoder's step, a printout's last digit); 0 for none."""
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > 1e-10 * np.ptp(values)]  # less is arithmetic's own rounding
    if not len(gaps):
        return 0.0
    least = float(gaps.min())
    # Steps between neighbours only: over the whole range a printout's rounding would add up.
    near = gaps[gaps <= 1.5 * least]
    step = float(near.mean())
    counts = gaps / step
    on_grid = np.mean(np.abs(counts - np.rint(counts)) < 0.1) >= 0.99
    return step if on_grid else 0.0


def parts(index: np.ndarray) -> list[np.ndarray]:
    """`index` in pieces that fit in memory."""
    return np.array_split(index, math.ceil(len(index) / 100_000))


class Blocks(NamedTuple):
    """Short blocks of one joint's readings, each expressed in polynomials."""

    first: np.ndarray  # (B,) index of each block's first reading; neighbours overlap by half
    basis: np.ndarray
    """(B, m, m), or (1, m, m) for all of them, orthonormal: column k is a polynomial of degree k,
    the last quarter is the rest."""
    share: np.ndarray  # (B, m) what each column holds of the readings
    degree: int  # the first degree that holds nothing but noise
    spread: float  # robust standard deviation of the shares from there on


def blocks(time: np.ndarray, values: np.ndarray) -> Blocks:
    """The polynomial spectrum of one joint's readings, scaled."""
    m = int(np.clip(len(time) // 4, 8, _BLOCK))
    first = np.unique(np.append(np.arange(0, len(time) - m, m // 2), len(time) - m))
    span = time[first + m - 1] - time[first]
    first = first[span <= 2 * np.median(span)]  # across a long gap nothing is smooth
    index = first[:, None] + np.arange(m)
    t, y = time[index], values[index]
    x = 2 * (t - t[:, :1]) / (t[:, -1:] - t[:, :1]) - 1
    top = 3 * m // 4  # the highest degrees need no names, and are ill-conditioned
    if np.ptp(x, axis=0).max() < 1e-6 / m:
        x = x[:1]  # evenly sampled: one basis serves all blocks
    basis = np.linalg.qr(np.polynomial.legendre.legvander(x, top - 1), mode="complete")[0]
    share = ((y - y.mean(axis=1, keepdims=True))[:, None] @ basis)[:, 0]
    # An encoder at rest says nothing of the noise, and where the motion ends must be seen where it
    # is at its largest.
    moves = np.ptp(y, axis=1) > 1e-14
    if not moves.any():
        return Blocks(first, basis, share, 1, 0.0)
    size = np.median(np.abs(y - np.median(y, axis=1, keepdims=True)), axis=1)
    lively = moves & (size >= min(0.3 * size.max(), np.sort(size)[-min(8, len(size))]))
    lively = np.flatnonzero(lively)
    live = share[lively[:: max(1, len(lively) // 1000)]]
    # Down from the top while the next degree is as small as all above it, within its statistics;
    # then up again by two, past motion that was too small to be noticed.
    limit = math.sqrt(1 + 3 * math.sqrt(4 / len(live)))
    each = spread(live)
    above = np.sqrt(np.cumsum(each[::-1] ** 2) / np.arange(1, m + 1))[::-1]
    degree = top
    while degree > 1 and each[degree - 1] <= limit * above[degree]:
        degree -= 1
    degree = min(degree + 2, top)
    left = spread(share[moves, degree:].reshape(-1, 1))[0]
    return Blocks(first, basis, share, degree, float(left))


def spread(values: np.ndarray) -> np.ndarray:
    """Standard deviation about zero of each column of (N, K) values, blind to a minority of
    outliers: clipped at three sigma."""
    count = len(values)
    half = (count - 1) // 2, count // 2
    size = np.abs(values)
    square = size**2
    # Not `np.median`: of columns this short it would take longer than all the rest.
    middle = np.partition(size, sorted(set(half)), axis=0)
    sigma = 1.4826 * 0.5 * (middle[half[0]] + middle[half[1]])
    for _ in range(10):
        kept = square <= 9 * sigma**2
        # 0.97334: the variance of a normal variable that is kept within three sigma.
        mean = (square * kept).sum(axis=0) / kept.sum(axis=0)
        new = np.sqrt(mean / 0.97334)
        if (np.abs(new - sigma) <= 1e-4 * sigma).all():
            break
        sigma = new
    return sigma
