"""From an EXPERIMENT on the command line to a fit."""

import contextlib
import dataclasses
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError, inside
from ._shell import NoNumbers, progress

if TYPE_CHECKING:
    from ..diagnosis.result import Diagnosis
    from ..fitting.result import Fit
    from ..procedure import Unloading
    from ..recordings.experiment import Experiment


def load(path: str) -> "Experiment":
    """Read the experiment, and say on standard error what was made of a lab's own files.

    **Raises:** `InputError`.
    """
    with progress() as say:
        say("reading")
        from ..recordings.experiment import load as read_experiment

        loaded = read_experiment(path)
    for each in loaded.recordings:
        if each.understood:
            print(f"residyn: {each.name}: {each.understood}", file=sys.stderr)
    return loaded


def integrated_by(experiment: "Experiment", name: str | None) -> "Experiment":
    """The experiment with the integrator that the command line names, if it names one.

    **Raises:** `InputError` for one that does not exist.
    """
    if name is None:
        return experiment
    from ..simulation.integrator import Integrator

    with inside("--integrator"):
        return dataclasses.replace(experiment, integrator=Integrator(name))


def bring(files: Sequence[str] | None) -> None:
    """Add the effects of users' files to the catalogue.

    **Raises:** `InputError`.
    """
    if files:
        with progress() as say:
            say("loading")
            from ..effects import load_effects

            for file in files:
                load_effects(file)


def input_files(path: str, experiment: "Experiment") -> list[Path]:
    """Every file that was read, so that none of them is written over."""
    base = Path() if path == "-" else Path(path).parent
    files = [base / r.name for r in experiment.recordings]
    return files if path == "-" else [Path(path), *files]


def title(path: str) -> str:
    """What to call an experiment at the head of a page."""
    return "Experiment from standard input" if path == "-" else Path(path).name


def fitted(
    experiment: "Experiment",
    effects: Sequence[str],
    starts: int,
    method: str = "levenberg",
    check_integration: bool = False,
    seed: int = 0,
) -> "Fit":
    """Fit, and show on the way what is being done.

    **Raises:** `InputError` for effects that do not exist or do not go with the experiment, and for
    a method whose extra is not installed; `NoNumbers` if no start led anywhere.
    """
    with progress() as say:
        say("loading")
        from ..fitting import fit

        with in_one_line():
            return fit(
                experiment,
                effects=effects,
                starts=starts,
                progress=say,
                method=method,
                check_integration=check_integration,
                **({"seed": seed} if seed else {}),
            )


def diagnosed(
    experiment: "Experiment",
    effects: Sequence[str],
    most: int,
    starts: int,
    budget: float | None = None,
) -> "Diagnosis":
    """Diagnose, and show on the way what is being done.

    **Raises:** as `fitted`.
    """
    with progress() as say:
        say("loading")
        from ..diagnosis import diagnose

        with in_one_line():
            return diagnose(
                experiment,
                effects=effects,
                max_effects=most,
                starts=starts,
                budget=budget,
                progress=say,
            )


def unloaded(
    experiment: "Experiment",
    effects: Sequence[str],
    starts: int,
    inertia_std: Sequence[float] | None,
    diagnosis: "Diagnosis | None" = None,
) -> "Unloading":
    """Take the bearings off, and show on the way what is being done.

    **Raises:** as `fitted`.
    """
    with progress() as say:
        say("loading")
        from ..procedure import unload

        with in_one_line():
            return unload(
                experiment,
                effects=effects,
                starts=starts,
                inertia_std=inertia_std,
                diagnosis=diagnosis,
                progress=say,
            )


def models(found: "Diagnosis", title: str = "") -> "list[tuple[str, Fit]]":
    """The first and the last model of a diagnosis, each with a heading for the report."""
    from ..reporting.names import base_name

    fits = [found.base, found.fit] if found.added else [found.fit]
    return [(": ".join(filter(None, [title, base_name(fit)])), fit) for fit in fits]


@contextlib.contextmanager
def in_one_line() -> Iterator[None]:
    """What a fit cannot do, as the complaint that the user reads."""
    from ..fitting import FitError, MissingExtra

    try:
        yield
    except FitError as error:
        raise NoNumbers(str(error)) from None
    except (ValueError, MissingExtra) as error:
        raise InputError(str(error)) from None
