"""`residyn race`."""

from typing import Annotated

from .. import reporting
from ..errors import InputError
from . import _options
from ._shell import INTERRUPTED, NoNumbers
from ._work import Work, computing, title

_METHODS = _options.option(
    "--methods LIST",
    f"Which methods, separated by commas: {', '.join(_options.METHODS)}, or any minimiser "
    "such as optimistix.BFGS or optax.adam. Without it, all of these seven.",
)
_REPEATS = _options.number("--repeats N", "Number of random seeds for each method.", least=1)
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
    """Let gradients and evolutionary searches race on recordings."""
    if seconds is not None and simulations is not None:
        raise InputError("--seconds and --simulations: give one of them")
    names = None if methods is None else [name.strip() for name in methods.split(",")]
    for name in names or ():
        _options.must_be_method("--methods", name)
    out = Work(json, report, table)
    loaded = out.begin(experiment, own, no_cache, integrator, {"--with": effects or []})
    with computing() as say:
        from ..fitting import race as run

        def news(name, seed, watch):
            who = name if seed == 0 else f"{name}, seed {seed}"
            say(f"{who}: objective {watch.best:.5g} after {watch.simulations:.0f} simulations")

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
        raise NoNumbers("interrupted", INTERRUPTED)
    if found.best is None:
        raise NoNumbers("no method led to finite numbers")
