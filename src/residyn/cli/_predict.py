"""Motions of a model at the times of an experiment's recordings."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ._shell import NoNumbers

if TYPE_CHECKING:
    from ..physics.model import Model
    from ..recordings.experiment import Experiment
    from ..recordings.recording import Recording


def model_with(
    experiment: "Experiment", effects: Sequence[str], numbers: dict[str, float]
) -> "Model":
    """The springs, dampers and effects, with all their numbers as given.

    **Raises:** `InputError` for an effect or a number that there is not, or a number left out.
    """
    from ..fitting import mechanism_of, model_for

    try:
        model = model_for(mechanism_of(experiment, experiment.recordings[0]), effects)
        if experiment.integrator is not None:
            experiment.integrator.check(model)
    except ValueError as error:
        raise InputError(str(error)) from None
    known = [n.name for n in model.numbers]
    for name in numbers:
        if name not in known:
            effect = name.rpartition(".")[0]
            hint = f"; add --with {effect}?" if effect and effect not in model.labels else ""
            raise InputError(
                f"--set {name}: the model has no such number{hint} (it has {', '.join(known)})"
            )
    missing = [n.name for n in model.fitted if n.name not in numbers]
    if missing:
        raise InputError(
            f"--set: {', '.join(missing)} not set; set all numbers, or none to have them fitted"
        )
    return model.with_values(numbers)


def first_angles(
    model: "Model", experiment: "Experiment", recording: "Recording", rates: np.ndarray
) -> np.ndarray:
    """Angles at the first instant: a parabola of the known slope through the first readings."""
    from ..physics.modal import fastest

    recording = recording.as_angles
    time = recording.time - recording.time[0]
    # Up to here, a swing at the fastest mode is a parabola within 0.3 %.
    window = 0.5 / max(fastest(_posed(model, experiment, recording)), 1e-9)
    angles = []
    for joint, rate in enumerate(rates):
        seen = np.flatnonzero(np.isfinite(recording.angle[:, joint]))
        use = seen[: max(5, int(np.searchsorted(time[seen], window)))]
        t, q = time[use], recording.angle[use, joint] - rate * time[use]
        columns = np.stack([np.ones_like(t), (t / (t[-1] or 1.0)) ** 2], axis=1)
        angles.append(np.linalg.lstsq(columns, q, rcond=None)[0][0])
    return np.array(angles)


def motion(
    model: "Model",
    experiment: "Experiment",
    recording: "Recording",
    angles: np.ndarray,
    rates: np.ndarray,
    memory: np.ndarray | None = None,
) -> np.ndarray:
    """Readings (N, n) of the bodies and under the drive of one recording, at its times.

    **Raises:** `NoNumbers` if the motion runs away.
    """
    import jax.numpy as jnp

    from ..simulation.simulate import Drive, simulate

    time, drive = recording.time - recording.time[0], None
    if recording.drive is not None:
        grid = np.linspace(time[0], time[-1], len(time))
        values = np.stack([np.interp(grid, time, u) for u in recording.drive.T], axis=1)
        drive = Drive(grid[0], grid[1] - grid[0], jnp.asarray(values))
    here = _posed(model, experiment, recording)
    begin = jnp.asarray(angles), jnp.asarray(rates)
    path = simulate(
        here,
        jnp.asarray(time),
        *begin,
        z0=memory,
        drive=drive,
        integrator=experiment.integrator,
        orders=recording.orders,
    )
    found = np.asarray(path.readings)
    if not np.isfinite(found).all():
        raise NoNumbers(f"{recording.name}: with these numbers the motion runs away")
    return found


def _posed(model: "Model", experiment: "Experiment", recording: "Recording") -> "Model":
    from ..fitting import mechanism_of
    from ..fitting.problem import posed

    return posed(model, mechanism_of(experiment, recording))
