"""`residyn inertia`."""

import typer

from ..errors import InputError
from . import _options
from ._experiment import input_files, load, title
from ._shell import DONE, NO_NUMBERS, NoNumbers, Outputs, complain, progress, set_up_jax


def inertia(
    experiment: _options.Experiment,
    json: _options.Json = None,
    report: _options.Report = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Find the arm's inertias from driven tests, and print its [arm] table."""
    out = Outputs(json, report)
    set_up_jax(not no_cache)
    loaded = load(experiment)
    out.spare(input_files(experiment, loaded))
    with progress() as say:
        say("loading")
        from .. import procedure
        from ..fitting import FitError

        say("solving Eq. 10 and 11")
        try:
            result = procedure.inertia(loaded)
        except FitError as error:
            raise NoNumbers(str(error)) from None
        except InputError as error:
            raise InputError(f"{experiment}: {error}") from None
    out.words.print(str(result), soft_wrap=True)
    out.write_json(result.to_dict())
    if report is not None:
        from ..reporting import write_page

        write_page(report, result, title(experiment))
        out.words.print(f"report: {report}", soft_wrap=True)
    if result.problem is not None:
        raise typer.Exit(complain(result.problem, NO_NUMBERS))
    out.words.print(f"\n{result.to_toml()}", soft_wrap=True, end="")
    raise typer.Exit(DONE)
