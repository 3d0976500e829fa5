"""Readings that repeat what was read already, as an encoder's do while its joint turns or rests.

An encoder shows steps. While a joint passes over them, the errors of its readings follow each other
through all values, and are as good as white noise. While it turns round or rests within one step,
all its readings have the same error, and together they say no more than one. Where noise shakes the
joint the error is a smaller one: of readings of variance w + e, where e is the mean square of what
noise leaves of the error, the mean of n has the variance e + w / n, as that of so many fewer has.
"""

import math

import numpy as np

from .polynomial_spectrum import grid_step

_WIDTH = 8.0  # sigma: range of the noise
_WAVES = np.arange(1, 200)


def repeats_of(readings: np.ndarray, noise: float) -> np.ndarray:
    """Which (N,) of the readings (N,) of a joint, NaN where one is missing, say nothing that others
    beside them do not; `noise` is the sigma of one, in their unit."""
    found = np.zeros(len(readings), bool)
    seen = np.flatnonzero(np.isfinite(readings))
    values = readings[seen]
    step = grid_step(values) if len(values) else 0.0
    if step <= 0:
        return found
    whole = max((noise / step) ** 2, 1 / 12)
    shaken = whole - 1 / 12  # square of what shakes the joint, in steps
    same = float(np.sum(np.exp(-shaken * (2 * np.pi * _WAVES) ** 2) / (2 * (np.pi * _WAVES) ** 2)))
    if len(values) * same < 0.5 * whole:
        return found  # noise makes all of them white
    place = np.rint((values - values.min()) / step).astype(int)
    for first, end in _stretches(place.tolist(), math.ceil(_WIDTH * math.sqrt(shaken) - 1e-6)):
        count = end - first
        each = round((whole + (count - 1) * same) / whole)  # of so many one is kept
        kept = first + np.arange((min(each, count) - 1) // 2, count, each)
        found[seen[np.setdiff1d(np.arange(first, end), kept)]] = True
    return found


def _stretches(place: list[int], width: int) -> list[tuple[int, int]]:
    """Where a joint turns or rests: from, to (not included), each within `width` + 1 steps that it
    leaves as it came or not at all."""
    found, first, low, high = [], 0, place[0], place[0]
    for i in range(1, len(place) + 1):
        if i < len(place) and max(high, place[i]) - min(low, place[i]) <= width:
            low, high = min(low, place[i]), max(high, place[i])
            continue
        passes = 0 < first and i < len(place) and (place[first - 1] < low) == (place[i] > high)
        if not passes:
            found.append((first, i))
        if i < len(place):
            first, low, high = i, place[i], place[i]
    return found
