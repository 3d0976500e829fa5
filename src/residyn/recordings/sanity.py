"""What a recording of free motion shows before any model is fitted to it, and no ringing arm does.

Free motion follows from the angles and rates alone. So an arm that stands still stays where it is:
one that stands still away from rest and then moves was held. It rings about its rest: angles that
ring about another value are not counted from there. And units show in sizes: no braked joint turns
by five radians, least of all between two readings, and no arm on a table takes minutes for a swing.

Each finding is one line that says what is seen and which key of the experiment file settles it.
The limits are wide apart from what arms do: over the hidden effects of the test rig, from 1.2
swings on, a rest is within 0.28 of the amplitude (a slipping brake apart), and an arm that is let
go leaves `_STILL` within 0.10 of a period. Limits are 0.5 and 0.2.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .arrays import clock_unit, clock_warnings
from .columns import Table
from .recording import Recording
from .resampling import decimated, evenly_sampled, moving_means, slowest_period, while_moving
from .rest import rest_angles

_OFF = 0.5  # of the amplitude about rest: a larger distance of rest from zero is no effect's
_SLIPPED = 10.0  # the same where a brake may have slipped, towards the side of the release
_APART = 0.3  # of the amplitude, to which a rest is known: releases that tell a slip from a zero
_FEWEST = 1.2  # swings of the slowest mode from which rest can be told from the rest of a swing
_STILL = 0.1  # of the largest excursion: a released arm covers it in 0.07 of a period of one mode
_QUITE = 0.03  # the same for the first 0.8 of that time: what swings up moves more
_HELD = 0.2  # of the slowest period: no free arm stays within `_STILL` of its beginning so long
_TURN = 5.0  # rad, which no braked joint turns
_SLOW = 300.0  # s, which no swing takes
_COUNT = "of a sample count, write times in s into the file"


class Finding(NamedTuple):
    """What is seen, in one line, and the key of `[[recordings]]` that settles it most likely; an
    empty one if none does, and "?" in its value where that cannot be told."""

    words: str
    key: str
    value: Any


def not_free(
    recording: Recording, units: tuple[str, ...] | None, table: Table, keys: Mapping[str, Any]
) -> Finding | None:
    """What is not as the free motion of an arm; None if nothing is.

    **Arguments:** `units` of the joints; `table`: the recording as its file has it; `keys`: those
    of its `[[recordings]]` table, which settle things.
    """
    time, angle, said = recording.time, recording.angle, table.stated
    if abs(recording.theta2) > 2 * np.pi:
        return in_degrees(recording, units, said, "")
    if "t" not in said and (warnings := clock_warnings(time)):
        unit = clock_unit(time)
        words = f'{warnings[0]}; units = {{ t = "{unit}" }} says so, or "s" if it is'
        if unit == "?":
            words = f'{warnings[0]}; units = {{ t = "ms" }} says so, or "s" if it is; {_COUNT}'
        return Finding(words, "units", {"t": unit})
    if units and (code := _lost(recording, units, table)) is not None:
        return code
    hint = 'units = {{ {} = "deg" }} says so, or "rad" if it is'
    if (large := in_degrees(recording, units, said, hint)) is not None:
        return large
    if recording.drive is not None or not (np.nanmax(angle, 0) > np.nanmin(angle, 0)).any():
        return None
    if units and (wild := _no_angle(recording, units, table)) is not None:
        return wild
    clock, motion = evenly_sampled(time, angle, recording.outliers)
    step = clock[1] - clock[0]
    period = slowest_period(while_moving(motion))
    if "t" not in said and period * step > _SLOW:
        words = (
            f"one swing takes {period * step:.3g} s: is t in milliseconds or samples? "
            f'units = {{ t = "ms" }} says so, or "s" if it is; {_COUNT}'
        )
        return Finding(words, "units", {"t": "?"})
    if "start" not in keys and (until := _held_until(motion, period)) is not None:
        words = (
            f"stands still for the first {until * step:.3g} s and then moves, as no free arm does "
            '(held, or not yet pushed): start = "release" finds where it is let go, start = '
            f"{time[0]:g} keeps all of it"
        )
        return Finding(words, "start", "release")
    if "rest" not in keys and len(motion) >= _FEWEST * period:
        return _off_rest(motion, units)
    return None


def in_degrees(
    recording: Recording, units: tuple[str, ...] | None, said: Collection[str], hint: str
) -> Finding | None:
    """What is larger than any braked joint turns in rad, if anything is, and seldom a driven one
    does; a column whose unit is `said` is believed, and `hint` tells how to say it of column {}."""
    if abs(recording.theta2) > 2 * np.pi:
        words = f"theta2 = {recording.theta2:g}: in degrees? it must be in rad"
        return Finding(words, "theta2", float(np.radians(recording.theta2)))
    for j, size in enumerate(recording.sizes):
        if units and units[j] == "rad" and f"q{j + 1}" not in said and size > _TURN:
            than = ", more than a braked joint turns" if recording.drive is None else ""
            words = f"q{j + 1} reaches {size:.3g} rad{than}: in degrees? "
            return Finding(words + hint.format(f"q{j + 1}"), "units", {f"q{j + 1}": "deg"})
    return None


def _lost(recording: Recording, units: tuple[str, ...], table: Table) -> Finding | None:
    """A value that readings repeat, more than `_TURN` from all others and farther than those are
    from each other: what some write for a lost sample."""
    for j, unit in enumerate(units):
        angle = recording.angle[:, j]
        same = angle == angle[np.nanargmax(np.abs(angle - np.nanmedian(angle)))]
        others, which = angle[np.isfinite(angle) & ~same], np.flatnonzero(same)
        if unit != "rad" or len(which) < 2 or not len(others):
            continue
        if np.abs(others - angle[which[0]]).min() > max(_TURN, np.ptp(others)):
            words = (
                f"{_readings(recording, j, which, table)}, one value far from all others: the code "
                "of a lost sample? that is an empty cell or nan"
            )
            return Finding(words, "", None)
    return None


def _readings(recording: Recording, joint: int, which: np.ndarray, table: Table) -> str:
    """Value and lines of readings: "q1 = -999 rad (-5.724e+04 deg), line 7"."""
    value, lines = float(recording.angle[which[0], joint]), table.lines_at(recording.time[which])
    where = f"{table.counted} {lines[0]}"
    if len(lines) > 1:
        where = f"{table.counted}s {lines[0]} to {lines[-1]} ({len(lines)} readings)"
    return f"q{joint + 1} = {value:.4g} rad ({np.degrees(value):.4g} deg), {where}"


def _no_angle(recording: Recording, units: tuple[str, ...], table: Table) -> Finding | None:
    """Readings that are `_TURN` from the others and from the one beside them, if there are any;
    what a fit sets aside as outliers is not looked at."""
    for j, unit in enumerate(units):
        seen = np.flatnonzero(np.isfinite(recording.angle[:, j]) & ~recording.outliers[:, j])
        angle = recording.angle[seen, j]
        if unit != "rad" or not (np.abs(np.diff(angle)) > _TURN).any():
            continue
        far = seen[np.abs(angle - np.median(angle)) > _TURN]
        if not len(far):
            continue
        words = (
            f"{_readings(recording, j, far, table)}, more than {_TURN:g} rad from the readings "
            "beside it, as no braked joint turns: a lost sample is an empty cell or nan; past a "
            "whole turn an angle goes on"
        )
        return Finding(words, "", None)
    return None


def _held_until(motion: np.ndarray, period: float) -> float | None:
    """How many samples of (N, n) angles stand still, if they move afterwards as no free arm does;
    `period` of the slowest mode in samples."""
    size = np.abs(motion - np.median(motion[-max(1, len(motion) // 4) :], axis=0)).max(axis=0)
    width = max(1, min(int(period / 40), len(motion)))
    smooth = moving_means(motion, width)
    first = np.median(smooth[:width], axis=0)
    size = np.where(size > 0, size, np.inf)
    each = np.abs(smooth - first) / size
    largest = each[:, int(np.argmax(each.max(axis=0)))]
    if largest[int(np.argmax(largest)) :].min() > 0.7 * largest.max():
        return None  # it has not turned back: a piece of one swing
    off = each.max(axis=1)
    moves = int(np.argmax(off > _STILL))
    until = moves + width // 2
    if not off.max() > _STILL or until <= _HELD * period:
        return None
    quite = off[: max(1, int(0.8 * moves))]
    noise = np.abs(np.diff(motion[:moves], axis=0)) if moves > 1 else np.zeros((1, len(size)))
    noise = (np.median(noise, axis=0) / size).max() / width**0.5
    if quite.max() >= _QUITE + 4 * noise:
        return None
    # Let go, it moves off as the square of time: to a quarter of `_STILL` in half the time.
    near = (np.abs(motion[:until] - first) / size).max(axis=1) <= _STILL / 4
    half = 1 + int(np.flatnonzero(near).max(initial=len(quite)))
    return max(len(quite), 2 * half - until)


def _rest_of(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) where joints rest, their amplitudes, and whether rest is too far from 0."""
    rest = rest_angles(decimated(motion))
    size = np.abs(motion - rest).max(axis=0)
    return rest, size, np.abs(rest) > _OFF * size


def off_rest_alike(recordings: Sequence[Recording]) -> str | None:
    """In words, that a joint rings about the same value in recordings of different releases, if so.

    A brake that slips holds what its joint can be deflected by, so that the rest that it leaves is
    as much farther as the release was. Where readings are not counted from rest it is the same.
    """
    found = []
    for recording in recordings:
        _, motion = evenly_sampled(recording.time, recording.angle, recording.outliers)
        found.append((motion[0], *_rest_of(motion)))
    first, rest, size, off = (np.stack(x) for x in zip(*found, strict=True))
    told = off.all(axis=0) & (np.ptp(first, axis=0) > _APART * size.max(axis=0))
    for j in np.flatnonzero(told):
        if np.ptp(rest[:, j]) < 0.5 * np.ptp(first[:, j]):  # nearer to none of that than to all
            each = ", ".join(f"{x:.4g}" for x in rest[:, j])
            return (
                f"q{j + 1} rings about {each} in recordings of different releases, not about 0, "
                'and no brake slips so: at rest it must read 0; rest = "estimate" takes it off, '
                "rest = [...] leaves it"
            )
    return None


def _off_rest(motion: np.ndarray, units: tuple[str, ...] | None) -> Finding | None:
    """That readings (N, n) are not 0 at rest, if so."""
    rest, size, off = _rest_of(motion)
    # A brake that slips takes its joint's rest along, towards where it was released.
    slipped = off & (rest * (motion[0] - rest) > 0) & (np.abs(rest) < _SLIPPED * size)
    if not off.any() or ((off == slipped).all() and off.sum() == 1):
        return None
    j = int(np.argmax(np.where(off & ~slipped, 2, off)))
    unit = f" {units[j]}" if units else ""
    none = ", ".join(["0"] * len(rest))
    words = (
        f"q{j + 1} rings about {rest[j]:.4g}{unit}, not about 0 (amplitude {size[j]:.2g}{unit}): "
        f'at rest it must read 0; rest = "estimate" takes it off, rest = [{none}] leaves it'
    )
    return Finding(words, "rest", "estimate")
