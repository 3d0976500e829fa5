"""Step 3 of the paper: the vibration in orbit, where no air bearings are (Eq. 5, 18 to 20).

Eq. 5 takes the bearings' masses off the inertias. That mends the frequencies; the decay it leaves
wrong, since whatever drag and friction the bearings have was fitted as damping of the joints. An
effect of the bearings that is named in the fit (`bearing_drag`, say) is taken off with them.
"""

import dataclasses
import inspect
import time
from collections.abc import Callable, Sequence

import jax
import numpy as np

from ..diagnosis import Diagnosis
from ..effects import AbstractEffect, catalogue
from ..errors import InputError
from ..fitting import DEFAULT_STARTS, Fit, FitError, RecordingFit, fit, mechanism_of
from ..fitting.problem import ready
from ..physics.effect import BASE
from ..physics.model import Model
from ..recordings.experiment import Experiment, must_be_experiment
from ..recordings.recording import Recording
from ..recordings.tables import ArmTable
from .carried import NAMES, Carried, carried, modes_with_errors
from .inertia import inertia
from .over_models import bare, over_models
from .result import InertiaResult
from .unloaded import BareCheck, Pose, Unloading


def unload(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
    inertia_std: Sequence[float] | np.ndarray | None = None,
    diagnosis: Diagnosis | None = None,
    progress: Callable[[str], None] | None = None,
) -> Unloading:
    """Fit an arm on its air bearings, and take the bearings off: inertia, drag and friction.

    Runs in float64 whatever JAX's setting. Fitted recordings may be with and without bearings, at
    any elbow angles, together. Recordings with `role = "check"` that were taken without bearings
    score the prediction.

    **Arguments:**

    - `experiment`: from `residyn.load`, with an `[arm]` and its `[[air_bearings]]`.
    - `effects`, `starts`, `progress`: as in `residyn.fit`.
    - `inertia_std`: what step 1 leaves uncertain in shoulder, elbow (kg m^2) and coupling (kg m),
      bearings on: (3,) standard errors, or their (3, 3) covariance. If not given, that of the
      experiment's own recordings with `role = "inertia"`; without those the inertias are exact.
    - `diagnosis`: of this experiment, from `residyn.diagnose`. Then the model is its likeliest one,
      and `over_models` of the result has the modes without bearings over all models in play.

    **Returns:** an `Unloading`.

    **Raises:** `InputError` (a `ValueError`) if there are no bearings to take off; `FitError`,
    `TypeError` and `ValueError` as `residyn.fit` does.
    """
    began = time.perf_counter()
    say = progress or (lambda words: None)
    own = effects if diagnosis is None else _own(diagnosis.fit.model)
    given = check_unload(experiment, own, inertia_std, diagnosed=diagnosis is not None)
    if diagnosis is not None and (diagnosis.search is None or diagnosis.fits.whole != experiment):
        raise ValueError("this diagnosis is of another experiment, or has not kept its search")
    with jax.enable_x64(True):
        if diagnosis is None:
            fitted = fit(experiment, effects=effects, starts=starts, progress=say)
        else:
            fitted = diagnosis.fit
        left = [e.label for e in fitted.model.effects if not e.of_bearings]
        if steep := [label for label in left if label in fitted.infinite_slopes]:
            raise FitError(
                f"the slope of {', '.join(steep)} is infinite at rest: there are no modes, with "
                "bearings or without"
            )
        step_1 = None if given is not None else _step_1(experiment, say)
        covariance = step_1.covariance if isinstance(step_1, InertiaResult) else given
        say("carrying the errors over")
        errors = carried(fitted, covariance)
        at = _poses(experiment)
        poses = tuple(_pose(fitted, r, errors) for r in at)
        over = None
        if diagnosis is not None and diagnosis.search:
            over = over_models(diagnosis.search, experiment, covariance, at, say)
        checks = []
        for beside in fitted.held_out:
            if not beside.recording.air_bearings:
                say(f"fitting {beside.recording.name} alone, to compare")
                checks.append(_check_against(fitted, beside, errors, starts))
    return Unloading(
        fit=fitted,
        poses=poses,
        left_out=tuple(e.label for e in fitted.model.effects if e.of_bearings),
        check=tuple(checks),
        inertia_covariance=covariance,
        errors=errors,
        over_models=over,
        step_1=step_1,
        seconds=time.perf_counter() - began,
    )


def check_unload(
    experiment: Experiment,
    effects: Sequence[str | AbstractEffect] = (),
    inertia_std: Sequence[float] | np.ndarray | None = None,
    diagnosed: bool = False,
) -> np.ndarray | None:
    """What step 3 must be given, before the long work.

    **Arguments:** as of `unload`; `diagnosed`: whether any effect of the catalogue may join.

    **Returns:** the covariance (3, 3) of the inertias, if that is given.

    **Raises:** `InputError`, one line, if there is nothing to take off, or an effect does not say
    whether it leaves with the bearings; `ValueError` for one that does not go with the experiment;
    `TypeError` for what is no experiment.
    """
    must_be_experiment(experiment)
    if not isinstance(experiment.inertia, ArmTable):
        raise InputError(
            "step 3 takes air bearings off an [arm]; the mass matrix of an [inertia] table has none"
        )
    if not experiment.bearings:
        raise InputError(
            "there is no [[air_bearings]] table: step 3 needs the joint, mass and inertia of every "
            "bearing that it is to take off (Eq. 5)"
        )
    if not any(r.air_bearings for r in experiment.fit_recordings):
        raise InputError(
            'no recording with role = "fit" was taken with the air bearings on: there is nothing '
            "to take off"
        )
    with jax.enable_x64(True):
        model = ready(experiment, experiment.fit_recordings, effects).model
    for kind in [*map(type, model.effects), *(catalogue().values() if diagnosed else ())]:
        if kind.of_bearings is None:
            raise InputError(
                f"{kind.name}: is it of the air bearings or of the joint? Write of_bearings = "
                "True (it leaves with the bearings) or False (it stays) in class "
                f"{kind.__name__}, {inspect.getsourcefile(kind)}"
            )
    return None if inertia_std is None else _covariance(inertia_std)


def _own(model: Model) -> list[AbstractEffect]:
    """The effects beside springs and dampers."""
    return [e for e in model.effects if e.name not in BASE]


def _covariance(std: Sequence[float] | np.ndarray) -> np.ndarray:
    """(3, 3), from standard errors (3,) or as it is. **Raises:** `InputError`."""
    given = np.asarray(std, float)
    square = np.diag(given**2) if given.shape == (3,) else given
    valid = (
        square.shape == (3, 3) and np.isfinite(square).all() and (given.ndim > 1 or min(given) >= 0)
    )
    if not valid or np.linalg.eigvalsh(square).min() < -1e-9 * np.trace(square):
        raise InputError(
            f"inertia_std = {np.array2string(given, separator=', ')}: must be the standard errors "
            f"of {', '.join(NAMES)}, three numbers from 0 up, or their covariance, 3 by 3"
        )
    return square


def _step_1(experiment: Experiment, say: Callable) -> InertiaResult | str | None:
    """Step 1 from the experiment's own driven tests, if it has any; or why it cannot be done."""
    if not any(r.role == "inertia" for r in experiment.recordings):
        return None
    say("step 1, for the errors of the inertias")
    try:
        return inertia(experiment)
    except (InputError, FitError) as error:
        return str(error)


def _poses(experiment: Experiment) -> list[Recording]:
    """One fitted recording of each elbow angle, in order."""
    found: list[Recording] = []
    for each in experiment.fit_recordings:
        if not any(abs(each.theta2 - other.theta2) < 1e-9 for other in found):
            found.append(each)
    return found


def _pose(fitted: Fit, recording: Recording, errors: Carried) -> Pose:
    mechanism = mechanism_of(fitted.experiment, dataclasses.replace(recording, air_bearings=True))
    on = dataclasses.replace(fitted.model, mechanism=mechanism)
    off = bare(fitted.experiment, fitted.model, recording)
    loaded, free = (modes_with_errors(model, fitted.model, errors) for model in (on, off))
    return Pose(
        theta2=recording.theta2,
        model=on,
        unloaded=off,
        with_bearings=loaded.modes,
        without_bearings=free.modes,
        leaves_with=loaded.leaves,
        leaves_without=free.leaves,
    )


def _check_against(fitted: Fit, beside: RecordingFit, errors: Carried, starts: int) -> BareCheck:
    """One recording without bearings: predicted, and what a fit of it alone finds."""
    recording = beside.recording
    off = bare(fitted.experiment, fitted.model, recording)
    alone = dataclasses.replace(recording, role="fit")
    experiment = dataclasses.replace(fitted.experiment, recordings=(alone,))
    try:
        free = fit(experiment, effects=_own(off), starts=starts)
    except FitError:
        free = None
    return BareCheck(beside, modes_with_errors(off, fitted.model, errors).modes, free)
