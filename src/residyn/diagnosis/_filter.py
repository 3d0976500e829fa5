"""A Kalman filter for a mechanism under unknown torques, and the smoother that looks back.

The state is the mechanism's own, x = (q, v, z), and behind it the torques' coefficients u, which
walk at random: u grows by a w of known variance from one instant to the next. Each joint's torque
is its coefficients times regressors known at every instant, and runs straight between instants.

The filter comes in two kinds. The *extended* one linearises the mechanism about its own estimate as
it goes, so it needs nothing but readings, and follows them whatever the model's errors: its phase
never drifts. The *linear* one takes linearisations along a path that is known by then; it is exact
where those are, and quick, since all of them can be had at once. The smoother is that of Bryson and
Frazier: it runs adjoints (l, L) backwards, inverts no covariance and so does not mind a torque
without any freedom, and its adjoints are what the likelihood's slope is made of.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model import Model
from ._grid import Grid
from ._step import advance, reading, size

_WILD = 7.0
"""Standard deviations of an innovation beyond which a reading pulls less the farther off it is. A
spike is alone in its place, and vanishes. A jump of torque bends the path: the first readings after
it are off by little, and each pulls the filter along."""


class Walk(NamedTuple):
    """How torques may move: n joints of o coefficients each."""

    regressor: Float[Array, "M o"]  # the same for all joints
    growth: Float[Array, "M n o"]  # variance of w, from this instant to the next
    begin: Float[Array, "n o"]  # variance of u at the first instant


class Start(NamedTuple):
    """What is known of x at the first instant."""

    state: Float[Array, " d"]
    variance: Float[Array, "d d"]


class Local(NamedTuple):
    """The mechanism linearised at an instant: x' = own x + held u + moved w + shift at the next
    one, reading = sees x + zero."""

    own: Float[Array, "d d"]
    held: Float[Array, "d m"]
    moved: Float[Array, "d m"]
    shift: Float[Array, " d"]
    sees: Float[Array, "n d"]
    zero: Float[Array, " n"]


class Filtered(NamedTuple):
    """What the filter knew at each instant before its reading, and what the reading did."""

    state: Float[Array, "M D"]
    variance: Float[Array, "M D D"]
    gain: Float[Array, "M n D"]
    surprise: Float[Array, "M n"]  # reading less expectation, 0 where there is none
    certainty: Float[Array, "M n"]  # 1 / variance of that, 0 where there is none
    trust: Float[Array, "M n"]  # variance of the reading as taken
    likelihood: Float[Array, " M"]  # log of, each instant's part


class Adjoint(NamedTuple):
    """The smoother's adjoints at each instant, its own reading included."""

    slope: Float[Array, "M D"]
    square: Float[Array, "M D D"]


def linearised(model: Model, grid: Grid, path, torque) -> Local:
    """The mechanism along a path (M, d) with torques (M, n): a `Local` of arrays (M, ...), whose
    `held` and `moved` are those of the torques at this instant and at the next."""
    after = jnp.concatenate([torque[1:], torque[-1:]])
    drive_after = jnp.concatenate([grid.drive[1:], grid.drive[-1:]])
    return jax.vmap(lambda *at: _local(model, *at))(
        grid.time, grid.step, grid.drive, drive_after, path, torque, after
    )


def _local(model: Model, t, h, drive, drive_after, x, torque, after) -> Local:
    d, n = x.shape[0], torque.shape[0]

    def end(y):
        return advance(model, t, h, y[:d], (y[d : d + n], y[d + n :]), (drive, drive_after))

    y = jnp.concatenate([x, torque, after])
    slopes = jax.jacfwd(end)(y)
    sees = jax.jacfwd(lambda x: reading(model, x))(x)
    return Local(
        own=slopes[:, :d],
        held=slopes[:, d : d + n],
        moved=slopes[:, d + n :],
        shift=end(y) - slopes @ y,
        sees=sees,
        zero=reading(model, x) - sees @ x,
    )


def by_coefficient(local: Local, regressor, after) -> Local:
    """Torques at both ends of a step, as regressors make them of coefficients."""
    n = local.held.shape[-1]

    def of(slopes, weights):
        return jnp.einsum("...xn,...o->...xno", slopes, weights).reshape(*slopes.shape[:-1], -1)

    assert local.moved.shape[-1] == n
    moved = of(local.moved, after)
    return local._replace(held=of(local.held, regressor) + moved, moved=moved)


def shifted(x: Array) -> Array:
    """Each instant's successor; the last one's is itself."""
    return jnp.concatenate([x[1:], x[-1:]])


def extended(model: Model, grid: Grid, start: Start, walk: Walk) -> tuple[Filtered, Local]:
    """Filter, linearising on the way; wild readings are given less weight."""
    d, (n, o) = size(model), walk.begin.shape

    def local_at(state, at):
        t, h, drive, drive_after, regressor, after = at
        u = state[d:].reshape(n, o)
        local = _local(model, t, h, drive, drive_after, state[:d], u @ regressor, u @ after)
        return by_coefficient(local, regressor, after)

    given = (
        grid.time,
        grid.step,
        grid.drive,
        shifted(grid.drive),
        walk.regressor,
        shifted(walk.regressor),
    )
    found, local = _run(
        grid, start, walk, given, local_at, sight=lambda x: _sight(model, x), gate=_WILD
    )
    assert local is not None
    return found, local


def linear(grid: Grid, start: Start, walk: Walk, locals_: Local) -> Filtered:
    """Filter with linearisations (by coefficient) known beforehand."""
    return _run(grid, start, walk, locals_, lambda state, local: local)[0]


def _sight(model: Model, x):
    sees = jax.jacfwd(lambda x: reading(model, x))(x)
    return sees, reading(model, x) - sees @ x


def _run(grid, start, walk, given, local_at, sight=None, gate=jnp.inf) -> tuple[Filtered, Any]:
    n, o = walk.begin.shape
    d, m = start.state.shape[0], n * o
    state = jnp.concatenate([start.state, jnp.zeros(m)])
    variance = jax.scipy.linalg.block_diag(start.variance, jnp.diag(walk.begin.reshape(-1)))

    def visit(carry, at):
        state, variance = carry
        here, growth, (angle, noise, seen) = at
        prior = state, variance
        sees, zero = sight(state[:d]) if sight else (here.sees, here.zero)
        records = []
        for j in range(n):
            spread = variance[:, :d] @ sees[j]
            surprise = jnp.where(seen[j], angle[j] - sees[j] @ state[:d] - zero[j], 0.0)
            natural = sees[j] @ spread[:d] + noise[j]
            taken = jnp.maximum(natural, (surprise / gate) ** 2)
            certainty = jnp.where(seen[j], 1.0 / taken, 0.0)
            gain = spread * certainty
            state = state + gain * surprise
            variance = variance - jnp.outer(gain, spread)
            likely = -0.5 * (surprise**2 * certainty + jnp.where(seen[j], jnp.log(taken), 0.0))
            records.append((gain, surprise, certainty, noise[j] + taken - natural, likely))
        gain, surprise, certainty, trust, likely = (
            jnp.stack(each) for each in zip(*records, strict=True)
        )
        local = local_at(state, here)
        x, u = state[:d], state[d:]
        across = local.own @ variance[:d] + local.held @ variance[d:]
        moved = local.moved * growth
        top = across[:, :d] @ local.own.T + across[:, d:] @ local.held.T + moved @ local.moved.T
        side = across[:, d:] + moved
        after = jnp.concatenate([local.own @ x + local.held @ u + local.shift, u])
        spread = jnp.block([[top, side], [side.T, variance[d:, d:] + jnp.diag(growth)]])
        record = Filtered(*prior, gain, surprise, certainty, trust, jnp.sum(likely))
        kept = local if sight else None  # the caller knows it otherwise
        return (after, 0.5 * (spread + spread.T)), (record, kept)

    readings = grid.angle, grid.variance, grid.seen
    visits = given, walk.growth.reshape(-1, m), readings
    return jax.lax.scan(visit, (state, variance), visits)[1]


def backwards(filtered: Filtered, locals_: Local) -> Adjoint:
    """The adjoints l and L of every instant."""
    n, d = locals_.sees.shape[-2:]
    big = filtered.state.shape[-1]

    def visit(carry, at):
        slope, square = carry
        local, gain, surprise, certainty = at
        # Back over the step to the next instant ...
        slope = _back(local, d, slope)
        square = _back(local, d, _back(local, d, square).T)
        # ... and over this one's readings, the last one first.
        for j in reversed(range(n)):
            sees = jnp.zeros(big).at[:d].set(local.sees[j])
            slope = slope - sees * (gain[j] @ slope + surprise[j] * certainty[j])
            across = square @ gain[j]
            square = square - jnp.outer(sees, across) - jnp.outer(across, sees)
            square = square + jnp.outer(sees, sees) * (gain[j] @ across + certainty[j])
        square = 0.5 * (square + square.T)
        return (slope, square), (slope, square)

    none = jnp.zeros(big), jnp.zeros((big, big))
    visits = locals_, filtered.gain, filtered.surprise, filtered.certainty
    return Adjoint(*jax.lax.scan(visit, none, visits, reverse=True)[1])


def _back(local: Local, d: int, x):
    """Transpose of the step, applied to the first axis."""
    return jnp.concatenate([local.own.T @ x[:d], local.held.T @ x[:d] + x[d:]])


def smoothed(filtered: Filtered, adjoint: Adjoint) -> Float[Array, "M D"]:
    """The state in the light of all readings."""
    return filtered.state - jnp.einsum("kab,kb->ka", filtered.variance, adjoint.slope)
