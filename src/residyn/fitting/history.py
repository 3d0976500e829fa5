"""The objective of Eq. 17, and how a search brought it down."""

import contextlib
import contextvars
import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .least_squares import over_recordings, predict
from .problem import Problem, Unknowns


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


# -- a stop watch for searches -------------------------------------------------------------------

_here: contextvars.ContextVar["Watch | None"] = contextvars.ContextVar("watch", default=None)
_error = eqx.filter_jit(relative_error)


class Watch:
    """Counts while a search runs, and knows its budget: simulations, seconds, the best objective.

    Whatever is done for the watch's sake alone (the objective of Eq. 17, which least squares does
    not minimise; compiling a program beforehand) happens with the watch stopped.

    **Arguments:**

    - `told`: called with the watch whenever there is news.
    - `most_simulations`, `most_seconds`: the budget; inf is none.
    - `numbers`: how many numbers the model has: a fit of springs and dampers alone, on the way to
      that of an effect, costs time and simulations, but its objective is another model's.
    """

    def __init__(
        self,
        told: Callable[["Watch"], None] = lambda watch: None,
        most_simulations: float = math.inf,
        most_seconds: float = math.inf,
        numbers: int | None = None,
    ):
        self.told, self.numbers = told, numbers
        self.most_simulations, self.most_seconds = most_simulations, most_seconds
        self.simulations, self.best = 0.0, math.inf
        self.rows: list[tuple[float, float, float]] = []
        self._began, self._paused = time.perf_counter(), 0.0

    @property
    def seconds(self) -> float:
        """Seconds on the clock."""
        return time.perf_counter() - self._began - self._paused

    def over(self) -> bool:
        """Whether the budget is spent."""
        return self.simulations >= self.most_simulations or self.seconds >= self.most_seconds

    def restart(self) -> None:
        """Begin to count, once programs are compiled."""
        self._began, self._paused, self.simulations = time.perf_counter(), 0.0, 0.0

    @property
    def paused_for(self) -> float:
        """Seconds that were not counted."""
        return self._paused

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """What happens here is not counted."""
        stopped = time.perf_counter()
        try:
            yield
        finally:
            self._paused += time.perf_counter() - stopped

    def add(self, simulations: float, objective: float) -> None:
        """So many more simulations of all fitted recordings, and the objective they led to."""
        self.simulations += simulations
        if objective < self.best:
            self.best = objective
        self.rows.append((self.simulations, self.seconds, self.best))
        with self.paused():
            self.told(self)

    def descended(self, problem: Problem, unknowns: Unknowns, steps: int) -> None:
        """A descent has taken so many steps, each of one simulation and one more for each direction
        of its Jacobian, whatever share of the recordings it covered."""
        numbers = problem.scale.numbers.shape[0]
        directions = numbers + problem.scale.states.shape[1]
        objective = math.inf
        if self.numbers is None or numbers == self.numbers:
            with self.paused():
                objective = float(_error(problem, jax.tree.map(jnp.asarray, unknowns)))
        self.add(steps * (1 + directions), objective if np.isfinite(objective) else math.inf)

    @property
    def history(self) -> History:
        """The best objective after so many simulations and seconds."""
        rows = [row for row in self.rows if math.isfinite(row[2])]
        spent, seconds, best = np.asarray(rows, float).reshape(-1, 3).T
        return History(spent, best, seconds)


@contextlib.contextmanager
def watched(watch: Watch) -> Iterator[Watch]:
    """Fits within are watched."""
    token = _here.set(watch)
    try:
        yield watch
    finally:
        _here.reset(token)


def watching() -> Watch | None:
    """The watch of the fit that runs."""
    return _here.get()
