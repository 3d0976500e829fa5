"""Is what is left just noise? A test that knows what the fit has swallowed.

White noise has the same energy at every frequency. The test takes the residual's energy in narrow
bands, at the modes, at their multiples and in between, as a share of the energy in all frequencies,
so that it asks for no sigma: noise that was stated or estimated wrongly does not fail it. If only
noise is left, each share has a known distribution (a beta), lost samples, uneven times and the
unknowns of the fit accounted for. Bands end above the motion; a single line is sought at all
frequencies (Fisher, Proc. R. Soc. A 125, 1929). The smallest probability of the bands, and that of
the lines, each corrected for their number, make the test's: p is below 0.01 in no more than one of
a hundred joints of which the model is right.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import betainc

from ..fitting.result import Fit
from ..recordings.polynomial_spectrum import grid_step
from .bands import LEAST, Band, RecordingBands
from .evidence import NOISE
from .linearised_fit import Tangent
from .spectrum import Spectrum, Strip, periodogram, spectrum, strips, whitened

_SLOWEST = 6  # half lines at the bottom that are a band of their own: offset, drift, creep
_WIDEST = 16  # lines: a wider band is cut, lest a narrow line drown in it
_ROUNDS = 6
_CYCLES = 2.0
"""In a recording, from which a line is one. Over T seconds a line, and the mean likewise, is spread
by 1/T to each side: these overlap below 2/T, where an offset, a drift and a line cannot be told
apart."""


class Line(NamedTuple):
    """The strongest line of a joint's residual."""

    frequency: float
    """Hz."""
    recording: int
    """In which of the fitted recordings."""


class White(NamedTuple):
    """The test of one joint, over all fitted recordings."""

    p: float
    """Probability that noise alone leaves a residual so far from white; NaN: too few readings."""
    line: Line | None
    """Its strongest line; None if noise alone leaves one as strong with p of `NOISE`, or if what is
    strongest is as slow as an offset or a drift."""


def white(
    fit: Fit,
    slopes: Sequence[np.ndarray],
    own: Sequence[RecordingBands],
    rows: Sequence[Sequence[Strip]],
    spectra: Sequence[Sequence[Spectrum | None]],
) -> Mapping[str, White]:
    """The test of each joint.

    **Arguments:** `slopes` (N, n, L) per recording from `predictions`; `own` of each recording;
    `rows` and `spectra` of the residual as it is, per joint and recording.
    """
    longest = max(r.recording.duration for r in fit.fitted)
    narrow = narrow_bands([each.bands for each in own], longest)
    grids = _grids(fit)
    if grids:
        rows = _without_rounding(fit, slopes, grids, [each.period for each in own])
        tops = [each[-1].stop for each in narrow]
        spectra = [list(map(spectrum_of, row, tops)) for row in rows]
    found = {}
    for joint, row, parts in zip(fit.joints, rows, spectra, strict=True):
        in_bands = whiteness_of(parts, narrow)
        p, line = strongest_line(row)
        each = [x for x in (in_bands, p) if np.isfinite(x)]
        found[joint] = White(of_the_least(each) if each else np.nan, line if p < NOISE else None)
    return found


def strongest_line(row: Sequence[Strip]) -> tuple[float, Line | None]:
    """Probability that noise alone leaves a line with so much of a recording's energy, corrected
    for the number of frequencies and recordings, and the line; NaN if none can be seen, and None if
    none is, or what is strongest is too slow for one."""
    each: list[tuple[float, Line | None]] = [(np.nan, None)]
    count = 0
    for i, strip in enumerate(row):
        left, along = strip.residual[strip.used], strip.tangent[strip.used]
        freedom, total = len(left) - float((along**2).sum()), float(left @ left)
        frequency, energy = periodogram(strip) if len(left) >= LEAST else (left[:0], left[:0])
        count += len(frequency)
        if len(frequency) and freedom > 2 and total > 0:
            best = np.argmax(energy)
            share = min(1.0, float(energy[best]) / total)
            time = strip.time[strip.used]
            slow = float(frequency[best]) * (time[-1] - time[0]) < _CYCLES
            line = None if slow else Line(float(frequency[best]), i)
            each.append(((1 - share) ** ((freedom - 2) / 2), line))
    least, line = min(each, key=lambda x: (not np.isfinite(x[0]), x[0]))
    return of_the_least([least] * count) if count else np.nan, line


def spectrum_of(strip: Strip, top: float) -> Spectrum | None:
    """The spectrum; None if there are too few readings for one."""
    return spectrum(strip, top) if strip.used.sum() >= LEAST else None


def whiteness_of(parts: Sequence[Spectrum | None], narrow: Sequence[Sequence[Band]]) -> float:
    """Probability that noise alone leaves a residual with so much of its energy in one narrow band,
    corrected for the number of bands; of each recording's spectrum its own bands."""
    seen = [(p, own) for p, own in zip(parts, narrow, strict=True) if p is not None]
    total, freedom = sum(p.energy for p, _ in seen), sum(p.freedom for p, _ in seen)
    found = []
    for i in range(len(narrow[0])):
        z = [whitened(p, p.columns(own[i].start, own[i].stop)) for p, own in seen]
        energy, count = sum(float(x @ x) for x in z), sum(len(x) for x in z)
        if 0 < count < freedom - 1 and total > 0:
            p = betainc((freedom - count) / 2, count / 2, max(0.0, 1 - energy / total))
            found.append(float(p))
    return of_the_least(found) if found else float("nan")


def of_the_least(p: Sequence[float]) -> float:
    """Probability that the smallest of so many is as small as it is."""
    least = min(p, default=1.0)
    return float(-np.expm1(len(p) * np.log1p(-least))) if least < 1 else 1.0


def narrow_bands(cut: Sequence[Sequence[Band]], duration: float) -> list[list[Band]]:
    """Of each recording the bands below the last one, cut to narrow ones: into as many pieces in
    all recordings, the longest of which has this duration (s)."""
    found: list[list[Band]] = [[] for _ in cut]

    def add(name: str, starts: np.ndarray, stops: np.ndarray) -> None:
        for own, start, stop in zip(found, starts.tolist(), stops.tolist(), strict=True):
            own.append(Band(name, start, stop))

    for same in zip(*(own[:-1] for own in cut), strict=True):
        start, stop = (np.array([getattr(b, edge) for b in same]) for edge in ("start", "stop"))
        slow = _SLOWEST / (2 * duration)
        if (start == 0).all() and (stop > 2 * slow).all():
            add("slow", start, np.full(len(cut), slow))
            start = np.full(len(cut), slow)
        pieces = max(1, int(np.ceil((stop - start).max() * duration / _WIDEST)))
        for a, b in itertools.pairwise(np.linspace(start, stop, pieces + 1)):
            add(same[0].name, a, b)
    return found


# -- the steps of an encoder -----------------------------------------------------------------

# A reading is the angle rounded to the encoder's grid. Where noise shakes the angle by half a step
# or more, rounding only adds some white noise. Where it does not, the rounding error follows the
# motion and is anything but white; but then it can be computed, from the motion that the model
# predicts: it is known, and no failure of the model. And where the joint moves by no more than a
# step or two, it hangs on a single bit, and its readings say nothing that can be tested.
_SHAKEN = 0.5  # steps: noise of this sigma makes the rounding error white
_LEAST = 0.05  # steps: no prediction is better than this
_WAVES = 30  # enough for a sawtooth blurred by _LEAST
_STEPS = 2.0  # range of a motion below which it hangs on single bits


class Grid(NamedTuple):
    """Values that a sensor can show: `origin` + k `step`, rad or m; `step` 0 is any value."""

    origin: float
    step: float

    @classmethod
    def of(cls, readings: np.ndarray) -> "Grid":
        """The grid of some readings."""
        values = np.unique(readings)
        step = grid_step(values) if len(values) > 1 else 0.0
        if step <= 0:
            return cls(0.0, 0.0)
        # Each gap is a small count of steps, so the counts are sure, and with them origin and step.
        count = np.concatenate([[0.0], np.cumsum(np.rint(np.diff(values) / step))])
        step, origin = np.polyfit(count, values, 1)
        return cls(float(origin), float(step))

    def matters(self, residual: np.ndarray) -> bool:
        """Whether so small a residual must have the pattern of the grid in it."""
        return self.step > 0 and self._shake(residual) < _SHAKEN * self.step

    def error(self, angle: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Mean rounding error of readings near `angle`, shaken by what is left of `residual`."""
        place, blur = (angle - self.origin) / self.step, self._shake(residual) / self.step
        wave = np.arange(1, _WAVES + 1)
        height = (-1.0) ** wave / (np.pi * wave) * np.exp(-2 * (np.pi * wave * blur) ** 2)
        return self.step * (np.sin(2 * np.pi * place[..., None] * wave) @ height)

    def _shake(self, residual: np.ndarray) -> float:
        spare = float(np.mean(residual**2)) - self.step**2 / 12
        return float(np.sqrt(max(spare, (_LEAST * self.step) ** 2)))


def hangs(time: np.ndarray, angle: np.ndarray, grid: Grid, period: float) -> np.ndarray:
    """Where (N,) the motion `angle` (N,) keeps within a step or two for a whole period (s);
    nowhere, if there is no period (inf)."""
    if not np.isfinite(period):
        return np.zeros(len(time), bool)
    low = np.searchsorted(time, time - period / 2)
    high = np.maximum(np.searchsorted(time, time + period / 2), np.arange(len(time)) + 1)
    size = np.array([np.ptp(angle[a:b]) for a, b in zip(low, high, strict=True)])
    return size < _STEPS * grid.step


def _grids(fit: Fit) -> dict[tuple[int, int], Grid]:
    """The encoder's grid by recording and joint, where the residual must have its pattern."""
    found = {}
    for i, r in enumerate(fit.fitted):
        for j in range(len(fit.joints)):
            use = r.used[:, j]
            if use.sum() >= LEAST:
                grid = Grid.of(r.recording.angle[use, j])
                if grid.matters(r.left[use, j]):
                    found[i, j] = grid
    return found


def _without_rounding(
    fit: Fit,
    slopes: Sequence[np.ndarray],
    grids: Mapping[tuple[int, int], Grid],
    periods: Sequence[float],
) -> list[list[Strip]]:
    """The residual with the pattern of the encoder's steps taken out, per joint and recording;
    `periods` of the recordings' slowest modes, s."""
    fitted = fit.fitted
    weights, left = [r.weight for r in fitted], [r.left for r in fitted]
    for (i, j), grid in grids.items():
        r = fitted[i]
        weights[i][hangs(r.recording.time, r.predicted[:, j], grid, periods[i]), j] = 0.0
    tangent = Tangent.of(slopes, weights, len(fit.numbers))
    moved, units = [np.zeros_like(x) for x in left], left
    for _ in range(_ROUNDS):
        units = [(x - m) * w for x, m, w in zip(left, moved, weights, strict=True)]
        for (i, j), grid in grids.items():
            use = weights[i][:, j] > 0
            if use.any():
                at = (fitted[i].predicted + moved[i])[use, j]
                error = grid.error(at, (left[i] - moved[i])[use, j])
                units[i][use, j] -= error * weights[i][use, j]
        # The fit took rounding for noise. To first order, this is the fit with the rounding known.
        part = tangent.part(units)
        units = [u - p for u, p in zip(units, part, strict=True)]
        moved = [m + p * r.recording.noise for m, p, r in zip(moved, part, fitted, strict=True)]
    return strips(fitted, units, tangent, weights)
