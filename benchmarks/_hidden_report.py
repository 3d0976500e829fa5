"""The tables of the hidden-effect benchmark, from the lines that its runs left."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks._hidden_score import QUESTIONS, Row, counts, exact, grouped, share, table, verdict

EDGES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.99, 1.0)


def summary(rows: Sequence[Row]) -> str:
    """Every question by noise."""
    noises = sorted({row["noise"] for row in rows})
    lines = []
    for what, questions in QUESTIONS.items():
        here = [[r for r in rows if r["what"] == what and r["noise"] == n] for n in noises]
        if not any(here):
            continue
        if what != "none":
            good = [[r for r in some if r.get("error") in (None, "diagnose")] for some in here]
            cells = [share([not counts(r) for r in some]) for some in good]
            lines.append([f"{what}: the oracle could not tell", *cells])
        for words, ask in questions:
            cells = [share([ask(r) for r in some if counts(r)]) for some in here]
            lines.append([f"{what}: {words}", *cells])
    return table(["", *(f"noise {100 * n:g} %" for n in noises)], lines)


def by_effect(rows: Sequence[Row]) -> str:
    """Right of counted, and what was named instead."""
    noises = sorted({row["noise"] for row in rows})
    lines = []
    for label in dict.fromkeys(r["hidden"][0] for r in rows if r["what"] in ("single", "outside")):
        own = [r for r in rows if r["hidden"] == [label]]
        cells = []
        for n in noises:
            some = [r for r in own if r["noise"] == n and counts(r)]
            ask = verdict("unexplained") if own[0]["what"] == "outside" else exact
            cells.append(f"{sum(map(ask, some))} of {len(some)}")
        named = Counter("+".join(r["added"]) or r["verdict"] for r in own if _confused(r))
        cells.append(", ".join(f"{k} ({n})" if n > 1 else k for k, n in named.most_common()))
        lines.append([label, *cells])
    return table(["hidden", *(f"{100 * n:g} %" for n in noises), "named instead"], lines)


def _confused(row: Row) -> bool:
    return counts(row) and not row.get("error") and not exact(row)


def confusions(rows: Sequence[Row]) -> list[str]:
    """Every counted case that came out otherwise: hidden -> named."""
    out = []
    for row in rows:
        wrong = _confused(row) if row["what"] in ("single", "pairs") else False
        wanted = {"none": "adequate", "outside": "unexplained"}.get(row["what"])
        if row.get("error"):
            out.append(f"- {row['key']}: {row['error']}: {row['trace'].strip().splitlines()[-1]}")
        elif counts(row) and (wrong or (wanted and row["verdict"] != wanted)):
            tie = row.get("wrong_over_right")
            words = "" if tie is None else f"; its fit is {tie:.3g} worse in chi-square"
            likes = "; in its group" if grouped(row) and not exact(row) and row["hidden"] else ""
            named = " + ".join(row["added"]) or "nothing"
            out.append(f"- {row['key']}: {named}, {row['verdict']}{words}{likes}")
    return out


def calibration(rows: Sequence[Row]) -> tuple[str, list[tuple[float, float, int]], list[str]]:
    """Every candidate of every case by the probability it was given: table, (mean probability,
    share physically there, how many) of each bin, and the most confident mistakes."""
    given = [
        (p, effect in row["hidden"], row["key"], effect)
        for row in rows
        if not row.get("error")
        for effect, p, *_ in row["candidates"]
    ]
    points, lines = [], []
    for low, high in itertools.pairwise(EDGES):
        some = [g for g in given if low <= g[0] < high or (high == 1.0 and g[0] >= 1.0)]
        if some:
            mean, there = np.mean([g[0] for g in some]), np.mean([g[1] for g in some])
            points.append((float(mean), float(there), len(some)))
            lines.append([f"{low:g} to {high:g}", f"{mean:.3f}", f"{there:.3f}", f"{len(some)}"])
    head = ["probability given", "its mean", "share physically there", "names"]
    worst = sorted((g for g in given if not g[1]), reverse=True)[:10]
    return (
        table(head, lines),
        points,
        [f"- {p:.3f} {effect} in {key}" for p, _, key, effect in worst],
    )


def draw(points: Sequence[tuple[float, float, int]], path: str | Path) -> None:
    """The calibration curve: on the diagonal, a probability means what it says."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    given, there, many = np.array(points).T
    z = 1.96  # Wilson's interval: honest where all or none of a few are there
    middle = (there + z**2 / (2 * many)) / (1 + z**2 / many)
    half = z / (1 + z**2 / many) * np.sqrt(there * (1 - there) / many + (z / (2 * many)) ** 2)
    figure, axes = plt.subplots(figsize=(4.2, 4.2), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1, zorder=0)
    axes.vlines(given, middle - half, middle + half, color="0.3", lw=1.2)
    axes.plot(given, there, "o", color="C0", ms=5)
    axes.set(xlabel="probability given to a name", ylabel="share of such names physically there")
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def report(rows: Sequence[Row], picture: str | Path | None) -> str:
    """All of it, in Markdown."""
    lists, points, worst = calibration(rows)
    if picture and points:
        draw(points, picture)
    seconds = [r["seconds"] for r in rows if "seconds" in r]
    broken = Counter(r["error"] for r in rows if r.get("error"))
    parts = [
        f"{len(rows)} cases" + "".join(f", {n} broken ({name})" for name, n in broken.items()),
        summary(rows),
        by_effect(rows),
        "What came out otherwise (of cases that the oracle could tell):",
        "\n".join(confusions(rows)) or "- nothing",
        "Calibration:",
        lists,
        "The most confident names that are not physically there:",
        "\n".join(worst) or "- none",
    ]
    if seconds:
        middle, late = np.percentile(seconds, [50, 95])
        parts.append(f"Seconds a diagnosis: median {middle:.1f}, 95 % below {late:.1f}.")
    return "\n\n".join(parts)
