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

from ..model import Model
from ..motion import Motion, split, stack
from ..parameter import stacked
from ..recording import Recording
from .beginnings import Beginnings, memory_along, oscillates, plain, tuned
from .problem import bucket
from .smoothing import smooth, uniform

_NARROWEST = 4  # samples in half a kernel
_STRIDE, _LONG = 2, 1000  # where there are so many samples, every other one will do
_LADDER = 12  # kernels tried, each 1.5 times wider than the last
_LEAST_KEPT = 0.05
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


@eqx.filter_jit
def _solve(models, beginnings: Beginnings, spacing, data):
    """Linear least squares on the acceleration error, for every kernel and beginning, without and
    with a constant torque at every joint beside the model.

    **Returns:** numbers (K, 2, B, P), their spread (K, 2, B), and the torque that is missing at the
    first beginning (K, R, G, n).
    """
    shape = [n.meaning.silent is None for n in models.fitted]
    joints = len(models.mechanism.joints)
    shape = jnp.asarray([*shape, *[False] * joints])
    own = jnp.arange(len(shape)) < len(shape) - joints

    def error(vector, model, t, q, v, a, drive, weight, z):
        model = model.with_vector(vector[:-joints])
        drive = split(drive + vector[-joints:])
        wanted = stack(model.acceleration(Motion.at(t, q, v, z), drive))
        return jnp.sqrt(weight) * (a - wanted)

    def one(vector, z0, data):  # one beginning and kernel; `data` over recordings
        length = data[0].shape[1]
        vector = jnp.concatenate([vector, jnp.zeros(joints)])
        t = spacing[:, None] * jnp.arange(length)
        z = eqx.filter_vmap(lambda m, *x: memory_along(m.with_vector(vector[:-joints]), *x))(
            models, spacing, data[0], data[1], z0
        )

        def rows(of, vector):
            row = jax.vmap(partial(of, vector), in_axes=(None,) + (0,) * 7)
            return eqx.filter_vmap(row)(models, t, *data, z)

        e, j = rows(lambda *x: (error(*x), jax.jacfwd(error)(*x)), vector)
        j = jnp.where(shape, 0.0, j)
        square, slope = jnp.einsum("rgnp,rgnk->pk", j, j), jnp.einsum("rgnp,rgn->p", j, e)
        readings = jnp.sum(data[-1]) * e.shape[-1]

        def kind(use):
            seen = use & (jnp.diag(square) > 0)
            size = jnp.sqrt(jnp.where(seen, jnp.diag(square), 1.0))
            scaled = jnp.where(seen[:, None] & seen, square / size / size[:, None], 0.0)
            # Blind directions stay put; of others the typical relative standard deviation is
            # wanted, in its logarithm, and for ranking only.
            scaled = scaled + jnp.diag(jnp.where(seen, 1e-12, 1.0))
            found = vector - jnp.linalg.solve(scaled, jnp.where(seen, slope / size, 0.0)) / size
            left = rows(error, found)
            volume = jnp.linalg.slogdet(scaled)[1] + 2.0 * jnp.sum(jnp.log(size))
            spread = 0.5 * (
                jnp.log(jnp.sum(left**2) / readings) - volume / jnp.maximum(1, jnp.sum(seen))
            )
            return found[:-joints], spread, left

        numbers, spread, left = jax.vmap(kind)(jnp.stack([own, own | True]))
        return numbers, spread, left[0]

    each = jax.vmap(one, in_axes=(0, 0, None))
    numbers, spread, e = jax.vmap(each, in_axes=(None, None, 0))(*beginnings, data)
    numbers, spread = numbers.swapaxes(1, 2), spread.swapaxes(1, 2)

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
