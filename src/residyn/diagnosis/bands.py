"""Frequency bands that mean something: tied to the modes.

What a model misses shows at telling frequencies. At a mode: its frequency or damping is off, or
changes with amplitude. At a multiple of one: a torque that is not linear. Below the first mode:
an offset, a drift, a creep. So the axis is cut at the modes and their multiples, and what lies
between is a band of its own.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..fitting.result import Mode, RecordingFit

MULTIPLES = (2, 3)
_REACH = 4.0  # times the highest mode: where the last band, "above", begins
_LINES = 2.0  # half width of a mode's band, in lines of the spectrum (1/duration) ...
_WIDTHS = 2.0  # ... or in half widths of its resonance, whichever is more
_MOST = 1000  # columns of a spectrum (half a line each)
_FULL = 0.45  # cycles per reading: beyond, lost and uneven samples leave nothing to see
LEAST = 20
"""Readings of a joint in a recording: fewer have no spectrum."""


class Band(NamedTuple):
    """A band of frequencies, Hz. `name` is "below mode 1", "mode 1", "3 x mode 1", "between" or
    "above"; without modes that ring, there are only "low" and "above"."""

    name: str
    start: float
    stop: float


def bands(modes: Sequence[Mode], fitted: Sequence[RecordingFit]) -> tuple[Band, ...]:
    """Bands that cover all frequencies from 0 to the highest that every spectrum can show."""
    line = max(1.0 / r.recording.duration for r in fitted)
    last = 0.5 / min(float(np.median(np.diff(r.recording.time))) for r in fitted)
    counts = [(n, r.recording.duration) for r in fitted for n in r.used.sum(axis=0) if n >= LEAST]
    top = min((min(_FULL * n, _MOST / 2) / seconds for n, seconds in counts), default=last)
    ringing = [m for m in modes if line < m.frequency_hz < 0.9 * top]
    if not ringing:
        edges = np.array([0.0, 1 / 64, 1 / 16, 1 / 4, 1.0]) * top
        low = [Band("low", float(a), float(b)) for a, b in itertools.pairwise(edges)]
        return (*low, Band("above", top, max(last, top)))
    top = min(top, _REACH * ringing[-1].frequency_hz)
    marks = _marks(modes, line, top)
    found: list[Band] = []
    for i, (middle, width, name) in enumerate(marks):
        low, high = max(middle - width, 0.0), min(middle + width, top)
        before = found[-1].stop if found else 0.0
        if i and marks[i - 1][0] + marks[i - 1][1] > low:  # they meet half way
            low = before
        if i + 1 < len(marks) and marks[i + 1][0] - marks[i + 1][1] < high:
            high = (middle + marks[i + 1][0]) / 2
        if low - before < line:  # too narrow to be a band
            low = before
        else:
            found.append(Band("between" if i else "below mode 1", before, low))
        found.append(Band(name, low, high))
    if top - found[-1].stop > line:
        found.append(Band("between", found[-1].stop, top))
    return (*found, Band("above", found[-1].stop, max(last, found[-1].stop)))


def _marks(modes: Sequence[Mode], line: float, top: float) -> list[tuple[float, float, str]]:
    """(frequency, half width, name) of the modes and of those multiples that stand clear."""
    marks: list[tuple[float, float, str]] = []
    for times in (1, *MULTIPLES):
        for i, mode in enumerate(modes, 1):
            middle = times * mode.frequency_hz
            width = max(_LINES * line, _WIDTHS * mode.damping_ratio * mode.frequency_hz)
            name = f"mode {i}" if times == 1 else f"{times} x mode {i}"
            clear = all(abs(middle - m) > max(width, w) for m, w, _ in marks)
            if (times == 1 or clear) and line < middle < top - line:
                marks.append((middle, width, name))
    return sorted(marks)
