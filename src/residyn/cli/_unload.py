"""`residyn unload`."""

from typing import Annotated

import typer

from ..errors import InputError
from . import _options
from ._experiment import bring, diagnosed, input_files, load, title, unloaded
from ._shell import DONE, NO_NUMBERS, Outputs, complain, progress, set_up_jax

_InertiaStd = Annotated[
    str | None,
    typer.Option(
        "--inertia-std",
        metavar="A,B,C",
        help="Standard errors of shoulder, elbow (kg m^2) and coupling (kg m) from step 1, to "
        'carry over. Recordings with role = "inertia" give them too.',
        show_default=False,
    ),
]


def unload(
    experiment: _options.Experiment,
    effects: _options.With = None,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    inertia_std: _InertiaStd = None,
    diagnose: Annotated[
        bool,
        typer.Option(
            "--diagnose",
            help="Diagnose first: the modes without bearings over all models that the recordings "
            "leave in play, with their probabilities.",
        ),
    ] = False,
    most: _options.MaxEffects = _options.MAX_EFFECTS,
    budget: _options.Budget = None,
    json: _options.Json = None,
    report: _options.Report = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Take the air bearings off, drag and friction too: how the arm rings in orbit."""
    if budget is not None and not 0 < budget < float("inf"):
        raise InputError(f"--budget {budget:g}: must be a number of seconds above 0")
    out = Outputs(json, report)
    std = _three(inertia_std)
    set_up_jax(not no_cache)
    bring(own)
    loaded = load(experiment)
    out.spare(input_files(experiment, loaded))
    try:
        diagnosis = diagnosed(loaded, effects or [], most, starts, budget) if diagnose else None
        found = unloaded(loaded, effects or [], starts, std, diagnosis)
    except InputError as error:
        raise InputError(f"{experiment}: {error}") from None
    out.words.print(f"{found.fit}\n{found}", soft_wrap=True)
    out.write_json(found.to_dict())
    if report is not None:
        with progress() as say:
            say("writing the report")
            from ..reporting import write_page

            write_page(report, found, title(experiment))
        out.words.print(f"report: {report}", soft_wrap=True)
    if not found.fit.converged:
        raise typer.Exit(complain(found.fit.reason, NO_NUMBERS))
    if not found.physical:
        raise typer.Exit(complain(found.unphysical[0], NO_NUMBERS))
    raise typer.Exit(DONE)


def _three(words: str | None) -> list[float] | None:
    """Three numbers separated by commas.

    **Raises:** `InputError`.
    """
    if words is None:
        return None
    try:
        found = [float(part) for part in words.split(",")]
    except ValueError:
        found = []
    if len(found) != 3 or not all(0 <= x < float("inf") for x in found):
        raise InputError(
            f"--inertia-std {words}: must be three numbers from 0 up, separated by commas, for "
            "shoulder, elbow (kg m^2) and coupling (kg m)"
        )
    return found
