"""The ring-down with its 95 % band, by draws from what the numbers and the inertias do not know.

The numbers n were fitted with the inertias I held, so that an error of I moves them by M = dn/dI
(see `carried`). A draw is I + d, with d from the covariance of step 1, and n + M d + e, with e from
the covariance of the fit, and from the combinations of numbers that no recording sees where these
leave the motion as it is. Each draw is simulated; the band at each instant holds the middle 95 %.
It knows nothing of effects that the model lacks, nor of the release, which is the same in all.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.model import Model
from ..simulation.interpolation import Trajectory
from ..simulation.simulate import simulate, steps_for
from .carried import MATTERS, Carried, moved

DRAWS = 200
_EDGES = (2.5, 97.5)  # percentiles between which 95 % lie


class RingDown(NamedTuple):
    """A released arm, and where it is in 95 % of the draws; arrays (N, n), rad."""

    path: Trajectory
    low: Float[np.ndarray, "N n"] | None  # None where the recordings leave the motion open
    high: Float[np.ndarray, "N n"] | None


def ring_down(
    model: Model,
    fitted: Model,
    errors: Carried,
    times: Float[np.ndarray, " N"],
    q0: Float[Array, " n"],
    draws: int,
) -> RingDown:
    """Let a model go at rest from `q0`. `errors` are those of the model `fitted`, of which `model`
    may lack some effects."""
    steps = steps_for(model, float(times[-1] - times[0]))
    names = [n.name for n in fitted.fitted]
    kept = [names.index(n.name) for n in model.fitted]
    path, at = simulate(model, times, q0, steps=steps), (jnp.asarray(times), q0, steps)
    unseen = errors.unseen[np.any(errors.unseen[:, kept], axis=1)]
    if draws == 0 or not np.isfinite(errors.numbers).all():
        return RingDown(path, None, None)
    if len(unseen):
        beside = _simulated(model, MATTERS * unseen[:, kept], np.zeros((len(unseen), 3)), *at)
        moved_by = np.abs(np.asarray(beside) - path.q).max() / MATTERS
        if not moved_by <= MATTERS * np.abs(path.q).max():
            return RingDown(path, None, None)
    rng = np.random.default_rng(0)
    how: Any = {"size": draws, "method": "eigh", "check_valid": "ignore"}  # they may be singular
    inertia = rng.multivariate_normal(np.zeros(3), errors.inertia, **how)
    own = rng.multivariate_normal(np.zeros(len(names)), errors.numbers, **how)
    own = own + rng.standard_normal((draws, len(unseen))) @ unseen
    numbers = (own + inertia @ errors.moved.T)[:, kept]
    found = np.asarray(_simulated(model, numbers, inertia, *at))
    # What a draw cannot follow (a stiffness below zero, an arm that is none) lies outside.
    found = np.where(np.isfinite(found), found, np.inf)
    low, high = np.percentile(found, _EDGES, axis=0, method="nearest")
    return RingDown(path, low, high)


@eqx.filter_jit
def _simulated(model: Model, numbers, inertia, times, q0, steps: int):
    """(draws, N, n) angles of the model with its numbers and inertias moved."""

    def one(draw):
        by, added = draw
        here = moved(model, model.vector() + by, added)
        return simulate(here, times, q0, steps=steps).q

    # One after the other: dry friction costs only where a joint stops or turns.
    return jax.lax.map(one, (jnp.asarray(numbers), jnp.asarray(inertia)))
