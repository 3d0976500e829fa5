"""`residyn compare`."""

import typer

from . import _options
from ._experiment import bring, fitted, input_files, load, title
from ._shell import DONE, NO_NUMBERS, Outputs, complain, progress, set_up_jax


def compare(
    experiment: _options.Experiment,
    effects: _options.With = None,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    json: _options.Json = None,
    report: _options.Report = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Fit, and say where the model fails: when, at what swing, at what frequency."""
    out = Outputs(json, report)
    set_up_jax(not no_cache)
    bring(own)
    loaded = load(experiment)
    out.spare(input_files(experiment, loaded))
    fit = fitted(loaded, effects or [], starts)
    with progress() as say:
        from ..diagnosis import compare_fit

        result = compare_fit(fit, say)
    out.words.print(str(result), soft_wrap=True)
    out.write_json(result.to_dict())
    if report is not None:
        out.write_report([(title(experiment), fit)], result)
        out.words.print(f"report: {report}", soft_wrap=True)
    raise typer.Exit(DONE if fit.stands else complain(fit.reason, NO_NUMBERS))
