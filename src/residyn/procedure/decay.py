"""When a mode has decayed, where physics allows it.

A mode falls to 1/e in 1 / (2 pi f zeta). An arm that nothing drives loses energy, so zeta > 0. A
fitted zeta below zero has no decay time: the mode grows, which is a statement about the fit, or
about what the recordings do not determine, and never about the arm.
"""

import math
from typing import NamedTuple

from ..fitting import Mode

_NORMAL = 1.96  # standard errors on each side of a 95 % interval


class Decay(NamedTuple):
    """Time to 1/e (s) and its 95 % interval; `high` is inf where the interval of the rate holds
    zero, `low` and `high` are NaN where the recordings leave the damping open."""

    value: float
    low: float
    high: float


def decay_of(mode: Mode) -> Decay | None:
    """When a mode has fallen to 1/e; None for one that grows.

    The relative errors of frequency and damping ratio are added: the most that any correlation of
    the two makes of them.
    """
    rate = 2 * math.pi * mode.frequency_hz * mode.damping_ratio
    if not rate > 0:
        return None
    share = mode.frequency_hz_std / mode.frequency_hz + mode.damping_ratio_std / mode.damping_ratio
    if not math.isfinite(share):
        return Decay(1 / rate, math.nan, math.nan)
    least = rate * (1 - _NORMAL * share)
    high = 1 / least if least > 0 else math.inf
    return Decay(1 / rate, 1 / (rate * (1 + _NORMAL * share)), high)
