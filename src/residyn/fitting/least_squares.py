"""Levenberg-Marquardt from many starts at once.

Ringing makes a cruel cost: off by half a cycle at the end of the record, the fit sits in a wrong
valley. Two things lead out of it. The closed-form start is already close. And each start first
fits the first few cycles alone, where no phase can slip, then a longer stretch, then everything.

Over the first cycles every start runs, many of them abreast under `vmap`: that is cheap, and it is
where starts differ. Those that end in the same place go on as one, for they would take the same
way; those that have fallen far behind do not go on. What is left descends one after the other, by
the program of a single start, which is also that of few starts over the first cycles: none waits
for another one, many starts cost little more than one, and few compile no more than one.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from ..runtime.export_cache import kept
from .abreast import asked, gathered
from .layout import read_of
from .linalg import Arrowhead
from .problem import Compressed, Problem, Unknowns, compressed
from .watch import watching

STEPS = 20  # of one call: between calls, the hopeless can be left
_CALLS = 4
_ABREAST = 10  # the same for starts abreast, where all wait for the last one
_LANES = 16  # starts abreast: more gain nothing, and wait for more
_FEW = 8  # starts that a CPU runs one after the other
# Steps end when the whitened residual moves by less than this many sigma, in total (sigma of the
# noise; after the first call, of whatever the model misses the readings by, if that is more) ...
RESIDUAL_TOLERANCE = 3e-3
# ... and no unknown by more than this share of its scale.
_UNKNOWN_TOLERANCE = 1e-5
# A start this many times worse than the best after a stretch has lost its way.
LOST = 25.0
_SAME = 0.5  # starts that end within this many standard errors of another one have ended there
_PART = 8  # the first cycles, where they are no more than this part of the readings


class Polished(NamedTuple):
    """Where the best start ended."""

    unknowns: Unknowns
    compressed: Compressed
    cost: float  # sum of squared whitened residuals
    steps: int
    converged: bool
    agreeing: int
    """How many starts ended here."""


class _Rows(NamedTuple):
    """Compressed residual: the only thing that the optimiser sees."""

    along: Float[Array, "R L"]
    beside: Float[Array, " R"]


def _norm(tree) -> Float[Array, ""]:
    """Size of a step for the stopping rule, in units of its own tolerance."""
    if isinstance(tree, _Rows):
        return optx.two_norm(tree.along)
    return optx.max_norm(tree) * (RESIDUAL_TOLERANCE / _UNKNOWN_TOLERANCE)


class Stretch(NamedTuple):
    """A problem over the first `only` integration steps of every recording."""

    problem: Problem
    only: Int[Array, ""] | None = None
    size: Float[Array, ""] | float = 1.0
    """What the optimiser takes for one sigma, in sigma."""

    @classmethod
    def of(cls, problem: Problem, share) -> "Stretch":
        """The first share (0 to 1) of every recording."""
        only = jnp.ceil(share * problem.steps).astype(int)
        counts = (problem.recorded.row < only)[..., None]
        weights = jnp.where(counts, problem.recorded.weights, 0.0)
        return cls(eqx.tree_at(lambda p: p.recorded.weights, problem, weights), only)


@eqx.filter_custom_jvp
def rows(y: Unknowns, stretch: Stretch) -> tuple[_Rows, Compressed]:
    """Compressed residual. Its Jacobian is known already, so it is attached, not derived."""
    squeezed = compressed(stretch.problem, y, stretch.only)
    return _Rows(squeezed.along / stretch.size, squeezed.beside / stretch.size), squeezed


@rows.def_jvp
def _rows_jvp(primals, tangents):
    (y, stretch), (dy, _) = primals, tangents
    squeezed = compressed(stretch.problem, y, stretch.only)
    everywhere = jnp.broadcast_to(dy.numbers, (dy.states.shape[0], dy.numbers.shape[0]))
    local = jnp.concatenate([everywhere, dy.states], axis=1)
    along = jnp.einsum("rij,rj->ri", squeezed.factor, local) / stretch.size
    rows = _Rows(squeezed.along / stretch.size, squeezed.beside / stretch.size)
    still = jax.tree.map(jnp.zeros_like, squeezed)
    return (rows, squeezed), (_Rows(along, jnp.zeros_like(squeezed.beside)), still)


def solver(y: Unknowns) -> optx.LevenbergMarquardt:
    """Levenberg-Marquardt of unknowns like these, with this module's stopping rule."""
    step = lx.QR() if y.states.shape[0] == 1 else Arrowhead()
    return optx.LevenbergMarquardt(0.0, RESIDUAL_TOLERANCE, _norm, step)


def descend(stretch: Stretch, y: Unknowns, steps: int = STEPS):
    """One Levenberg-Marquardt descent: where it ended, steps, whether it converged, and J there."""
    solution = optx.least_squares(
        rows,
        solver(y),
        y,
        args=stretch,
        has_aux=True,
        options={"jac": "fwd"},
        max_steps=steps,
        throw=False,
    )
    done = solution.result == optx.RESULTS.successful
    return solution.value, solution.stats["num_steps"], done, solution.aux


def polish(
    problem: Problem,
    starts: Unknowns,
    shares: Sequence[float],
    hopeless: Callable[[float], bool] = lambda cost: False,
    size: float = 1.0,
) -> Polished:
    """Descend from every start (leading axis S) over growing shares (0 to 1) of the recordings.

    `hopeless` is asked, now and then, whether a start that has not yet settled should be left where
    it is, at this cost; `size` is the least rms residual to expect, in sigma.
    """
    if not gathered():
        # Once, not in every call; an effect may hold what is no array.
        arrays, rest = eqx.partition(problem, eqx.is_array_like)
        problem = eqx.combine(jax.device_put(arrays), rest)
    going, shares = _begun(starts), list(shares)
    if len(going) > 1:
        few = len(going) <= _FEW and (gathered() or jax.default_backend() == "cpu")
        going = together(
            [_alone(problem, each, shares[0], hopeless, size, calls=1) for each in going]
            if few
            else _abreast(problem, starts, shares[0], size)
        )
        # Those that had not settled go on where they are before more of the recording counts.
        rest = [e if e.converged else _alone(problem, e, shares[0], hopeless, size) for e in going]
        going, shares = together(rest), shares[1:] or shares
    for share in shares:
        going = together([_alone(problem, each, share, hopeless, size) for each in going])
    return going[0]


def _alone(
    problem: Problem, start: Polished, share: float, hopeless, size: float, calls: int = _CALLS
) -> Polished:
    """One start's descent over a share of the recordings."""
    readings = max(1, np.count_nonzero(problem.recorded.weights))
    end, unit = start, size
    for _ in range(calls):
        here = problem, end.unknowns, np.asarray(float(share)), np.asarray(unit)
        out = asked(_one_stretch, _stretch, *here)
        before, watch = end.steps, watching()
        end = _polished(jax.device_get(out), end)
        if watch is not None:
            watch.descended(problem, end.unknowns, end.steps - before)
        if np.isfinite(end.cost):
            unit = max(unit, math.sqrt(end.cost / readings))
        if end.converged or (share == 1.0 and hopeless(end.cost)):
            break
        if watch is not None and watch.over():
            break
    return end


def evaluated(problem: Problem, y: Unknowns) -> Compressed:
    """Residual and Jacobian at these unknowns, by the program of the descents: nothing else need be
    compiled. To an optimiser for which one sigma is infinite all is small, so it goes nowhere."""
    out = asked(_one_stretch, _stretch, problem, y, np.asarray(1.0), np.asarray(np.inf))
    return out[1]


def _polished(out, start: Polished) -> Polished:
    y, squeezed, cost, steps, good = out
    return Polished(y, squeezed, float(cost), start.steps + int(steps), bool(good), start.agreeing)


def _abreast(problem: Problem, starts: Unknowns, share: float, size: float) -> list[Polished]:
    """Every start's descent over a share of the recordings."""
    head, begun = _head(problem, share), _begun(starts)
    lanes, found = min(len(begun), _LANES), []
    for first in range(0, len(begun), lanes):
        some = begun[first : first + lanes]
        filled = [*some, *[some[-1]] * (lanes - len(some))]
        y = jax.tree.map(lambda *x: np.stack(x), *(each.unknowns for each in filled))
        out = _stretches(head, y, np.asarray(float(share)), np.asarray(size))
        out = jax.device_get(out)
        if (watch := watching()) is not None:
            steps, best = int(np.sum(out[3][: len(some)])), int(np.argmin(out[2]))
            watch.descended(problem, _row(out[0], best), steps)
        found += [_polished(_row(out, i), start) for i, start in enumerate(some)]
    return found


def _begun(starts: Unknowns) -> list[Polished]:
    """Starts that have not moved yet."""
    nothing: Compressed = None  # pyright: ignore[reportAssignmentType]
    starts, count = jax.device_get(starts), starts.numbers.shape[0]
    return [Polished(_row(starts, i), nothing, math.inf, 0, False, 1) for i in range(count)]


def together(ends: list[Polished]) -> list[Polished]:
    """The different places where starts ended, the best one first, without those far behind."""
    found: list[Polished] = []
    for end in sorted(ends, key=lambda e: e.cost if math.isfinite(e.cost) else math.inf):
        for i, other in enumerate(found):
            if _distance(other, end) < _SAME:
                found[i] = other._replace(agreeing=other.agreeing + end.agreeing)
                break
        else:
            if not found or end.cost <= LOST * found[0].cost:
                found.append(end)
    return found


def _distance(one: Polished, other: Polished) -> float:
    """Between two ends, in standard errors of the first."""
    numbers = np.asarray(other.unknowns.numbers) - one.unknowns.numbers
    states = np.asarray(other.unknowns.states) - one.unknowns.states
    local = np.concatenate([np.tile(numbers, (len(states), 1)), states], axis=1)
    return float(np.linalg.norm(np.einsum("rij,rj->ri", one.compressed.factor, local)))


def _head(problem: Problem, share: float) -> Problem:
    """The problem with room for the first quarter only, if the share's readings lie there."""
    instants, room = problem.recorded.row.shape[-1] // _PART, problem.room // _PART
    only = math.ceil(share * int(problem.steps))
    late = np.asarray(problem.recorded.weights)[:, instants:].any(axis=-1)
    if only > room or np.any(late & (np.asarray(problem.recorded.row)[:, instants:] < only)):
        return problem
    first = [x[:, :instants] for x in read_of(problem.recorded)]
    short = eqx.tree_at(lambda p: read_of(p.recorded), problem, first)
    return dataclasses.replace(short, room=room)


def _row(tree, index: int):
    return jax.tree.map(lambda x: x[index], tree)


_ENDED = Unknowns(0, 0), Compressed(0, 0, 0, 0), 0, 0, 0  # pyright: ignore[reportArgumentType]


def _one_stretch(problem: Problem, y: Unknowns, share, size):
    """One start's descent: where it ended, J there, the cost, steps, whether it converged."""
    return _ended(Stretch.of(problem, share)._replace(size=size), y, STEPS)


_stretch = kept(like=_ENDED)(_one_stretch)


@kept(like=_ENDED)
def _stretches(problem: Problem, y: Unknowns, share, size):
    """`_stretch` for starts (S, ...) abreast."""
    stage = Stretch.of(problem, share)._replace(size=size)
    # See `over_recordings`: what dry friction seldom asks for must stay seldom.
    if problem.model.dry:
        return jax.lax.map(lambda start: _ended(stage, start, _ABREAST), y)
    return jax.vmap(lambda start: _ended(stage, start, _ABREAST))(y)


def _ended(stage: Stretch, y: Unknowns, most: int):
    y, steps, good, squeezed = descend(stage, y, most)
    total = jnp.sum(squeezed.along**2) + jnp.sum(squeezed.beside**2)
    return y, squeezed, jnp.where(jnp.isfinite(total), total, jnp.inf), steps, good
