"""How exact the integration was, and the fit without its error: once more at twice the steps.

Integration steps of length h leave an error that falls as a power of h, the fifth for a smooth
model. So the motion at twice the steps is so much nearer to the true one that its difference from
the motion of the fit *is* the fit's integration error, to a few per cent (where dry friction costs
the steps some of their order, to a third). It is given in times the noise of one reading, rms over
the readings of the worst joint.

Errors of single readings add up in the numbers, since they are all of one kind, a phase that runs
ahead: 0.003 of the noise at 4000 readings moved a number by 0.09 of its standard error. But what
the numbers would have to be for the finer motion to be the same as the coarse one is a small
problem of least squares, of which the same simulation gives residual and Jacobian: one Gauss-Newton
step takes the error from the numbers, to first order (defect correction: Stetter, Numerische
Mathematik 29, 1978). It is a projection, so it never moves the motion by more than the error.

A solver that chooses its steps takes them from its tolerances, which are made tighter as well.
"""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..physics.modal import fastest, not_finite_at_rest
from ..physics.model import Model
from ..recordings.recording import Recording
from ..simulation.integrator import Integrator
from .covariance import spread_of
from .history import watching
from .lanes import Fitting, evaluating
from .layout import drives
from .least_squares import RESIDUAL_TOLERANCE, Compressed, predictions
from .linalg import BLIND, damped_step
from .multistart import Descent
from .problem import Problem, Ready
from .result import Fit, FitError, RecordingFit

TENTH = 0.1
"""Of the noise, or of what a model misses the readings by, if that is more: as much integration
error as hardly counts. As an error of its own it would make standard errors half a per cent wider.
"""
_SURE = 1.1
"""Standard errors are known to a tenth: no steps may change them by more."""
_TIGHTER = 2.0**5
# Refined steps are to leave this share of what `TENTH` is of; no more than so many times as many,
# and in all than the readings' own motion asks for, what that costs being in proportion, and room
# in memory with it.
_AIM, MOST_AT_ONCE, _MOST_IN_ALL = 0.02, 8, 64
_ORDER, _ROUGH_ORDER = 5.0, 2.0
# What a fit is checked against: this solver, or, where joints stick, so many times its own steps.
_REFERENCE = Integrator("Dopri8", rtol=1e-10, atol=1e-13)
_FINEST = 16
# Tsitouras' stages damp nothing that fades within less than a third of a step.
_STABLE = 3.0


def corrected(
    descent: Descent, recordings: Sequence[Recording]
) -> Fitting[tuple[Descent, float, bool]]:
    """A descent's minimum without the error that integration has left in it, to first order; that
    error, in times the noise; and whether shorter steps are called for, by it or by the standard
    errors. The error is inf where twice the steps lead to no finite motion, and to no other
    minimum."""
    problem, y = descent.problem, descent.unknowns
    fine, error = yield from at_twice_the_steps(descent, recordings)
    coarse = too_coarse(error, descent.reduced_chi2)
    watch = watching()
    if watch is not None:
        watch.descended(problem, y, 2)
    if coarse or _misjudged(descent, fine):
        return descent, error, True
    factor, count, n = np.asarray(fine.factor), y.numbers.shape[0], fine.predicted.shape[-1]
    square = factor.transpose(0, 2, 1) @ factor
    slope = np.einsum("rij,ri->rj", factor, fine.along)
    # What is known beforehand of internal states has no such error.
    slope[:, count + 2 * n :] -= y.states[:, 2 * n :]
    step = damped_step(square, slope, count, BLIND)
    local = step.local()
    moved = np.sqrt(np.einsum("ra,rab,rb->", local, square, local))
    if not moved > RESIDUAL_TOLERANCE:  # the descent did not look any closer
        return descent, error, False
    there = jax.tree.map(np.add, y, step)
    found = jax.device_get((yield from evaluating(problem, there)))
    if watch is not None:
        watch.descended(problem, there, 1)
    cost = float(found.cost)
    if not math.sqrt(cost) <= math.sqrt(descent.cost) + moved:  # it bends more than slopes say
        return descent, error, False
    return descent._replace(unknowns=there, compressed=found, cost=cost), error, False


def _misjudged(descent: Descent, fine: Compressed) -> bool:
    """Whether twice the steps change the standard error of a number by more than a tenth, unless it
    is larger than the number itself with both. Where a torque has corners, slopes are less exact
    than the motion, and along a combination of numbers that hardly moves it their errors would be
    all that is known."""
    unit, factors = np.ones(len(descent.numbers)), (descent.compressed.factor, fine.factor)
    before, after = (spread_of(np.asarray(x), unit, 1.0).std for x in factors)
    known = np.isfinite(before) & np.isfinite(after)
    known &= np.minimum(before, after) < np.abs(descent.unknowns.numbers)
    off = np.abs(np.log(after[known] / before[known]))
    return bool(np.any(off > math.log(_SURE)))


def at_twice_the_steps(
    descent: Descent, recordings: Sequence[Recording]
) -> Fitting[tuple[Compressed, float]]:
    """The motion where a descent ended, but at twice the steps: how far it is from the descent's
    own, a residual like any other, with its Jacobian; and the same in times the noise."""
    fine, own = finer(descent.problem, recordings), np.asarray(descent.compressed.predicted)
    angles = np.zeros(np.shape(fine.recorded.angles))
    angles[:, : own.shape[1]] = own
    fine = dataclasses.replace(fine, recorded=dataclasses.replace(fine.recorded, angles=angles))
    found = jax.device_get((yield from evaluating(fine, descent.unknowns)))
    return found, rms_over_noise(found.predicted, descent.beside(recordings))


def rms_over_noise(predicted: np.ndarray, beside: Sequence[RecordingFit]) -> float:
    """Between readings predicted (R, N, n) otherwise and those of a fit, in times the noise: rms of
    the worst joint; inf if it is not finite."""
    total, count = 0.0, 0
    for other, own in zip(predicted, beside, strict=True):
        off = (other[: len(own.predicted)] - own.predicted) / own.recording.noise
        total = total + np.sum(off**2, axis=0, where=own.used)
        count = count + own.used.sum(axis=0)
    error = np.sqrt(np.max(total / np.maximum(count, 1)))
    return float(error) if np.isfinite(error) else math.inf


def finer(problem: Problem, recordings: Sequence[Recording]) -> Problem:
    """The problem at twice the steps, in the same room: the same compiled program serves."""
    steps, recorded = 2 * int(problem.steps), problem.recorded
    assert steps <= problem.room, "a problem has room for twice its steps"
    place = 2 * np.asarray(recorded.place)
    late = place >= 1.0
    drive = None if recorded.drive is None else drives(recordings, steps, problem.room)
    recorded = dataclasses.replace(
        recorded, row=2 * np.asarray(recorded.row) + late, place=place - late, drive=drive
    )
    tighter = _TIGHTER * np.asarray(problem.tighter)
    return dataclasses.replace(problem, recorded=recorded, steps=np.asarray(steps), tighter=tighter)


def too_coarse(error: float, chi2: float) -> bool:
    """Whether steps leave an integration error, in times the noise, that counts: readings that the
    model misses by more than noise determine the numbers less, too."""
    return error > TENTH * math.sqrt(max(1.0, chi2))


def refined(descent: Descent, error: float) -> Ready | None:
    """A descent's recordings with so many more steps that this integration error would have been
    small beside what the readings are missed by otherwise; None if these are too many, or chosen by
    what integrates. A model that is damped without bounds asks for ever more by itself."""
    here, model = descent.here, descent.model
    order = _ROUGH_ORDER if model.rough else _ORDER
    aim = _AIM * math.sqrt(max(1.0, descent.reduced_chi2 - error**2))
    times = (error / aim) ** (1 / order) if math.isfinite(error) else MOST_AT_ONCE
    more = here._replace(finer=here.finer * min(max(2, math.ceil(times)), MOST_AT_ONCE))
    usual = here._replace(finer=1).steps(model, float(here.pace.max()))
    return None if here.adapts or more.steps(model) > _MOST_IN_ALL * usual else more


def stable(here: Ready, begin: Model) -> Ready | None:
    """The same recordings with steps that follow what fades fastest in the model `begin`; None if
    they do already.

    **Raises:** `FitError` if that would take more than a few times as many, or if nothing says how
    fast it fades.
    """
    if here.integrator is not None:
        return None
    rate = max(fastest(m) for m in here.posed(begin))
    step = here.duration / here.steps(begin)
    if not rate * step > _STABLE:
        return None
    if not math.isfinite(rate):
        words = not_finite_at_rest(begin)
        raise FitError(f"no start led to a motion that could be: {words}")
    times = math.ceil(2 * rate * step / _STABLE)
    if times > MOST_AT_ONCE:
        raise FitError(
            f"the integration steps, {step:.2g} s, are too coarse for this model, whose fastest "
            f'time constant is {1 / rate:.2g} s: write solver = "Kvaerno5" under [integrator], '
            "which is made for stiff effects"
        )
    return here._replace(finer=here.finer * times)


def checked(fit: Fit) -> tuple[float, str]:
    """The integration error of a fit's readings against a reference, in times the noise, and the
    reference in words: diffrax's Dopri8 at rtol = 1e-10, or, with dry friction or a slipping brake,
    which it cannot integrate, sixteen times as many steps. Call it in float64.

    The motion begins in the fitted initial states, so that nothing but the integration differs.
    """
    sticks = fit.model.dry or fit.model.follows
    # Twice the nodes for the reference's curve, so that none of the difference is the curve's.
    here = fit.ready._replace(
        integrator=None if sticks else _REFERENCE,
        finer=fit.ready.finer * (_FINEST if sticks else 2),
    )
    problem, _ = here.problem(fit.model, [r.wild for r in fit.fitted])
    numbers, states = fit.problem.numbers(fit.unknowns), fit.problem.states(fit.unknowns)
    predicted = eqx.filter_jit(predictions)
    found = np.asarray(predicted(problem, jnp.asarray(numbers), jnp.asarray(states)))
    error = rms_over_noise(found, fit.fitted)
    words = f"{_FINEST} times the steps" if sticks else "Dopri8 at rtol 1e-10"
    return error, words
