"""The fit as a least-squares problem: unknowns in, whitened residuals out.

The unknowns are the model's numbers, shared by all recordings, and each recording's own initial
state, which nobody measured. One recording's residual depends on the numbers and its own state
only, so its Jacobian J has few columns; and of J and the residual r only the small triangular
factor of J'J, the projection of r on J's columns and the length of what is left of r matter to
least squares. `compressed` returns just these. They stand in for thousands of residuals exactly:
same cost, same gradient, same Gauss-Newton matrix. So the optimiser's own algebra costs nothing,
and its cost does not grow with the number of samples.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..equation import Piecewise
from ..mechanism import AbstractMechanism
from ..model import Model
from ..motion import Scalar
from ..nodes import read_rows
from ..parameter import stacked
from ..recording import Recording
from ..simulation import march

# A residual beyond this many sigma comes from a simulation that has run away.
_RUNAWAY = 1e6


class Unknowns(NamedTuple):
    """What a fit moves: (P,) numbers of the model and (R, s) initial states (q0, v0, z0), where z0
    are the internal states beyond what their effects begin with."""

    numbers: Float[Array, " P"]
    states: Float[Array, "R s"]


class Recorded(eqx.Module):
    """R recordings as arrays of N instants each: their readings, and behind the last one of a
    shorter recording instants at which nothing was read.

    Time counts from each recording's first sample.
    """

    duration: Float[Array, " R"]
    row: Int[Array, "R N"]  # integration step in which each instant lies
    place: Float[Array, "R N"]  # where within it, 0 to 1
    angles: Float[Array, "R N n"]
    weights: Float[Array, "R N n"]  # 1/sigma of each reading; 0 where there is none
    mechanism: AbstractMechanism
    drive: Piecewise | None


class Problem(eqx.Module):
    """A model, its recordings and the scales in which the unknowns are of order one.

    How many integration steps a recording takes is an input like any other, so that one compiled
    program serves slow arms and fast ones; only the `room` for them is compiled in.
    """

    model: Model
    recorded: Recorded
    scale: Unknowns
    active: Float[Array, " P"]  # 1 for a number that the fit moves, 0 for one it must keep
    steps: Int[Array, ""]  # M, of every recording
    room: int = eqx.field(static=True)  # at least M
    fixed: bool = eqx.field(static=True, default=False)
    """Whether M is `room`, compiled in: what reverse mode asks for."""

    def numbers(self, y: Unknowns) -> Float[Array, " P"]:
        """The model's numbers, in their own units, at scaled unknowns."""
        kept = self.model.vector()
        moved = self.scale.numbers * y.numbers
        return jnp.where(self.active > 0, moved, kept)

    def states(self, y: Unknowns) -> Float[Array, "R s"]:
        """The initial states, in their own units, at scaled unknowns."""
        return self.scale.states * y.states

    def scaled(self, numbers, states) -> Unknowns:
        """The inverse of `numbers` and `states`."""
        return Unknowns(numbers / self.scale.numbers, states / self.scale.states)


def bucket(count: int, base: int = 2) -> int:
    """The next power of `base`, from 16 up: few sizes, so few compilations."""
    size = 16
    while size < count:
        size *= base
    return size


def lay_out(
    recordings: Sequence[Recording],
    mechanisms: Sequence[AbstractMechanism],
    wild: Sequence[np.ndarray],
    steps: int,
    room: int,
    instants: int = 0,
) -> Recorded:
    """Readings as they lie in `steps` equal steps a recording; `wild` (N, n) ones get no weight.

    `instants` is the least N to lay out for.
    """
    longest = max(instants, *(len(r.time) for r in recordings))
    shape = len(recordings), longest, recordings[0].angle.shape[1]
    row, place = np.zeros(shape[:2], int), np.zeros(shape[:2])
    angles, weights = np.zeros(shape), np.zeros(shape)
    for i, (r, bad) in enumerate(zip(recordings, wild, strict=True)):
        count = len(r.time)
        part = (r.time - r.time[0]) / (r.time[-1] - r.time[0]) * steps
        row[i, :count] = np.clip(np.floor(part).astype(int), 0, steps - 1)
        place[i, :count] = part - row[i, :count]
        seen = np.isfinite(r.angle) & ~bad
        angles[i, :count] = np.where(seen, r.angle, 0.0)
        weights[i, :count] = np.where(seen, 1.0 / r.noise, 0.0)
    return Recorded(
        duration=jnp.asarray([r.duration for r in recordings]),
        row=jnp.asarray(row),
        place=jnp.asarray(place),
        angles=jnp.asarray(angles),
        weights=jnp.asarray(weights),
        mechanism=stacked(mechanisms),
        drive=_drives(recordings, steps, room),
    )


def _drives(recordings: Sequence[Recording], steps: int, room: int) -> Piecewise | None:
    """Drive torques as one straight line a step, with the readings' own impulse and moment.

    The integrator follows a straight line exactly, but a kink inside a step would cost it its
    order, and a torque merely smoothed shifts the position with every jump. Impulse and moment kept
    step by step keep rate and position at the end of every step.
    """
    if all(r.drive is None for r in recordings):
        return None
    drives = []
    for r in recordings:
        ends = np.linspace(r.time[0], r.time[-1], steps + 1)
        h = ends[1] - ends[0]
        left, right = [], []
        for torque in (r.drive if r.drive is not None else np.zeros_like(r.angle)).T:
            once, twice = _integrals(r.time, torque, ends)
            mean = np.diff(once) / h
            # Second integral over the step, beyond that of its mean: a slope s gives -s h^3 / 12.
            slope = -12 * (np.diff(twice) - h * once[:-1] - mean * h**2 / 2) / h**3
            left.append(mean - slope * h / 2)
            right.append(mean + slope * h / 2)
        sides = (
            np.stack([np.pad(x, (0, room - steps)) for x in side], 1) for side in (left, right)
        )
        drives.append(Piecewise(0.0, h, *sides))
    return stacked(drives)


def _integrals(time: np.ndarray, x: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second integral, from time[0], of straight lines through (time, x)."""
    gap, slope = np.diff(time), np.diff(x) / np.diff(time)
    once = np.concatenate([[0.0], np.cumsum(gap * (x[:-1] + slope * gap / 2))])
    rise = gap * (once[:-1] + gap * (x[:-1] / 2 + slope * gap / 6))
    twice = np.concatenate([[0.0], np.cumsum(rise)])
    i = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(gap) - 1)
    s = at - time[i]
    return (
        once[i] + s * (x[i] + slope[i] * s / 2),
        twice[i] + s * (once[i] + s * (x[i] / 2 + slope[i] * s / 6)),
    )


def posed(model: Model, mechanism: AbstractMechanism) -> Model:
    """The model on another mechanism: another pose of the arm, or with its bearings off."""
    return eqx.tree_at(lambda m: m.mechanism, model, mechanism)


def predict(problem: Problem, one: Recorded, numbers, state, only=None) -> Float[Array, "N n"]:
    """Predicted readings of one recording (`one` without its leading axis); after the `only` first
    steps, if that is given, whatever."""
    n = one.angles.shape[-1]
    model = posed(problem.model.with_vector(numbers), one.mechanism)
    nodes = march(
        model,
        0.0,
        one.duration,
        state[:n],
        state[n : 2 * n],
        steps=problem.room if problem.fixed else problem.steps,
        z0=state[2 * n :],
        drive=one.drive,
        room=None if problem.fixed else problem.room,
        only=only,
    )
    return read_rows(model, nodes, one.row, one.place)


def whiten(one: Recorded, predicted) -> Float[Array, "N n"]:
    """Whitened residual of one recording: (model - measurement) / sigma."""
    misfit = (predicted - one.angles) * one.weights
    sane = jnp.isfinite(misfit) & (jnp.abs(misfit) < _RUNAWAY)
    return jnp.where(sane, misfit, jnp.where(one.weights > 0, _RUNAWAY, 0.0))


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

    def one(recorded, scale, state):
        def local(z):
            moved = problem.numbers(Unknowns(z[:numbers], y.states))
            predicted = predict(problem, recorded, moved, scale * z[numbers:], only)
            return whiten(recorded, predicted), predicted

        z = jnp.concatenate([y.numbers, state])
        misfit, slopes, predicted = jax.vmap(
            lambda e: jax.jvp(local, (z,), (e,), has_aux=True), out_axes=(None, 0, None)
        )(jnp.eye(len(z)))
        slopes = jnp.where(jnp.isfinite(slopes), slopes, 0.0).reshape(len(z), -1)
        flat = misfit.reshape(-1)
        square = slopes @ slopes.T + jnp.diag(known)
        slope, total = slopes @ flat + known * z, flat @ flat + jnp.sum(known * z**2)
        return Compressed(predicted, *_compress(square, slope, total))

    return over_recordings(one, problem.model)(problem.recorded, problem.scale.states, y.states)


def over_recordings(one: Callable, model: Model) -> Callable:
    """`one`, of one recording, for all of them: abreast, or, where dry friction asks what seldom
    happens, one after the other, for abreast it would have to be computed every time."""

    def each(*trees):
        if jax.tree.leaves(trees)[0].shape[0] == 1:
            found = one(*jax.tree.map(lambda x: x[0], trees))
            return jax.tree.map(lambda x: x[None], found)
        if model.dry:
            return jax.lax.map(lambda x: one(*x), trees)
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
