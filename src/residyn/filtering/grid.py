"""Recordings as the instants that a filter visits.

All recordings of an experiment stand one after the other on one grid; at the end of each the motion
begins anew. Where readings come much faster than the motion changes, groups of them are averaged,
of each joint those that there are. The mean of q(t + d) over the times d of its readings is that of
q + d q' + (d^2 / 2) q'', which the reading's row of the filter says exactly to this order: for each
joint and instant, by the mean of d and its variance. Where readings are lost or far apart, instants
without a reading lie between. The count of instants is filled up to one of a few lengths, so that
one compiled program serves many recordings.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import gammainccinv

from ..fitting.layout import bucket
from ..recordings.recording import Recording

STEP = 0.3
"""Readings are averaged up to this step times the fastest angular frequency, and ..."""
LONGEST = 0.45
"""... steps are divided from this one on: the phase of a fourth-order step is good to 3e-4."""
_MINOR = 1e-2  # of the power of the acceleration, and of the angles: less needs no step of its own
_LENGTHS = 512, 1536  # and twice that, and so on: few lengths to compile for
_WIDE = 31  # lines of a periodogram that are averaged, at least, ...
_SHARE = 0.05  # ... and to either side this share of a line's own frequency
# Lines behind Hann's window that tell as much as one independent line: squared correlations summed.
_HANN = 1 + 2 * (2 / 3) ** 2 + 2 * (1 / 6) ** 2
_SURE = 1e-6  # probability with which noise alone stands out of the noise at a line
_ENOUGH = 4096  # instants: fewer are not averaged at all
_INERTIA_ERROR = 0.02  # relative: inertias are known to per cents


class Grid(NamedTuple):
    """K instants of n joints, all recordings one after the other."""

    time: np.ndarray  # (K,) s from each recording's first sample
    step: np.ndarray  # (K,) s to the next instant; 0 at the end of a recording, and in the filling
    drive: np.ndarray  # (K, 3, n) N m at the beginning, middle and end of each step
    angle: np.ndarray  # (K, n) mean reading, rad or m; 0 where there is none
    seen: np.ndarray  # (K, n) whether there is one
    variance: np.ndarray  # (K, n) of it: the noise's, over how many readings it is the mean of
    offset: np.ndarray  # (K, n) s, from the instant to the mean time of these readings
    spread: np.ndarray  # (K, n) s^2, half the variance of their times
    run: np.ndarray  # (K,) which recording
    last: np.ndarray  # (K,) whether a recording ends here and another one follows
    group: tuple[np.ndarray, ...]
    """(N,) of each recording: at which of its own instants each sample is."""
    real: int  # how many instants are no filling
    fast: float  # rad/s, of the fastest motion that its steps are made for

    def of(self, recording: int) -> np.ndarray:
        """Indices of the instants of one recording."""
        return np.flatnonzero((self.run == recording) & (np.arange(len(self.run)) < self.real))

    def of_readings(self, recording: int, values: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Values (N, n) at the samples of a recording, at its own instants here: averaged where its
        readings are, over those that are `seen` (N, n)."""
        group, count = self.group[recording], len(self.of(recording))
        readings = np.maximum(_sums(seen, group, count), 1)
        return _sums(np.where(seen, values, 0.0), group, count) / readings


class Spectrum(NamedTuple):
    """The readings of one recording, one spectrum a joint."""

    pace: np.ndarray  # (F,) angular frequencies, rad/s
    lines: np.ndarray
    """(n, F) Fourier coefficients of the windowed angles about their mean, rad or m; of a reading
    of order k, its own over (i pace)^k."""
    signal: np.ndarray  # (n, F) power beyond the noise, 0 where nothing stands out of it

    @classmethod
    def of(cls, recording: Recording, wild: np.ndarray, mirrored: bool = False) -> "Spectrum":
        """The spectrum of a recording, but for the end of it in which next to nothing moves.

        A window hides the beginning, where a fast mode is that is soon over. `mirrored`, a
        recording goes on before its first instant as it came: a release from rest is smooth there,
        and the window hides nothing; any other beginning has a corner, of high frequencies.
        """
        time = recording.time - recording.time[0]
        dt = float(np.median(np.diff(time)))
        even, use = np.arange(0.0, time[-1], dt), np.isfinite(recording.angle) & ~wild
        pairs = zip(use.T, recording.angle.T, strict=True)
        ways = np.stack([_bridged(time[u], angle[u], even) for u, angle in pairs], axis=1)
        x = ways[..., : max(moving(ways[0].T), 2 * _WIDE)]
        x = np.concatenate([x[..., :0:-1], x], axis=-1) if mirrored else x
        window = np.hanning(x.shape[-1])
        found = np.fft.rfft((x - x.mean(axis=-1, keepdims=True)) * window)
        # What noise leaves of a line: the more, the fewer readings tell the angles at all instants.
        fewer = np.maximum(1.0, len(even) / np.maximum(use.sum(axis=0), 1))
        unit = (recording.noise**2 * fewer * np.sum(window**2))[:, None]
        # The lines of what is even are twice as close, and know half as much each.
        lines = _WIDE * (2 if mirrored else 1)
        power = np.min([[_averaged(p, lines) for p in way] for way in np.abs(found) ** 2], axis=0)
        # Of noise, a mean of k lines is gamma distributed; its level is not known so well that more
        # than `_WIDE` of them would tell it.
        first, last = _around(power.shape[-1], lines)
        k = np.minimum((last - first) / lines, 1.0) * _WIDE / _HANN
        signal = np.where(power > gammainccinv(k, _SURE) / k * unit, power - unit, 0.0)
        pace = 2 * math.pi * np.fft.rfftfreq(x.shape[-1], dt)
        once = np.append(0.0, -1j / pace[1:])  # of a constant there is no integral
        down = once ** np.array(recording.orders)[:, None]
        return cls(pace, found[0] * down, signal * np.abs(down) ** 2)

    @property
    def fastest(self) -> float:
        """Angular frequency, rad/s, below which all but a minor part of the acceleration lies."""
        top = self.pace[1]
        for power in self.signal:
            above = np.cumsum((power * self.pace**4)[::-1])[::-1]
            if above[0] > 0:
                top = max(top, self.pace[np.flatnonzero(above > _MINOR * above[0])[-1]])
        return float(top)

    def stiffness(self, inertia: np.ndarray, driven: bool = False) -> np.ndarray:
        """(n,) size of each joint's spring by least squares: of the slope of the torque Z q'' that
        moves it against its angle, N m/rad; `inertia` (n, n) is Z. Not less than what that torque
        may be off by: beside a fast mode the spring's is a small difference of large ones. What is
        `driven` may have no spring: there, the rms of that torque over the rms of the angle."""
        kept = np.where((self.signal > 0) & (self.pace <= self.fastest), self.lines, 0.0)
        acceleration = self.pace**2 * kept  # but for its sign, as the torque's
        torque = inertia @ acceleration
        power = np.maximum(np.sum(np.abs(self.lines) ** 2, axis=1), 1e-300)
        if driven:
            return np.sqrt(np.sum(np.abs(torque) ** 2, axis=1) / power)
        slope = np.abs(np.real(torque * self.lines.conj()).sum(axis=1)) / power
        squares = inertia**2 @ np.sum(np.abs(acceleration) ** 2, axis=1)
        return np.maximum(slope, _INERTIA_ERROR * np.sqrt(squares / power))


def _bridged(time: np.ndarray, angle: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(2, M) readings (N,) at other instants (M,), where some are lost: by lines, which have
    corners, and by cubics, which enlarge noise. Of both powers the lesser counts."""
    lines = np.interp(at, time, angle) if len(time) else 0 * at
    if len(time) < 4:
        return np.stack([lines, lines])
    return np.stack([lines, CubicSpline(time, angle)(np.clip(at, time[0], time[-1]))])


def _around(count: int, wide: int) -> tuple[np.ndarray, np.ndarray]:
    """(F,) first and last + 1 of the lines around each of so many, `wide` at least but for the
    ends."""
    line = np.arange(count)
    half = np.maximum(wide // 2, (_SHARE * line).astype(int))
    return np.maximum(line - half, 0), np.minimum(line + half + 1, count)


def _averaged(power: np.ndarray, wide: int) -> np.ndarray:
    """(F,) mean of the lines around each line."""
    total = np.append(0.0, np.cumsum(power))
    first, last = _around(len(power), wide)
    return (total[last] - total[first]) / (last - first)


def lay_out(
    recordings: Sequence[Recording],
    wild: Sequence[np.ndarray],
    fast: float | None = None,
    least: float = 0.0,
) -> Grid:
    """The grid of some recordings; `wild` (N, n) of each marks readings that do not count. `fast`
    (rad/s) is the fastest motion, if that is known; else it is no slower than `least`."""
    if fast is None:
        each = (Spectrum.of(r, w).fastest for r, w in zip(recordings, wild, strict=True))
        fast = max(least, *each)
    most = sum(len(r.time) for r in recordings) / _ENOUGH  # readings in an average
    each = [_one(r, w, fast, most) for r, w in zip(recordings, wild, strict=True)]
    group, parts = zip(*each, strict=True)
    ends = np.cumsum([len(p[0]) for p in parts])
    last, real = np.zeros(ends[-1], bool), int(ends[-1])
    last[ends[:-1] - 1] = True
    run = np.repeat(np.arange(len(parts)), np.diff(ends, prepend=0))
    columns = [*map(np.concatenate, zip(*parts, strict=True)), run, last]
    more = min(bucket(real, least=length) for length in _LENGTHS) - real
    filled = [np.pad(x, [(0, more), *[(0, 0)] * (x.ndim - 1)], mode="edge") for x in columns]
    grid = Grid(*filled, group=group, real=real, fast=fast)
    grid.seen[real:], grid.angle[real:] = False, 0.0
    return grid


def _one(recording: Recording, wild: np.ndarray, fast: float, most: float):
    """At which instant (N,) each sample of one recording is, and what else a `Grid` has of it, for
    motions up to `fast` rad/s. Samples within the time of `most` are at one instant, the mean of
    their times, where that is still short beside the motion."""
    time = recording.time - recording.time[0]
    gap = float(np.median(np.diff(time)))
    size = max(1, min(math.ceil(most), int(STEP / fast / gap)))
    clock = np.arange(len(time)) if size == 1 else (time / gap + 0.5) // size
    _, group = np.unique(clock, return_inverse=True)
    samples = np.bincount(group)
    when = np.bincount(group, time) / samples
    pieces = np.maximum(1, np.ceil(np.diff(when) * fast / LONGEST - 1e-6)).astype(int)
    at = np.concatenate([[0], np.cumsum(pieces)])
    fine = np.interp(np.arange(at[-1] + 1), at, when)
    drive = np.zeros_like(recording.angle) if recording.drive is None else recording.drive
    drive = _sums(drive, group, len(samples)) / samples[:, None]
    drive = np.stack([np.interp(fine, when, u) for u in drive.T], axis=1)
    after = np.concatenate([drive[1:], drive[-1:]])
    three = np.stack([drive, 0.5 * (drive + after), after], axis=1)
    group, seen = at[group], np.isfinite(recording.angle) & ~wild
    since, readings = (time - fine[group])[:, None], _sums(seen, group, len(fine))
    angle, offset, square = (
        _sums(np.where(seen, x, 0.0), group, len(fine)) / np.maximum(readings, 1)
        for x in (recording.angle, since, since**2)
    )
    step, variance = np.append(np.diff(fine), 0.0), recording.noise**2 / np.maximum(readings, 1)
    spread = 0.5 * (square - offset**2)
    return group, (fine, step, three, angle, readings > 0, variance, offset, spread)


def _sums(x: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(count, n) sums of x (N, n) over each group (N,)."""
    return np.stack([np.bincount(group, column, count) for column in x.T], axis=1)


def local_amplitude(time: np.ndarray, angle: np.ndarray, period: float) -> np.ndarray:
    """(N, n) local amplitude of each joint about where it rests: sqrt(2) times the standard
    deviation over one `period` (s) around each instant."""
    half = 0.5 * min(period, time[-1] - time[0])
    # The window slides, but not beyond the recording.
    middle = np.clip(time, time[0] + half, time[-1] - half)

    def mean(values: np.ndarray) -> np.ndarray:
        area = np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time)))
        ends = (np.interp(middle + side * half, time, area) for side in (1.0, -1.0))
        return (next(ends) - next(ends)) / (2 * half)

    centred = (angle - angle.mean(axis=0)).T
    return np.stack([np.sqrt(2 * np.maximum(mean(q**2) - mean(q) ** 2, 0.0)) for q in centred], 1)


def moving(angle: np.ndarray) -> int:
    """How many instants of (N, n) angles come before next to nothing moves: all but a minor part of
    the squares about rest lies in them, however long it was recorded after."""
    off = angle - np.median(angle, axis=0)
    moved = np.cumsum(np.sum(off**2, axis=1))
    return int(np.searchsorted(moved, (1 - _MINOR) * moved[-1])) + 1
