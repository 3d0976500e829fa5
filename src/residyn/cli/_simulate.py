"""`residyn simulate`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError, inside, number
from ..files import make_folder
from . import _options
from ._experiment import bring, fitted, input_files, integrated_by, load
from ._shell import DONE, NO_NUMBERS, complain, console, progress, set_up_jax

if TYPE_CHECKING:
    import numpy as np

    from ..recordings.experiment import Experiment
    from ..recordings.recording import Recording

_Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A number of the model, as spring:elbow.stiffness=16.7. May be repeated. Set all or "
        "none: without any, they are fitted first.",
        show_default=False,
    ),
]
_Out = Annotated[str, typer.Option("--out", metavar="FOLDER", help="Where the recordings go.")]
_Noise = Annotated[
    float, typer.Option("--noise", metavar="SIGMA", help="Gaussian noise to add, rad (or m).")
]
_Seed = Annotated[int, typer.Option("--seed", metavar="N", help="Which noise.", min=0)]
_Q0 = Annotated[
    str | None,
    typer.Option(
        "--q0",
        metavar="ANGLES",
        help="Where to begin, rad (or m): one number per joint, as 0.25,-0.3.",
        show_default=False,
    ),
]
_V0 = Annotated[
    str | None,
    typer.Option(
        "--v0",
        metavar="RATES",
        help="Rates to begin with, rad/s (or m/s): one number per joint.",
        show_default=False,
    ),
]


def simulate(
    experiment: _options.Experiment,
    effects: _options.With = None,
    own: _options.Effects = None,
    values: _Set = None,
    out: _Out = "simulated",
    noise: _Noise = 0.0,
    seed: _Seed = 0,
    q0: _Q0 = None,
    v0: _V0 = None,
    starts: _options.Starts = _options.STARTS,
    integrator: _options.Integrator = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Write predicted recordings, one CSV file each."""
    if not 0 <= noise < float("inf"):
        raise InputError(f"--noise {noise:g}: must be a number from 0 up (rad or m)")
    numbers = _numbers(values or [])
    set_up_jax(not no_cache)
    bring(own)
    loaded = integrated_by(load(experiment), integrator)
    angles, rates = _per_joint("--q0", q0, loaded), _per_joint("--v0", v0, loaded)
    # Driven recordings of step 1 have their brakes off: springs and dampers say nothing of them.
    shown = [r for r in loaded.recordings if r.role != "inertia"]
    if not shown:
        raise InputError(f"{experiment}: has no recording of braked motion to simulate")
    paths = _paths(Path(out), shown, input_files(experiment, loaded))
    words, status = console(stderr=True), DONE
    if numbers:
        predicted = _with_numbers(loaded, shown, effects or [], numbers, angles, rates)
        taken = [] if angles is not None else ["angles from the first readings, smoothed"]
        taken += [] if rates is not None else ["rates of zero"]
        if taken:
            words.print(f"begins with {' and '.join(taken)}; --q0 and --v0 give others")
    else:
        result = fitted(loaded, effects or [], starts)
        words.print(str(result), soft_wrap=True)
        if not result.stands:
            status = complain(result.reason, NO_NUMBERS)
        predicted = _with_fit(result, shown, angles, rates)
    _write(paths, shown, predicted, noise, seed)
    for path, recording in zip(paths, shown, strict=True):
        print(f"{path}: {len(recording.time)} samples, at the times of {recording.name}")
    raise typer.Exit(status)


def _with_numbers(experiment, recordings, effects, numbers, angles, rates) -> "list[np.ndarray]":
    """The motion with numbers that the user gave."""
    with progress() as say:
        say("loading")
        import numpy as np

        from ._predict import first_angles, model_with, motion

        model = model_with(experiment, effects, numbers)
        v0 = np.zeros(len(experiment.joints)) if rates is None else rates
        found = []
        for recording in recordings:
            say(f"simulating {recording.name}")
            q0 = first_angles(model, experiment, recording, v0) if angles is None else angles
            found.append(motion(model, experiment, recording, q0, v0))
        return found


def _with_fit(fit, recordings, angles, rates) -> "list[np.ndarray]":
    """The motion with the numbers of a fit, from its own initial states unless others are given."""
    from ._predict import motion

    # Warned of, a recording is another object: they are told by their times.
    beside = {id(r.recording.time): r for r in fit.whole}
    if angles is None and rates is None:
        return [beside[id(r.time)].predicted for r in recordings]
    n = len(fit.experiment.joints)
    found = []
    with progress() as say:
        for recording in recordings:
            say(f"simulating {recording.name}")
            state = beside[id(recording.time)].state
            q0 = state[:n] if angles is None else angles
            v0 = state[n : 2 * n] if rates is None else rates
            found.append(motion(fit.model, fit.experiment, recording, q0, v0, state[2 * n :]))
    return found


def _numbers(words: Sequence[str]) -> dict[str, float]:
    """NAME=VALUE, each once."""
    found: dict[str, float] = {}
    for each in words:
        name, equals, value = each.partition("=")
        name = name.strip()
        if not equals or not name:
            raise InputError(f"--set {each}: must be NAME=VALUE, as spring:elbow.stiffness=16.7")
        if name in found:
            raise InputError(f"--set {each}: {name} is set twice")
        found[name] = _float(f"--set {name}", value)
    return found


def _float(key: str, words: str) -> float:
    try:
        value: float | str = float(words)
    except ValueError:
        value = words
    return number(key, value, "in SI units")


def _per_joint(option: str, words: str | None, experiment: "Experiment") -> "np.ndarray | None":
    """Numbers separated by commas, one per joint."""
    if words is None:
        return None
    import numpy as np

    parts, joints = words.split(","), experiment.joints
    if len(parts) != len(joints):
        many = f"{len(joints)} numbers separated by commas" if len(joints) > 1 else "one number"
        raise InputError(f"{option} {words}: must be {many}, for {', '.join(joints)}")
    return np.array([_float(option, part) for part in parts])


def _paths(folder: Path, recordings: "Sequence[Recording]", inputs: Sequence[Path]) -> list[Path]:
    """One file per recording, named as it is; none of them an input.

    **Raises:** `InputError`, before anything is written.
    """
    paths: list[Path] = []
    for recording in recordings:
        stem = Path(recording.name).stem or "recording"
        path, again = folder / f"{stem}.csv", 2
        while path in paths:
            path, again = folder / f"{stem}-{again}.csv", again + 1
        if any(path.resolve() == each.resolve() for each in inputs):
            raise InputError(f"{path}: is an input of this experiment; give --out another folder")
        paths.append(path)
    with inside("--out"):
        make_folder(folder)
    return paths


def _write(
    paths: Sequence[Path],
    recordings: "Sequence[Recording]",
    predicted: "Sequence[np.ndarray]",
    noise: float,
    seed: int,
) -> None:
    import numpy as np

    from ..recordings.csv import write_csv

    random = np.random.default_rng(seed)
    for path, recording, angle in zip(paths, recordings, predicted, strict=True):
        if noise:
            angle = angle + noise * random.standard_normal(angle.shape)
        write_csv(path, recording.time, angle, recording.drive)
