"""All that is said of a race: a table for a terminal, for a paper and for a page."""

import math
from collections.abc import Sequence

import numpy as np

from ..fitting.race import ONE, TEN, Race, Raced
from ..physics.effect import BASE
from . import figures as plot
from . import layout
from .layout import Table, filled, printed, section, separated

_HEAD = ("method", "objective", "to 10 %", "to 1 %", "k off", "c off")
MEANING = (
    "objective: in times the least one of all. to 10 %, to 1 %: simulations and seconds until a "
    "method came within so much of it. k off, c off: how far the worst stiffness and the worst "
    "damping are from those of the best fit, in its standard errors."
)


def text(race: Race) -> str:
    if not race.methods:
        return "the race was ended before any method was done"
    out = [*section("Race", f"{' + '.join(race.model)}; budget: {race.budget}")]
    # Names break at their spaces where the line is full.
    rows = [[each.name.replace("_", " "), *_cells(race, each)] for each in race.methods]
    out += printed(Table(_HEAD, rows), indent=2)
    if race.best is not None:
        out.append(f"least objective (Eq. 17): {race.best.objective:.6g}, of {race.best.name}")
    out += filled(MEANING)
    if race.repeats > 1:
        out.append(f"medians over {race.repeats} seeds; (the worst) behind the objective")
    for each in race.methods:
        out += [line for e in errors(each) for line in filled(f"{each.name}: {e}")]
    out.append("given beforehand:")
    for words, some in given(race).items():
        out += filled(words, f"  {', '.join(each.name for each in some)}: ", 6)
    if race.interrupted:
        out.append(f"interrupted while {race.interrupted} was running, which is left out")
    return "\n".join(out)


def table(race: Race) -> Table:
    return Table(_HEAD, [[each.title, *_cells(race, each)] for each in race.methods])


def given(race: Race) -> dict[str, list[Raced]]:
    """What was given, in words, and to which methods."""
    found: dict[str, list[Raced]] = {}
    for each in race.methods:
        found.setdefault(each.given, []).append(each)
    return found


def errors(each: Raced) -> list[str]:
    """Why runs failed, each reason once."""
    return list(dict.fromkeys(run.error for run in each.runs if run.error))


def _cells(race: Race, each: Raced) -> list[str]:
    run = each.median
    ratio = _short(run.objective / race.least) if math.isfinite(run.objective) else "--"
    if race.repeats > 1 and math.isfinite(each.worst.objective):
        ratio += f" ({_short(each.worst.objective / race.least)})"
    found = [ratio]
    for target in (TEN, ONE):
        spent = each.within(target * race.least)
        known = math.isfinite(spent.simulations)
        found.append(f"{spent.simulations:.0f}, {spent.seconds:.2g} s" if known else "--")
    numbers = () if run.fit is None else run.fit.numbers
    far = list(zip(race.off(run), numbers, strict=True))
    for kind in BASE:
        own = [x for x, n in far if n.name.startswith(kind) and np.isfinite(x)]
        found.append(_short(max(own), 2) if own else "--")
    return found


def _short(x: float, digits: int = 4) -> str:
    return f"{x:.{digits}f}" if x < 10 else f"{x:.3g}"


def drawn(race: Race) -> list[Raced]:
    return [each for each in race.methods if len(each.median.history.objective)]


def curves(methods: Sequence[Raced], against: str) -> str:
    """How their objectives fall, as an SVG element."""
    histories = [each.median.history for each in methods]
    figure = plot.convergence(histories, [each.title for each in methods], against=against)
    code = plot.svg(figure)
    return code[code.index("<svg") :]


def latex(race: Race) -> str:
    return layout.latex(table(race))


def csv(race: Race) -> str:
    """A line for each run of each method."""
    head = ["method", "seed", "objective", "simulations", "seconds"]
    head += [f"{x}_{within}_percent" for within in (10, 1) for x in ("simulations", "seconds")]
    rows = []
    for run in (run for each in race.methods for run in each.runs):
        spent = []
        for least in (TEN * race.least, ONE * race.least):
            spent += [run.history.until(least), run.history.seconds_until(least)]
        own = run.name, str(run.seed), run.objective, run.simulations, run.seconds
        rows.append([*own, *spent])
    return separated(head, rows)
