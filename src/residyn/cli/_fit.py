"""`residyn fit`."""

from typing import TYPE_CHECKING, NoReturn

import typer

from ..errors import InputError
from . import _options
from ._each import fit_each
from ._experiment import bring, fitted, input_files, integrated_by, load, title
from ._shell import DONE, NO_NUMBERS, Outputs, complain, set_up_jax

if TYPE_CHECKING:
    from ..fitting.result import Fit

NOTHING = "nothing"
"""Of --against: no effect, springs and dampers alone."""


def fit(
    experiment: _options.OneExperiment = None,
    each: _options.Each = None,
    jobs: _options.Jobs = 1,
    effects: _options.With = None,
    against: _options.Against = None,
    own: _options.Effects = None,
    starts: _options.Starts = _options.STARTS,
    method: _options.Method = _options.METHODS[0],
    integrator: _options.Integrator = None,
    check_integration: _options.CheckIntegration = False,
    seed: _options.Seed = 0,
    json: _options.Json = None,
    report: _options.Report = None,
    table: _options.Table = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Fit springs, dampers and other effects to recordings."""
    if method not in _options.METHODS and "." not in method:
        known = ", ".join(_options.METHODS)
        raise InputError(
            f'--method "{method}": there is no such method; it must be one of {known}, or a '
            "minimiser such as optimistix.BFGS"
        )
    if method not in _options.DESCENTS and starts != _options.STARTS:
        raise InputError(
            "--starts goes with --method levenberg or random; what else there is has no starts"
        )
    if method not in _options.SEEDED and seed != 0:
        raise InputError(f"--seed goes with a --method that draws; {method} does not")
    if each is not None:
        if experiment is not None:
            raise InputError(f"--each {each}: takes the place of EXPERIMENT; leave one of them out")
        if report is not None or table is not None or method != _options.METHODS[0]:
            raise InputError("--each goes with none of --report, --table and --method")
        if integrator is not None or check_integration:
            raise InputError(
                "--each goes with neither --integrator nor --check-integration; [integrator] in "
                "an experiment's file says what integrates it"
            )
        if against is not None:
            raise InputError("--each goes without --against")
        bring(own)
        fit_each(each, effects or [], own, starts, json, no_cache, jobs)
    if jobs != 1:
        raise InputError(f"--jobs {jobs} goes with --each FOLDER")
    if against is not None and table is not None:
        raise InputError("--table is of one model; it goes without --against")
    if experiment is None:
        raise InputError("an EXPERIMENT is needed, a TOML file, or --each FOLDER")
    out = Outputs(json, report, table)
    set_up_jax(not no_cache)
    bring(own)
    loaded = integrated_by(load(experiment), integrator)
    out.spare(input_files(experiment, loaded))
    how = starts, method, check_integration, seed
    result = fitted(loaded, effects or [], *how)
    if against is not None:
        other = fitted(loaded, [e for e in against if e != NOTHING], *how)
        _beside(out, result, other, report)
    out.words.print(str(result), soft_wrap=True)
    if result.misses:
        out.words.print(
            f"the model misses something: residyn diagnose {experiment}", soft_wrap=True
        )
    out.write_json(result.to_dict())
    out.write_table(result)
    if report is not None:
        out.write_report([(title(experiment), result)])
        out.words.print(f"report: {report}", soft_wrap=True)
    if not result.stands:
        raise typer.Exit(complain(result.reason, NO_NUMBERS))
    if result.unphysical:
        names = ", ".join(n.name for n in result.unphysical)
        raise typer.Exit(complain(f"{names}: negative, which is not physical", NO_NUMBERS))
    raise typer.Exit(DONE)


def _beside(out: Outputs, one: "Fit", other: "Fit", report: str | None) -> NoReturn:
    """Print and write two models side by side."""
    from ..reporting.side_by_side import SideBySide, headings

    found = SideBySide(one, other)
    out.words.print(str(found), soft_wrap=True)
    out.write_json(found.to_dict())
    if report is not None:
        out.write_report(headings(found))
        out.words.print(f"report: {report}", soft_wrap=True)
    for name, fit in (("A", one), ("B", other)):
        if not fit.stands:
            raise typer.Exit(complain(f"{name}: {fit.reason}", NO_NUMBERS))
    raise typer.Exit(DONE)
