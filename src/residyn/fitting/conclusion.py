"""From where a search ended to a `Fit`: errors, modes, held-out recordings, integration error.

Every search ends here, whatever it searched by.
"""

import dataclasses
import time
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..physics.modal import infinite_slopes_of
from ..physics.model import Model
from ..recordings.experiment import Experiment
from ..recordings.segments import by_recording
from .covariance import modes_of, numbers_of, spread_of
from .history import History
from .integration import at_twice_the_steps, corrected, refined
from .lanes import Fitting, alone
from .least_squares import Compressed, compressed, one_start
from .linalg import BLIND, damped_step
from .multistart import Descent, descending, polishing
from .problem import Problem, Ready, Unknowns, mechanism_of, posed
from .result import Fit, FitError, RecordingFit, by_chance

_FAR = 1.0  # standard errors that least squares would still go
_CONVERGED = "converged: the last step moved the fit by less than 1/100 of its error"
_STOPPED = "step limit reached before the numbers settled"


def finishing(
    experiment: Experiment,
    start: np.ndarray,
    descent: Descent,
    began: float,
    correct: bool = True,
    progress: Callable[[str], None] = lambda words: None,
) -> Fitting[Fit]:
    """What a fit returns, from where a descent ended; `start` (P,) is where it began. Where the
    error of the integration counts, the descent goes on with shorter steps, and `progress` is told;
    what is left of it is taken from the numbers. Neither, if they are no minimum (`correct`).
    """
    recordings, usual = experiment.fit_recordings, None
    if correct:
        descent, error, coarse = yield from corrected(descent, recordings)
        while coarse:
            again = yield from _with_shorter_steps(descent, error, progress)
            if again is None:
                break
            usual = usual or (int(descent.problem.steps), error)
            descent, error, coarse = yield from corrected(again, recordings)
    else:
        _, error = yield from at_twice_the_steps(descent, recordings)
    model, fitted = descent.model, descent.beside(recordings)
    chi2 = descent.reduced_chi2
    # Errors assume that the residual is white noise of the size that was stated; where it is larger
    # they grow with it.
    sizes = np.asarray(descent.problem.scale.numbers)
    spread = spread_of(np.asarray(descent.compressed.factor), sizes, max(1.0, chi2))
    modes = modes_of(model, spread)
    held_out = yield from _held_out(experiment, model, descent.here, descent.problem)
    found = Fit(
        experiment=experiment,
        model=model,
        numbers=numbers_of(model, start, spread),
        spread=spread,
        recordings=(*fitted, *held_out),
        reduced_chi2=chi2,
        modes=modes,
        infinite_slopes=() if modes else infinite_slopes_of(model),
        starts=descent.starts,
        agreeing_starts=descent.agreeing,
        converged=descent.converged,
        reason=_CONVERGED if descent.converged else _STOPPED,
        steps=descent.steps,
        integration_error=error,
        seconds=time.perf_counter() - began,
        integration_steps=int(descent.problem.steps),
        shortened=usual,
        problem=descent.problem,
        unknowns=descent.unknowns,
        ready=descent.here,
    )
    return dataclasses.replace(found, needed=(yield from _needed(found, descent)))


def _with_shorter_steps(
    descent: Descent, error: float, progress: Callable[[str], None]
) -> Fitting[Descent | None]:
    """The descent from where it ended, with so many steps that this integration error would have
    been small; None if there cannot be, or if they lead nowhere."""
    here = refined(descent, error)
    if here is None:
        return None
    progress("fitting again with shorter integration steps")
    begin, states = (here, descent.model, descent.numbers[None]), descent.states[None]
    try:
        again = yield from descending(*begin, descent.outliers, near=states)
    except FitError:
        return None
    return again._replace(
        steps=descent.steps + again.steps, starts=descent.starts, agreeing=descent.agreeing
    )


def _needed(fit: Fit, descent: Descent) -> Fitting[tuple[str, ...]]:
    """`Fit.needed`: each is left out, and all else is fitted again."""
    found = []
    for label in fit.unseen:
        index = fit.model.labels.index(label)
        own = np.array([n.effect == index for n in fit.model.fitted])
        none = [n.meaning.silent if n.effect == index else None for n in fit.model.fitted]
        values = np.where([x is None for x in none], descent.numbers, np.array(none, float))
        problem = eqx.tree_at(
            lambda p: (p.model, p.active),
            descent.problem,
            (
                fit.model.with_vector(jnp.asarray(values)),
                np.where(own, 0.0, descent.problem.active),
            ),
        )
        begin = problem.scaled(values, descent.states)
        starts = jax.tree.map(lambda x: np.asarray(x)[None], begin)
        end = yield from polishing(problem, starts, [1.0])
        rise = (end.cost - descent.cost) / max(1.0, fit.reduced_chi2)
        if not by_chance(rise, int(own.sum())):
            found.append(label)
    return tuple(found)


class Found(NamedTuple):
    """Where a search by other means than least squares ended: numbers (P,), initial states (R, s),
    the numbers that it began with (P,), the objective on the way, its steps or generations, and
    whether it had settled."""

    numbers: np.ndarray
    states: np.ndarray
    first: np.ndarray
    history: History
    steps: int
    settled: bool


def searched(
    experiment: Experiment,
    here: Ready,
    found: Found,
    reason: str,
    began: float,
) -> Fit:
    """The fit of what a search has found, which did not end in a least-squares minimum."""
    model = here.model.with_vector(jnp.asarray(found.numbers))
    # Once more with the step that these numbers ask for.
    problem, _ = here.problem(model, here.outliers)
    at = jax.device_get(problem.scaled(jnp.asarray(found.numbers), jnp.asarray(found.states)))
    there = jax.device_get(compressed(problem, at))
    cost = float(there.cost)
    if not np.isfinite(cost):
        raise FitError("no individual led to finite numbers: is this the arm that was recorded?")
    end = Descent(here, problem, here.outliers, at, there, cost, found.steps, found.settled)
    fit = alone(finishing(experiment, found.first, end, began, correct=False), _evaluated)
    far = _far(fit, there, np.asarray(problem.scale.numbers))
    return dataclasses.replace(fit, reason=reason, history=found.history, short_of_minimum=far)


def _evaluated(problem: Problem, y: Unknowns, shares, size):
    """`one_start`, which need not be compiled for what only evaluates."""
    if np.isfinite(size):
        return one_start(problem, y, shares, size)
    found = compressed(problem, y)
    return y, found, found.cost, 0, True, 1


def _far(fit: Fit, there: Compressed, sizes: np.ndarray) -> tuple[str, float] | None:
    """How far the least-squares minimum still is, by one Gauss-Newton step: the number that is
    farthest, and by how many standard errors; None if that is little."""
    factor = np.asarray(there.factor)
    slope = np.einsum("rij,ri->rj", factor, there.along)
    step = damped_step(factor.transpose(0, 2, 1) @ factor, slope, len(sizes), BLIND).numbers * sizes
    far = np.abs(step) / np.array([n.std for n in fit.numbers])
    if not far.size or not far.max() > _FAR:
        return None
    worst = int(np.argmax(far))
    return fit.numbers[worst].name, float(far[worst])


def with_held_out(fit: Fit, experiment: Experiment) -> Fitting[Fit]:
    """A fit of the fitted recordings alone, with those that the experiment holds out beside it."""
    more = yield from _held_out(experiment, fit.model, fit.ready, fit.problem)
    return dataclasses.replace(fit, experiment=experiment, recordings=(*fit.recordings, *more))


def _held_out(
    experiment: Experiment, model: Model, fitted: Ready, like: Problem
) -> Fitting[list[RecordingFit]]:
    """Check recordings beside the fitted model: only their initial states are fitted."""
    group, found = len(fitted.recordings), []
    numbers = np.asarray(model.vector())[None]
    for first in range(0, len(experiment.check_recordings), group):
        # As many at a time as were fitted, so that no other program need be compiled.
        some = experiment.check_recordings[first : first + group]
        filled = [*some, *[some[-1]] * (group - len(some))]
        mechanisms = tuple(mechanism_of(experiment, r) for r in filled)
        # The same effects, also where bare recordings know none of bearings.
        begin = posed(model, mechanisms[0])
        here = fitted._replace(model=begin, recordings=tuple(filled), mechanisms=mechanisms)
        try:
            end = yield from descending(here, begin, numbers, here.outliers, like=like)
        except FitError as error:
            names = " or ".join(whole.name for whole, _ in by_recording(some))
            raise FitError(f"{names} (held out): {error}") from None
        found += end.beside(filled)[: len(some)]
    return found
