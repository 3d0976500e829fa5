"""From an EXPERIMENT on the command line to a fit."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .._input import InputError
from ._shell import NoNumbers, progress

if TYPE_CHECKING:
    from ..fitting.result import Fit
    from ..recording import Experiment


def load(path: str) -> "Experiment":
    """Read the experiment.

    **Raises:** `InputError`.
    """
    with progress() as say:
        say("reading")
        from .. import recording

        return recording.load(path)


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


def fitted(experiment: "Experiment", effects: Sequence[str], starts: int) -> "Fit":
    """Fit, and show on the way what is being done.

    **Raises:** `InputError` for effects that do not exist or do not go with the experiment;
    `NoNumbers` if no start led anywhere.
    """
    with progress() as say:
        say("loading")
        from ..fitting import FitError, fit

        try:
            return fit(experiment, effects=effects, starts=starts, progress=say)
        except FitError as error:
            raise NoNumbers(str(error)) from None
        except ValueError as error:
            raise InputError(str(error)) from None
