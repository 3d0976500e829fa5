"""`residyn simulate`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._input import InputError, number
from . import _options
from ._experiment import fitted, input_files, load
from ._shell import DONE, NO_NUMBERS, NoNumbers, complain, console, progress, set_up_jax

if TYPE_CHECKING:
    import numpy as np

    from ..model import Model
    from ..recording import Experiment, Recording

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
        help="Where to begin, rad (or m), as 0.25,-0.3; one number per joint.",
        show_default=False,
    ),
]
_V0 = Annotated[
    str | None,
    typer.Option(
        "--v0",
        metavar="RATES",
        help="Rates to begin with, rad/s (or m/s); one number per joint.",
        show_default=False,
    ),
]


def simulate(
    experiment: _options.Experiment,
    effects: _options.With = None,
    values: _Set = None,
    out: _Out = "simulated",
    noise: _Noise = 0.0,
    seed: _Seed = 0,
    q0: _Q0 = None,
    v0: _V0 = None,
    starts: _options.Starts = _options.STARTS,
    no_cache: _options.NoCache = False,
) -> None:
    """Write what a model predicts: one CSV per recording of the experiment, at its times."""
    if not 0 <= noise < float("inf"):
        raise InputError(f"--noise {noise:g}: must be a number from 0 up (rad or m)")
    numbers = _numbers(values or [])
    set_up_jax(not no_cache)
    loaded = load(experiment)
    begin = tuple(_per_joint(o, w, loaded) for o, w in (("--q0", q0), ("--v0", v0)))
    # Driven recordings of step 1 have their brakes off: springs and dampers say nothing of them.
    shown = [r for r in loaded.recordings if r.role != "inertia"]
    if not shown:
        raise InputError(f"{experiment}: has no recording of braked motion to simulate")
    paths = _paths(Path(out), shown, input_files(experiment, loaded))
    say = console(stderr=True)
    if numbers:
        predicted = _set(loaded, shown, effects or [], numbers, begin)
        if begin[0] is None or begin[1] is None:
            taken = " and ".join(
                words
                for words, given in (
                    ("angles from the first readings, smoothed", begin[0]),
                    ("at rest", begin[1]),
                )
                if given is None
            )
            say.print(f"beginning with {taken} (--q0 and --v0 give others)", soft_wrap=True)
        status = DONE
    else:
        result = fitted(loaded, effects or [], starts)
        say.print(str(result), soft_wrap=True)
        by_recording = {id(r.recording): r for r in result.recordings}
        predicted = [by_recording[id(r)].predicted for r in shown]
        if begin != (None, None):
            n = len(loaded.joints)
            states = [by_recording[id(r)].state for r in shown]
            predicted = [
                _run(result.model, loaded, r, _or(begin[0], s[:n]), _or(begin[1], s[n:]))
                for r, s in zip(shown, states, strict=True)
            ]
        status = DONE if result.converged else complain(result.reason, NO_NUMBERS)
    _write(paths, shown, predicted, noise, seed)
    for path, recording in zip(paths, shown, strict=True):
        print(f"{path}: {len(recording.time)} samples as in {recording.name}")
    raise typer.Exit(status)


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

    parts = words.split(",")
    joints = experiment.joints
    if len(parts) != len(joints):
        raise InputError(
            f"{option} {words}: must be {len(joints)} number{'s' * (len(joints) > 1)} separated by "
            f"commas, for {', '.join(joints)}"
        )
    return np.array([_float(option, part) for part in parts])


def _or(given: "np.ndarray | None", otherwise: "np.ndarray") -> "np.ndarray":
    return otherwise if given is None else given


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
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be made ({error.strerror})") from None
    return paths


def _set(
    experiment: "Experiment",
    recordings: "Sequence[Recording]",
    effects: Sequence[str],
    numbers: dict[str, float],
    begin: "Sequence[np.ndarray | None]",
) -> "list[np.ndarray]":
    """The motion with numbers given by the user."""
    from ..fit import mechanism_of, model_for

    try:
        model = model_for(mechanism_of(experiment, recordings[0]), effects)
    except ValueError as error:
        raise InputError(str(error)) from None
    fitted = [n.name for n in model.fitted]
    known = [n.name for n in model.numbers]
    for name in numbers:
        if name not in known:
            effect = name.rpartition(".")[0]
            hint = "" if effect in model.labels or not effect else f"; add --with {effect}?"
            raise InputError(
                f"--set {name}: the model has no such number{hint} (it has {', '.join(known)})"
            )
    missing = [name for name in fitted if name not in numbers]
    if missing:
        raise InputError(
            f"--set: {', '.join(missing)} not set; set all numbers, or none to have them fitted"
        )
    model = model.with_values(numbers)
    predicted = []
    for recording in recordings:
        v0 = _or(begin[1], recording.angle[0] * 0.0) if begin[1] is not None else None
        rates = v0 if v0 is not None else [0.0] * len(experiment.joints)
        angles = begin[0] if begin[0] is not None else _first(model, experiment, recording, rates)
        predicted.append(_run(model, experiment, recording, angles, rates))
    return predicted


def _first(model: "Model", experiment: "Experiment", recording: "Recording", rates):
    """Angles at the first instant: a parabola of the known slope through the first readings."""
    import numpy as np

    from ..fit import mechanism_of
    from ..fit.problem import posed
    from ..simulate import fastest

    time = recording.time - recording.time[0]
    # Up to here, a swing at the fastest mode is a parabola within 0.3 %.
    window = 0.5 / max(fastest(posed(model, mechanism_of(experiment, recording))), 1e-9)
    angles = []
    for joint, rate in enumerate(rates):
        seen = np.flatnonzero(np.isfinite(recording.angle[:, joint]))
        use = seen[: max(5, int(np.searchsorted(time[seen], window)))]
        t, q = time[use], recording.angle[use, joint] - rate * time[use]
        size = t[-1] or 1.0
        columns = np.stack([np.ones_like(t), (t / size) ** 2], axis=1)
        angles.append(np.linalg.lstsq(columns, q, rcond=None)[0][0])
    return np.array(angles)


def _run(model: "Model", experiment: "Experiment", recording: "Recording", q0, v0) -> "np.ndarray":
    """The motion of one recording's bodies at its times."""
    import numpy as np

    from ..fit import mechanism_of
    from ..fit.problem import posed
    from ..simulate import Drive, simulate

    time, drive = recording.time, None
    if recording.drive is not None:
        grid = np.linspace(time[0], time[-1], len(time))
        values = np.stack([np.interp(grid, time, u) for u in recording.drive.T], axis=1)
        drive = Drive(grid[0], grid[1] - grid[0], values)
    with progress() as say:
        say(f"simulating {recording.name}")
        here = posed(model, mechanism_of(experiment, recording))
        motion = np.asarray(simulate(here, time, q0, v0, drive=drive).q)
    if not np.isfinite(motion).all():
        raise NoNumbers(f"{recording.name}: with these numbers the motion runs away")
    return motion


def _write(
    paths: Sequence[Path],
    recordings: "Sequence[Recording]",
    predicted: "Sequence[np.ndarray]",
    noise: float,
    seed: int,
) -> None:
    import numpy as np

    from .._csv import write_csv

    random = np.random.default_rng(seed)
    for path, recording, angle in zip(paths, recordings, predicted, strict=True):
        if noise:
            angle = angle + noise * random.standard_normal(angle.shape)
        write_csv(path, recording.time, angle, recording.drive)
