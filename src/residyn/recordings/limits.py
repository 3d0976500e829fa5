"""What a rig can do: within which limits the next test may be planned, `[limits]` of the file."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import InputError, entries, number, quote


@dataclass(frozen=True)
class Limits:
    """Limits of the next tests. What is None is not limited beyond what `residyn plan` tries by
    itself: twice the angles and loads that were recorded, as long as the longest, every elbow
    angle, bearings on and off, no motor."""

    angle: Any = None
    """Largest angle at release, rad (m): a number, or one for each joint."""
    theta2: Any = None
    """Lowest and highest elbow angle at rest, rad (arm only)."""
    air_bearings: Any = None
    """true, false, or [true, false]: whether tests are made on the bearings, off them, or both."""
    extra_mass: Any = None
    """Least and largest load on the first coordinate, kg m^2 (kg if it slides); constant inertia
    only."""
    load: Any = None
    """Least and largest load on whatever rubs, N."""
    duration: Any = None
    """Longest recording, s."""
    drive: Any = None
    """Largest torque of the motors, N m (N): a number, or one for each joint; 0 for none."""

    def __post_init__(self):
        for field in dataclasses.fields(self):
            given = getattr(self, field.name)
            if given is not None:
                object.__setattr__(self, field.name, _checked(field.name, given))

    def check(self, joints: Sequence[str], arm: bool, bearings: bool) -> None:
        """**Raises:** `InputError` for a limit that does not go with the experiment."""
        for key in ("angle", "drive"):
            given = getattr(self, key)
            if isinstance(given, tuple) and len(given) != len(joints):
                raise InputError(
                    f"{key} = {quote(list(given))}: must be one number, or {len(joints)}, one for "
                    f"each joint ({', '.join(joints)})"
                )
        if self.theta2 is not None and not arm:
            raise InputError("theta2 is the elbow's angle of an [arm]; with [inertia] leave it out")
        if self.extra_mass is not None and arm:
            raise InputError("extra_mass is for [inertia] only; with [arm] leave it out")
        if self.air_bearings is not None and not bearings:
            raise InputError("air_bearings: there is no [[air_bearings]] table; leave it out")

    def each(self, key: str, joints: int) -> tuple[float, ...] | None:
        """`angle` or `drive` of every joint."""
        given = getattr(self, key)
        return given if given is None or isinstance(given, tuple) else (given,) * joints


_SIZES = {"angle": "rad or m", "drive": "N m or N"}
_RANGES = {"theta2": ("rad", -math.inf), "extra_mass": ("kg m^2 or kg", 0.0), "load": ("N", 0.0)}


def _checked(key: str, given: Any) -> Any:
    """A limit as it is kept: one number or a tuple."""
    if key == "duration":
        return number(key, given, "s", above=0)
    if key in _RANGES:
        unit, least = _RANGES[key]
        right = f"two numbers ({unit}), the lower one first, as [a, b]"
        low, high = (number(key, x, unit) for x in entries(key, given, right, 2))
        if not least <= low <= high:
            raise InputError(f"{key} = {quote(list(given))}: must be {right}")
        return low, high
    several = isinstance(given, list | tuple)
    each = tuple(given) if several else (given,)
    if key in _SIZES:
        each = tuple(number(key, x, _SIZES[key], least=0) for x in each)
        if key == "angle" and not any(each):
            raise InputError(f"{key} = {quote(given)}: must be above 0 somewhere ({_SIZES[key]})")
        return each if several else each[0]
    if not each or not all(isinstance(x, bool) for x in each):
        raise InputError(f"{key} = {quote(given)}: must be true, false or [true, false]")
    return tuple(dict.fromkeys(each))
