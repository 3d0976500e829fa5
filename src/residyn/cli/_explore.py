"""`residyn explore`."""

import contextlib
import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

from . import _options
from ._shell import DONE, NoNumbers, console, progress, set_up_jax, tell
from ._work import bring, must_go_with, one_complaint


def explore(
    experiment: Annotated[
        str,
        _options.argument(
            "EXPERIMENT",
            'A TOML file that describes the arm and its recordings; "demo" is the one that '
            "ships with residyn.",
        ),
    ],
    effects: _options.With = None,
    own: _options.Effects = None,
    port: Annotated[int, _options.number("--port N", "Port; 0: any free one.", most=65535)] = 0,
    no_browser: Annotated[
        bool, _options.option("--no-browser", "Only print the address; open no browser.")
    ] = False,
    no_cache: _options.NoCache = False,
) -> None:
    """Add effects by hand on a page, and watch the error fall. Ctrl-C stops it (status 0)."""
    set_up_jax(not no_cache)
    bring(own)
    with progress("loading"), contextlib.ExitStack() as stack:
        try:
            from ..reporting.explorer.files import ExperimentFiles
            from ..reporting.explorer.server import Explorer, serve
        except ModuleNotFoundError as error:
            raise NoNumbers(f"explore needs {error.name}: pip install 'residyn[explore]'") from None
        path = Path(experiment)
        if experiment == "demo" and not path.exists():
            from ..demo import experiment_file

            path = stack.enter_context(experiment_file())
        files = ExperimentFiles(path)
        for line in files.experiment.understood:
            tell(line)
        with one_complaint():  # of nothing to fit or a wrong effect, before any page opens
            from ..fitting.problem import ready

            must_go_with(files.experiment, "--with", effects or [])
            ready(files.experiment, files.experiment.fit_recordings, effects or [])
    out = console()

    def opened(address: str) -> None:
        out.print(f"{address}\nCtrl-C stops it.", soft_wrap=True)
        sys.stdout.flush()
        if not no_browser:
            webbrowser.open(address)

    serve(Explorer(files.experiment, tuple(effects or ()), experiment, files), port, opened)
    # A thread may be in the middle of a compilation, which nothing can interrupt.
    sys.stdout.flush()
    os._exit(DONE)
