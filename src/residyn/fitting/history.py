"""The objective of Eq. 17, and how a search brought it down."""

import contextlib
import contextvars
import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .least_squares import predictions
from .problem import Problem, Unknowns


class Part(str):
    """Words on how it goes, with the `share` (0 to 1) that is done."""

    share: float

    def __new__(cls, words: str, share: float) -> "Part":
        part = super().__new__(cls, words)
        part.share = share
        return part


class History(NamedTuple):
    """The least objective (Eq. 17) found after so many simulations of all fitted recordings."""

    simulations: np.ndarray  # (K,), growing
    objective: np.ndarray  # (K,), never growing
    seconds: np.ndarray | None = None  # (K,), growing, if they were kept

    @classmethod
    def of(cls, rows: Sequence[tuple[float, float, float]]) -> "History":
        """From rows of simulations, seconds and the least objective."""
        spent, seconds, best = np.asarray(rows, float).reshape(-1, 3).T
        return cls(spent, best, seconds)

    def until(self, objective: float) -> float:
        """Simulations spent until this objective was reached; inf if it was not."""
        return self._until(objective, self.simulations)

    def seconds_until(self, objective: float) -> float:
        """The same in seconds; inf, too, if they were not kept."""
        return math.inf if self.seconds is None else self._until(objective, self.seconds)

    def _until(self, objective: float, spent: np.ndarray) -> float:
        reached = np.flatnonzero(self.objective <= objective)
        return float(spent[reached[0]]) if len(reached) else math.inf


def relative_error(problem: Problem, y: Unknowns) -> Float[Array, ""]:
    """Eq. 17 at scaled unknowns: |predicted - measured| / |measured| of every joint's series of
    angles, summed over the joints.

    A series is that of all fitted recordings, one after the other; lost readings and outliers are
    in neither norm. A joint that does not move at all counts with its error alone.
    """
    predicted = predictions(problem, problem.numbers(y), problem.states(y))
    seen, angles = problem.recorded.weights > 0, problem.recorded.angles
    off = jnp.sum(jnp.where(seen, predicted - angles, 0.0) ** 2, axis=(0, 1))
    size = jnp.sum(jnp.where(seen, angles, 0.0) ** 2, axis=(0, 1))
    return jnp.sum(jnp.sqrt(off / jnp.where(size > 0, size, 1.0)))


_relative_error = eqx.filter_jit(relative_error)


def objective_of(problem: Problem, y: Unknowns) -> float:
    """`relative_error`, by a program of its own."""
    return float(_relative_error(problem, jax.tree.map(jnp.asarray, y)))


# -- a stop watch for searches -------------------------------------------------------------------

_here: contextvars.ContextVar["Watch | None"] = contextvars.ContextVar("watch", default=None)


class Watch:
    """Counts while a search runs, and knows its budget: simulations, seconds, the best objective.

    Whatever is done for the watch's sake alone (the objective of Eq. 17, which least squares does
    not minimise; compiling a program beforehand) happens with the watch stopped.

    **Arguments:**

    - `told`: called with the watch whenever there is news.
    - `most_simulations`, `most_seconds`: the budget; inf is none.
    """

    def __init__(
        self,
        told: Callable[["Watch"], None] = lambda watch: None,
        most_simulations: float = math.inf,
        most_seconds: float = math.inf,
    ):
        self.told = told
        self.most_simulations, self.most_seconds = most_simulations, most_seconds
        self.simulations, self.best = 0.0, math.inf
        self.rows: list[tuple[float, float, float]] = []
        self._first: Any = None
        self._began, self.paused_for = time.perf_counter(), 0.0  # s that were not counted

    @property
    def seconds(self) -> float:
        """Seconds on the clock."""
        return time.perf_counter() - self._began - self.paused_for

    def over(self) -> bool:
        """Whether the budget is spent."""
        return self.simulations >= self.most_simulations or self.seconds >= self.most_seconds

    def restart(self) -> None:
        """Begin to count, once programs are compiled."""
        self._began, self.paused_for, self.simulations = time.perf_counter(), 0.0, 0.0

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """What happens here is not counted."""
        stopped = time.perf_counter()
        try:
            yield
        finally:
            self.paused_for += time.perf_counter() - stopped

    def add(self, simulations: float, *objectives: float) -> None:
        """For each of these objectives, so many more simulations of all fitted recordings that led
        to it; what they took is shared alike among them."""
        began = self.rows[-1][1] if self.rows else 0.0
        clock = np.linspace(began, self.seconds, len(objectives) + 1)[1:]
        for second, objective in zip(clock.tolist(), objectives, strict=True):
            self.simulations += simulations
            if objective < self.best:
                self.best = objective
            self.rows.append((self.simulations, second, self.best))
        with self.paused():
            self.told(self)

    def descended(self, problem: Problem, unknowns: Unknowns, steps: int) -> None:
        """A descent has taken so many steps, each of one simulation and one more for each direction
        of its Jacobian, whatever share of the recordings it covered.

        What is fitted on the way, segments of the recordings or springs and dampers alone, costs
        simulations and time, but its objective is another problem's than the first one's.
        """
        numbers, states = problem.scale.numbers.shape, problem.scale.states.shape
        self._first = self._first or (numbers, states)
        objective = math.inf
        if self._first == (numbers, states):
            with self.paused():
                objective = objective_of(problem, unknowns)
        self.add(steps * (1 + numbers[0] + states[1]), objective)

    @property
    def history(self) -> History:
        """The best objective after so many simulations and seconds."""
        return History.of([row for row in self.rows if math.isfinite(row[2])])


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
