"""Decay of a mode in words that physics allows.

A mode falls to 1/e in 1 / (2 pi f zeta). An arm that nothing drives loses energy, so zeta > 0. A
fitted zeta below zero has no decay time: the mode grows, which is a statement about the fit, or
about what the recordings do not determine, and never about the arm.
"""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from ..fitting import Mode
from ..reporting.numbers import plain, with_error

if TYPE_CHECKING:
    from .unloaded import Unloading

_NORMAL = 1.96
"""Standard errors on each side of a 95 % interval."""


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


def decay_words(mode: Mode) -> str:
    """ "in 12.5 s (12.3 to 12.7)"; of a mode that grows, what that is."""
    found = decay_of(mode)
    if found is None:
        return "grows: not physical"
    value = f"in {plain(found.value, 3)} s"
    if math.isnan(found.low):
        return f"{value} (error not known)"
    if math.isinf(found.high):
        return f"{value} ({plain(found.low, 3)} or more)"
    low, high = plain(found.low, 3), plain(found.high, 3)
    return value if low == high else f"{value} ({low} to {high})"


def unphysical(found: "Unloading", remedy: str) -> Iterable[str]:
    """One line for each mode, with and without bearings, that no arm can have."""
    for pose in found.poses:
        sides = (
            ("without bearings", pose.without_bearings, pose.leaves_without),
            ("on the bearings", pose.with_bearings, pose.leaves_with),
        )
        for where, modes, leaves in sides:
            at = f"{where} (theta2 = {pose.theta2:.4g} rad)"
            if leaves:
                yield (
                    f"the arm {at} moves away from its rest instead of ringing about it: its "
                    "stiffness there is negative, which is not physical; these recordings do not "
                    f"determine its frequency; {remedy}"
                )
            for order, mode in enumerate(modes, 1):
                if decay_of(mode) is None:
                    yield f"mode {order} {at} {_grows(mode)}; {remedy}"


def _grows(mode: Mode) -> str:
    value, std = with_error(mode.damping_ratio, mode.damping_ratio_std)
    how = (
        "though by less than two standard errors" if not mode.grows else "as nothing drives the arm"
    )
    return (
        f"grows, with a damping ratio of {value} +/- {std}: not physical, {how}; these recordings "
        "do not determine how it decays"
    )
