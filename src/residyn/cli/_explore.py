"""`residyn explore`."""

import contextlib
import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from . import _options
from ._experiment import bring
from ._shell import DONE, NoNumbers, console, progress, set_up_jax

_Port = Annotated[
    int, typer.Option("--port", metavar="N", min=0, max=65535, help="0 takes one that is free.")
]
_NoBrowser = Annotated[
    bool, typer.Option("--no-browser", help="Only print the address; open no browser.")
]
DEMO = "demo"


def explore(
    experiment: Annotated[
        str,
        typer.Argument(
            metavar="EXPERIMENT",
            help='A TOML file that describes the arm and its recordings; "demo" is the one that '
            "ships with residyn.",
            show_default=False,
        ),
    ],
    effects: _options.With = None,
    own: _options.Effects = None,
    port: _Port = 0,
    no_browser: _NoBrowser = False,
    no_cache: _options.NoCache = False,
) -> None:
    """Add effects by hand on a page, and watch the error fall; Ctrl-C stops it."""
    set_up_jax(not no_cache)
    bring(own)
    with progress() as say, contextlib.ExitStack() as stack:
        say("loading")
        try:
            from ..reporting.explorer.files import ExperimentFiles
            from ..reporting.explorer.server import Explorer, serve
        except ModuleNotFoundError as error:
            raise NoNumbers(f"explore needs {error.name}: pip install 'residyn[explore]'") from None
        path = Path(experiment)
        if experiment == DEMO and not path.exists():
            from ..demo import experiment_file

            path = stack.enter_context(experiment_file())
        files = ExperimentFiles(path)
        if not files.experiment.fit_recordings:
            raise InputError(f'{experiment}: no recording has role = "fit": nothing to fit to')
        _check(files.experiment, effects or [])
    out = console()

    def opened(address: str) -> None:
        out.print(f"{address}\nCtrl-C stops it.", soft_wrap=True)
        sys.stdout.flush()
        if not no_browser:
            webbrowser.open(address)

    name = "demo" if experiment == DEMO else experiment
    serve(Explorer(files.experiment, tuple(effects or ()), name, files), port, opened)
    # A thread may be in the middle of a compilation, which nothing can interrupt.
    sys.stdout.flush()
    os._exit(DONE)


def _check(experiment, effects) -> None:
    """Complain of a wrong effect here, before any page opens."""
    from ..fitting.problem import ready

    try:
        ready(experiment, experiment.fit_recordings, effects)
    except ValueError as error:
        raise InputError(str(error)) from None
