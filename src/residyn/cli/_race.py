"""`residyn race`."""

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from .. import reporting
from ..errors import InputError
from . import _options
from ._shell import INTERRUPTED, NoNumbers, complain, console
from ._work import Work, one_complaint, title

if TYPE_CHECKING:
    from ..fitting.history import Watch

_METHODS = _options.option(
    "--methods LIST",
    f"Which methods, separated by commas: {', '.join(_options.METHODS)}, or any minimiser "
    "such as optimistix.BFGS or optax.adam. Without it, the first seven.",
)
_REPEATS = _options.number("--repeats N", "Seeds that each method runs with.", least=1)
_SECONDS = _options.seconds("--seconds S", "The most that one run of a method may take.")
_SIMULATIONS = _options.number(
    "--simulations N",
    "The most simulations that one run of a method may take, instead of --seconds.",
    least=1,
)


def race(
    experiment: _options.Experiment,
    methods: Annotated[str | None, _METHODS] = None,
    repeats: Annotated[int, _REPEATS] = 1,
    seconds: Annotated[float | None, _SECONDS] = None,
    simulations: Annotated[int | None, _SIMULATIONS] = None,
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
    out = Work(json, report, table)
    loaded = out.begin(experiment, own, no_cache, integrator)
    with _live() as (say, news), one_complaint():
        from ..fitting import race as run

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
    out.give(found, lambda path: reporting.write_page(path, found, title(experiment)))
    if found.interrupted:
        raise typer.Exit(complain("interrupted", INTERRUPTED))
    if found.best is None:
        raise NoNumbers("no method led to finite numbers")


@contextlib.contextmanager
def _live() -> Iterator[tuple[Callable[[str], None], "Callable[[str, int, Watch], None]"]]:
    """A table on standard error in which every method's best objective falls; gone afterwards."""
    from rich.live import Live
    from rich.table import Table

    rows: dict[str, tuple[str, str, str]] = {}
    doing = ""

    def drawn() -> Table:
        table = Table(title=doing, title_justify="left", box=None)
        for head in ("method", "objective", "simulations", "seconds"):
            table.add_column(head, justify="left" if head == "method" else "right")
        for name, told in rows.items():
            table.add_row(name, *told)
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
            told = f"{watch.best:.5g}", f"{watch.simulations:.0f}", f"{watch.seconds:.1f}"
            rows[name if seed == 0 else f"{name}, seed {seed}"] = told
            live.update(drawn(), refresh=True)

        yield say, news
