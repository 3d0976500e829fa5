"""`residyn race`."""

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from . import _options
from ._experiment import bring, in_one_line, input_files, integrated_by, load, title
from ._shell import DONE, INTERRUPTED, NO_NUMBERS, Outputs, complain, console, set_up_jax

if TYPE_CHECKING:
    from ..fitting.history import Watch
    from ..fitting.race import Race

_Methods = Annotated[
    str | None,
    typer.Option(
        "--methods",
        metavar="LIST",
        help="Which methods, separated by commas: levenberg, random, genetic, "
        "genetic_release_told, cma_es, differential_evolution, particle_swarm, or any minimiser "
        "such as optimistix.BFGS or optax.adam. Without it, the first seven.",
        show_default=False,
    ),
]
_Repeats = Annotated[
    int, typer.Option("--repeats", metavar="N", min=1, help="Seeds that each method runs with.")
]
_Seconds = Annotated[
    float | None,
    typer.Option(
        "--seconds",
        metavar="S",
        help="The most seconds that one run of a method may take.",
        show_default=False,
    ),
]
_Simulations = Annotated[
    int | None,
    typer.Option(
        "--simulations",
        metavar="N",
        help="The most simulations that one run of a method may take, instead of --seconds.",
        show_default=False,
    ),
]


def race(
    experiment: _options.Experiment,
    methods: _Methods = None,
    repeats: _Repeats = 1,
    seconds: _Seconds = None,
    simulations: _Simulations = None,
    effects: _options.With = None,
    own: _options.Effects = None,
    integrator: _options.Integrator = None,
    json: _options.Json = None,
    report: _options.Report = None,
    table: _options.Table = None,
    no_cache: _options.NoCache = False,
) -> None:
    """Let gradients and evolutionary searches race on these recordings."""
    if seconds is not None and simulations is not None:
        raise InputError("--seconds and --simulations: give one of them")
    names = None if methods is None else [name.strip() for name in methods.split(",")]
    out = Outputs(json, report, table)
    set_up_jax(not no_cache)
    bring(own)
    loaded = integrated_by(load(experiment), integrator)
    out.spare(input_files(experiment, loaded))
    from ..fitting import race as run

    with _live() as (say, news), in_one_line():
        found = run(
            loaded,
            effects=effects or [],
            methods=names,
            repeats=repeats,
            seconds=seconds,
            simulations=simulations,
            progress=say,
            news=news,
        )
    out.words.print(str(found), soft_wrap=True)
    out.write_json(found.to_dict())
    out.write_table(found)
    if report is not None:
        from ..reporting import write_page

        write_page(report, found, title(experiment))
        out.words.print(f"report: {report}", soft_wrap=True)
    raise typer.Exit(_status(found))


def _status(found: "Race") -> int:
    if found.interrupted:
        return complain("interrupted", INTERRUPTED)
    if found.best is None:
        return complain("no method led to finite numbers", NO_NUMBERS)
    return DONE


@contextlib.contextmanager
def _live() -> Iterator[tuple[Callable[[str], None], "Callable[[str, int, Watch], None]"]]:
    """A table on standard error in which every method's best objective falls; gone afterwards."""
    from rich.live import Live
    from rich.table import Table

    rows: dict[tuple[str, int], tuple[str, str, str]] = {}
    doing = ""

    def drawn() -> Table:
        table = Table(title=doing, title_justify="left", box=None)
        for head in ("method", "objective", "simulations", "seconds"):
            table.add_column(head, justify="left" if head == "method" else "right")
        for (name, seed), row in rows.items():
            table.add_row(name if seed == 0 else f"{name}, seed {seed}", *row)
        return table

    out = console(stderr=True)
    if not out.is_terminal:
        yield lambda words: None, lambda name, seed, watch: None
        return
    with Live(drawn(), console=out, transient=True, auto_refresh=False) as live:

        def say(words: str) -> None:
            nonlocal doing
            doing = words
            live.update(drawn(), refresh=True)

        def news(name: str, seed: int, watch: "Watch") -> None:
            row = f"{watch.best:.5g}", f"{watch.simulations:.0f}", f"{watch.seconds:.1f}"
            rows[name, seed] = row
            live.update(drawn(), refresh=True)

        yield say, news
