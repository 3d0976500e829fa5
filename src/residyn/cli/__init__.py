"""The commands of `residyn`.

Nothing here computes. Each command reads what the user gave, calls the same functions that a
notebook would, and prints. Two promises shape these files: asking for help is instant, so JAX and
matplotlib are imported inside the commands that need them; and whoever makes a mistake reads one
line that says what would be right, never a traceback (`_shell`).
"""

import os
import signal

import typer

from . import _demo, _diagnose, _effects, _example, _explore, _fit, _procedure, _race, _simulate
from ._shell import INTERRUPTED, run

app = typer.Typer(
    name="residyn",
    help="Fit the joint stiffness and damping of a braked arm from recorded motion.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
)


@app.callback(invoke_without_command=True)
def residyn(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", help="Print the version and stop."),
) -> None:
    """Fit the joint stiffness and damping of a braked arm from recorded motion."""
    if version:
        from .. import __version__

        print(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())
        raise typer.Exit


for _command in (
    _example.new,
    _example.example,
    _demo.demo,
    _fit.fit,
    _diagnose.compare,
    _diagnose.diagnose,
    _diagnose.plan,
    _explore.explore,
    _procedure.inertia,
    _procedure.unload,
    _race.race,
    _simulate.simulate,
    _effects.effects,
):
    app.command(_command.__name__)(_command)


def main(args: list[str] | None = None) -> int:
    """Run the command with these words. Without any, those of the command line: the process then
    ends here, for Python would wait for threads that still compile, or pull their memory away.

    **Returns:** the exit status.
    """
    status = run(app, args)
    if args is None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if status == INTERRUPTED:
            os._exit(status)
    return status
