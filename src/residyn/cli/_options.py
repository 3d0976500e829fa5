"""The options that several commands share, so that they read the same everywhere."""

import math
from typing import Annotated, Any

import typer

from ..errors import InputError


def option(usage: str, words: str, **more: Any) -> Any:
    """An option as `--help` shows it; `usage` is its name and, if it takes a value, what that is:
    "--json FILE"."""
    name, _, metavar = usage.partition(" ")
    return typer.Option(name, metavar=metavar or None, help=words, **more)


def number(usage: str, words: str, least: float = 0, most: float | None = None) -> Any:
    """An option that is a number from `least` to `most`. Typer refuses others, but not infinity,
    nor NaN in some versions."""

    def finite(given: float | None) -> float | None:
        if isinstance(given, float) and not math.isfinite(given):
            raise typer.BadParameter(f"{given} is no finite number.")
        return given

    return option(usage, words, min=least, max=most, callback=finite)


def seconds(usage: str, words: str) -> Any:
    return number(usage, words, least=0.001)


def argument(metavar: str, words: str) -> Any:
    return typer.Argument(metavar=metavar, help=words, show_default=False)


DESCENTS = ("levenberg", "random")
SEARCHES = ("genetic", "genetic_release_told", "cma_es", "differential_evolution", "particle_swarm")
METHODS = (*DESCENTS, *SEARCHES)
SEEDED = METHODS[1:]
STARTS = 6
MAX_EFFECTS = 3


def must_be_method(option: str, name: str) -> None:
    """**Raises:** `InputError` for a method that there is not; a minimiser has a point in its
    name."""
    if name not in METHODS and "." not in name:
        raise InputError(
            f'{option} "{name}": there is no such method; it must be one of '
            f"{', '.join(METHODS)}, or a minimiser such as optimistix.BFGS"
        )


_EXPERIMENT = argument(
    "EXPERIMENT",
    'A TOML file that describes the arm and its recordings; "-" reads it from standard input.',
)
Experiment = Annotated[str, _EXPERIMENT]
OneExperiment = Annotated[str | None, _EXPERIMENT]
Jobs = Annotated[
    int | None,
    number(
        "--jobs N",
        "With --each: how many processes share the experiments; as many as there are cores, "
        "unless there are few experiments for each.",
        least=1,
    ),
]
Each = Annotated[
    str | None,
    option(
        "--each FOLDER",
        "Fit every experiment (*.toml) of a folder instead of one; --json FILE then takes a "
        "line for each as it is done, and a run that was stopped goes on from there.",
    ),
]
With = Annotated[
    list[str] | None,
    option(
        "--with EFFECT",
        "Add an effect to the springs and dampers: NAME, or NAME:JOINT. May be repeated; "
        "`residyn effects` lists them.",
    ),
]
Against = Annotated[
    list[str] | None,
    option(
        "--against EFFECT",
        "Fit a second model, with these effects instead of those of --with, and set the two "
        'side by side; "nothing": springs and dampers alone. May be repeated.',
    ),
]
Effects = Annotated[
    list[str] | None,
    option(
        "--effects FILE.py",
        "A Python file that defines effects of your own, to use by name. May be repeated.",
    ),
]
Starts = Annotated[int, number("--starts N", "How many starts to fit from.", least=1)]
MaxEffects = Annotated[
    int, number("--max-effects N", "How many effects to add at most; 0 tries none.")
]
Budget = Annotated[
    float | None,
    seconds(
        "--budget SECONDS",
        "End the search after so long, with the best so far. Ctrl-C does the same at any "
        "time. Without it the search ends when nothing more is gained.",
    ),
]
Found = Annotated[
    str | None,
    option(
        "--found FILE.py",
        "If a law without a name is found, write it as an effect into this file, for "
        "--effects FILE.py.",
    ),
]
Method = Annotated[
    str,
    option(
        "--method METHOD",
        f"How to search: {', '.join(METHODS)}, or a minimiser such as optimistix.BFGS.",
    ),
]
Seed = Annotated[int, number("--seed N", "Random seed of a method that uses random numbers.")]
Integrator = Annotated[
    str | None,
    option(
        "--integrator NAME",
        "`fixed` (default) or a diffrax solver such as Tsit5, Dopri8 or, for a stiff effect, "
        "Kvaerno5; overrides [integrator] of the file.",
    ),
]
CheckIntegration = Annotated[
    bool,
    option(
        "--check-integration",
        "Integrate the fitted motion again with Dopri8 at rtol = 1e-10 (with dry friction or a "
        "slipping brake: with 16 times as many steps), and state the error.",
    ),
]
Json = Annotated[
    str | None,
    option(
        "--json FILE",
        'Write the result as JSON; "-" writes it to standard output, and all words to '
        "standard error.",
    ),
]
Report = Annotated[
    str | None,
    option("--report FILE.html", "Write one self-contained page with pictures."),
]
Table = Annotated[
    str | None,
    option(
        "--table FILE.tex|FILE.csv",
        "Write the numbers as a table for a paper: LaTeX (booktabs), or CSV.",
    ),
]
NoCache = Annotated[
    bool,
    option("--no-cache", "Keep no compiled programs in your cache folder, and use none."),
]
