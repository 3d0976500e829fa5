"""Least squares from one start: simulate, compress, and descend by Levenberg-Marquardt.

One recording's residual depends on the numbers and its own initial state only, so its Jacobian J
has few columns; and of J and the residual r only the small triangular factor of J'J, the projection
of r on J's columns and the length of what is left of r matter to least squares. `compressed`
returns just these. They stand in for thousands of residuals exactly: same cost, same gradient, same
Gauss-Newton matrix. So the optimiser's own algebra costs nothing, and its cost does not grow with
the number of samples.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..physics.model import Model
from ..physics.motion import Scalar
from ..runtime.export_cache import kept
from ..simulation.interpolation import Nodes, read_rows
from ..simulation.simulate import march
from .layout import Recorded, read_of
from .linalg import RIDGE, damped_least_squares
from .problem import Problem, Unknowns, posed

# A residual beyond this many sigma comes from a simulation that has run away.
RUNAWAY = 1e6
# Instants whose residuals are squared and summed at a time: their derivatives stay in the cache,
# and how many there are need not be compiled in.
_CHUNK = 256
_AT_ONCE = 8  # recordings that a CPU takes together
STEPS = 20  # of one call: between calls, the search can be ended
# Steps end when the next one would move the whitened residual by less than this many sigma, in
# total (sigma of the noise; after the first call, of whatever the model misses the readings by, if
# that is more) ...
RESIDUAL_TOLERANCE = 3e-3
# ... and no unknown by more than this share of its scale.
_UNKNOWN_TOLERANCE = 1e-5


def predict(problem: Problem, one: Recorded, numbers, state, only=None) -> Float[Array, "N n"]:
    """Predicted readings of one recording (`one` without its leading axis), in its `only` first so
    many steps, if that is given: what is said of later ones means nothing."""
    found = _simulated(problem, one, numbers, state, only)
    return read_rows(*found, jnp.asarray(one.row), jnp.asarray(one.place), one.orders)


def _simulated(problem: Problem, one: Recorded, numbers, state, only=None) -> tuple[Model, Nodes]:
    """The model with these numbers on one recording's bodies, and its motion, of which `only` the
    first so many steps are taken, if that is given."""
    n = one.angles.shape[-1]
    model = posed(problem.model.with_vector(numbers), one.mechanism)
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
        integrator=problem.integrator,
        tighter=jnp.asarray(problem.tighter),
    )


def whiten(one: Recorded, predicted) -> Float[Array, "N n"]:
    """Whitened residual of one recording: (model - measurement) / sigma."""
    misfit = (predicted - one.angles) * one.weights
    sane = jnp.isfinite(misfit) & (jnp.abs(misfit) < RUNAWAY)
    return jnp.where(sane, misfit, jnp.where(one.weights > 0, RUNAWAY, 0.0))


class Compressed(NamedTuple):
    """A least-squares problem at a point, one row per recording (L = P + s local unknowns)."""

    predicted: Float[Array, "R N n"]  # readings, in their units
    factor: Float[Array, "R L L"]  # upper triangular, factor'factor = J'J
    along: Float[Array, "R L"]  # residual projected on J's columns
    beside: Float[Array, " R"]  # length of the rest of the residual

    @property
    def cost(self) -> Float[Array, ""]:
        """Sum of squared whitened residuals, and of what is known beforehand of internal states."""
        return (self.along**2).sum() + (self.beside**2).sum()


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
            predicted = read_rows(*here, part.row, part.place, part.orders)
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

        none = jnp.zeros_like(recorded.angles)
        sums = jnp.diag(known), known * z, jnp.sum(known * z**2), none
        # Reverse mode asks for one chunk, and no loop.
        sums = add(0, sums) if problem.fixed else jax.lax.fori_loop(0, chunks, add, sums)
        square, slope, total, predicted = sums
        return Compressed(predicted, *_compress(square, slope, total))

    return side_by_side(one, problem.model)(problem.recorded, problem.scale.states, y.states)


def _chunks(problem: Problem, only, chunk: int):
    """How many chunks of instants hold all that count."""
    recorded, index = problem.recorded, jnp.arange(problem.recorded.row.shape[-1])
    counts = index < recorded.count[:, None]
    if only is not None:
        counts &= recorded.row < only
    return -(-jnp.max(jnp.sum(counts, axis=-1)) // chunk)


def side_by_side(one: Callable, model: Model) -> Callable:
    """`one`, of one recording or start, for all of them: side by side, a few at a time where a
    CPU's cache cannot hold them all, or one after the other where dry friction asks what seldom
    happens: side by side it would be computed every time."""

    def each(*trees):
        count = jax.tree.leaves(trees)[0].shape[0]
        if count == 1:
            found = one(*jax.tree.map(lambda x: x[0], trees))
            return jax.tree.map(lambda x: x[None], found)
        if model.dry:
            return jax.lax.map(lambda x: one(*x), trees)
        if count > 2 * _AT_ONCE and jax.default_backend() == "cpu":
            return jax.lax.map(lambda x: one(*x), trees, batch_size=_AT_ONCE)
        return jax.vmap(one)(*trees)

    return each


def _compress(square, slope, total):
    diagonal = jnp.diag(square)
    size = jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1.0))
    # Columns of unit length: what rounding leaves of a combination that the data cannot see is then
    # about 1e-16, and the tiny ridge keeps the factor real.
    unit = square / size / size[:, None] + RIDGE * jnp.eye(len(size))
    unit = unit + jnp.diag(jnp.where(diagonal > 0, 0.0, 1.0))
    lower = jnp.linalg.cholesky(unit) * size[:, None]
    along = jax.scipy.linalg.solve_triangular(lower, slope, lower=True)
    beside = jnp.sqrt(jnp.maximum(total - along @ along, 0.0))
    return lower.T, along, beside


def predictions(problem: Problem, numbers, states) -> Float[Array, "R N n"]:
    """Predicted readings of all recordings, from numbers and initial states in their own units."""

    def one(recorded, state):
        return predict(problem, recorded, numbers, state)

    return side_by_side(one, problem.model)(problem.recorded, states)


@kept(like=(0, 0, 0))
def look(problem: Problem, y: Unknowns, only):
    """Predictions (R, N, n), their slopes (R, N, n, L), and whitened residuals (R, N, n); `only`:
    in the first so many steps, as in `predict`."""
    numbers = problem.scale.numbers.shape[0]

    def one(recorded, scale, state):
        def local(z):
            moved = problem.numbers(Unknowns(z[:numbers], y.states))
            predicted = predict(problem, recorded, moved, scale * z[numbers:], only)
            return predicted, predicted

        z = jnp.concatenate([y.numbers, state])
        slopes, predicted = jax.jacfwd(local, has_aux=True)(z)
        slopes = jnp.where(jnp.isfinite(slopes), slopes, 0.0)
        return predicted, slopes, whiten(recorded, predicted)

    each = side_by_side(one, problem.model)
    return each(problem.recorded, problem.scale.states, y.states)


def first_step(problem: Problem, y: Unknowns, predicted, slopes) -> Unknowns:
    """Where the first step of a descent from `y` leads, by predictions and `slopes` that `look` has
    found there for the same weights, whatever the readings."""
    count, n = problem.scale.numbers.shape[0], predicted.shape[-1]

    def one(recorded, predicted, slopes, state):
        misfit = whiten(recorded, predicted).reshape(-1)
        J = (slopes * recorded.weights[..., None]).reshape(len(misfit), -1)
        known = jnp.where(jnp.arange(J.shape[1]) >= count + 2 * n, 1.0, 0.0)
        z = known * jnp.concatenate([y.numbers, state])
        return _compress(J.T @ J + jnp.diag(known), J.T @ misfit + z, misfit @ misfit + z @ z)[:2]

    factor, along = jax.vmap(one)(problem.recorded, predicted, slopes, y.states)
    return problem.stepped(y, damped_least_squares(factor, along, 1.0, y))


class Polished(NamedTuple):
    """Where the best start ended."""

    unknowns: Unknowns
    compressed: Compressed
    cost: float  # sum of squared whitened residuals
    steps: int
    converged: bool
    agreeing: int = 1  # how many starts ended here


class Horizon(NamedTuple):
    """A problem over the first `only` integration steps of every recording."""

    problem: Problem
    only: Int[Array, ""] | None = None
    size: Float[Array, ""] | float = 1.0  # what the optimiser takes for one sigma, in sigma

    @classmethod
    def of(cls, problem: Problem, share) -> "Horizon":
        """The first share (0 to 1) of every recording."""
        only = jnp.ceil(share * problem.steps).astype(int)
        counts = (problem.recorded.row < only)[..., None]
        weights = jnp.where(counts, problem.recorded.weights, 0.0)
        return cls(eqx.tree_at(lambda p: p.recorded.weights, problem, weights), only)


ENDED = Unknowns(0, 0), Compressed(0, 0, 0, 0), 0, 0, 0, 0  # pyrefly: ignore[bad-argument-type]


def one_descent(problem: Problem, y: Unknowns, shares, size):
    """One start's descents over growing `shares` (K,) of the recordings, those of 0 left out, as
    long as they converge: where the last one ended, J there, the cost, the steps of all, whether it
    converged, and how many there were."""

    count, (recordings, instants, n) = jnp.sum(shares > 0), problem.recorded.angles.shape
    size_of_J = y.numbers.shape[0] + y.states.shape[1]

    def more(carry):
        *_, converged, done = carry
        return (done < count) & ((done == 0) | converged)

    def another(carry):
        y, _, _, steps, _, done = carry
        horizon = Horizon.of(problem, shares[done])._replace(size=size)
        y, squeezed, cost, more_steps, converged = descended(horizon, y, STEPS)
        return y, squeezed, cost, steps + more_steps, converged, done + 1

    nothing = Compressed(
        jnp.zeros((recordings, instants, n)),
        jnp.zeros((recordings, size_of_J, size_of_J)),
        jnp.zeros((recordings, size_of_J)),
        jnp.zeros(recordings),
    )
    none = jnp.asarray(0)
    y = jax.tree.map(jnp.asarray, y)
    begin = y, nothing, jnp.asarray(jnp.inf), none, jnp.asarray(False), none
    return jax.lax.while_loop(more, another, begin)


one_start = kept(like=ENDED)(one_descent)


@eqx.filter_custom_jvp
def rows(y: Unknowns, horizon: Horizon) -> tuple[tuple[Array, Array], Compressed]:
    """Compressed residual, the only thing that an optimiser sees. Its Jacobian is known already, so
    it is attached, not derived."""
    squeezed = compressed(horizon.problem, y, horizon.only)
    return (squeezed.along, squeezed.beside), squeezed


@rows.def_jvp
def _rows_jvp(primals, tangents):
    (found, squeezed), (dy, _) = rows(*primals), tangents
    still = jax.tree.map(jnp.zeros_like, squeezed)
    along = _moved(squeezed, dy) - squeezed.along
    return (found, squeezed), ((along, still.beside), still)


class _Tried(NamedTuple):
    """What a descent knows where it is, and the step that it will try."""

    cost: Float[Array, ""]
    here: Compressed
    step: Unknowns
    trust: Float[Array, ""]  # the reciprocal of the damping, a trust region's size
    small: Bool[Array, ""]  # whether the step is too small to be worth a look


class CompressedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt for optimistix, each step solved for in the compressed residual, damped
    as in a trust region (Gould, Orban, Sartenaer and Toint, 4OR 3, 2005, for the numbers).

    As the compressed residual's slopes are known, so is how far the next step will move it. If that
    is next to nothing, the step is taken to first order, and not evaluated: optimistix' own
    Levenberg-Marquardt, which knows no such residual, evaluates once more in every descent.
    """

    rtol: float = 0.0
    atol: float = RESIDUAL_TOLERANCE
    norm: Callable = eqx.field(default=optx.two_norm, static=True)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        empty, still = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), (aux_struct, y))
        return _Tried(jnp.asarray(jnp.inf), empty, still, jnp.asarray(1.0), jnp.asarray(False))

    def step(self, fn, y, args, options, state, tags):
        there = args.problem.stepped(y, state.step)
        _, new = fn(there, args)
        cost, first = new.cost, jnp.isinf(state.cost)
        promise = jnp.sum(_moved(state.here, state.step) ** 2) - jnp.sum(state.here.along**2)
        gain = cost - state.cost
        accept = first | (gain <= 0.01 * promise)
        good = ~first & (promise < 0) & (gain < 0.99 * promise)
        trust = state.trust * jnp.where(accept, jnp.where(good, 3.5, 1.0), 0.25)
        at, here, cost = jax.tree.map(
            lambda x, y: jnp.where(accept, x, y), (there, new, cost), (y, state.here, state.cost)
        )
        size = args.size
        step = damped_least_squares(here.factor / size, here.along / size, 1.0 / trust, y)
        change = self.norm(_moved(here, step) - here.along) / size
        largest = optx.max_norm(step)
        small = accept & (change < self.atol) & (largest < _UNKNOWN_TOLERANCE)
        return at, _Tried(cost, here, step, trust, small), here

    def terminate(self, fn, y, args, options, state, tags):
        return state.small, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        step = jax.tree.map(lambda x: jnp.where(state.small, x, 0.0), state.step)
        moved = aux._replace(along=_moved(aux, step))
        return jax.tree.map(jnp.add, y, step), moved, {}


def descended(horizon: Horizon, y: Unknowns, most: int):
    """`one_descent` of at most so many steps."""
    solution = optx.least_squares(
        rows,
        CompressedLevenbergMarquardt(),
        y,
        args=horizon,
        has_aux=True,
        max_steps=most,
        throw=False,
    )
    squeezed, good = solution.aux, solution.result == optx.RESULTS.successful
    cost = jnp.where(jnp.isfinite(squeezed.cost), squeezed.cost, jnp.inf)
    return solution.value, squeezed, cost, solution.stats["num_steps"], good


def _moved(squeezed: Compressed, step: Unknowns) -> Float[Array, "R L"]:
    """The residual's projection after a step, to first order."""
    return squeezed.along + jnp.einsum("rij,rj->ri", squeezed.factor, step.local())
