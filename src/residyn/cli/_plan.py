"""`residyn plan`."""

from typing import Annotated

import typer

from ..errors import InputError
from . import _options
from ._experiment import bring, diagnosed, in_one_line, input_files, load
from ._shell import DONE, INTERRUPTED, Outputs, complain, progress, set_up_jax


def plan(
    experiment: _options.Experiment,
    effects: _options.With = None,
    tests: Annotated[
        int, typer.Option("--tests", metavar="K", min=1, help="How many tests to plan.")
    ] = 3,
    most: _options.MaxEffects = _options.MAX_EFFECTS,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    budget: _options.Budget = None,
    json: _options.Json = None,
    no_cache: _options.NoCache = False,
) -> None:
    """The next tests to make, within [limits], and what each outcome would mean."""
    if budget is not None and not 0 < budget < float("inf"):
        raise InputError(f"--budget {budget:g}: must be a number of seconds above 0")
    out = Outputs(json, None)
    set_up_jax(not no_cache)
    bring(own)
    loaded = load(experiment)
    out.spare(input_files(experiment, loaded))
    found = diagnosed(loaded, effects or [], most, starts, budget)
    with progress() as say:
        from ..diagnosis import plan as planned

        with in_one_line():
            result = planned(found, tests=tests, progress=say)
    out.words.print(str(result), soft_wrap=True)
    out.write_json(result.to_dict())
    if found.budget.stopped == "interrupted":
        raise typer.Exit(complain("interrupted: planned from the best so far", INTERRUPTED))
    raise typer.Exit(DONE)
