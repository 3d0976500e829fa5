"""A race as a table: for a terminal, for a paper, and as comma-separated values."""

import math
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from .publish import escaped, lines, scientific, table

if TYPE_CHECKING:
    from .race import Race, Raced

HEAD = ("method", "objective / best", "to 10 %", "to 1 %", "k off", "c off")


def text(race: "Race") -> str:
    """The table, 80 columns and more, and what each method was given."""
    if not race.methods:
        return "the race was ended before any method was done"
    rows = [HEAD, *([each.title, *cells(race, each)] for each in race.methods)]
    wide = [max(len(str(row[i])) for row in rows) for i in range(len(HEAD))]
    out = [f"[[Race]]  {' + '.join(race.model)}; budget: {race.budget}"]
    for row in rows:
        pairs = list(zip(row, wide, strict=True))
        padded = [f"{pairs[0][0]:<{wide[0]}}", *(f"{x:>{w}}" for x, w in pairs[1:])]
        out.append("  " + "  ".join(padded).rstrip())
    best = race.best
    if best is not None:
        out.append(f"least objective (Eq. 17): {best.objective:.6g}, of {best.name}")
    out.append(
        "to: simulations, seconds until within so much of it. k, c off: standard errors of the "
        "best fit between its numbers and these, the worst one"
    )
    if race.repeats > 1:
        out.append(f"medians over {race.repeats} seeds; (the worst) behind the objective")
    failed = [(each.title, run.error) for each in race.methods for run in each.runs if run.error]
    out += [f"{title}: {error}" for title, error in dict(failed).items()]
    out.append("given beforehand:")
    for each in race.methods:
        head = f"  {each.title}: "
        out += textwrap.wrap(head + each.given, 100, subsequent_indent="      ")
    if race.interrupted:
        out.append(f"interrupted while {race.interrupted} was running, which is left out")
    return "\n".join(out)


def cells(race: "Race", each: "Raced") -> list[str]:
    """What the table says of a method, behind its name."""
    from .race import ONE, TEN

    run = each.median
    ratio = _short(run.objective / race.least) if math.isfinite(run.objective) else "--"
    if race.repeats > 1 and math.isfinite(each.worst.objective):
        ratio += f" ({_short(each.worst.objective / race.least)})"
    found = [ratio]
    for target in (TEN, ONE):
        spent = each.within(target * race.least)
        known = math.isfinite(spent.simulations)
        found.append(f"{spent.simulations:.0f}, {spent.seconds:.2g} s" if known else "--")
    return [*found, *off(race, each)]


def off(race: "Race", each: "Raced") -> list[str]:
    """How far the worst spring and the worst damper are off, in standard errors."""
    run = each.median
    if run.fit is None:
        return ["--", "--"]
    far = race.off(run)
    found = []
    for kind in ("spring", "damper"):
        own = [x for x, n in zip(far, run.fit.numbers, strict=True) if n.name.startswith(kind)]
        good = [x for x in own if np.isfinite(x)]
        found.append(f"{max(good):.2g}" if good else "--")
    return found


def _short(x: float) -> str:
    return f"{x:.4f}" if x < 10 else f"{x:.3g}"


def latex(race: "Race") -> str:
    """The table of `text` with booktabs."""
    rows = []
    for each in race.methods:
        objective, *spent = cells(race, each)
        rows.append([escaped(each.title), objective, *spent[:2], *map(scientific, spent[2:])])
    head = [
        "Method",
        "Objective / best",
        r"to 10\,\%",
        r"to 1\,\%",
        r"$k$, std.\ errors off",
        r"$c$, std.\ errors off",
    ]
    return table("lrrrrr", head, [rows])


def comma_separated(race: "Race") -> str:
    """A line for each run of each method."""
    from .race import ONE, TEN

    rows = []
    for each in race.methods:
        for run in each.runs:
            ten, one = (run.history.until(x * race.least) for x in (TEN, ONE))
            clock = [run.history.seconds_until(x * race.least) for x in (TEN, ONE)]
            spent = [ten, clock[0], one, clock[1]]
            rows.append(
                [run.name, str(run.seed), run.objective, run.simulations, run.seconds, *spent]
            )
    head = ("method", "seed", "objective", "simulations", "seconds")
    more = ("simulations_10_percent", "seconds_10_percent")
    return lines((*head, *more, "simulations_1_percent", "seconds_1_percent"), rows)
