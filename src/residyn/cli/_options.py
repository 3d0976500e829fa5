"""The options that several commands share, so that they read the same everywhere."""

from typing import Annotated

import typer

_EXPERIMENT = typer.Argument(
    metavar="EXPERIMENT",
    help='A TOML file that describes the arm and its recordings; "-" reads it from standard input.',
    show_default=False,
)
Experiment = Annotated[str, _EXPERIMENT]
OneExperiment = Annotated[str | None, _EXPERIMENT]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs",
        metavar="N",
        min=1,
        help="With --each: how many processes share the experiments.",
    ),
]
Each = Annotated[
    str | None,
    typer.Option(
        "--each",
        metavar="FOLDER",
        help="Fit every experiment (*.toml) of a folder instead of one; --json FILE then takes a "
        "line for each as it is done, and a run that was stopped goes on from there.",
        show_default=False,
    ),
]
With = Annotated[
    list[str] | None,
    typer.Option(
        "--with",
        metavar="EFFECT",
        help="Add an effect to the springs and dampers: NAME, or NAME:JOINT. May be repeated; "
        "`residyn effects` lists them.",
        show_default=False,
    ),
]
Against = Annotated[
    list[str] | None,
    typer.Option(
        "--against",
        metavar="EFFECT",
        help="Fit a second model, with these effects instead of those of --with, and set the two "
        'side by side; "nothing": springs and dampers alone. May be repeated.',
        show_default=False,
    ),
]
Effects = Annotated[
    list[str] | None,
    typer.Option(
        "--effects",
        metavar="FILE.py",
        help="A Python file that defines effects of your own, to use by name. May be repeated.",
        show_default=False,
    ),
]
Starts = Annotated[
    int, typer.Option("--starts", metavar="N", min=1, help="How many starts to fit from.")
]
MaxEffects = Annotated[
    int,
    typer.Option(
        "--max-effects", metavar="N", min=0, help="How many effects to add at most; 0 only names."
    ),
]
Budget = Annotated[
    float | None,
    typer.Option(
        "--budget",
        metavar="SECONDS",
        help="End the search after so long, with the best so far. Ctrl-C does the same at any "
        "time. Without it the search ends when nothing more is gained.",
        show_default=False,
    ),
]
Found = Annotated[
    str | None,
    typer.Option(
        "--found",
        metavar="FILE.py",
        help="If a law without a name is found, write it as an effect into this file, for "
        "--effects FILE.py.",
        show_default=False,
    ),
]
Method = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="METHOD",
        help="How to search: levenberg, random (starts), genetic, genetic_release_told, cma_es, "
        "differential_evolution, particle_swarm, or a minimiser such as optimistix.BFGS.",
    ),
]
Seed = Annotated[
    int, typer.Option("--seed", metavar="N", min=0, help="Of a --method that draws: which draw.")
]
Integrator = Annotated[
    str | None,
    typer.Option(
        "--integrator",
        metavar="NAME",
        help="What integrates: fixed steps, or a solver of diffrax such as Tsit5, Dopri8 or, for "
        "a stiff effect, Kvaerno5; before [integrator] in the file.",
        show_default=False,
    ),
]
CheckIntegration = Annotated[
    bool,
    typer.Option(
        "--check-integration",
        help="Integrate the fitted motion again with Dopri8 at rtol = 1e-10, and state the error.",
    ),
]
Json = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help='Write the result as JSON; "-" writes it to standard output, and all words to '
        "standard error.",
        show_default=False,
    ),
]
Report = Annotated[
    str | None,
    typer.Option(
        "--report",
        metavar="FILE.html",
        help="Write one self-contained page with pictures.",
        show_default=False,
    ),
]
Table = Annotated[
    str | None,
    typer.Option(
        "--table",
        metavar="FILE.tex|FILE.csv",
        help="Write the numbers as a table for a paper: LaTeX (booktabs), or CSV.",
        show_default=False,
    ),
]
NoCache = Annotated[
    bool,
    typer.Option(
        "--no-cache",
        help="Keep no compiled programs in your cache folder, and use none.",
    ),
]

METHODS = (
    "levenberg",
    "random",
    "genetic",
    "genetic_release_told",
    "cma_es",
    "differential_evolution",
    "particle_swarm",
)
DESCENTS, SEEDED = METHODS[:2], METHODS[1:]
STARTS = 6
MAX_EFFECTS = 3
