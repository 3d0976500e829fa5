"""Where an arm that rings would come to rest.

The mean of a ring-down is not its rest: the last swing is cut off anywhere, an elbow that swings
wide pulls the arm aside, by the square of the swing, and a joint with dry friction stops anywhere
near its rest. So means are taken while a joint moves, under a window that falls to zero at its
ends, wide enough to let no swing through, and led back to where the squares under it are none.
"""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from .resampling import decimated, evenly_sampled, moving_counts, slowest_period, while_moving

_SWINGS = 8  # of the slowest mode, two of the best windows: with fewer, rest is known roughly
_WINDOWS = {
    4: (0.35875, -0.48829, 0.14128, -0.01168),
    3: (0.42, -0.5, 0.08),
}
"""Cosines of the window that spans so many swings: Blackman's and Harris', Blackman's."""

_LEAK = 1e-3  # what a mean may be off, of the swing under its window
_LEAK_OF_MEANS = 0.03  # the same of a triangle over two swings
_ASIDE = 0.5  # how far a swing of one radian typically pulls an arm aside, rad


def rest_angles(motion: np.ndarray) -> np.ndarray:
    """(n,) rad: angles at rest, from a ring-down (N, n) rad at equal steps."""
    rest = motion.mean(axis=0)
    if not (np.ptp(motion, axis=0) > 1e-9).any():
        return rest
    period = slowest_period(while_moving(motion))
    # Less than a swing tells no rest, however early the joint stops.
    counts = np.maximum(moving_counts(motion), math.ceil(2 * period))
    n = motion.shape[1]
    for _ in range(3):
        swing = motion - rest
        squares = [swing[:, i] * swing[:, j] for i in range(n) for j in range(i, n)]
        size = (swing**2).sum(axis=1)
        columns = np.column_stack([swing, *squares, size])
        rest = rest + [_aside(columns[:count], j, n, period) for j, count in enumerate(counts)]
    return rest


def _aside(columns: np.ndarray, joint: int, n: int, period: float) -> float:
    """How far a joint's rest is from zero, while it moves, by all joints' angles, their squares and
    the sum of those, (N, n + ... + 1)."""
    window, leak = _window(len(columns), period)
    step = max(1, len(window) // 8)  # from one place of the window to the next
    means = sliding_window_view(columns, len(window), axis=0)[::step] @ window
    size = np.sqrt(means[:, -1])
    off = leak * (size + 0.1 * size.max())
    causes = np.column_stack([np.ones(len(means)), means[:, n:-1]]) / off[:, None]
    # How far squares pull aside is known beforehand to its typical size.
    ridge = np.diag([0.0] + [_ASIDE**-2] * (causes.shape[1] - 1))
    right = causes.T @ (means[:, joint] / off)
    return np.linalg.lstsq(causes.T @ causes + ridge, right, rcond=None)[0][0]


def estimated_rest(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(n,) rad: where a ring-down rests, and in words where that is known roughly."""
    _clock, motion = evenly_sampled(time, angle)
    count = moving_counts(motion).min() / slowest_period(while_moving(motion))
    warnings = [
        f"with {count:.2g} swings of the slowest mode its rest is known roughly: diagnose "
        "estimates what it is off; for a fit whose residual has an offset give rest as a list, or "
        'add --with sensor_offset, with several recordings own = ["sensor_offset"] in all of these '
        "but one"
    ]
    return rest_angles(decimated(motion)), warnings if count < _SWINGS else []


def _window(count: int, period: float) -> tuple[np.ndarray, float]:
    """A window of sum one that lets no swing of this period, in samples, or shorter through, and
    what it lets through of one."""
    spans = next((k for k in _WINDOWS if k * period <= count), None)
    if spans is None:
        # Means over a swing of means over a swing: its decay does not come through either.
        swing = min(count, round(period))
        window = np.convolve(np.ones(swing), np.ones(min(swing, count - swing + 1)))
        return window / window.sum(), _LEAK_OF_MEANS
    width = math.ceil(spans * period)
    turn = 2 * np.pi * (np.arange(width) + 0.5) / width
    window = np.sum([a * np.cos(k * turn) for k, a in enumerate(_WINDOWS[spans])], axis=0)
    return window / window.sum(), _LEAK
