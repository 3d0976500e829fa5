"""A recording at equal steps, and at no more of them than its slowest mode needs."""

import math

import numpy as np

from .outliers import outlier_mask


def evenly_sampled(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The recording at equal steps, missing readings and outliers filled in."""
    step = float(np.median(np.diff(time)))
    # A long pause of the logger must not make the even clock endless.
    step = max(step, (time[-1] - time[0]) / (10 * len(time)))
    clock = time[0] + step * np.arange(math.floor((time[-1] - time[0]) / step + 1e-6) + 1)
    good = np.isfinite(angle) & ~outlier_mask(time, angle)
    columns = [np.interp(clock, time[g], a[g]) for g, a in zip(good.T, angle.T, strict=True)]
    return clock, np.stack(columns, axis=1)


def decimated(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of so many samples after each other that 40 or more are left of the slowest period: all
    that a rest needs. Times (N,) s at equal steps and angles (N, n), as they come back."""
    many = int(slowest_period(angle - angle.mean(axis=0)) / 40)
    if many < 2:
        return time, angle
    whole = len(time) // many * many
    mean = lambda x: x[:whole].reshape(-1, many, *x.shape[1:]).mean(axis=1)  # noqa: E731
    return mean(time), mean(angle)


def slowest_period(motion: np.ndarray) -> float:
    """The period of the slowest mode, in samples, of motion (N, n) about zero."""
    count = len(motion)
    # Padded, so that a few swings in all are counted finely enough.
    shaped = motion * np.hanning(count)[:, None]
    power = np.abs(np.fft.rfft(shaped, 8 * count, axis=0)[8:]) ** 2
    large = power >= 0.02 * np.maximum(power.max(axis=0), 1e-300)
    peaks = large[1:-1] & (power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])
    first = min((int(np.flatnonzero(p)[0]) for p in peaks.T if p.any()), default=0)
    return 8 * count / (first + 9)
