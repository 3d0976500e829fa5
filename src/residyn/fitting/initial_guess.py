"""A start without simulation: Eq. 1 in weak form.

Position, rate and acceleration that all passed the *same* filter (`smoothing`) obey the same
linear equation of motion. Stiffness and damping follow from linear least squares on
`q'' - acceleration(q, q'; numbers) = 0`, for each of a few values of whatever shapes an effect
without being proportional to it.

Which width is best depends on modes and noise that are not known yet: narrow ones let noise in,
which biases the stiffness, and wide ones leave nothing of a fast mode. So every width of a
geometric ladder gives one candidate, the least uncertain ones go on, and the simulations of the
multi-start judge between them.

An arm that comes to rest away from zero (a brake has slipped, a table is tilted) would make its
springs look soft, or negative: beside those candidates, others come from equations with a constant
torque at every joint, which is then forgotten.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..physics.model import Model
from ..physics.motion import Motion, split, stack
from ..physics.parameter import stacked
from ..recordings.recording import Recording
from ..runtime.export_cache import kept
from .beginnings import Beginnings, memory_along, oscillates, plain, tuned
from .layout import AnyArray, bucket
from .smoothing import smooth, uniform

_NARROWEST = 4  # samples in half a kernel
_STRIDE, _LONG = 2, 1000  # where there are so many samples, every other one will do
_ENOUGH = 64  # recordings, evenly picked: a start needs no more, and the fit weighs all of them
_LADDER = 12  # kernels tried, each 1.5 times wider than the last
_LEAST_KEPT = 0.05
_INSTANTS = 8, 2048  # room for instants comes in powers of this, from this up
_CHUNK = 256  # instants whose equations are summed at a time
_FAR = 10.0  # times its typical size: no number is looked for much further away
_ROUNDING = 1e-14
_ELSEWHERE = 0.1  # of a joint's swing: where it rings about, if not about zero


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
    if len(recordings) > _ENOUGH and not models[0].memory:
        some = np.linspace(0, len(recordings) - 1, _ENOUGH).round().astype(int)
        models, recordings, wild = ([x[i] for i in some] for x in (models, recordings, wild))
    grids = [uniform(r, w) for r, w in zip(recordings, wild, strict=True)]
    shortest = min(len(g.q) for g in grids)
    # What passed a kernel varies from sample to sample as slowly as the kernel does; a memory is
    # run along the motion, and wants all of it.
    stride = _STRIDE if shortest >= _LONG and not models[0].memory else 1
    longest = max(len(g.q[::stride]) for g in grids)
    longest = bucket(longest) if models[0].memory else bucket(longest, *_INSTANTS)
    halves = np.array([round(_NARROWEST * 1.5**i) for i in range(_LADDER)])
    fits = halves <= max(_NARROWEST, shortest // 8)
    used = np.where(fits, halves, _NARROWEST)  # always as many: one compiled program
    each = [smooth(g, used, r.noise, stride) for g, r in zip(grids, recordings, strict=True)]
    data = tuple(_side_by_side(parts, longest) for parts in zip(*each, strict=True))
    posed = stacked(models)
    spacing = np.array([g.dt * stride for g in grids])

    chunks = np.asarray(-(-max(q.shape[1] for q, *_ in each) // min(_CHUNK, longest)))

    def solved(beginnings: Beginnings):
        equations = jax.device_get(_equations(posed, beginnings, spacing, data, chunks))
        return _solved(equations, np.asarray(beginnings.numbers), sizes, used // stride)

    beginnings = plain(models[0], sizes, len(grids))
    if oscillates(models[0]):
        first = jax.tree.map(lambda x: x[0], beginnings)
        found = solved(beginnings)[0][:, 0, 0]
        missing = jax.device_get(_missing(posed, first, found, spacing, data))
        beginnings = tuned(models[0], beginnings, missing, spacing, fits)
    numbers, spread = solved(beginnings)
    # Without and with a constant torque, (K, 2, B): taken as further beginnings, unless there are
    # several already, which tell more.
    elsewhere = len(beginnings.numbers) == 1 and any(_rests_elsewhere(g.q) for g in grids)
    kinds = slice(None, None, -1) if elsewhere else slice(1)
    numbers, spread = numbers[:, kinds], spread[:, kinds]
    memory = np.tile(beginnings.memory, (numbers.shape[1], 1, 1))
    numbers = numbers.reshape(_LADDER, -1, numbers.shape[-1])
    spread = spread.reshape(_LADDER, -1)
    # A kernel wider than the slowest swing leaves only rest and drift, which any tiny stiffness
    # fits beautifully.
    kept = np.max([s.kept(used // stride) for s in each], axis=0)
    fits &= kept > min(_LEAST_KEPT, 0.5 * kept.max())
    # Overlapping kernels share their noise: a kernel of half-width h leaves about 1/h as many
    # independent equations.
    spread = spread + np.where(fits, 0.5 * np.log(halves), np.inf)[:, None]
    spread = np.where(np.isfinite(numbers).all(axis=-1), spread, np.inf)
    memory = np.broadcast_to(memory, (_LADDER, *memory.shape))
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


def _rests_elsewhere(q: np.ndarray) -> bool:
    """Whether a joint, its angles (G, n), rings about an angle that is not near zero."""
    middle = np.median(q[len(q) // 2 :], axis=0)
    return bool(np.any(np.abs(middle) > _ELSEWHERE * np.abs(q).max(axis=0)))


def _errors(of, models, vector, data, z, t):
    """`of`, the acceleration error or its derivative, at every instant of every recording."""
    row = jax.vmap(partial(of, vector), in_axes=(None,) + (0,) * 7)
    return eqx.filter_vmap(row)(models, t, *data, z)


def _error(vector, model, t, q, v, a, drive, weight, z):
    """Acceleration, and a torque at each joint that no effect gives, less what was measured."""
    joints = len(model.mechanism.joints)
    model = model.with_vector(vector[:-joints])
    drive = split(drive + vector[-joints:])
    wanted = stack(model.acceleration(Motion.at(t, q, v, z), drive))
    return jnp.sqrt(weight) * (a - wanted)


def _memories(models, vector, z0, spacing, data):
    """Each recording's internal states (R, G, m) along its motion, with these numbers (P,)."""
    return eqx.filter_vmap(lambda m, *x: memory_along(m.with_vector(vector), *x))(
        models, spacing, data[0], data[1], z0
    )


class _Equations(NamedTuple):
    """Linear equations for changes of U unknowns, the model's numbers (P,) and a constant torque at
    every joint: J'J, J'e and e'e, for every kernel and beginning."""

    square: AnyArray  # (K, B, U, U)
    slope: AnyArray  # (K, B, U)
    total: AnyArray  # (K, B)
    readings: AnyArray  # (K,) how many there are, by their weight


@kept(like=_Equations(0, 0, 0, 0))  # pyright: ignore[reportArgumentType]
def _equations(models, beginnings: Beginnings, spacing, data, chunks) -> _Equations:
    """The acceleration error and its slopes, summed over the first `chunks` chunks of instants."""
    joints = len(models.mechanism.joints)
    shape = [n.meaning.silent is None for n in models.fitted]
    shape = jnp.asarray([*shape, *[False] * joints])
    t = spacing[:, None] * jnp.arange(data[0].shape[2])
    chunk = min(_CHUNK, t.shape[1])

    def one(vector, z0, data):  # one beginning and kernel; `data` over recordings
        z = _memories(models, vector, z0, spacing, data)
        vector = jnp.concatenate([vector, jnp.zeros(joints)])

        def add(index, sums):
            """How many chunks there are need not be compiled in."""
            part = jax.tree.map(
                lambda x: jax.lax.dynamic_slice_in_dim(x, index * chunk, chunk, 1), (data, z, t)
            )
            of = lambda *x: (_error(*x), jax.jacfwd(_error)(*x))  # noqa: E731
            e, j = _errors(of, models, vector, *part)
            j = jnp.where(shape, 0.0, j)
            more = jnp.einsum("rgnp,rgnk->pk", j, j), jnp.einsum("rgnp,rgn->p", j, e), jnp.sum(e**2)
            return jax.tree.map(jnp.add, sums, more)

        empty = jnp.zeros((len(shape),) * 2), jnp.zeros(len(shape)), jnp.zeros(())
        return jax.lax.fori_loop(0, chunks, add, empty)

    each = jax.vmap(one, in_axes=(0, 0, None))
    sums = jax.vmap(each, in_axes=(None, None, 0))(*beginnings, data)
    return _Equations(sums[0], sums[1], sums[2], jnp.sum(data[-1], axis=(1, 2)) * joints)


def _solved(
    equations: _Equations, vectors: np.ndarray, sizes: np.ndarray, halves: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (K, 2, B, P), without and with the constant torques, and their spread (K, 2, B), from
    beginnings (B, P); `sizes` (P,) are typical, `halves` (K,) the kernels' half-widths in instants.
    """
    squares, slopes, total, readings = (np.asarray(x) for x in equations)
    own, found, spreads = vectors.shape[1], [], []
    for count in (own, slopes.shape[-1]):
        square, slope = squares[..., :count, :count], slopes[..., :count]
        diagonal = np.einsum("kbii->kbi", square)
        seen = diagonal > 0
        size = np.sqrt(np.where(seen, diagonal, 1.0))
        scaled = square / size[..., None] / size[..., None, :]
        # Blind directions stay put; of others the typical relative standard deviation is wanted, in
        # its logarithm, and for ranking only.
        scaled = scaled + np.where(seen, 1e-12, 1.0)[..., None] * np.eye(count)
        change = _change(scaled, slope / size)
        gained = np.einsum("kbi,kbi->kb", slope / size, change)
        left = np.maximum(total + gained, _ROUNDING * total)
        left = np.maximum(left, 1e-300) / np.maximum(readings, 1e-300)[:, None]
        volume = np.linalg.slogdet(scaled)[1] + 2.0 * np.sum(np.log(size), axis=-1)
        spread = 0.5 * (np.log(left) - volume / np.maximum(1, seen.sum(axis=-1)))
        # What these readings hardly determine stays near where it began: far away, no simulation
        # would come back. Equations share their noise with as many others as a kernel is wide.
        known = np.append(_FAR * sizes, np.full(count - own, np.inf))
        ridge = (halves[:, None] * left)[..., None] / (known * size) ** 2
        change = _change(scaled + ridge[..., None] * np.eye(count), slope / size) / size
        found.append(vectors + change[..., :own])
        spreads.append(np.where(readings[:, None] > 0, spread, np.inf))
    return np.stack(found, axis=1), np.stack(spreads, axis=1)


def _change(square: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Least squares' step; none where something is not finite."""
    good = np.asarray(np.isfinite(square).all(axis=(-2, -1)) & np.isfinite(slope).all(axis=-1))
    square = np.where(good[..., None, None], square, np.eye(square.shape[-1]))
    step = -np.linalg.solve(square, slope[..., None])[..., 0]
    return np.where(good[..., None], step, np.nan)


@kept(like=0)
def _missing(models, beginning: Beginnings, numbers, spacing, data):
    """The torque (K, R, G, n) that is missing beside numbers (K, P) found from one beginning."""
    joints = len(models.mechanism.joints)
    t = spacing[:, None] * jnp.arange(data[0].shape[2])

    def torque(model, q, e):
        rows = model.bodies.mass_matrix(split(q))
        return stack(tuple(sum(z * x for z, x in zip(row, split(e), strict=True)) for row in rows))

    def one(found, data):
        z = _memories(models, beginning.numbers, beginning.memory, spacing, data)
        vector = jnp.concatenate([found, jnp.zeros(joints)])
        left = _errors(_error, models, vector, data, z, t)
        # Of each recording's own model, which may hold what is no array: not for `jax.vmap`.
        return eqx.filter_vmap(jax.vmap(torque, in_axes=(None, 0, 0)))(models, data[0], -left)

    return jax.vmap(one)(numbers, data)


def perturbed(best: np.ndarray, count: int, spread: float = 0.3) -> np.ndarray:
    """`count` points around one: each number times a log-normal factor of log-spread `spread`.

    The factors are always the same ones, so that the same recording gives the same fit.
    """
    factors = np.random.default_rng(0).standard_normal((count, len(best)))
    return best * np.exp(spread * factors)
