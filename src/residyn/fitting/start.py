"""A start without simulation: Eq. 1 in weak form.

Smoothed by a kernel K, the measured angles give K*q, K'*q and K''*q: position, rate and
acceleration which all passed the *same* filter, so that a linear equation of motion still holds
exactly between them, whatever the kernel's width. No noisy difference is ever taken. Stiffness
and damping then follow from linear least squares on `q'' - acceleration(q, q'; numbers) = 0`,
for each of a few values of whatever shapes an effect without being proportional to it.

Which width is best depends on modes and noise that are not known yet: narrow ones let noise in,
which biases the stiffness, and wide ones leave nothing of a fast mode. So every width of a
geometric ladder gives one candidate, the least uncertain ones go on, and the simulations of the
multi-start judge between them.
"""

import functools
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..model import Model
from ..motion import Motion, split, stack
from ..parameter import stacked
from ..recording import Recording
from .beginnings import Beginnings, memory_along, oscillates, plain, tuned
from .problem import bucket

_POWER = 5  # (1 - s^2)^5 is smooth enough at its ends for two derivatives
_NARROWEST = 4  # samples in half a kernel
_STRIDE, _LONG = 2, 1000  # where there are so many samples, every other one will do
_LADDER = 12  # kernels tried, each 1.5 times wider than the last
_LEAST_KEPT = 0.05
_EVEN = 1e-6  # of the spacing


class Uniform(NamedTuple):
    """A recording on a uniform grid of G instants, `dt` s apart."""

    q: np.ndarray  # (G, n)
    good: np.ndarray  # (G,) False where readings were missing for more than a few samples
    drive: np.ndarray  # (G, n)
    dt: float


def uniform(recording: Recording, wild: np.ndarray) -> Uniform:
    """Resample to the median spacing, leaving out lost and wild readings."""
    time = recording.time
    dt = float(np.median(np.diff(time)))
    grid = np.arange(time[0], time[-1] + 1e-9 * dt, dt)
    q = np.empty((len(grid), recording.angle.shape[1]))
    good = np.ones(len(grid), bool)
    seen = np.isfinite(recording.angle) & ~wild
    even = len(grid) == len(time) and np.abs(grid - time).max() < _EVEN * dt
    for joint, use in enumerate(seen.T):
        if even and use.all():
            q[:, joint] = recording.angle[:, joint]
            continue
        known = time[use]
        q[:, joint] = _cubic(known, recording.angle[use, joint], grid)
        after = np.searchsorted(known, grid).clip(1, len(known) - 1)
        good &= np.diff(known)[after - 1] < 4.5 * dt
    drive = np.zeros_like(q)
    if recording.drive is not None:
        drive = np.stack([np.interp(grid, time, u) for u in recording.drive.T], axis=1)
    return Uniform(q, good, drive, dt)


def _cubic(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Cubic Lagrange interpolation through the four nearest readings."""
    first = (np.searchsorted(x, at) - 2).clip(0, len(x) - 4)
    index = first[:, None] + np.arange(4)
    nodes, values = x[index], y[index]
    total = np.zeros(len(at))
    for i in range(4):
        others = [k for k in range(4) if k != i]
        top = np.prod(at[:, None] - nodes[:, others], axis=1)
        total += values[:, i] * top / np.prod(nodes[:, [i]] - nodes[:, others], axis=1)
    return total


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
        whole, shares = self.q[0].std(axis=0), []
        for q, half in zip(self.q, halves, strict=True):
            inside = q[half : max(half + 1, len(q) - half)]
            shares.append((inside.std(axis=0) / np.maximum(whole, 1e-300)).max())
        return np.asarray(shares)


def smooth(data: Uniform, halves: np.ndarray, noise: np.ndarray, stride: int) -> Smoothed:
    """Through the kernels of these half-widths (H,), in samples, at every `stride`-th instant."""
    length, widest = len(data.q), int(halves.max())
    # Long enough that no end reaches round to the other, and quick to transform.
    size = _quick(length + 2 * widest)

    def through(columns: np.ndarray, responses: np.ndarray) -> np.ndarray:
        if not columns.any():
            return np.zeros((len(responses), *columns[::stride].shape))
        spectrum = np.fft.rfft(columns.T, size)
        passed = np.fft.irfft(responses[:, None] * spectrum, size)
        return passed[..., :length:stride].transpose(0, 2, 1)

    responses, louder = _responses(tuple(int(half) for half in halves), size)
    q, v, a = (through(data.q, r / data.dt**k) for k, r in enumerate(responses))
    index = np.arange(0, length, stride)
    inside = (index >= halves[:, None]) & (index < length - halves[:, None])
    inside &= _sums(~data.good, halves, stride) == 0
    # Where the motion has died away only noise is left, which would pull the numbers to itself.
    left = noise * louder[:, None]
    rest = np.median(data.q[-max(10, length // 10) :], axis=0)
    wide = 2 * halves
    size2 = np.stack([_sums(x, wide, stride) for x in ((data.q - rest) ** 2).T], axis=-1)
    size2 = np.maximum(size2, 0.0) / (2 * wide + 1)[:, None, None]
    share = (size2 / (6 * left[:, None]) ** 2).max(axis=2)
    weight = share / (1 + share) * inside
    return Smoothed(q, v, a, through(data.drive, responses[0]), weight)


def _quick(least: int) -> int:
    """The next length that is a power of two, or one and a half times one."""
    size = 1 << (least - 1).bit_length()
    return size * 3 // 4 if size * 3 // 4 >= least else size


@functools.lru_cache(maxsize=16)  # recordings come in few lengths
def _responses(halves: tuple[int, ...], size: int) -> tuple[np.ndarray, np.ndarray]:
    """For samples one apart, what the kernels and their first two derivatives do to a spectrum of
    `size` instants, (3, H, F), and how much of white noise passes the kernels, (H,)."""
    rows = np.zeros((3, len(halves), size))
    for i, half in enumerate(halves):  # the middle stands at 0, its left side last
        for row, k in zip(rows[:, i], kernel(half, 1.0), strict=True):
            row[: half + 1], row[size - half :] = k[half:], k[:half]
    return np.fft.rfft(rows), np.sqrt((rows[0] ** 2).sum(axis=-1))


def _sums(x: np.ndarray, halves: np.ndarray, stride: int) -> np.ndarray:
    """(H, G): the sum of x (G,) over the instants up to `halves` (H,) away, at every `stride`-th
    instant."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    index = np.arange(0, len(x), stride)
    first = np.maximum(index - halves[:, None], 0)
    last = np.minimum(index + halves[:, None] + 1, len(x))
    return total[last] - total[first]


class Candidates(NamedTuple):
    """Closed-form estimates, best first: (C, P) numbers, (C, R, m) internal states at the first
    sample, (C,) typical log relative spread."""

    numbers: np.ndarray
    memory: np.ndarray
    spread: np.ndarray


def closed_form(
    models: Sequence[Model],
    recordings: Sequence[Recording],
    wild: Sequence[np.ndarray],
    sizes: np.ndarray,
) -> Candidates:
    """Candidate numbers for a model from its recordings (one model per recording's pose).

    `sizes` (P,) are the numbers' typical ones, in which their grids are given.

    **Returns:** the candidates, the least uncertain first; empty if the model has no numbers.
    """
    grids = [uniform(r, w) for r, w in zip(recordings, wild, strict=True)]
    shortest = min(len(g.q) for g in grids)
    # What passed a kernel varies from sample to sample as slowly as the kernel does; a memory is
    # run along the motion, and wants all of it.
    stride = _STRIDE if shortest >= _LONG and not models[0].memory else 1
    longest = bucket(max(len(g.q[::stride]) for g in grids))
    halves = np.array([round(_NARROWEST * 1.5**i) for i in range(_LADDER)])
    fits = halves <= max(_NARROWEST, shortest // 8)
    used = np.where(fits, halves, _NARROWEST)  # always as many: one compiled program
    each = [smooth(g, used, r.noise, stride) for g, r in zip(grids, recordings, strict=True)]
    data = tuple(jnp.asarray(_side_by_side(parts, longest)) for parts in zip(*each, strict=True))
    posed = stacked(models)
    spacing = jnp.asarray([g.dt * stride for g in grids])

    def solved(beginnings: Beginnings):
        begin = jax.tree.map(jnp.asarray, beginnings)
        return jax.device_get(_solve(posed, begin, spacing, data))

    beginnings = plain(models[0], sizes, len(grids))
    if oscillates(models[0]):
        missing = solved(beginnings)[2]
        beginnings = tuned(models[0], beginnings, missing, np.asarray(spacing), fits)
    numbers, spread, _ = solved(beginnings)
    # A kernel wider than the slowest swing leaves only rest and drift, which any tiny stiffness
    # fits beautifully.
    kept = np.max([s.kept(used // stride) for s in each], axis=0)
    fits &= kept > min(_LEAST_KEPT, 0.5 * kept.max())
    # Overlapping kernels share their noise: a kernel of half-width h leaves about 1/h as many
    # independent equations.
    spread = spread + np.where(fits, 0.5 * np.log(halves), np.inf)[:, None]
    spread = np.where(np.isfinite(numbers).all(axis=-1), spread, np.inf)
    memory = np.broadcast_to(beginnings.memory, (_LADDER, *beginnings.memory.shape))
    order = _order(spread)
    flat = [x.reshape(spread.size, *x.shape[2:])[order] for x in (numbers, memory, spread)]
    return Candidates(*flat)


def _order(spread: np.ndarray) -> np.ndarray:
    """Indices into the flat (kernels, beginnings), best first, hopeless ones left out.

    Every beginning's best kernel comes before any beginning's second: what tells shapes apart is
    the simulation.
    """
    rank = np.argsort(np.argsort(spread, axis=0, kind="stable"), axis=0, kind="stable")
    order = np.lexsort((spread.reshape(-1), rank.reshape(-1)))
    return order[np.isfinite(spread.reshape(-1)[order])]


def _side_by_side(parts: Sequence[np.ndarray], longest: int) -> np.ndarray:
    """(H, G, ...) of each recording as (H, R, longest, ...), filled up with zeros."""
    filled = np.zeros((parts[0].shape[0], len(parts), longest, *parts[0].shape[2:]))
    for i, part in enumerate(parts):
        filled[:, i, : part.shape[1]] = part
    return filled


@eqx.filter_jit
def _solve(models, beginnings: Beginnings, spacing, data):
    """Linear least squares on the acceleration error, for every kernel and beginning.

    **Returns:** numbers (K, B, P), their spread (K, B), and the torque that is missing at the first
    beginning (K, R, G, n).
    """
    shape = jnp.asarray([n.meaning.silent is None for n in models.fitted])

    def error(vector, model, t, q, v, a, drive, weight, z):
        model = model.with_vector(vector)
        wanted = stack(model.acceleration(Motion.at(t, q, v, z), split(drive)))
        return jnp.sqrt(weight) * (a - wanted)

    def one(vector, z0, data):  # one beginning and kernel; `data` over recordings
        length = data[0].shape[1]
        t = spacing[:, None] * jnp.arange(length)
        z = eqx.filter_vmap(lambda m, *x: memory_along(m.with_vector(vector), *x))(
            models, spacing, data[0], data[1], z0
        )

        def equations(vector):
            def row(model, *instant):
                e = error(vector, model, *instant)
                return e, jax.jacfwd(error)(vector, model, *instant)

            rows = eqx.filter_vmap(jax.vmap(row, in_axes=(None,) + (0,) * 7))
            e, j = rows(models, t, *data, z)
            j = jnp.where(shape, 0.0, j)
            return jnp.einsum("rgnp,rgnk->pk", j, j), jnp.einsum("rgnp,rgn->p", j, e), e

        square, slope, _ = equations(vector)
        seen = jnp.diag(square) > 0
        size = jnp.sqrt(jnp.where(seen, jnp.diag(square), 1.0))
        scaled = square / size / size[:, None] + 1e-12 * jnp.eye(len(size))
        vector = vector - jnp.linalg.solve(scaled, slope / size) / size
        square, _, e = equations(vector)
        count = jnp.sum(data[-1]) * e.shape[-1]
        # Log of the typical relative standard deviation, for ranking only.
        square = square + jnp.diag(jnp.where(seen, 0.0, 1.0))
        spread = 0.5 * (
            jnp.log(jnp.sum(e**2) / count)
            - jnp.linalg.slogdet(square)[1] / jnp.maximum(1, jnp.sum(seen))
        )
        return vector, spread, e

    each = jax.vmap(one, in_axes=(0, 0, None))
    numbers, spread, e = jax.vmap(each, in_axes=(None, None, 0))(*beginnings, data)

    def torque(model, q, e):
        rows = model.bodies.mass_matrix(split(q))
        return stack(tuple(sum(z * x for z, x in zip(row, split(e), strict=True)) for row in rows))

    # Of each recording's own model, which may hold what is no array: not for `jax.vmap`.
    each = eqx.filter_vmap(jax.vmap(torque, in_axes=(None, 0, 0)))
    return numbers, spread, jax.vmap(partial(each, models))(data[0], -e[:, 0])


def perturbed(best: np.ndarray, count: int, spread: float = 0.3) -> np.ndarray:
    """`count` points around one: each number times a log-normal factor of log-spread `spread`.

    The factors are always the same ones, so that the same recording gives the same fit.
    """
    factors = np.random.default_rng(0).standard_normal((count, len(best)))
    return best * np.exp(spread * factors)
