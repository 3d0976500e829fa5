"""Angles, rates and accelerations that all passed the same filter.

A kernel K that is smooth at its ends turns readings q into K*q, K'*q and K''*q: no noisy difference
is ever taken, and whatever linear equation the motion obeys still holds between them, exactly,
whatever the kernel's width. Wide kernels let little noise through, and little of a fast mode.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len

from ..recordings.recording import Recording
from ..recordings.resampling import even_step

_POWER = 5  # (1 - s^2)^5 is smooth enough at its ends for two derivatives
_EVEN = 1e-6  # of the spacing


class Uniform(NamedTuple):
    """A recording on a uniform grid of G instants, `dt` s apart."""

    q: np.ndarray  # (G, n)
    # (G,) False where readings were missing for more than a few samples, or at an end: there, the
    # nearest one is held.
    good: np.ndarray
    drive: np.ndarray  # (G, n)
    dt: float


def uniform(recording: Recording, outliers: np.ndarray) -> Uniform:
    """Resample to equal steps, leaving out missing readings and outliers."""
    time, angle = recording.time, recording.as_angles.angle
    dt = even_step(time)
    grid = np.arange(time[0], time[-1] + 1e-9 * dt, dt)
    q = np.empty((len(grid), angle.shape[1]))
    good = np.ones(len(grid), bool)
    seen = np.isfinite(angle) & ~outliers
    even = len(grid) == len(time) and np.abs(grid - time).max() < _EVEN * dt
    for joint, use in enumerate(seen.T):
        if even and use.all():
            q[:, joint] = angle[:, joint]
            continue
        from scipy.interpolate import CubicSpline  # a tenth of a second, and rarely needed

        known = time[use]
        at = grid.clip(known[0], known[-1])
        q[:, joint] = CubicSpline(known, angle[use, joint])(at)
        after = np.searchsorted(known, at).clip(1, len(known) - 1)
        good &= (np.diff(known)[after - 1] < 4.5 * dt) & (np.abs(grid - at) < _EVEN * dt)
    drive = np.zeros_like(q)
    if recording.drive is not None:
        drive = np.stack([np.interp(grid, time, u) for u in recording.drive.T], axis=1)
    return Uniform(q, good, drive, dt)


def kernel(half: int, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The kernel of half-width `half` samples and its first two derivatives, s^-1 and s^-2."""
    s = np.arange(-half, half + 1) / half
    bump, p = 1 - s**2, _POWER
    value = bump**p
    first = -2 * p * s * bump ** (p - 1)
    second = -2 * p * bump ** (p - 1) + 4 * p * (p - 1) * s**2 * bump ** (p - 2)
    total, width = value.sum(), half * dt
    return value / total, first / total / width, second / total / width**2


class Smoothed(NamedTuple):
    """A recording through H kernels: arrays (H, G, n) and a weight (H, G), 0 where a kernel's
    result does not apply."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    drive: np.ndarray
    weight: np.ndarray

    def kept(self, halves: np.ndarray) -> np.ndarray:
        """(H,) share of the motion (rms about its mean, best joint) that passes each kernel."""
        length = self.q.shape[1]
        inside = (q[h : max(h + 1, length - h)] for q, h in zip(self.q, halves, strict=True))
        passed = np.stack([part.std(axis=0) for part in inside])
        return (passed / np.maximum(self.q[0].std(axis=0), 1e-300)).max(axis=1)


def smooth(
    data: Uniform, halves: np.ndarray, noise: np.ndarray, stride: int, dry: Sequence[int] = ()
) -> Smoothed:
    """Through the kernels of these half-widths (H,), in samples, at every `stride`-th instant.

    `noise` (n,) is that of the angles; instants at which a joint with `dry` friction stands still
    get next to no weight.
    """
    length, widest = len(data.q), int(halves.max())
    # Long enough that no end reaches round to the other, and quick to transform.
    size = 4 * int(next_fast_len(-(-(length + 2 * widest) // 4)))

    def through(columns: np.ndarray, responses: np.ndarray) -> np.ndarray:
        if not columns.any():
            return np.zeros((*responses.shape[:-1], *columns[::stride].shape))
        passed = responses[..., None, :] * np.fft.rfft(columns.T, size)
        if stride > 1:  # fewer instants, of a spectrum that is folded
            assert stride == 2
            half = size // 4 + 1
            passed = 0.5 * (passed[..., :half] + passed[..., : -half - 1 : -1].conj())
        found = np.fft.irfft(passed, size // stride)[..., : -(-length // stride)]
        return found.swapaxes(-1, -2)

    responses, louder = _responses(tuple(int(half) for half in halves), size)
    q, v, a = through(data.q, responses) / data.dt ** np.arange(3.0).reshape(3, 1, 1, 1)
    index = np.arange(0, length, stride)
    inside = (index >= halves[:, None]) & (index < length - halves[:, None])
    inside &= _sums(~data.good[None], halves, index) == 0
    # Where the motion has died away only noise is left, which would pull the numbers to itself.
    rest = np.median(data.q[-max(10, length // 10) :], axis=0)
    share = _beyond_noise(q - rest, inside, halves, stride, noise * louder[0][:, None]).max(axis=-1)
    # Friction that holds a joint is any torque up to its level: no equation of a joint that slides.
    rates = v[..., list(dry)], louder[1][:, None] * noise[list(dry)] / data.dt
    slides = _beyond_noise(rates[0], inside, halves, stride, rates[1])
    share = np.minimum(share, slides.min(axis=-1, initial=np.inf))
    weight = share / (1 + share) * inside
    return Smoothed(q, v, a, through(data.drive, responses[0]), weight)


def _beyond_noise(
    x: np.ndarray, inside: np.ndarray, halves: np.ndarray, stride: int, noise: np.ndarray
) -> np.ndarray:
    """(H, G, n) how large the squares of x (H, G, n) are beyond those of its `noise` (H, n), in
    times the square of six times that noise: means over the instants `inside` (H, G) up to a
    kernel's width away."""
    near, index = 2 * halves // stride, np.arange(x.shape[1])
    total, count = (_sums(y, near, index) for y in (x**2 * inside[..., None], inside))
    mean = np.maximum(total, 0.0) / np.maximum(count, 1)[..., None]
    return np.maximum(mean / noise[:, None] ** 2 - 1.0, 0.0) / 6**2


@functools.lru_cache(maxsize=16)  # recordings come in few lengths
def _responses(halves: tuple[int, ...], size: int) -> tuple[np.ndarray, np.ndarray]:
    """For samples one apart, what the kernels and their first two derivatives do to a spectrum of
    `size` instants, (3, H, F), and how much of white noise passes them, (3, H)."""
    rows = np.zeros((3, len(halves), size))
    for i, half in enumerate(halves):  # the middle stands at 0, its left side last
        for row, k in zip(rows[:, i], kernel(half, 1.0), strict=True):
            row[: half + 1], row[size - half :] = k[half:], k[:half]
    return np.fft.rfft(rows), np.sqrt((rows**2).sum(axis=-1))


def _sums(x: np.ndarray, near: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(H, G, ...) sums of x (H, N, ...) or (1, N, ...) over the rows up to `near` (H,) away from
    each of `index` (G,)."""
    total = np.cumsum(np.pad(x, [(0, 0), (1, 0), *[(0, 0)] * (x.ndim - 2)]), axis=1)
    rows, away = np.arange(len(x))[:, None], near[:, None]
    last = np.minimum(index + away + 1, x.shape[1])
    return total[rows, last] - total[rows, np.maximum(index - away, 0)]
