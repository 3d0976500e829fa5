"""`residyn diagnose`."""

import typer

from ..errors import InputError
from . import _options
from ._experiment import bring, diagnosed, input_files, load, models, title
from ._shell import DONE, INTERRUPTED, NO_NUMBERS, Outputs, complain, set_up_jax


def diagnose(
    experiment: _options.Experiment,
    effects: _options.With = None,
    most: _options.MaxEffects = _options.MAX_EFFECTS,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    budget: _options.Budget = None,
    json: _options.Json = None,
    report: _options.Report = None,
    table: _options.Table = None,
    found_file: _options.Found = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Name the effect that is missing, add it, and see the error fall."""
    if budget is not None and not 0 < budget < float("inf"):
        raise InputError(f"--budget {budget:g}: must be a number of seconds above 0")
    out = Outputs(json, report, table, found_file)
    set_up_jax(not no_cache)
    bring(own)
    loaded = load(experiment)
    out.spare(input_files(experiment, loaded))
    found = diagnosed(loaded, effects or [], most, starts, budget)
    out.words.print(str(found), soft_wrap=True)
    out.write_json(found.to_dict())
    out.write_table(found)
    out.write_found(found)
    if report is not None:
        out.write_report(models(found, title(experiment)), diagnosis=found)
        out.words.print(f"report: {report}", soft_wrap=True)
    if found.budget.stopped == "interrupted":
        raise typer.Exit(complain("interrupted: the best so far is above", INTERRUPTED))
    raise typer.Exit(DONE if found.fit.converged else complain(found.fit.reason, NO_NUMBERS))
