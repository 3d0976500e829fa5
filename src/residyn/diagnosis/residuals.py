"""Where a model fails: the squared residual, divided up.

By joint, by time, by amplitude of the swing and by frequency. All energies are in units of the
noise of a reading, so that joints and recordings add up. A share alone says little, since noise has
its shares too; so each part also says how many times the noise it is, 1 being what noise alone
leaves after a fit (which swallows a little of it, most of all at the modes).
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..filtering.grid import local_amplitude
from ..fitting.result import Fit, RecordingFit
from ..runtime.json import finite, number
from .bands import RecordingBands, recording_bands
from .evidence import NOISE
from .linearised_fit import Tangent, predictions
from .spectrum import Spectrum, energies, strips
from .whiteness import Line, spectrum_of, white

WINDOWS = 8
_HALVINGS = 3  # amplitudes: above 1/2, 1/4, 1/8 of the largest, and the rest
_TINY = 0.5  # degrees of freedom: with less, noise would leave nothing to compare with


class Cell(NamedTuple):
    """A part of the squared residual, in units of the noise."""

    energy: float
    freedom: float
    """What noise alone would leave of it."""

    @property
    def ratio(self) -> float:
        """Rms residual over what noise alone would leave; NaN if that is nothing."""
        return math.sqrt(self.energy / self.freedom) if self.freedom > _TINY else math.nan


class Part(NamedTuple):
    """A window, a range or a band: what it is and, per joint, what is in it."""

    name: str
    start: float
    stop: float
    cells: tuple[Cell, ...]

    @property
    def whole(self) -> Cell:
        """All joints together."""
        return together(self.cells)


def together(cells: Sequence[Cell]) -> Cell:
    """The sum of some cells."""
    return Cell(sum(c.energy for c in cells), sum(c.freedom for c in cells))


class Coloured(NamedTuple):
    """A residual that is larger than the noise, and not white."""

    joint: str
    """Where it is least like noise."""
    ratio: float
    """Its rms there, in times the noise."""
    frequency_hz: float | None
    """Of the strongest line that stands out of white noise; None if none does."""

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return finite(self._asdict())


def coloured(fit: Fit) -> Coloured | None:
    """What a fit leaves, if that is more than noise leaves and not white; else None. Of what its
    model leaves, a fit that did not settle says nothing."""
    if not (fit.misses and fit.converged):
        return None
    at = where(fit, predictions(fit, fit.unknowns)[1])
    found = [
        Coloured(joint, ratio, at.line_hz(joint))
        for joint, ratio in zip(fit.joints, fit.ratio.tolist(), strict=True)
        if at.white[joint] < NOISE
    ]
    return max(found, key=lambda c: c.ratio, default=None)


@dataclass(frozen=True, eq=False)
class Where:
    """The squared residual of the fitted recordings, divided up in four ways.

    Each division's energies add up to the same sum.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    white: Mapping[str, float]
    """Of each joint, p of `whiteness.white`."""
    line: Mapping[str, Line | None]
    """Of each joint the strongest line; None if none stands out of white noise, or what does is an
    offset or a drift."""
    joint: tuple[Cell, ...]
    """One cell per joint."""
    time: tuple[Part, ...]
    """Equal windows of the time since each recording's first sample, s."""
    amplitude: tuple[tuple[Part, ...], ...]
    """Per joint, ranges of the local amplitude of its own swing, rad or m, largest first. Local:
    sqrt(2) times the standard deviation over one period of the recording's slowest mode."""
    frequency: tuple[Part, ...]
    """Bands tied to each recording's own modes, see `bands.Band`; their edges, Hz, are those of the
    first recording."""
    recordings: tuple[RecordingBands, ...]
    """Of each fitted recording its modes and bands, as many as there are in `frequency`."""

    @property
    def total(self) -> float:
        """All squared residuals, in units of the noise."""
        return sum(c.energy for c in self.joint)

    def line_hz(self, joint: str) -> float | None:
        """The frequency of a joint's line, if it has one."""
        line = self.line[joint]
        return None if line is None else line.frequency

    @property
    def alike(self) -> bool:
        """Whether all recordings have the same bands."""
        return len({own.bands for own in self.recordings}) == 1

    def to_dict(self) -> dict[str, Any]:
        """The JSON under `where`. All `share` are of the whole squared residual (in units of the
        noise), so that in each list they add up to 1; `ratio` is the rms in times the noise."""

        def cell(c: Cell) -> dict[str, Any]:
            share = c.energy / self.total if self.total > 0 else math.nan
            return {"share": number(share), "ratio": number(c.ratio)}

        def part(p: Part) -> dict[str, Any]:
            named = {"name": p.name} if p.name else {}
            each = {j: cell(c) for j, c in zip(self.joints, p.cells, strict=True)}
            edges = {"start": number(p.start), "stop": number(p.stop)}
            return {**named, **edges, **cell(p.whole), "joints": each}

        def edges(i: int) -> dict[str, Any]:
            own = {own.name: own.bands[i] for own in self.recordings}
            each = {name: {"start": b.start, "stop": b.stop} for name, b in own.items()}
            return {"recordings": each}

        return {
            "white": {joint: number(p) for joint, p in self.white.items()},
            "line": {joint: self.line_hz(joint) for joint in self.line},
            "joint": {j: cell(c) for j, c in zip(self.joints, self.joint, strict=True)},
            "time": [part(p) for p in self.time],
            "amplitude": [
                {"joint": j, "unit": u, "start": p.start, "stop": p.stop, **cell(p.whole)}
                for j, u, parts in zip(self.joints, self.units, self.amplitude, strict=True)
                for p in parts
            ],
            "frequency": [part(p) | edges(i) for i, p in enumerate(self.frequency)],
        }


def where(fit: Fit, slopes: Sequence[np.ndarray]) -> Where:
    """Divide up the residual of a fit; `slopes` (N, n, L) per recording from `predictions`."""
    weights = [r.weight for r in fit.fitted]
    tangent = Tangent.of(slopes, weights, len(fit.numbers))
    units = [r.left * r.weight for r in fit.fitted]
    energy = [u**2 for u in units]
    # What noise alone leaves of each squared reading: 1 less what the fit has swallowed.
    freedom = [(w > 0) - (c**2).sum(axis=-1) for w, c in zip(weights, tangent.columns, strict=True)]

    def cells(chosen: Sequence[np.ndarray]) -> tuple[Cell, ...]:
        sums = [
            np.sum([x[s].sum(axis=0) for x, s in zip(xs, chosen, strict=True)], axis=0).tolist()
            for xs in (energy, freedom)
        ]
        return tuple(Cell(*each) for each in zip(*sums, strict=True))

    own = recording_bands(fit)
    rows = strips(fit.fitted, units, tangent, weights)
    tops = [each.bands[-1].start for each in own]
    spectra = [list(map(spectrum_of, row, tops)) for row in rows]
    tested = white(fit, slopes, own, rows, spectra)
    return Where(
        joints=fit.joints,
        units=fit.units,
        white={joint: found.p for joint, found in tested.items()},
        line={joint: found.line for joint, found in tested.items()},
        joint=cells([np.ones(len(u), bool) for u in units]),
        time=tuple(_by_time(fit.fitted, cells)),
        amplitude=tuple(_by_amplitude(fit, [each.period for each in own], cells)),
        frequency=_by_frequency(spectra, own),
        recordings=own,
    )


def _by_time(fitted: Sequence[RecordingFit], cells):
    since = [r.recording.time - r.recording.time[0] for r in fitted]
    edges = np.linspace(0.0, max(t[-1] for t in since), WINDOWS + 1)
    for i, (a, b) in enumerate(itertools.pairwise(edges)):
        last = i == WINDOWS - 1
        chosen = [(t >= a) & ((t < b) | last) for t in since]
        yield Part("", float(a), float(b), cells(chosen))


def _by_amplitude(fit: Fit, periods: Sequence[float], cells):
    sizes = list(map(swing, fit.fitted, periods))
    for j in range(len(fit.joints)):
        most = max(float(s[:, j].max()) for s in sizes)
        edges = [most * 0.5**i for i in range(_HALVINGS + 1)] + [0.0]
        parts = []
        for i, (high, low) in enumerate(itertools.pairwise(edges)):
            last = i == _HALVINGS
            chosen = [((s[:, j] > low) | last) & (s[:, j] <= high) for s in sizes]
            if any(c.any() for c in chosen):
                parts.append(Part("", low, high, (cells(chosen)[j],)))
        yield tuple(parts)


def swing(beside: RecordingFit, period: float) -> np.ndarray:
    """(N, n) amplitude of the measured motion over one period (s) around each sample."""
    r = beside.recording
    pairs = zip(beside.used.T, r.as_angles.angle.T, strict=True)
    seen = [np.interp(r.time, r.time[u], q[u]) if u.any() else 0.0 * r.time for u, q in pairs]
    return local_amplitude(r.time, np.stack(seen, axis=1), min(period, r.duration / 4))


def _by_frequency(
    spectra: Sequence[Sequence[Spectrum | None]], own: Sequence[RecordingBands]
) -> tuple[Part, ...]:
    columns, first = [], own[0].bands
    for row in spectra:
        sums = np.zeros((2, len(first)))
        for one, its in zip(row, own, strict=True):
            if one is not None:
                found = energies(one, [one.columns(b.start, b.stop) for b in its.bands[:-1]])
                whole = np.array([one.energy, one.freedom])
                sums[:, :-1] += found
                sums[:, -1] += np.maximum(whole - np.sum(found, axis=1), 0.0)
        columns.append([Cell(float(e), float(f)) for e, f in sums.T])
    return tuple(
        Part(*band, cells) for band, cells in zip(first, zip(*columns, strict=True), strict=True)
    )
