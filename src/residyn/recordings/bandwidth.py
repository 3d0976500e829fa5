"""Readings that a low-pass filter has smoothed say no more than those that it leaves independent.

The noise of readings is taken to be white: as strong at every frequency. A filter (of the
amplifier, or of whoever exported the readings) ends it at a cut-off far below half the sampling
rate. Then the noise of neighbours is nearly the same, its size between them is no measure of it,
and a fit that counts each reading as a new one believes them too much. Readings at twice the
cut-off tell all that there is (Shannon, Proc. IRE 37, 1949), and have white noise.

A cut-off shows in the spectrum: beyond the motion, which falls steeply, noise is flat for an octave
and more, and ends. No mechanism does that: an angle falls with the square of the frequency at
least, whatever torque moves it.
"""

import itertools
import math

import numpy as np

_BANDS = 4  # of an octave
_LINES = 6  # of a band, at least: three independent ones
_FLAT = 2.0  # between a plateau's bands and their mean, at most: half power is its end, or ...
_SIGMAS = 3.0  # ... this many standard deviations of what so many lines tell of a band
# Times less power, at least: an octave beyond the plateau, where a filter of second order has 16
# times less; and at the highest frequencies, where noise of a tenth would still count as noise.
_ENDS = 10.0, 100.0
_NOISE = 1e-2  # of all power, at most: noise of a tenth of the motion, above which it is motion
_EVEN = 1.0  # samples that an instant may be off its place: filters work on even ones
_LOST = 0.05  # of the readings, at most: lines across more have a spectrum of their own


def independent(time: np.ndarray, angle: np.ndarray) -> tuple[int, float]:
    """One of how many readings (N, n) is to be taken so that the noise of these is white (1 where
    all is), and the bandwidth of the noise, the largest of all joints that move, Hz (inf there)."""
    index, dt, band = np.arange(len(time)), (time[-1] - time[0]) / (len(time) - 1), 0.0
    lost = ~np.isfinite(angle)
    if np.abs(time - time[0] - dt * index).max() < _EVEN * dt and lost.mean() < _LOST:
        pairs = zip(angle.T, ~lost.T, strict=True)
        whole = [np.interp(index, index[seen], x[seen]) for x, seen in pairs if seen.any()]
        band = max((_bandwidth(x) for x in whole if np.ptp(x) > 0), default=0.0)
    every = round(1 / band) if band else 1
    return (every, 0.5 * band / dt) if every > 1 else (1, np.inf)


def _bandwidth(x: np.ndarray) -> float:
    """The bandwidth of the noise of readings (N,), as a share of the highest frequency: that at
    which a plateau in their spectrum would end if it ended at once; 1 if there is none."""
    # Bands of a fixed ratio, down from the top.
    edges = 2.0 ** (-np.arange(60) / _BANDS)
    edges = edges[: np.count_nonzero(-np.diff(edges) * len(x) / 2 >= _LINES) + 1]
    # A damped motion is over in the second half; noise is not.
    bands, late = _powers(x, edges), _powers(x[len(x) // 2 :], edges)
    # Behind this window two lines tell as much as an independent one.
    unsure = _SIGMAS * np.sqrt(2.0 / (-np.diff(edges) * len(x) / 2))
    limit = np.maximum(math.log(_FLAT), unsure)
    for top in range(_BANDS, len(bands) - _BANDS):
        own = slice(top, top + _BANDS + 1)
        level = bands[own].mean()
        flat = level > 0 and np.all(np.abs(np.log(bands[own] / level)) < limit[own])
        ends = bands[: top - _BANDS + 1].max() * _ENDS[0] < level and bands[0] * _ENDS[1] < level
        lasts = late[own].mean() * _FLAT > level
        if flat and ends and lasts and level * edges[top] < _NOISE * x.var():
            beyond = -np.diff(edges)[: own.stop] @ bands[: own.stop]
            return float(edges[own.stop] + beyond / level)
    return 1.0


def _powers(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(B,) spectral density of readings (N,) in bands between `edges` (B + 1,), shares of the
    highest frequency: their variance, if it were that everywhere."""
    window = np.hanning(len(x)) ** 2  # its side lobes are below any noise
    power = np.abs(np.fft.rfft((x - x.mean()) * window)) ** 2 / np.sum(window**2)
    lines = (edges * len(power)).astype(int)
    return np.array([power[low:high].mean() for high, low in itertools.pairwise(lines)])
