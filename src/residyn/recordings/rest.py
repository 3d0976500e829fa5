"""Where an arm that rings would come to rest.

The mean of a ring-down is not its rest: the last swing is cut off anywhere, and an elbow that
swings wide pulls the arm aside, by the square of the swing. So means are taken under a window that
falls to zero at its ends, wide enough to let no swing through, and led back to where the squares
under the same window are none.
"""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from .resampling import decimated, evenly_sampled, slowest_period

_SWINGS = 8  # of the slowest mode, two of the best windows: with fewer, rest is known roughly
_WINDOWS = {
    4: (0.35875, -0.48829, 0.14128, -0.01168),
    3: (0.42, -0.5, 0.08),
    2: (0.5, -0.5),
}
"""Cosines of the window that spans so many swings: Blackman's and Harris', Blackman's, Hann's."""

_LEAK = 1e-3  # what a mean may be off, of the swing under its window
_STILL = 0.05  # of the largest swing: less may be an arm that sticks, anywhere
_ASIDE = 0.5  # how far a swing of one radian typically pulls an arm aside, rad


def rest_angles(motion: np.ndarray) -> np.ndarray:
    """(n,) rad: angles at rest, from a ring-down (N, n) rad at equal steps."""
    rest = motion.mean(axis=0)
    if not (np.ptp(motion, axis=0) > 1e-9).any():
        return rest
    window = _window(len(motion), slowest_period(motion - rest))
    step = max(1, len(window) // 8)
    n = motion.shape[1]
    for _ in range(3):
        swing = motion - rest
        squares = [swing[:, i] * swing[:, j] for i in range(n) for j in range(i, n)]
        means = _under(window, np.column_stack([swing, *squares]), step)
        size = np.sqrt(_under(window, (swing**2).sum(axis=1, keepdims=True), step)[:, 0])
        moving = size >= _STILL * size.max()
        means, size = means[moving], size[moving]
        off = _LEAK * (size + 0.1 * size.max())
        causes = np.column_stack([np.ones(len(means)), means[:, n:]]) / off[:, None]
        # How far squares pull aside is known beforehand to its typical size.
        ridge = np.diag([0.0] + [_ASIDE**-2] * (causes.shape[1] - 1))
        right = causes.T @ (means[:, :n] / off[:, None])
        rest = rest + np.linalg.lstsq(causes.T @ causes + ridge, right, rcond=None)[0][0]
    return rest


def estimated_rest(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(n,) rad: where a ring-down rests, and in words where that is known roughly."""
    _clock, motion = evenly_sampled(time, angle)
    count = len(motion) / slowest_period(motion - motion.mean(axis=0))
    warnings = [
        f"with {count:.2g} swings of the slowest mode its rest is known roughly: if the residual "
        "has an offset, fit sensor_offset too"
    ]
    return rest_angles(decimated(motion)), warnings if count < _SWINGS else []


def _window(count: int, period: float) -> np.ndarray:
    """A window of sum one that lets no swing of this period, in samples, or shorter through."""
    spans = next((k for k in _WINDOWS if k * period <= count), 2)
    width = min(count, math.ceil(spans * period))
    turn = 2 * np.pi * (np.arange(width) + 0.5) / width
    window = np.sum([a * np.cos(k * turn) for k, a in enumerate(_WINDOWS[spans])], axis=0)
    return window / window.sum()


def _under(window: np.ndarray, columns: np.ndarray, step: int) -> np.ndarray:
    """Weighted means of columns (N, k) under the window at every `step`-th place, (places, k)."""
    return sliding_window_view(columns, len(window), axis=0)[::step] @ window
