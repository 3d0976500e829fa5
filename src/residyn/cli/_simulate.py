"""`residyn simulate`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..errors import InputError, inside
from ..files import check_folder, make_folder
from . import _options
from ._shell import NoNumbers, console
from ._work import Work, computing, float_of, floats_of, input_files, must_stand

if TYPE_CHECKING:
    import numpy as np

    from ..physics.model import Model
    from ..recordings.experiment import Experiment
    from ..recordings.recording import Recording

_SET = _options.option(
    "--set NAME=VALUE",
    "A number of the model, as spring:elbow.stiffness=16.7. May be repeated. Set all or "
    "none: without any, they are fitted first.",
)
_OUT = _options.option("--out FOLDER", "Where the recordings go.")
_NOISE = _options.number("--noise SIGMA", "Gaussian noise to add, rad (or m).")
_SEED = _options.number("--seed N", "Which noise.")
_Q0 = _options.option(
    "--q0 ANGLES", "Where to begin, rad (or m): one number per joint, as 0.25,-0.3."
)
_V0 = _options.option("--v0 RATES", "Rates to begin with, rad/s (or m/s): one number per joint.")


def simulate(
    experiment: _options.Experiment,
    effects: _options.With = None,
    own: _options.Effects = None,
    values: Annotated[list[str] | None, _SET] = None,
    out: Annotated[str, _OUT] = "simulated",
    noise: Annotated[float, _NOISE] = 0.0,
    seed: Annotated[int, _SEED] = 0,
    q0: Annotated[str | None, _Q0] = None,
    v0: Annotated[str | None, _V0] = None,
    starts: _options.Starts = _options.STARTS,
    integrator: _options.Integrator = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Write predicted recordings, one CSV file each."""
    numbers: dict[str, float] = {}
    for each in values or []:
        name, equals, value = (part.strip() for part in each.rpartition("="))
        if not equals or not name:
            raise InputError(f"--set {each}: must be NAME=VALUE, as spring:elbow.stiffness=16.7")
        if name in numbers:
            raise InputError(f"--set {each}: {name} is set twice")
        numbers[name] = float_of(f"--set {name}", value)
    loaded = Work().begin(experiment, own, no_cache, integrator, {"--with": effects or []})
    import numpy as np

    from ..fitting import fit, mechanism_of
    from ..fitting.problem import first_state, posed
    from ..physics.modal import fastest
    from ..recordings.csv import write_csv

    angles = None if q0 is None else np.array(floats_of("--q0", q0, loaded.joints))
    rates = None if v0 is None else np.array(floats_of("--v0", v0, loaded.joints))
    # Driven recordings of step 1 have their brakes off: springs and dampers say nothing of them.
    shown = [r for r in loaded.recordings if r.role != "inertia"]
    if not shown:
        raise InputError(f"{experiment}: has no recording of braked motion to simulate")
    paths = _paths(Path(out), shown, input_files(experiment, loaded, own))
    words, fitted, predicted = console(stderr=True), None, []
    if numbers:
        with computing() as say:
            model = _model_with(loaded, shown, effects or [], numbers)
            for r in shown:
                say(f"simulating {r.name}")
                here = posed(model, mechanism_of(loaded, r))
                begin = np.zeros(r.joints) if rates is None else rates
                read = first_state(r, r.outliers, max(fastest(here), 1e-9))[: r.joints]
                first = read if angles is None else angles
                predicted.append(_motion(here, r, loaded.integrator, first, begin))
        taken = {} if angles is not None else {"--q0": "angles from the first readings, smoothed"}
        taken |= {} if rates is not None else {"--v0": "rates of zero"}
        if taken:
            give = f"{' and '.join(taken)} give{'s' * (len(taken) == 1)} others"
            words.print(f"begins with {' and '.join(taken.values())}; {give}")
    else:
        with computing() as say:
            fitted = fit(loaded, effects=effects or [], starts=starts, progress=say)
        words.print(str(fitted), soft_wrap=True)
        with computing() as say:
            # Warned of, a recording is another object: they are told by their times.
            beside = {id(f.recording.time): f for f in fitted.whole}
            for r in shown:
                say(f"simulating {r.name}")
                found = beside[id(r.time)]
                if angles is None and rates is None:
                    predicted.append(found.predicted)
                    continue
                q, v, memory = np.split(found.state, [r.joints, 2 * r.joints])
                first, begin = q if angles is None else angles, v if rates is None else rates
                here = posed(fitted.model, mechanism_of(loaded, r))
                predicted.append(_motion(here, r, loaded.integrator, first, begin, memory))
    random = np.random.default_rng(seed)
    with inside("--out"):
        make_folder(Path(out))
    for path, r, angle in zip(paths, shown, predicted, strict=True):
        if noise:
            angle = angle + noise * random.standard_normal(angle.shape)
        write_csv(path, r.time, angle, r.drive)
        print(f"{path}: {len(r.time)} samples, at the times of {r.name}")
    if fitted is not None:
        must_stand(fitted)


def _model_with(
    experiment: "Experiment",
    shown: "Sequence[Recording]",
    effects: Sequence[str],
    numbers: dict[str, float],
) -> "Model":
    """The springs, dampers and effects of a fit, with all their numbers as given."""
    from ..fitting.problem import ready

    model = ready(experiment, shown, effects).model
    known = [n.name for n in model.numbers if n.acts]
    for name in numbers:
        if name not in known:
            effect = name.partition(".")[0]
            hint = f"; add --with {effect}?" if effect and effect not in model.labels else ""
            raise InputError(
                f"--set {name}: the model has no such number{hint} (it has {', '.join(known)})"
            )
    missing = [n.name for n in model.fitted if n.acts and n.name not in numbers]
    if missing:
        raise InputError(
            f"--set: {', '.join(missing)} not set; set all numbers, or none to have them fitted"
        )
    return model.with_values(numbers)


def _motion(
    here: "Model",
    recording: "Recording",
    integrator: Any,
    angles: "np.ndarray",
    rates: "np.ndarray",
    memory: "np.ndarray | None" = None,
) -> "np.ndarray":
    """Readings (N, n) of a model under the drive of one recording, at its times."""
    import numpy as np

    from ..simulation.simulate import Drive, simulate

    time, drive = recording.time - recording.time[0], None
    if recording.drive is not None:
        grid = np.linspace(time[0], time[-1], len(time))
        values = np.stack([np.interp(grid, time, u) for u in recording.drive.T], axis=1)
        drive = Drive(grid[0], grid[1] - grid[0], values)
    how = {"z0": memory, "drive": drive, "integrator": integrator, "orders": recording.orders}
    found = np.asarray(simulate(here, time, angles, rates, **how).readings)
    if not np.isfinite(found).all():
        raise NoNumbers(f"{recording.name}: with these numbers the motion runs away")
    return found


def _paths(folder: Path, recordings: "Sequence[Recording]", inputs: Sequence[Path]) -> list[Path]:
    """One file per recording, named as it is; none of them an input."""
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
        check_folder(folder)
    return paths
