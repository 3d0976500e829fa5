"""The spectrum of a residual, exact for lost samples, uneven times and what a fit has swallowed.

Cosines of half a cycle, one, one and a half ... over the recording are an orthonormal set on even
samples only: lost samples and uneven times make them lean on each other, and the fit has removed
the tangent from the residual. The first is in the cosines' products with each other: with these,
energies taken one band after another, each less what the bands before it explain, add up. Both
are in the covariance of the residual's products with the cosines, were it white noise: divided by
it, the energy in any k cosines is chi-square with k degrees of freedom.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import dct, next_fast_len, rfft

from ..fitting.result import RecordingFit
from .evidence import CONTENDERS
from .linearised_fit import Tangent

_EVENLY = 1e-9  # rad, over the highest cosine: this far off even counts as even
_MOST = 4096  # rows; a longer recording is averaged in blocks, which keeps white noise white
_PIECE = 64  # cosines at a time: eigenvalues of large matrices cost most
_SEEN = 0.05  # of a cosine's own energy: what must be left of it to count
_DENSE = 4  # frequencies of a periodogram per line (1/duration): the nearest keeps 95 % of a sine


class Spectrum(NamedTuple):
    """One joint of one recording: products with the K cosines and what they would be by chance.

    Cosine j has the frequency j / (2 T), T = `duration`.
    """

    duration: float
    products: np.ndarray  # (K,) of the whitened residual with each cosine
    overlap: np.ndarray  # (K, K) products of the cosines with each other; one on the diagonal
    along: np.ndarray  # (L, K) products of the tangent's columns with the cosines
    energy: float  # of the whole whitened residual
    freedom: float  # its expectation: readings less unknowns

    def columns(self, start: float, stop: float) -> np.ndarray:
        """Indices of the cosines from `start` to below `stop`, Hz."""
        first, end = (int(np.ceil(2 * self.duration * f - 1e-9)) for f in (start, stop))
        return np.arange(first, min(end, len(self.products)))


class Strip(NamedTuple):
    """One joint of one recording, a row per sample."""

    time: np.ndarray  # (N,) s
    residual: np.ndarray  # (N,) whitened
    tangent: np.ndarray  # (N, K), see `linearised_fit.Tangent`
    used: np.ndarray  # (N,) whether the reading counts


def strips(
    fitted: Sequence[RecordingFit],
    units: Sequence[np.ndarray],
    tangent: Tangent,
    weights: Sequence[np.ndarray],
) -> list[list[Strip]]:
    """Per joint and recording, from whitened residuals and weights (N, n) of each recording."""
    return [
        [
            Strip(r.recording.time, u[:, j], c[:, j], w[:, j] > 0)
            for r, u, c, w in zip(fitted, units, tangent.columns, weights, strict=True)
        ]
        for j in range(weights[0].shape[1])
    ]


def spectrum(strip: Strip, top: float) -> Spectrum:
    """The spectrum up to `top` Hz."""
    time, residual, tangent, used = strip
    rows = np.flatnonzero(used)
    time, residual, tangent = time[rows], residual[rows], tangent[rows]
    energy = float(residual @ residual)
    freedom = float(len(rows) - (tangent**2).sum())
    step = (time[-1] - time[0]) / (len(time) - 1)
    duration = len(time) * step
    block = -(-len(rows) // _MOST)
    if block > 1:
        first = np.arange(0, len(rows), block)
        count = np.diff(np.append(first, len(rows)))
        time = np.add.reduceat(time, first) / count
        residual = np.add.reduceat(residual, first) / np.sqrt(count)
        tangent = np.add.reduceat(tangent, first) / np.sqrt(count)[:, None]
    phase, many = (time - time[0] + step / 2) * np.pi / duration, int(np.ceil(2 * duration * top))
    even = (np.arange(len(phase)) + 0.5) * np.pi / len(phase)
    columns = np.column_stack([residual, tangent])
    if len(phase) >= many and np.abs(phase - even).max() < _EVENLY / max(1, many):
        columns = np.asarray(dct(columns, axis=0, norm="ortho"))[:many]
        overlap = np.eye(many)
    else:
        cosines = np.cos(phase[:, None] * np.arange(many))
        cosines /= np.sqrt((cosines**2).sum(axis=0))
        columns, overlap = cosines.T @ columns, cosines.T @ cosines
    return Spectrum(duration, columns[:, 0], overlap, columns[:, 1:].T, energy, freedom)


def energies(one: Spectrum, groups: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Energy in groups of cosines, each less what stronger groups explain, and its expectation.

    With the energy in no group, which is never negative, they add up to the residual's own.
    """
    if _even(one.overlap):  # the usual case, at no cost
        energy = np.array([(one.products[g] ** 2).sum() for g in groups])
        return energy, np.array([len(g) - (one.along[:, g] ** 2).sum() for g in groups])
    strength = [(one.products[g] ** 2).mean() if len(g) else 0.0 for g in groups]
    energy, freedom = np.zeros((2, len(groups)))
    # Rows: orthonormal combinations of cosines. Where samples are lost the bands are not quite
    # apart, and the strongest leaks most: so it comes first.
    rows = np.zeros((0, len(one.products)))
    for i in np.argsort(strength)[::-1]:
        pieces = max(1, -(-len(groups[i]) // _PIECE))
        for group in np.array_split(groups[i], pieces):
            shared = rows @ one.overlap[:, group]
            turn = _whitening(one.overlap[np.ix_(group, group)] - shared.T @ shared)
            new = -(turn @ shared.T) @ rows
            new[:, group] += turn
            energy[i] += ((new @ one.products) ** 2).sum()
            freedom[i] += len(new) - ((one.along @ new.T) ** 2).sum()
            rows = np.vstack([rows, new])
    return energy, freedom


def whitened(one: Spectrum, group: np.ndarray) -> np.ndarray:
    """Independent combinations of a group's products: each of variance 1 if only noise is left."""
    along = one.along[:, group]
    # Of the products, were the residual white noise less its part along the tangent.
    covariance = one.overlap[np.ix_(group, group)] - along.T @ along
    return _whitening(covariance) @ one.products[group]


def periodogram(strip: Strip) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,), Hz, to half a reading's rate, and the energy (F,) that a sine of each, at
    its best amplitude and phase, explains: chi-square with 2 degrees of freedom if only noise is
    left. The least-squares periodogram (Lomb, Astrophysics and Space Science 39, 1976) less what
    the fit has swallowed. Times count to a quarter of the step between readings: such a sine is
    not quite one, but what noise has of it is known as well.
    """
    rows = np.flatnonzero(strip.used)
    time = strip.time[rows] - strip.time[rows[0]]
    step = float(np.median(np.diff(strip.time))) / 2
    slot = np.rint(time / step).astype(int)
    size = next_fast_len(_DENSE * (slot[-1] + 1), real=True)

    def transformed(x: np.ndarray) -> np.ndarray:
        return np.asarray(rfft(np.bincount(slot, x), size))

    last = size // 4 + 1
    count, product = transformed(np.ones(len(rows))), transformed(strip.residual[rows])[:last]
    # Of cosine and sine, the products with each other: half the sum and the difference.
    both, other = np.full(last, count[0].real), count[: 2 * last : 2].copy()
    for column in strip.tangent[rows].T:
        along = transformed(column)[:last]
        both -= np.abs(along) ** 2
        other -= along**2
    square = both**2 - np.abs(other) ** 2
    energy = 2 * (both * np.abs(product) ** 2 - (other.conj() * product**2).real)
    seen = square > _SEEN * count[0].real ** 2
    seen[:_DENSE] = False  # less than a cycle
    return np.flatnonzero(seen) / (size * step), energy[seen] / square[seen]


def _whitening(square: np.ndarray) -> np.ndarray:
    """Rows w of which w square w' is the identity, less what can hardly be seen."""
    if not len(square):
        return square
    if _even(square):
        return np.eye(len(square))
    size, turn = np.linalg.eigh(square)
    return (turn[:, size > _SEEN] / np.sqrt(size[size > _SEEN])).T


def _even(overlap: np.ndarray) -> bool:
    """Whether it is the identity: even samples, and none of them lost."""
    return bool(np.abs(overlap - np.eye(len(overlap))).max() < 1e-9)


def lines(time: np.ndarray, x: np.ndarray, dt: float, chance: float = 1.0) -> list[float]:
    """Strongest frequencies, Hz, of x (N,) at the times (N,), taken at steps `dt`; only those as
    strong as one of white noise is with less than a `chance`."""
    even = np.arange(time[0], time[-1], dt) if len(time) else time
    if len(even) < 4:
        return []
    x, span = np.interp(even, time, x), even[-1] - even[0]
    f = np.fft.rfftfreq(4 * len(even), dt)
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(even)), 4 * len(even))) ** 2
    power = power * (f > 1.5 / span)
    # Lines of noise are distributed exponentially, and half as many as readings are independent.
    mean = float(np.median(power)) / math.log(2.0)
    least = mean * math.log(len(even) / 2 / chance) if chance < 1 else 0.0
    found = []
    for _ in range(CONTENDERS):
        if power.max() < least:
            break
        line = float(max(f[np.argmax(power)], 0.5 / span))
        power[np.abs(f - line) < 2.0 / span] = 0
        found.append(line)
    return found
