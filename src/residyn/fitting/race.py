"""Gradients against evolutionary search on one's own recordings.

Every method gets the same model, the same readings, the same compiled simulation and the same
objective, the relative error of Eq. 17. What is its own is how it searches, and what it is given
beforehand; `METHODS` says that of each. A method in a race is the same as `residyn.fit(...,
method=NAME)` with the same seed.

*Simulations* are those of all fitted recordings; a step of a descent counts as one and one more for
each direction of its Jacobian. *Seconds* are those of the search, its programs compiled beforehand;
of a descent, those of the whole fit: start, errors of the numbers and modes are among them.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np

from ..effects import AbstractEffect
from ..errors import quote
from ..recordings.experiment import Experiment, must_be_experiment
from ..runtime.json import number
from ..runtime.presentation import TableResult
from .fit import fit
from .genetic import evosax_or_missing
from .history import History, Watch, watched
from .methods import GENETIC, LEVENBERG, METHODS, RANDOM, named
from .result import Fit, FitError

TEN, ONE = 1.1, 1.01
"""Times the best objective: within 10 % and within 1 %."""


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """One method with one seed. `fit` is None where it failed, and `error` says why."""

    name: str
    seed: int
    fit: Fit | None
    history: History
    seconds: float
    error: str = ""

    @property
    def objective(self) -> float:
        """Eq. 17 in the end; inf where it failed."""
        return math.inf if self.fit is None else self.fit.objective

    @property
    def simulations(self) -> float:
        """Simulations run."""
        return float(self.history.simulations[-1]) if len(self.history.simulations) else 0.0


class Spent(NamedTuple):
    """What a method spent until its objective was small enough: medians over its repeats, inf where
    most of them did not get there."""

    simulations: float
    seconds: float

    def to_dict(self) -> dict[str, float] | None:
        """JSON; None if it did not get there."""
        return self._asdict() if math.isfinite(self.simulations) else None


@dataclasses.dataclass(frozen=True, eq=False)
class Raced:
    """A method: its runs, one for each seed."""

    name: str
    title: str
    given: str
    runs: tuple[Run, ...]

    @property
    def median(self) -> Run:
        """The run with the median objective (of two in the middle, the worse)."""
        return sorted(self.runs, key=lambda run: run.objective)[len(self.runs) // 2]

    @property
    def worst(self) -> Run:
        """The run with the largest objective."""
        return max(self.runs, key=lambda run: run.objective)

    def within(self, objective: float) -> Spent:
        """What was spent until this objective."""
        simulations = [run.history.until(objective) for run in self.runs]
        seconds = [run.history.seconds_until(objective) for run in self.runs]
        return Spent(_median(simulations), _median(seconds))


@dataclasses.dataclass(frozen=True, eq=False)
class Race(TableResult, about="race"):
    """A race. Print it; `to_dict()` is the JSON, `to_latex()` and `to_csv()` are tables."""

    experiment: Experiment
    model: tuple[str, ...]
    methods: tuple[Raced, ...]
    repeats: int
    budget: str
    interrupted: str = ""
    """The method that was running when the race was ended; empty if it came to its end."""

    @property
    def best(self) -> Run | None:
        """The run with the least objective."""
        runs = [run for each in self.methods for run in each.runs if run.fit is not None]
        return min(runs, key=lambda run: run.objective, default=None)

    @property
    def least(self) -> float:
        """The least objective; inf if nothing was found."""
        return math.inf if self.best is None else self.best.objective

    def off(self, run: Run) -> np.ndarray:
        """(P,) how far a run's numbers are from the best run's, in its standard errors."""
        best = self.best and self.best.fit
        if run.fit is None or best is None:
            return np.zeros(0)
        pairs = zip(run.fit.numbers, best.numbers, strict=True)  # pyrefly: ignore
        return np.array([abs(a.value - b.value) / b.std for a, b in pairs])

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn race`."""
        return {
            "model": list(self.model),
            "budget": self.budget,
            "repeats": self.repeats,
            "interrupted": self.interrupted or None,
            "best": None if self.best is None else self.best.name,
            "methods": [self._told(each) for each in self.methods],
        }

    def _told(self, each: Raced) -> dict[str, Any]:
        run, parameters, off = each.median, None, None
        if run.fit is not None:
            parameters = run.fit.to_dict()["parameters"]
            off = dict(zip(parameters, map(number, self.off(run)), strict=True))
        return {
            "name": each.name,
            "title": each.title,
            "given": each.given,
            "objective": number(run.objective),
            "objective_worst": number(each.worst.objective),
            "simulations": run.simulations,
            "seconds": run.seconds,
            "parameters": parameters,
            "standard_errors_off": off,
            "within_10_percent": each.within(TEN * self.least).to_dict(),
            "within_1_percent": each.within(ONE * self.least).to_dict(),
            "seeds": [
                {
                    "seed": r.seed,
                    "objective": number(r.objective),
                    "simulations": r.simulations,
                    "seconds": r.seconds,
                }
                for r in each.runs
            ],
            "error": run.error or None,
        }


def race(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    methods: Sequence[Any] | None = None,
    repeats: int = 1,
    seconds: float | None = None,
    simulations: int | None = None,
    integrator: Any = None,
    progress: Callable[[str], None] | None = None,
    news: Callable[[str, int, Watch], None] | None = None,
) -> Race:
    """Let methods race to the least objective (Eq. 17) on the recordings of an experiment.

    **Arguments:**

    - `effects`, `integrator`: as of `residyn.fit`.
    - `methods`: names out of `residyn.fitting.methods.METHODS`; `"optax.adam"`, `"optimistix.BFGS"`
      or any other minimiser of theirs; or such a minimiser itself. None are all of `METHODS`.
    - `repeats`: how often each method runs, with the seeds 0, 1, ...
    - `seconds`, `simulations`: the most that one run of one method may spend; it is asked between
      generations and between descents. Neither: the paper's 500 generations.
    - `progress`: called with a few words as each run begins.
    - `news`: called with method, seed and watch whenever a run has news of its objective.

    Ctrl-C ends the race with the runs that were done.

    **Returns:** a `Race`.

    **Raises:** `ValueError` for methods that are no list, for a method, a number of repeats or a
    budget that cannot be; `TypeError` for what is no experiment; `MissingExtra` without evosax
    where a method needs it. A method that finds nothing says so in its run.
    """
    must_be_experiment(experiment)
    if not isinstance(repeats, Integral) or repeats < 1:
        raise ValueError(f"repeats = {quote(repeats)}: must be a whole number, at least one")
    repeats = int(repeats)
    for key, value in (("seconds", seconds), ("simulations", simulations)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise ValueError(f"{key} = {value}: must be a number above 0")
    if isinstance(methods, str):
        raise ValueError(f'methods = "{methods}": must be a list, as ["{methods}"]')
    entered = {}
    for method in METHODS if methods is None else methods:
        name, words = named(method)
        if name in entered:
            raise ValueError(f"method {name} is there twice")
        entered[name] = method, words
    if not entered:
        raise ValueError("no method is named: nothing can race")
    if any(name in GENETIC for name in entered):
        evosax_or_missing()
    if integrator is not None:
        experiment = dataclasses.replace(experiment, integrator=integrator)
    # Initial states of check recordings are fitted when a search is over: they take no part in it.
    fitted = dataclasses.replace(experiment, recordings=experiment.fit_recordings)
    most = [math.inf if x is None else x for x in (simulations, seconds)]
    say, hear = progress or (lambda words: None), news or (lambda name, seed, watch: None)
    raced: list[Raced] = []
    interrupted, known = "", ()
    for name, (method, words) in entered.items():
        runs: list[Run] = []
        try:
            for seed in range(repeats):
                say(words.title + (f", seed {seed}" if repeats > 1 else ""))
                runs.append(_run(fitted, effects, name, method, seed, most, hear))
        except KeyboardInterrupt:
            interrupted = name
        if runs:
            raced.append(Raced(name, words.title, words.given, tuple(runs)))
            known = next((r.fit.model.labels for r in runs if r.fit is not None), known)
        if interrupted:
            break
    limits = [f"{simulations} simulations"] if simulations is not None else []
    limits += [f"{seconds:g} s"] if seconds is not None else []
    budget = " and ".join(limits) or "each method's own: 500 generations, or until it has settled"
    return Race(experiment, known, tuple(raced), repeats, budget, interrupted)


def _run(experiment, effects, name: str, method, seed: int, most, hear) -> Run:
    descent = name in (LEVENBERG, RANDOM)
    how = {"effects": effects, "method": method}
    if name in GENETIC or name == RANDOM:  # what draws nothing has no seed
        how["seed"] = seed
    if name in GENETIC and math.isfinite(most[0]):
        # A search that narrows its steps narrows them over the generations that it has.
        own = GENETIC[name]
        how["generations"] = max(1, min(own.generations, int(most[0]) // own.population))
    try:
        if descent:
            fit(experiment, **how)  # compiles
        with watched(Watch(lambda watch: hear(name, seed, watch), *most)) as watch:
            found = fit(experiment, **how)
    except FitError as error:
        return Run(name, seed, None, History.of([]), 0.0, str(error))
    rows = [row for row in watch.rows if math.isfinite(row[2])]
    if descent:  # the whole fit, and what it ends with
        simulations, _, best = rows[-1]
        rows[-1] = simulations, found.seconds - watch.paused_for, min(found.objective, best)
    history = History.of(rows)
    return Run(name, seed, found, history, rows[-1][1])


def _median(values: list[float]) -> float:
    """The middle one; of two, the worse."""
    return sorted(values)[len(values) // 2] if values else math.inf
