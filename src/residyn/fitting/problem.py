"""The fit as a least-squares problem: unknowns in, whitened residuals out.

The unknowns are the model's numbers, shared by all recordings, and each recording's own initial
state, which nobody measured. One recording's residual depends on the numbers and its own state
only, so its Jacobian J has few columns; and of J and the residual r only the small triangular
factor of J'J, the projection of r on J's columns and the length of what is left of r matter to
least squares. `compressed` returns just these. They stand in for thousands of residuals exactly:
same cost, same gradient, same Gauss-Newton matrix. So the optimiser's own algebra costs nothing,
and its cost does not grow with the number of samples.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..physics.mechanism import AbstractMechanism
from ..physics.model import Model
from ..physics.motion import Scalar
from ..simulation.integrator import Integrator
from ..simulation.interpolation import Nodes, read_rows
from ..simulation.simulate import march
from .layout import AnyArray, Recorded, bucket, read_of

# A residual beyond this many sigma comes from a simulation that has run away.
RUNAWAY = 1e6
# Instants whose residuals are squared and summed at a time: their derivatives stay in the cache,
# and how many there are need not be compiled in.
_CHUNK = 256
_ABREAST = 8  # recordings that a CPU takes together


class Unknowns(NamedTuple):
    """What a fit moves: (P,) numbers of the model and (R, s) initial states (q0, v0, z0), where z0
    are the internal states beyond what their effects begin with."""

    numbers: Float[AnyArray, " P"]
    states: Float[AnyArray, "R s"]


class Problem(eqx.Module):
    """A model, its recordings and the scales in which the unknowns are of order one.

    How many integration steps a recording takes is an input like any other, so that one compiled
    program serves slow arms and fast ones; only the `room` for them is compiled in.
    """

    model: Model
    recorded: Recorded
    scale: Unknowns
    active: Float[AnyArray, " P"]  # 1 for a number that the fit moves, 0 for one it must keep
    steps: Int[AnyArray, ""]  # M, of every recording
    room: int = eqx.field(static=True)  # at least M
    fixed: bool = eqx.field(static=True, default=False)
    """Whether M is `room`, compiled in: what reverse mode asks for."""
    integrator: Integrator | None = eqx.field(static=True, default=None)
    """What integrates instead of fixed steps; M are then the nodes that it leaves behind."""
    tighter: Float[AnyArray, ""] | None = None
    """What its tolerances are divided by."""

    def numbers(self, y: Unknowns) -> Float[AnyArray, " P"]:
        """The model's numbers, in their own units, at scaled unknowns."""
        # NumPy where nothing is traced: JAX would compile each of these operations by itself.
        here = np if isinstance(y.numbers, np.ndarray) else jnp
        kept = here.asarray(self.model.vector())
        moved = self.scale.numbers * y.numbers
        return here.where(self.active > 0, moved, kept)

    def states(self, y: Unknowns) -> Float[AnyArray, "R s"]:
        """The initial states, in their own units, at scaled unknowns."""
        return self.scale.states * y.states

    def scaled(self, numbers, states) -> Unknowns:
        """The inverse of `numbers` and `states`."""
        return Unknowns(numbers / self.scale.numbers, states / self.scale.states)


def tight(problem: Problem) -> Problem:
    """The problem with hardly more instants than its recordings have, for programs whose cost grows
    with what is there, read or not."""
    recorded = problem.recorded
    few = bucket(int(np.max(recorded.count)))
    if few >= recorded.row.shape[-1]:
        return problem
    return eqx.tree_at(
        lambda p: read_of(p.recorded), problem, [x[:, :few] for x in read_of(recorded)]
    )


def posed(model: Model, mechanism: AbstractMechanism) -> Model:
    """The model on another mechanism: another pose of the arm, or with its bearings off."""
    return eqx.tree_at(lambda m: m.mechanism, model, mechanism)


def predict(problem: Problem, one: Recorded, numbers, state) -> Float[Array, "N n"]:
    """Predicted readings of one recording (`one` without its leading axis)."""
    model, nodes = _simulated(problem, one, numbers, state)
    return read_rows(model, nodes, jnp.asarray(one.row), jnp.asarray(one.place))


def _simulated(problem: Problem, one: Recorded, numbers, state, only=None) -> tuple[Model, Nodes]:
    """The model with these numbers on one recording's bodies, and its motion, of which `only` the
    first so many steps are taken, if that is given."""
    n = one.angles.shape[-1]
    model = posed(problem.model.with_vector(numbers), one.mechanism)
    integrator = problem.integrator
    adjoint = integrator and integrator.adjoint
    return model, march(
        model,
        0.0,
        one.duration,
        state[:n],
        state[n : 2 * n],
        steps=problem.room if problem.fixed else jnp.asarray(problem.steps),
        z0=state[2 * n :],
        drive=one.drive,
        room=None if problem.fixed else problem.room,
        only=only,
        adjoint=adjoint,
        integrator=integrator,
        tighter=1.0 if problem.tighter is None else jnp.asarray(problem.tighter),
    )


def whiten(one: Recorded, predicted) -> Float[Array, "N n"]:
    """Whitened residual of one recording: (model - measurement) / sigma."""
    misfit = (predicted - one.angles) * one.weights
    sane = jnp.isfinite(misfit) & (jnp.abs(misfit) < RUNAWAY)
    return jnp.where(sane, misfit, jnp.where(one.weights > 0, RUNAWAY, 0.0))


class Compressed(NamedTuple):
    """A least-squares problem at a point, one row per recording (L = P + s local unknowns)."""

    predicted: Float[Array, "R N n"]  # readings, rad or m
    factor: Float[Array, "R L L"]  # upper triangular, factor'factor = J'J
    along: Float[Array, "R L"]  # residual projected on J's columns
    beside: Float[Array, " R"]  # length of the rest of the residual


@eqx.filter_jit  # inside a larger program too: it is traced once where it is used many times
def compressed(problem: Problem, y: Unknowns, only: Scalar | None = None) -> Compressed:
    """Residual and Jacobian at scaled unknowns, compressed; `only`: of the first so many steps."""
    numbers, angles = problem.scale.numbers.shape[0], problem.recorded.angles
    # What an effect remembered at the first sample is known to be of its typical size: a reading
    # like any other, without which a silent effect's memory could be anything.
    size = numbers + y.states.shape[1]
    known = jnp.where(jnp.arange(size) >= numbers + 2 * angles.shape[-1], 1.0, 0.0)

    instants = problem.recorded.row.shape[-1]
    chunk = instants if problem.fixed else min(instants, _CHUNK)
    chunks = _chunks(problem, only, chunk)

    def one(recorded, scale, state):
        # What an effect holds that is no array passes no transformation.
        rest = eqx.filter(posed(problem.model, recorded.mechanism), eqx.is_array_like, inverse=True)

        def simulated(z):
            moved = problem.numbers(Unknowns(z[:numbers], y.states))
            model, nodes = _simulated(problem, recorded, moved, scale * z[numbers:], only)
            return (model.vector(), nodes.ends), (eqx.filter(model, eqx.is_array_like), nodes)

        z = jnp.concatenate([y.numbers, state])
        point, moving, (arrays, nodes) = jax.vmap(
            lambda e: jax.jvp(simulated, (z,), (e,), has_aux=True), out_axes=(None, 0, None)
        )(jnp.eye(len(z)))
        model = eqx.combine(arrays, rest)

        def seen(point, part):
            vector, ends = point
            here = model.with_vector(vector), nodes._replace(ends=ends)
            predicted = read_rows(*here, part.row, part.place)
            return whiten(part, predicted), predicted

        def add(index, sums):
            square, slope, total, readings = sums
            first = index * chunk
            part = eqx.tree_at(
                read_of,
                recorded,
                [jax.lax.dynamic_slice_in_dim(x, first, chunk) for x in read_of(recorded)],
            )
            misfit, slopes, predicted = jax.vmap(
                lambda d: jax.jvp(lambda p: seen(p, part), (point,), (d,), has_aux=True),
                out_axes=(None, 0, None),
            )(moving)
            slopes = jnp.where(jnp.isfinite(slopes), slopes, 0.0).reshape(len(z), -1)
            flat = misfit.reshape(-1)
            return (
                square + slopes @ slopes.T,
                slope + slopes @ flat,
                total + flat @ flat,
                jax.lax.dynamic_update_slice_in_dim(readings, predicted, first, 0),
            )

        sums = (
            jnp.diag(known),
            known * z,
            jnp.sum(known * z**2),
            jnp.zeros_like(recorded.angles),
        )
        if problem.fixed:
            square, slope, total, predicted = add(0, sums)
        else:
            square, slope, total, predicted = jax.lax.fori_loop(0, chunks, add, sums)
        return Compressed(predicted, *_compress(square, slope, total))

    return over_recordings(one, problem.model)(problem.recorded, problem.scale.states, y.states)


def _chunks(problem: Problem, only, chunk: int):
    """How many chunks of instants hold all that count."""
    recorded, index = problem.recorded, jnp.arange(problem.recorded.row.shape[-1])
    counts = index < recorded.count[:, None]
    if only is not None:
        counts &= recorded.row < only
    return -(-jnp.max(jnp.sum(counts, axis=-1)) // chunk)


def over_recordings(one: Callable, model: Model) -> Callable:
    """`one`, of one recording, for all of them: abreast, a few at a time where a CPU's cache cannot
    hold them all, or, where dry friction asks what seldom happens, one after the other, for abreast
    it would have to be computed every time."""

    def each(*trees):
        count = jax.tree.leaves(trees)[0].shape[0]
        if count == 1:
            found = one(*jax.tree.map(lambda x: x[0], trees))
            return jax.tree.map(lambda x: x[None], found)
        if model.dry:
            return jax.lax.map(lambda x: one(*x), trees)
        if count > 2 * _ABREAST and jax.default_backend() == "cpu":
            return jax.lax.map(lambda x: one(*x), trees, batch_size=_ABREAST)
        return jax.vmap(one)(*trees)

    return each


def _compress(square, slope, total):
    diagonal = jnp.diag(square)
    size = jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1.0))
    # Columns of unit length: what rounding leaves of a combination that the data cannot see is then
    # about 1e-16, and the tiny ridge keeps the factor real.
    unit = square / size / size[:, None] + 1e-14 * jnp.eye(len(size))
    unit = unit + jnp.diag(jnp.where(diagonal > 0, 0.0, 1.0))
    lower = jnp.linalg.cholesky(unit) * size[:, None]
    along = jax.scipy.linalg.solve_triangular(lower, slope, lower=True)
    beside = jnp.sqrt(jnp.maximum(total - along @ along, 0.0))
    return lower.T, along, beside
