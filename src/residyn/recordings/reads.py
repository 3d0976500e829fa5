"""What a sensor reads of a joint: its angle, its rate or its acceleration.

An encoder reads angles, a gyroscope rates, an accelerometer accelerations: the derivative of order
0, 1 or 2 of one and the same motion. A fit predicts that derivative, and compares it with what was
read. Nothing is integrated there: the integral of white noise is no white noise any more. Only
first guesses and typical sizes want angles, and for those an integral without its slow drift will
do (`angles_from`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError, quote
from .resampling import evenly_sampled, moving_means, slowest_period

READS = ("angle", "rate", "acceleration")
"""By the order of the derivative."""
PER_TIME = ("", "/s", "/s^2")


def check_reads(reads: Any, joints: int) -> tuple[str, ...]:
    """What is read of each joint, from one word for all of them or a list.

    **Raises:** `InputError`.
    """
    known = ", ".join(quote(x) for x in READS)
    words = [reads] * joints if isinstance(reads, str) else reads
    if not isinstance(words, list | tuple) or any(x not in READS for x in words):
        raise InputError(f"reads = {quote(reads)}: must be {known}, or a list of these")
    if len(words) != joints:
        raise InputError(
            f"reads = {quote(reads)}: must have one word for each of {joints} joints ({known})"
        )
    return tuple(words)


def reading_units(units: Sequence[str] | None, orders: Sequence[int]) -> tuple[str, ...] | None:
    """The units of readings, where joints are in these units: "rad/s" of a rate."""
    if units is None:
        return None
    return tuple(u + PER_TIME[k] for u, k in zip(units, orders, strict=True))


def angles_from(time: np.ndarray, reading: np.ndarray, orders: Sequence[int]) -> np.ndarray:
    """Angles (N, n) that go roughly with readings (N, n) of these orders: integrated, and after
    each integral the mean over one period of the slowest mode taken off. Constants of integration,
    the drift of a sensor and an arm's own creep leave with it.
    """
    found = np.array(reading)
    clock, even = evenly_sampled(time, reading)
    step = clock[1] - clock[0]
    period = min(round(slowest_period(even)), len(clock))
    for j, order in enumerate(orders):
        x = even[:, j] - np.mean(even[:, j])
        for _ in range(order):
            x = np.append(0.0, np.cumsum(0.5 * step * (x[1:] + x[:-1])))
            # Near the ends the period over which means are taken stays inside.
            first = np.clip(np.arange(len(x)) - period // 2, 0, len(x) - period)
            x = x - moving_means(x, period)[first]
        if order:
            found[:, j] = np.where(np.isfinite(found[:, j]), np.interp(time, clock, x), np.nan)
    return found
