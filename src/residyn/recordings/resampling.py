"""A recording at equal steps, and at no more of them than are needed."""

import math
from typing import cast

import numpy as np
from scipy.fft import next_fast_len

from .outliers import outlier_mask

_STILL = 0.05  # of all that a joint moves: less may be one that sticks, anywhere


def even_step(time: np.ndarray) -> float:
    """The median step of `time` (N,), s, or as long a one that equal steps are 10 N at most: a long
    pause of the logger must not make an even clock endless."""
    return max(float(np.median(np.diff(time))), float(time[-1] - time[0]) / (10 * len(time)))


def evenly_sampled(
    time: np.ndarray, angle: np.ndarray, outliers: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The recording at equal steps, missing readings and outliers (N, n) filled in, which are
    looked for if they are not known."""
    step = even_step(time)
    clock = time[0] + step * np.arange(math.floor((time[-1] - time[0]) / step + 1e-6) + 1)
    outliers = outlier_mask(time, angle) if outliers is None else outliers
    good = np.isfinite(angle) & ~outliers
    columns = [np.interp(clock, time[g], a[g]) for g, a in zip(good.T, angle.T, strict=True)]
    return clock, np.stack(columns, axis=1)


def decimated(motion: np.ndarray) -> np.ndarray:
    """Means of so many samples after each other that 40 or more are left of the slowest period: all
    that a rest needs, of angles (N, n) at equal steps."""
    many = int(slowest_period(while_moving(motion)) / 40)
    return motion if many < 2 else block_means(motion, many)


def moving_counts(motion: np.ndarray) -> np.ndarray:
    """(n,) how many samples of motion (N, n) it takes until each joint stays where it is."""
    back = motion[::-1]
    spans = (np.maximum.accumulate(back) - np.minimum.accumulate(back))[::-1]
    return np.maximum((spans > _STILL * spans[0]).sum(axis=0), 1)


def while_moving(motion: np.ndarray) -> np.ndarray:
    """Motion (N, n) until all joints stay where they are."""
    return motion[: moving_counts(motion).max()]


def slowest_period(motion: np.ndarray) -> float:
    """The period of the slowest mode, in samples, of motion (N, n); of a single sample, which shows
    no frequency, its own length."""
    count = len(motion)
    # Padded, so that a few swings in all are counted finely enough.
    window = np.hanning(count + 2)[1:-1]
    shaped = (motion - window @ motion / window.sum()) * window[:, None]
    length = cast(int, next_fast_len(8 * count, real=True))
    power = np.abs(np.fft.rfft(shaped, length, axis=0)[8:]) ** 2
    large = power >= 0.02 * np.maximum(power.max(axis=0, initial=0.0), 1e-300)
    peaks = large[1:-1] & (power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])
    first = min((int(np.flatnonzero(p)[0]) for p in peaks.T if p.any()), default=0)
    return length / (first + 9)


def moving_means(x: np.ndarray, width: int) -> np.ndarray:
    """(N - width + 1, ...) means of so many rows of x (N, ...), from each one on."""
    total = np.cumsum(np.concatenate([np.zeros_like(x[:1]), x]), axis=0)
    return (total[width:] - total[:-width]) / width


def block_means(x: np.ndarray, many: int) -> np.ndarray:
    """Means of so many rows after each other of x (N,) or (N, n); NaN where more than half of them
    are missing. A rest of fewer rows is left out."""
    blocks = x[: len(x) // many * many].reshape(-1, many, *x.shape[1:])
    seen = np.isfinite(blocks)
    total = np.where(seen, blocks, 0.0).sum(axis=1)
    count = seen.sum(axis=1)
    return np.where(2 * count >= many, total / np.maximum(count, 1), np.nan)
