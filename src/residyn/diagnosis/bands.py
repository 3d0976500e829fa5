"""Frequency bands that mean something: tied to the modes.

What a model misses shows at telling frequencies. At a mode: its frequency or damping is off, or
changes with amplitude. At a multiple of one: a torque that is not linear. Below the first mode:
an offset, a drift, a creep. So the axis is cut at the modes and their multiples, and what lies
between is a band of its own.

Modes depend on the pose and the load, so each recording has bands about its own modes. All have
bands of the same names, which can be summed: a multiple is marked only where it stands clear of the
modes, on the same side of each, in all recordings, and what lies between two marks is a band only
if it is wide enough in all.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from ..fitting.covariance import modes_of
from ..fitting.result import Fit, Mode, RecordingFit
from ..physics.model import Model

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


class RecordingBands(NamedTuple):
    """What is one fitted recording's own: its name, modes (those of the model on its bodies) and
    bands."""

    name: str
    modes: tuple[Mode, ...]
    bands: tuple[Band, ...]

    @property
    def period(self) -> float:
        """Of its slowest mode, s; inf without modes that ring."""
        return 1 / self.modes[0].frequency_hz if self.modes else math.inf


def recording_bands(fit: Fit) -> tuple[RecordingBands, ...]:
    """Of each fitted recording."""
    known: list[tuple[Model, tuple[Mode, ...]]] = [(fit.model, fit.modes)]
    each = []
    for model in fit.ready.posed(fit.model):
        alike = (m for one, m in known if eqx.tree_equal(one.mechanism, model.mechanism))
        modes = next(alike, None)
        if modes is None:
            modes = modes_of(model, fit.spread)
            known.append((model, modes))
        each.append(modes)
    rows = zip(fit.fitted, each, bands(each, fit.fitted), strict=True)
    return tuple(RecordingBands(f.recording.name, modes, cut) for f, modes, cut in rows)


def bands(
    modes: Sequence[Sequence[Mode]], fitted: Sequence[RecordingFit]
) -> tuple[tuple[Band, ...], ...]:
    """Bands of each recording, about its own `modes`, that cover all frequencies from 0 to the
    highest that every spectrum can show; the same names in all recordings."""
    line = max(1.0 / r.recording.duration for r in fitted)
    last = 0.5 / min(float(np.median(np.diff(r.recording.time))) for r in fitted)
    counts = [(n, r.recording.duration) for r in fitted for n in r.used.sum(axis=0) if n >= LEAST]
    most = min((min(_FULL * n, _MOST / 2) / seconds for n, seconds in counts), default=last)
    count = min(map(len, modes))
    frequency, damping = (
        np.array([[getattr(m, name) for m in own[:count]] for own in modes])
        for name in ("frequency_hz", "damping_ratio")
    )  # (R, modes) each
    ringing = ((line < frequency) & (frequency < 0.9 * most)).all(axis=0)
    found: list[tuple[str, np.ndarray, np.ndarray]] = []  # name, start (R,) and stop (R,)
    before = np.zeros(len(modes))
    if ringing.any():
        top = np.minimum(most, _REACH * frequency[:, ringing].max(axis=1))
        marks = _marks(frequency, damping, line, top)
        for i, (middle, width, name) in enumerate(marks):
            low, high = np.maximum(middle - width, 0.0), np.minimum(middle + width, top)
            if i:  # they meet half way
                low = np.where(marks[i - 1][0] + marks[i - 1][1] > low, before, low)
            if i + 1 < len(marks):
                half = (middle + marks[i + 1][0]) / 2
                high = np.where(marks[i + 1][0] - marks[i + 1][1] < high, half, high)
            if (low - before).min() < line:  # too narrow to be a band
                low = before
            else:
                found.append(("between" if i else "below mode 1", before, low))
            found.append((name, low, high))
            before = high
        if (top - before).min() > line:
            found.append(("between", before, top))
            before = top
    else:
        for share in (1 / 64, 1 / 16, 1 / 4, 1.0):
            found.append(("low", before, np.full(len(modes), share * most)))
            before = found[-1][2]
    found.append(("above", before, np.maximum(last, before)))
    return tuple(
        tuple(Band(name, float(start[r]), float(stop[r])) for name, start, stop in found)
        for r in range(len(modes))
    )


def _marks(
    frequency: np.ndarray, damping: np.ndarray, line: float, top: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, str]]:
    """Frequency (R,), half width (R,) and name of the modes, and of those multiples that stand
    clear, from the modes' frequencies and damping ratios (R, modes)."""
    marks: list[tuple[np.ndarray, np.ndarray, str]] = []
    for times in (1, *MULTIPLES):
        for i, (own, ratio) in enumerate(zip(frequency.T, damping.T, strict=True), 1):
            middle, width = times * own, np.maximum(_LINES * line, _WIDTHS * ratio * own)
            name = f"mode {i}" if times == 1 else f"{times} x mode {i}"
            off = [((middle - m) / np.maximum(width, w)) for m, w, _ in marks]
            clear = all((x > 1).all() or (x < -1).all() for x in off)
            if (times == 1 or clear) and ((line < middle) & (middle < top - line)).all():
                marks.append((middle, width, name))
    return sorted(marks, key=lambda mark: float(mark[0][0]))
