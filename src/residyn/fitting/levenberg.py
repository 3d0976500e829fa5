"""Levenberg-Marquardt from many starts at once.

Ringing makes a cruel cost: off by half a cycle at the end of the record, the fit sits in a wrong
valley. Two things lead out of it. The closed-form start is already close. And each start first
fits the first few cycles alone, where no phase can slip, then a longer stretch, then everything.
All starts run abreast under `vmap`, in one compiled program; a start that has fallen far behind
after the first stretch follows the best one from there, and is not counted as agreeing.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from .problem import Compressed, Problem, Unknowns, compressed

STEPS = 20  # of one call: between calls, the hopeless can be left
_CALLS = 4
# Steps end when the whitened residual moves by less than this many sigma, in total (sigma of the
# noise; after the first call, of whatever the model misses the readings by, if that is more) ...
_RESIDUAL_TOLERANCE = 3e-3
# ... and no unknown by more than this share of its scale.
_UNKNOWN_TOLERANCE = 1e-5
# A start this many times worse than the best after the first stretch has lost its way.
LOST = 25.0


class Polished(NamedTuple):
    """Where every start (leading axis S) ended."""

    unknowns: Unknowns
    cost: Float[Array, " S"]  # sum of squared whitened residuals
    steps: Int[Array, " S"]
    converged: Bool[Array, " S"]
    lost: Bool[Array, " S"]
    compressed: Compressed


class _Rows(NamedTuple):
    """Compressed residual: the only thing that the optimiser sees."""

    along: Float[Array, "R L"]
    beside: Float[Array, " R"]


def _norm(tree) -> Float[Array, ""]:
    """Size of a step for the stopping rule, in units of its own tolerance."""
    if isinstance(tree, _Rows):
        return optx.two_norm(tree.along)
    return optx.max_norm(tree) * (_RESIDUAL_TOLERANCE / _UNKNOWN_TOLERANCE)


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


def solver() -> optx.LevenbergMarquardt:
    """Levenberg-Marquardt with this module's stopping rule."""
    return optx.LevenbergMarquardt(rtol=0.0, atol=_RESIDUAL_TOLERANCE, norm=_norm)


def descend(stretch: Stretch, y: Unknowns):
    """One Levenberg-Marquardt descent: where it ended, steps, whether it converged, and J there."""
    solution = optx.least_squares(
        rows,
        solver(),
        y,
        args=stretch,
        has_aux=True,
        options={"jac": "fwd"},
        max_steps=STEPS,
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
    """Descend from every start over growing shares (0 to 1) of the recordings.

    `hopeless` is asked, now and then, whether a start that has not yet settled should be left where
    it is, at this cost; `size` is the least rms residual to expect, in sigma.
    """
    lost = jnp.zeros(starts.numbers.shape[0], bool)
    readings = max(1, np.count_nonzero(problem.recorded.weights))
    out, taken = None, 0
    for share in shares:
        unit = size
        for _ in range(_CALLS):
            out = _stretch(problem, starts, lost, jnp.asarray(float(share)), jnp.asarray(unit))
            if np.isfinite(least := np.min(out.cost)):
                unit = max(unit, float(np.sqrt(least / readings)))
            starts, lost, taken = out.unknowns, out.lost, taken + out.steps
            settled = np.asarray(out.converged | lost)
            if settled.all() or (share == 1.0 and hopeless(float(np.min(out.cost)))):
                break
    assert out is not None
    return out._replace(steps=taken)


@eqx.filter_jit
def _stretch(problem: Problem, y: Unknowns, lost, share, size) -> Polished:
    stage = Stretch.of(problem, share)._replace(size=size)

    def one(start):
        return descend(stage, start)

    # See `over_recordings`: what dry friction seldom asks for must stay seldom.
    y, steps, good, squeezed = jax.lax.map(one, y) if problem.model.dry else jax.vmap(one)(y)
    total = _cost(squeezed)
    best = jnp.argmin(total)
    lost = lost | ~(total <= LOST * total[best])
    y = jax.tree.map(lambda x: jnp.where(_like(lost, x), x[best][None], x), y)
    return Polished(y, total, steps, good, lost, squeezed)


def _cost(squeezed: Compressed) -> Float[Array, " S"]:
    total = jnp.sum(squeezed.along**2, axis=(1, 2)) + jnp.sum(squeezed.beside**2, axis=1)
    return jnp.where(jnp.isfinite(total), total, jnp.inf)


def _like(mask, leaf):
    return mask.reshape(mask.shape + (1,) * (leaf.ndim - 1))
