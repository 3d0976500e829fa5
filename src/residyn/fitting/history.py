"""The objective of Eq. 17, and how a search brought it down."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .problem import Problem, Unknowns, over_recordings, predict


class History(NamedTuple):
    """The least objective (Eq. 17) found after so many simulations of all fitted recordings."""

    simulations: np.ndarray  # (K,), growing
    objective: np.ndarray  # (K,), never growing
    seconds: np.ndarray | None = None  # (K,), growing, if they were kept

    def until(self, objective: float) -> float:
        """Simulations spent until this objective was reached; inf if it was not."""
        reached = np.flatnonzero(self.objective <= objective)
        return float(self.simulations[reached[0]]) if len(reached) else float("inf")

    def seconds_until(self, objective: float) -> float:
        """The same in seconds; inf, too, if they were not kept."""
        reached = np.flatnonzero(self.objective <= objective)
        if self.seconds is None or not len(reached):
            return float("inf")
        return float(self.seconds[reached[0]])


def relative_error(problem: Problem, y: Unknowns) -> Float[Array, ""]:
    """Eq. 17 at scaled unknowns: |predicted - measured| / |measured| of every joint's series of
    angles, summed over the joints.

    A series is that of all fitted recordings, one after the other; lost and wild readings are in
    neither norm. A joint that does not move at all counts with its error alone.
    """
    numbers = problem.numbers(y)

    def one(recorded, state):
        predicted = predict(problem, recorded, numbers, state)
        seen = recorded.weights > 0
        off = jnp.where(seen, predicted - recorded.angles, 0.0)
        size = jnp.where(seen, recorded.angles, 0.0)
        return jnp.sum(off**2, axis=0), jnp.sum(size**2, axis=0)

    each = over_recordings(one, problem.model)(problem.recorded, problem.states(y))
    off, size = (jnp.sum(x, axis=0) for x in each)
    return jnp.sum(jnp.sqrt(off / jnp.where(size > 0, size, 1.0)))
