"""What a rig can do: within which limits the next test may be planned, `[limits]` of the file."""

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
    """Least and largest load on the first coordinate, kg (constant inertia only)."""
    load: Any = None
    """Least and largest load on whatever rubs, N."""
    duration: Any = None
    """Longest recording, s."""
    drive: Any = None
    """Largest torque of the motors, N m (N): a number, or one for each joint; 0 for none."""

    def __post_init__(self):
        for key, unit in (("angle", "rad or m"), ("drive", "N m or N")):
            given = getattr(self, key)
            if given is not None:
                several = isinstance(given, list | tuple)
                each = [number(key, x, unit, least=0) for x in (given if several else [given])]
                if not each or (key == "angle" and not any(each)):
                    raise InputError(f"{key} = {quote(given)}: must be above 0 somewhere ({unit})")
                object.__setattr__(self, key, tuple(each) if several else each[0])
        for key, unit, least in (
            ("theta2", "rad", -math.inf),
            ("extra_mass", "kg", 0.0),
            ("load", "N", 0.0),
        ):
            given = getattr(self, key)
            if given is not None:
                right = f"two numbers ({unit}), the lower one first, as [a, b]"
                low, high = (number(key, x, unit) for x in entries(key, given, right, 2))
                if not least <= low <= high:
                    raise InputError(f"{key} = {quote(list(given))}: must be {right}")
                object.__setattr__(self, key, (low, high))
        if self.duration is not None:
            object.__setattr__(self, "duration", number("duration", self.duration, "s", above=0))
        given = self.air_bearings
        if given is not None:
            each = tuple(given) if isinstance(given, list | tuple) else (given,)
            if not each or not all(isinstance(x, bool) for x in each):
                raise InputError(
                    f"air_bearings = {quote(given)}: must be true, false or [true, false]"
                )
            object.__setattr__(self, "air_bearings", tuple(dict.fromkeys(each)))

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
