"""How exact the integration was: the fitted motion once more, at twice the steps.

Integration steps of length h leave an error that falls as a power of h, the fifth for a smooth
model. So the motion at twice the steps is so much nearer to the true one that its difference from
the motion of the fit *is* the fit's integration error, to a few per cent (where dry friction costs
the steps some of their order, to a third). It is given in times the noise of one reading, rms over
the readings of the worst joint: what is small beside the noise cannot be seen in the numbers.

A solver that chooses its steps takes them from its tolerances, which are made tighter as well.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..physics.modal import fastest
from ..physics.model import Model
from ..recordings.recording import Recording
from ..simulation.integrator import Integrator
from .layout import drives
from .least_squares import over_recordings, predict, predicted_at
from .problem import Problem, Ready, Unknowns, ready
from .result import Fit, FitError

TENTH = 0.1
"""Times the noise, beyond which an integration error is worth a warning."""
_TIGHTER = 2.0**5
# Refined steps are to leave this share of the noise; no more than so many times as many are taken.
_AIM, _MOST = 0.02, 8
_ORDER, _ROUGH_ORDER = 5.0, 2.0
# What a fit is checked against: this solver, or, where joints stick, so many times its own steps.
_REFERENCE = Integrator("Dopri8", rtol=1e-10, atol=1e-13)
_FINEST = 16
# Tsitouras' stages damp nothing that fades within less than a third of a step.
_STABLE = 3.0


def integration_error(
    problem: Problem,
    unknowns: Unknowns,
    predicted: np.ndarray,
    recordings: Sequence[Recording],
    wild: Sequence[np.ndarray],
    evaluate: Callable[[Problem, Unknowns], Any] = predicted_at,
) -> Callable[[], float]:
    """Integration error of readings (R, N, n) predicted at these unknowns, in times the noise; inf
    where twice the steps lead to no finite motion. `evaluate` predicts the same readings.

    The motion at twice the steps is begun here, and awaited where the result is called.
    """
    found = evaluate(finer(problem, recordings), unknowns)

    def awaited() -> float:
        total, count = np.zeros(predicted.shape[-1]), 0
        rows = zip(predicted, np.asarray(found), recordings, wild, strict=True)
        for own, other, recording, bad in rows:
            seen = np.isfinite(recording.angle) & ~bad
            off = (other - own)[: len(seen)] / recording.noise
            total += np.sum(off**2, axis=0, where=seen)
            count += seen.sum(axis=0)
        error = np.sqrt(np.max(total / np.maximum(count, 1)))
        return float(error) if np.isfinite(error) else math.inf

    return awaited


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
    tighter = None if problem.tighter is None else _TIGHTER * np.asarray(problem.tighter)
    return dataclasses.replace(problem, recorded=recorded, steps=np.asarray(steps), tighter=tighter)


def refined(here: Ready, error: float) -> Ready:
    """The same recordings with so many more steps that this integration error would have been
    small."""
    order = _ROUGH_ORDER if here.model.rough else _ORDER
    times = (error / _AIM) ** (1 / order) if math.isfinite(error) else _MOST
    return here._replace(finer=here.finer * min(max(2, math.ceil(times)), _MOST))


def stable(here: Ready, begin: Model) -> Ready | None:
    """The same recordings with steps that follow what fades fastest in the model `begin`; None if
    they do already.

    **Raises:** `FitError` if that would take more than a few times as many.
    """
    if here.integrator is not None:
        return None
    rate = max(fastest(m) for m in here.posed(begin))
    step = max(r.duration for r in here.recordings) / here.steps(begin)
    if not rate * step > _STABLE:
        return None
    times = math.ceil(2 * rate * step / _STABLE)
    if times > _MOST:
        raise FitError(
            f"the integration steps, {step:.2g} s, are too coarse for this model, whose fastest "
            f"time constant is {1 / rate:.2g} s: integrate it with --integrator Kvaerno5, which "
            "is made for stiff effects"
        )
    return here._replace(finer=here.finer * times)


def checked(fit: Fit) -> tuple[float, str]:
    """The integration error of a fit's readings against a reference, in times the noise, and the
    reference in words: diffrax's Dopri8 at rtol = 1e-10, or, with dry friction or a slipping brake,
    which it cannot integrate, sixteen times as many steps. Call it in float64.

    The motion begins in the fitted initial states, so that nothing but the integration differs.
    """
    fitted = [r for r in fit.recordings if r.recording.role != "check"]
    effects = [e for e in fit.model.effects if e.name not in ("spring", "damper")]
    here = ready(fit.experiment, [r.recording for r in fitted], effects)
    sticks = fit.model.dry or fit.model.follows
    usual = max(1, round(fit.integration_steps / here.steps(fit.model) * here.finer))
    # Twice the nodes for the reference's curve, so that none of the difference is the curve's.
    here = here._replace(
        integrator=None if sticks else _REFERENCE, finer=usual * (_FINEST if sticks else 2)
    )
    problem, _ = here.problem(fit.model, [r.wild for r in fitted])
    states = jnp.asarray(np.stack([r.state for r in fitted]))
    found = np.asarray(_predicted(problem, jnp.asarray(fit.model.vector()), states))
    longest = found.shape[1]
    own = [np.pad(r.predicted, ((0, longest - len(r.predicted)), (0, 0))) for r in fitted]
    y = problem.scaled(np.asarray(fit.model.vector()), np.asarray(states))
    error = integration_error(
        problem,
        y,
        np.stack(own),
        [r.recording for r in fitted],
        [r.wild for r in fitted],
        lambda *_: found,
    )
    words = f"{_FINEST} times the steps" if sticks else "Dopri8 at rtol 1e-10"
    return error(), words


@eqx.filter_jit
def _predicted(problem: Problem, numbers, states):
    def one(recorded, state):
        return predict(problem, recorded, numbers, state)

    return over_recordings(one, problem.model)(problem.recorded, states)
