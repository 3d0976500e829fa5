"""From an experiment to a fit: guess, descend, judge.

Everything numerical lives in the neighbours of this file; here is their order.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from numbers import Integral
from typing import Any

import jax

from ..effects import AbstractEffect
from ..recordings.experiment import Experiment, must_be_experiment
from .conclusion import finishing
from .genetic import drawn, fit_genetic
from .initial_guess import resolving
from .integration import checked, stable
from .lanes import Fitting, alone
from .methods import GENETIC, LEVENBERG, RANDOM, named
from .minimise import fit_minimised
from .multistart import DEFAULT_STARTS, beginning, descending, multistart
from .problem import ready
from .result import Fit, FitError


def fit(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
    progress: Callable[[str], None] | None = None,
    method: Any = "levenberg",
    integrator: Any = None,
    check_integration: bool = False,
    **search: Any,
) -> Fit:
    """Fit springs, dampers and any `effects` to the recordings of an experiment.

    Least squares on the angles themselves (the model simulated beside every recording), over all
    numbers of the model and every recording's own initial state, from a start found in closed form
    and others around it. Runs in float64 whatever JAX's setting.

    **Arguments:**

    - `experiment`: from `residyn.load`, or made of arrays.
    - `effects`: what to add to the springs and dampers: `name`, `name:joint`, or an effect.
    - `starts`: how many starts to try, at least 1; where they disagree above the noise, multiple
      shooting begins from them, too.
    - `progress`: called with a few words as each phase begins.
    - `method`: "levenberg", or "genetic" for the paper's genetic algorithm on Eq. 17, which knows
      no `starts` and takes further arguments: those of `residyn.fitting.Genetic`. Others are
      "cma_es", "differential_evolution" and "particle_swarm", which take the same ones, "random"
      (Levenberg-Marquardt from random starts, with a `seed`), and any minimiser of optax or
      optimistix, by name ("optimistix.BFGS") or itself.
    - `integrator`: "fixed" steps, or a solver of diffrax: a name such as "Tsit5", an instance, or
      a `residyn.Integrator`; every simulation of the fit and every Jacobian is then a
      `diffrax.diffeqsolve`. None is the experiment's own, fixed steps unless it names one.
    - `check_integration`: integrate once more, with Dopri8 at rtol = 1e-10, and state that error.

    **Returns:** a `Fit`.

    **Raises:** `FitError` if no start led to finite numbers; `TypeError` for what is no experiment;
    `ValueError` for an effect that does not exist or does not go with this experiment or this
    integrator; with "genetic", `MissingExtra` without evosax.
    """
    must_be_experiment(experiment)
    say = progress or (lambda words: None)
    if integrator is not None:
        experiment = dataclasses.replace(experiment, integrator=integrator)
    with jax.enable_x64(True):
        found = _by(method, experiment, effects, starts, say, search)
        if check_integration:
            say("checking the integration")
            found = dataclasses.replace(found, integration_checked=checked(found))
        return found


def _by(method: Any, experiment, effects, starts: int, say, search: dict[str, Any]) -> Fit:
    named(method)
    if isinstance(method, str) and method in GENETIC:
        how = dataclasses.replace(GENETIC[method], **search)
        return fit_genetic(experiment, effects, how, say)
    if method not in (LEVENBERG, RANDOM):
        return fit_minimised(experiment, effects, method, say, **search)
    seed = search.pop("seed", 0) if method == RANDOM else None
    if search:
        raise TypeError(f'{next(iter(search))} is no argument of method="{method}"')
    return alone(fitting(experiment, effects, starts, say, seed))


def fitting(
    experiment: Experiment,
    effects: Sequence[str | AbstractEffect],
    starts: int,
    progress: Callable[[str], None],
    seed: int | None = None,
) -> Fitting[Fit]:
    """`fit` by Levenberg-Marquardt, for `lanes`; with a `seed`, from random starts instead of the
    closed form. Run it in float64."""
    began = time.perf_counter()
    if not isinstance(starts, Integral) or starts < 1:
        raise ValueError(f"starts = {starts!r}: must be a whole number, at least one")
    starts = int(starts)
    progress("finding a start in closed form")
    begin = beginning(experiment, effects, starts)
    experiment, here, numbers, memory = begin
    if seed is None:
        progress(f"fitting from {starts} start{'s' * (starts > 1)}")
        base = functools.partial(ready, experiment, here.recordings, ()) if effects else None
        begun = base, starts, progress, numbers, memory
        try:
            descent = yield from multistart(here, *begun)
        except FitError:
            finer = stable(here, resolving(here, numbers))
            if finer is None:
                raise
            progress("fitting with steps that are short enough")
            descent = yield from multistart(finer, *begun)
    else:
        progress("drawing starts")
        numbers = drawn(begin, starts, seed)
        progress(f"fitting from {starts} of them")
        first = here.model.with_vector(numbers[0])
        descent = yield from descending(here, first, numbers, here.outliers, progress)
    progress("errors, modes and held-out recordings")
    return (yield from finishing(experiment, numbers[0], descent, began, progress=progress))
