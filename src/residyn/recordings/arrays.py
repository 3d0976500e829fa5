"""What arrays must be to be a recording: a time that goes on, readings that are numbers.

A reading may be missing (NaN); a time may not, and neither may a force for long.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import LARGEST, InputError, number

_SHORTEST = 1e-9  # s, which nothing reads an arm in
LEAST = 20  # readings per joint below which there is nothing to fit


def check_table(time: Any, angle: Any, what: str = "angle") -> tuple[np.ndarray, np.ndarray]:
    """Copies of time (N,) and angle (N, n), checked to be a recording; NaN is a missing one."""
    time, angle = _floats(time, "time", "(N,)"), _floats(angle, what, "(N,) or (N, joints)")
    if time.ndim != 1:
        raise InputError(f"time has shape {time.shape}; it must be (N,)")
    angle = angle[:, None] if angle.ndim == 1 else angle
    if angle.ndim != 2 or len(angle) != len(time) or not angle.shape[1]:
        raise InputError(
            f"{what} has shape {angle.shape}; it must be ({len(time)}, joints), a row per time"
        )
    check_time(time, lambda i: f"sample {i}")
    if len(time) > 1 and (step := float(np.median(np.diff(time)))) < _SHORTEST:
        raise InputError(f"t goes up by {step:.3g} s, too short a step for a reading; is it in s?")
    return time, angle


def check_time(time: np.ndarray, where: Callable[[int], str]) -> None:
    """That time (N,) is known and increases; `where` says which sample one is."""
    missing = np.flatnonzero(np.isnan(time))
    if len(missing):
        raise InputError(f"{where(missing[0])} has no time")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        i = int(back[0]) + 1
        raise InputError(
            f"{where(i)}: t = {time[i]:.12g} does not come after the t = {time[i - 1]:.12g} "
            "before it; time must increase"
        )


def _floats(values: Any, what: str, shape: str) -> np.ndarray:
    try:
        if np.asarray(values).dtype.kind in "cmM":  # complex, or dates, which have their own unit
            raise TypeError
        if isinstance(values, np.ma.MaskedArray):
            values = np.where(np.ma.getmaskarray(values), np.nan, values.data)
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what} must be an array of numbers, of shape {shape}") from None
    # NaN passes: it compares as false.
    if (np.abs(array) > LARGEST).any():
        raise InputError(f"{what} has infinite or absurdly large numbers")
    return array


def check_drive(
    drive: Any, time: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray | None, list[str]]:
    """The drive, shaped as `angle`, with gaps filled; and what was done, in words."""
    if drive is None:
        return None, []
    _, force = check_table(time, drive, "drive")
    if force.shape != angle.shape:
        raise InputError(f"drive has shape {force.shape}; it must be {angle.shape} like angle")
    warnings = []
    for j, column in enumerate(force.T):
        missing = np.isnan(column)
        if missing.all():
            raise InputError(f"u{j + 1} has no value at all; leave it out if there is no drive")
        if missing.any():
            column[missing] = np.interp(time[missing], time[~missing], column[~missing])
            count = int(np.count_nonzero(missing))
            warnings.append(
                f"u{j + 1} has {count} missing value{'s' * (count > 1)}, filled in linearly"
            )
    return force, warnings


def check_enough(angle: np.ndarray, part: bool) -> None:
    """Enough readings of every joint; `part` if they were cut out of more."""
    here = " between start and stop" if part else ""
    if len(angle) < LEAST:
        many = f"{len(angle)} sample{'s' * (len(angle) != 1)}"
        raise InputError(f"has {many}{here}; at least {LEAST} are needed")
    for j, count in enumerate(np.isfinite(angle).sum(axis=0).tolist()):
        if count == 0:
            raise InputError(f"q{j + 1} has no reading{here}: every sample is missing")
        if count < LEAST:
            many = f"{count} reading{'s' * (count != 1)}"
            raise InputError(f"q{j + 1} has {many}{here}; at least {LEAST} are needed")


def check_noise(noise: Any, joints: int) -> np.ndarray:
    """Sigma of one reading, (joints,), from a number or one per joint."""
    values = noise.tolist() if hasattr(noise, "tolist") else noise
    values = list(values) if isinstance(values, (list, tuple)) else [values] * joints
    if len(values) != joints:
        raise InputError(
            f"noise has {len(values)} numbers: must be one number, or one for each of "
            f"{joints} joints"
        )
    return np.array([number("noise", value, "rad or m", above=0) for value in values])


def clock_unit(time: np.ndarray) -> str:
    """The unit that time seems to have: "s" as a rule; "ms", "us" or "ns" where nothing that rings
    is read so slowly for so long; "?" where it may be milliseconds or a count of samples."""
    step = float(np.median(np.diff(time)))
    if len(time) < 50 or step < 0.5:
        return "s"
    if (np.abs(np.diff(time) - 1) < 1e-6).mean() > 0.9:
        return "?"
    return "ms" if step < 200 else "us" if step < 2e5 else "ns"


def clock_warnings(time: np.ndarray) -> list[str]:
    """Doubts about the unit of time, as `clock_unit` has it."""
    if (unit := clock_unit(time)) == "s":
        return []
    if unit == "?":
        return ["t goes up by 1: is it a sample count, or in milliseconds? it must be in s"]
    words = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}[unit]
    return [f"t goes up by {np.median(np.diff(time)):g}: is it in {words}? it must be in s"]
