"""From an experiment to a fit: start, descend, set wild readings aside, score, and say.

Everything numerical lives in the neighbours of this file; here is their order.
"""

import contextlib
import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect
from ..physics.modal import modes_of, state_matrices
from ..physics.model import Model
from ..recordings.experiment import Experiment
from .base_first import from_the_base, led_astray, lonely
from .covariance import Spread, spread_of
from .descent import Descent, descend, wild_beside
from .drifting import without_drift
from .integration import TENTH, at_twice_the_steps, checked, corrected, refined, stable
from .least_squares import Polished, evaluated, polish
from .multistart import beginning, resolving
from .problem import Compressed, Problem, Unknowns
from .result import Fit, FitError, Mode, Number, RecordingFit
from .setup import Ready, ready

DEFAULT_STARTS = 6
_MORE = 4  # times as many starts, if no other one ended where the best one did
_SAME = 1e-6  # of chi-square


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
    - `starts`: how many starts to try, at least 1; if they lead nowhere, six are tried; if no
      other one ends where the best does, above the noise, four times as many.
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

    **Raises:** `FitError` if no start led to finite numbers; `ValueError` for an effect that does
    not exist or does not go with this experiment or this integrator; with "genetic",
    `MissingExtra` without evosax.
    """
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
    from .methods import GENETIC, RANDOM, check_method

    check_method(method)
    if method == RANDOM:
        from .random_starts import fit_random

        return fit_random(experiment, effects, starts, progress=say, **search)
    if isinstance(method, str) and method in GENETIC:
        from .genetic import fit_genetic

        how = dataclasses.replace(GENETIC[method], **search)
        return fit_genetic(experiment, effects, how, say)
    if method != "levenberg":
        from .minimise import fit_minimised

        return fit_minimised(experiment, effects, method, say, **search)
    if search:
        raise TypeError(f'{next(iter(search))} is no argument of method="levenberg"')
    try:
        return _fit(experiment, effects, starts, say)
    except FitError:
        if starts >= DEFAULT_STARTS:
            raise
        # The first start in closed form may be a bad one: others from it seldom are, too.
        say(f"no start led anywhere: fitting from {DEFAULT_STARTS}")
        return _fit(experiment, effects, DEFAULT_STARTS, say)


def _fit(experiment, effects, starts, progress) -> Fit:
    began = time.perf_counter()
    if starts < 1:
        raise ValueError(f"starts = {starts}: at least one start is needed")
    if not experiment.fit_recordings:
        raise ValueError('no recording has role = "fit": there is nothing to fit to')
    here = ready(experiment, experiment.fit_recordings, effects)
    wild = wild_beside(here, [r.angle for r in here.recordings])

    progress("finding a start in closed form")
    numbers, memory = beginning(here, wild, starts)
    whole = experiment
    experiment = without_drift(whole, here.model.with_vector(jnp.asarray(numbers[0])))
    if experiment is not whole:
        here = ready(experiment, experiment.fit_recordings, effects)
        wild, memory = wild_beside(here, [r.angle for r in here.recordings]), None

    progress(f"fitting from {starts} start{'s' * (starts > 1)}")
    begin = resolving(here, numbers)
    descent, failed = None, None
    try:
        descent = descend(here, begin, numbers, wild, progress, memory)
    except FitError as error:
        failed = error
    if effects and starts > 1 and (descent is None or led_astray(descent)):
        progress("fitting springs and dampers alone, to begin again from there")
        bare = ready(experiment, here.recordings, ())
        again = from_the_base(here, bare, numbers, memory, wild)
        if again is not None and (descent is None or again.cost < descent.cost):
            descent = again
    if not effects and starts > 1 and descent is not None and lonely(descent):
        numbers, memory = beginning(here, wild, _MORE * starts)
        progress(
            f"fitting from {len(numbers)} starts: no other of {starts} ended where the best one did"
        )
        afresh = resolving(here, numbers)
        with contextlib.suppress(FitError):
            again = descend(here, afresh, numbers, wild, progress, memory)
            if again.cost < (1.0 + _SAME) * descent.cost:  # how many agree is known better, too
                begin, descent = afresh, again
    if descent is None:
        assert failed is not None
        again = stable(here, begin)
        if again is None:
            raise failed
        progress("fitting with steps that are short enough")
        here = again
        descent = descend(here, begin, numbers, wild, progress, memory)
    progress("errors, modes and held-out recordings")
    start = np.asarray(begin.vector())
    found = finish(experiment, start, descent, began)
    adapts = here.integrator is not None and here.integrator.adapts
    if found.integration_error > TENTH and not adapts:
        progress("fitting again with shorter integration steps")
        again = _refined(here, descent, found.integration_error)
        if again is not None:
            usual = found.integration_steps, found.integration_error
            found = dataclasses.replace(finish(experiment, start, again, began), shortened=usual)
    return found


def _refined(here: Ready, descent: Descent, error: float) -> Descent | None:
    """The descent from where it ended, with shorter steps; None if that leads nowhere."""
    numbers = np.asarray(descent.problem.numbers(descent.unknowns))
    states = np.asarray(descent.problem.states(descent.unknowns))
    begin = here.model.with_vector(jnp.asarray(numbers))
    quiet = lambda words: None  # noqa: E731
    try:
        again = descend(
            refined(here, error), begin, numbers[None], descent.wild, quiet, near=states[None]
        )
    except FitError:
        return None
    return again._replace(
        steps=descent.steps + again.steps, starts=descent.starts, agreeing=descent.agreeing
    )


def finish(
    experiment: Experiment,
    start: np.ndarray,
    descent: Descent,
    began: float,
    search: Callable[..., Polished] = polish,
    evaluate: Callable[[Problem, Unknowns], Compressed] = evaluated,
    correct: bool = True,
) -> Fit:
    """What a fit returns, from where a descent ended; `start` (P,) is where it began. The error of
    the integration is taken from its numbers, unless they are no minimum (`correct`). Initial
    states of check recordings are found by `search`; `evaluate` gives residual and Jacobian."""
    if correct:
        descent, error = corrected(descent, experiment.fit_recordings, evaluate)
    else:
        error = at_twice_the_steps(descent, experiment.fit_recordings, evaluate)[1]
    problem = descent.problem
    model = problem.model.with_vector(jnp.asarray(problem.numbers(descent.unknowns)))
    fitted = descent.beside(experiment.fit_recordings)
    unknown = len(start) + sum(f.state.size for f in fitted)
    readings = sum(int(f.used.sum()) for f in fitted)
    chi2 = descent.cost / max(1, readings - unknown)
    # Errors assume that the residual is white noise of the size that was stated; where it is larger
    # they grow with it.
    sizes = np.asarray(descent.problem.scale.numbers)
    spread = spread_of(np.asarray(descent.compressed.factor), sizes, max(1.0, chi2))
    return Fit(
        experiment=experiment,
        model=model,
        numbers=_numbers(model, start, spread),
        covariance=spread.covariance,
        recordings=(*fitted, *_held_out(experiment, model, descent, search)),
        reduced_chi2=chi2,
        modes=_modes(model, spread.covariance),
        starts=descent.starts,
        agreeing_starts=descent.agreeing,
        converged=descent.converged,
        reason=_reason(descent.converged),
        steps=descent.steps,
        integration_error=error,
        seconds=time.perf_counter() - began,
        open_groups=spread.open_groups,
        integration_steps=int(descent.problem.steps),
    )


def _held_out(
    experiment: Experiment, model: Model, descent: Descent, search: Callable[..., Polished]
) -> list[RecordingFit]:
    """Check recordings beside the fitted model: only their initial states are fitted."""
    # The effects themselves, not their names: bare recordings know no effect of bearings by name.
    effects = [e for e in model.effects if e.name not in ("spring", "damper")]
    group, found = len(descent.wild), []
    numbers = np.asarray(model.vector())[None]
    for first in range(0, len(experiment.check_recordings), group):
        # As many at a time as were fitted, so that no other program need be compiled.
        some = experiment.check_recordings[first : first + group]
        filled = [*some, *[some[-1]] * (group - len(some))]
        here = ready(experiment, filled, effects)._replace(finer=descent.finer)
        begin = here.model.with_vector(model.vector())
        wild = wild_beside(here, [r.angle for r in here.recordings])
        quiet, like = lambda words: None, descent.problem
        end = descend(here, begin, numbers, wild, quiet, like=like, search=search)
        found += end.beside(filled)[: len(some)]
    return found


def _numbers(model: Model, start: np.ndarray, spread: Spread) -> tuple[Number, ...]:
    values, units = np.asarray(model.vector()), model.mechanism.units
    found = []
    for i, number in enumerate(model.fitted):
        # A number of no one joint (gravity's moment, say) takes the unit of the first.
        unit = units[number.joint or 0] if units else None
        found.append(
            Number(
                name=number.name,
                words=number.meaning.words,
                value=float(values[i]),
                std=float(spread.std[i]),
                start=float(start[i]),
                unit=number.meaning.dimension.unit(unit),
                sign=number.meaning.sign,
                determined=bool(np.isfinite(spread.std[i])),
            )
        )
    return tuple(found)


def _modes(model: Model, covariance: np.ndarray) -> tuple[Mode, ...]:
    """The modes that ring, with errors carried over from the numbers."""
    vector = np.asarray(model.vector())
    steps = np.diag(1e-6 * np.maximum(np.abs(vector), 1e-6))
    beside = np.concatenate([vector[None], vector + steps, vector - steps])
    # All at once: one by one, these small matrices would take as long as the search.
    matrices = state_matrices(model, beside)
    values = np.linalg.eigvals(np.asarray(matrices))
    best, *others = (np.stack(modes_of(x)) for x in values)
    up, down = np.split(np.asarray(others).reshape(-1, *best.shape), 2)
    slopes = (up - down) / (2 * np.diag(steps)[:, None, None])
    found = []
    for i, (frequency, damping) in enumerate(best.T):
        if frequency > 0 and abs(damping) < 1 - 1e-9:
            spread = [_carried(slopes[:, j, i], covariance) for j in (0, 1)]
            found.append(Mode(float(frequency), spread[0], float(damping), spread[1]))
    return tuple(found)


def _carried(slope: np.ndarray, covariance: np.ndarray) -> float:
    """Standard error of a quantity with this slope in the numbers."""
    use = slope != 0
    return float(np.sqrt(slope[use] @ covariance[np.ix_(use, use)] @ slope[use]))


def _reason(converged: bool) -> str:
    if converged:
        return "converged: the last step moved the fit by less than 1/100 of its error"
    return "step limit reached before the numbers settled"
