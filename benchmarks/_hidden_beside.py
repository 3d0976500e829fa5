"""Methods that only name an effect, beside residyn on the same cases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks._hidden_score import Row, counts, share, table
from benchmarks._hidden_sindy import ABSENT


def by_name(row: Row) -> bool:
    """For methods that only name: the first name of one, the first two of a pair, none of none."""
    hidden = row["hidden"]
    named = row["named"] if "named" in row else row.get("added", [])
    return set(named[: len(hidden) or None]) == set(hidden)


def beside(rows: Sequence[Row], others: Sequence[Row]) -> str:
    """First names right, each method beside residyn on the counted cases that both did."""
    own = {row["key"]: row for row in rows if counts(row)}
    lines = []
    for method in dict.fromkeys(r["method"] for r in others if "method" in r):
        for what in dict.fromkeys(r["what"] for r in others):
            for noise in sorted({r["noise"] for r in others}):
                some = [
                    r
                    for r in others
                    if (r.get("method"), r["what"], r["noise"]) == (method, what, noise)
                    and r["key"] in own
                ]
                if some and what != "outside":
                    every = method == "bic"
                    known = [r for r in some if every or all(map(in_library, r["hidden"]))]
                    cells = [share([by_name(r) for r in each]) for each in (some, known)]
                    cells.append(share([by_name(own[r["key"]]) for r in some]))
                    lines.append([method, what, f"{100 * noise:g} %", *cells])
    head = ["method", "hidden", "noise", "right", "right, of what its library has", "residyn there"]
    return table(head, lines)


def in_library(label: str) -> bool:
    """Whether PySINDy's library has a term for it (BIC tries all)."""
    return not label.startswith(("sensor_", *ABSENT))


def settings(rows: Sequence[Row], best: int = 5) -> str:
    """PySINDy's best settings by form and noise: mean of the share of effects (of its library)
    named, and the share of recordings of nothing left alone."""
    scores: dict[tuple[str, float], dict[str, dict[str, list[bool]]]] = {}
    for row in rows:
        if "method" in row and all(in_library(x) for x in row["hidden"]):
            form, _, setting = row["method"].partition(" ")
            own = scores.setdefault((form, row["noise"]), {}).setdefault(setting, {})
            own.setdefault(row["what"], []).append(by_name(row))
    lines = []
    for (form, noise), own in sorted(scores.items()):
        order = sorted(own, key=lambda m: -np.mean([np.mean(x) for x in own[m].values()]))
        for m in order[:best]:
            words = ", ".join(f"{what} {share(x)}" for what, x in own[m].items())
            lines.append(f"{form}, noise {100 * noise:g} %, {m}: {words}")
    return "\n".join(lines)
