"""The tables of the hidden-effect benchmark, from the lines that its runs and its oracle left.

*What can be told.* A case with one effect counts if the oracle's fit with the truth brings
chi-square below that of springs and dampers by more than `SURE` + 2 for every number of the effect;
of two effects each must be so given the other; outside the catalogue the true motion stands for the
fit.

*Class.* A name is in the truth's equivalence class if, in the truth's place, it leaves the same to
within noise: its chi-square is at most `TIE` above the truth's, each plus the one for every fitted
number by which a fit follows the noise. Class first: the likeliest name is of the class. By name:
it is the hidden effect itself, where its class has no other member. The log probability is that of
the sum over the class, at least `FLOOR`.

*Calibration* takes every name of every case, counted or not: a probability has to be honest about
faint effects too. A name is right there if it is physically there, and also if its class is.

A case that broke down counts as a failure, for a user would have had nothing.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests import rig

Row = dict[str, Any]
SURE = 25.0
"""Fall of chi-square that leaves no doubt, beyond 2 for every number that was added."""
TIE = 2 * math.log(20.0)
"""Chi-square up to which two fits cannot be told apart: odds of 20 to 1."""
FLOOR = 1e-6
EDGES = (0.0, 0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.99, 1.0)


class Seen(NamedTuple):
    """What the oracle says of a case."""

    tellable: bool
    classes: tuple[frozenset[str], ...]
    """Of each hidden effect."""


def seen(row: Row) -> Seen:
    """From the oracle's line."""
    fits = {frozenset(k.split("+")) if k else frozenset(): v for k, v in row["fits"].items()}
    fits = {k: (chi2, n) for k, (chi2, n) in fits.items() if chi2 is not None}
    hidden = frozenset(row["hidden"])
    known = hidden & set(rig.NAMES)
    base, numbers = fits[frozenset()]
    chi2, many = fits.get(known, (math.inf, numbers)) if known else (math.inf, numbers + 1)
    best = min(chi2, row["truth"])
    limit = SURE + 2 * (many - numbers)
    without = [fits[s][0] for s in (known - {x} for x in known) if s in fits] or [base]
    tellable = bool(hidden) and all(left - best > limit for left in without)
    level = min(chi2 + many, row["truth"]) + TIE
    classes = []
    for x in row["hidden"]:
        rest = known - {x}
        names = {
            next(iter(s - rest))
            for s, (left, n) in fits.items()
            if rest < s and len(s) == len(known) and left + n <= level
        }
        classes.append(frozenset({x} | (names if x in known else set())))
    return Seen(tellable, tuple(classes))


def likeliest(row: Row) -> str | None:
    """The first name; None if there is no name at all."""
    if row.get("error"):
        return None
    names = row["named"] if "named" in row else [c[0] for c in row["candidates"]]
    return names[0] if names else None


def named(row: Row, count: int) -> list[str]:
    """The names given; of methods that only rank, as many as are hidden."""
    if row.get("error"):
        return []
    return list(row["named"][:count]) if "named" in row else list(row["added"])


def log_probability(row: Row, s: Seen) -> float | None:
    """Mean over the hidden effects of the log probability of their classes, nats."""
    if row.get("error") or "candidates" not in row:
        return math.log(FLOOR) if row.get("error") else None
    given = {c[0]: c[1] for c in row["candidates"]}
    sums = [sum(given.get(x, 0.0) for x in each) for each in s.classes]
    return float(np.mean([math.log(min(1.0, max(x, FLOOR))) for x in sums]))


def family_first(row: Row, s: Seen) -> bool | None:
    """Whether the likeliest family and place is the hidden effect's, or one of its class's."""
    if "families" not in row:
        return None
    first = {e for f in row["families"][:1] for e, _ in f[3]}
    return bool(first & s.classes[0])


def each_class(row: Row, s: Seen) -> bool:
    """Whether every hidden effect is named, or stood for by a member of its class."""
    names = named(row, len(s.classes))
    return any(
        all(n in c for n, c in zip(some, s.classes, strict=True))
        for some in itertools.permutations(names, len(s.classes))
    )


def none_besides(row: Row, s: Seen) -> bool:
    """The same, and nothing else is named."""
    return each_class(row, s) and len(named(row, len(s.classes))) == len(s.classes)


def by_name(row: Row, s: Seen) -> bool | None:
    """The hidden effect and nothing else, where no other name does as well."""
    alone = all(len(c) == 1 for c in s.classes)
    return sorted(named(row, len(s.classes))) == sorted(row["hidden"]) if alone else None


def verdict(wanted: str) -> Callable[[Row, Seen], bool | None]:
    """Whether that is the verdict; None for methods without one."""
    return lambda r, s: (
        r["verdict"] == wanted if "verdict" in r else (False if "error" in r else None)
    )


def left_over(row: Row, s: Seen) -> bool | None:
    """Unexplained, where the names leave more than the true motion does, beyond doubt."""
    left = row.get("chi2")
    if left is None or left["last"] - left["truth"] <= SURE + 2:
        return None
    return row["verdict"] == "unexplained"


def held_out(row: Row, s: Seen) -> bool | None:
    """Error over the last third, predicted, within 5 % of the noise there."""
    held = row.get("held_out")
    return None if held is None else held["last"] <= 1.05 * held["floor"]


Question = Callable[[Row, Seen], "bool | float | None"]
QUESTIONS: tuple[tuple[str, str, Question], ...] = (
    ("single", "mean log probability of the class, nats", log_probability),
    ("single", "class first", lambda r, s: likeliest(r) in s.classes[0]),
    ("single", "family and place first", family_first),
    ("single", "class named, none besides", none_besides),
    ("single", "alone and by name, where no other does as well", by_name),
    ("single", 'verdict "missing"', verdict("missing")),
    ("single", "last third, not fitted, within 5 % of the noise", held_out),
    ("none", 'verdict "adequate"', verdict("adequate")),
    ("none", "nothing named", lambda r, s: not r.get("error") and not named(r, 1)),
    ("outside", 'verdict "unexplained"', verdict("unexplained")),
    ("outside", '"unexplained", where names leave something', left_over),
    ("pairs", "mean log probability of a class, nats", log_probability),
    ("pairs", "both classes named", each_class),
    ("pairs", "both classes named, none besides", none_besides),
)


def summary(columns: Mapping[str, Sequence[Row]], told: Mapping[str, Seen]) -> str:
    """Every question by column."""
    lines = []
    for what in ("single", "outside", "pairs"):
        some = [[told[r["key"]].tellable for r in rows if r["what"] == what]
                for rows in columns.values()]  # fmt: skip
        if any(some):
            lines.append(
                [f"{what}: the oracle could not tell", *(share([not x for x in s]) for s in some)]
            )
    for what, words, ask in QUESTIONS:
        cells = []
        for rows in columns.values():
            here = [(r, told[r["key"]]) for r in rows if r["what"] == what]
            answers = [ask(r, s) for r, s in here if what == "none" or s.tellable]
            known = [a for a in answers if a is not None]
            numbers = [a for a in known if not isinstance(a, bool)]
            cells.append(f"{np.mean(numbers):.3f} ({len(numbers)})" if numbers else share(known))
        if any(c != "-" for c in cells):
            lines.append([f"{what}: {words}", *cells])
    sure = [[g for g in given(rows, told) if g[0] >= 0.9] for rows in columns.values()]
    lines.append(["names given 90 % or more: there", *(share([g[1] for g in s]) for s in sure)])
    lines.append(["the same: there, or of the class", *(share([g[2] for g in s]) for s in sure)])
    for words, key, how in (
        ("seconds, median", "seconds", np.median),
        ("seconds, worst", "seconds", np.max),
        ("CPU s, median", "cpu", np.median),
        ("peak memory, MB, worst", "peak_mb", np.max),
    ):
        each = [[r[key] for r in rows if key in r] for rows in columns.values()]
        if any(each):
            lines.append([words, *(f"{how(x):.3g}" if x else "-" for x in each)])
    return table(["", *columns], lines)


def given(rows: Sequence[Row], told: Mapping[str, Seen]) -> list[tuple[float, bool, bool, str]]:
    """Every name of every case: its probability, whether it is there, or its class, and where."""
    return [
        (p, e in r["hidden"], any(e in c for c in told[r["key"]].classes), f"{e} in {r['key']}")
        for r in rows
        if not r.get("error")
        for e, p, *_ in r.get("candidates", ())
    ]


def calibration(names: Sequence[tuple[float, bool, bool, str]]):
    """Table, and (mean probability, share physically there, how many) of each bin."""
    points, lines = [], []
    for low, high in itertools.pairwise(EDGES):
        some = [g for g in names if low <= g[0] < high or (high == 1.0 and g[0] >= 1.0)]
        if some:
            mean, there, either = np.mean([g[:3] for g in some], axis=0)
            points.append((float(mean), float(there), len(some)))
            lines.append(
                [
                    f"{low:g} to {high:g}",
                    f"{mean:.3f}",
                    f"{there:.3f}",
                    f"{either:.3f}",
                    f"{len(some)}",
                ]
            )
    head = ["probability given", "its mean", "share there", "there, or of the class", "names"]
    return table(head, lines), points


def draw(points: Sequence[tuple[float, float, int]], path: str | Path) -> None:
    """The calibration curve: on the diagonal, a probability means what it says."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    mean, there, many = np.array(points).T
    z = 1.96  # Wilson's interval: honest where all or none of a few are there
    middle = (there + z**2 / (2 * many)) / (1 + z**2 / many)
    half = z / (1 + z**2 / many) * np.sqrt(there * (1 - there) / many + (z / (2 * many)) ** 2)
    figure, axes = plt.subplots(figsize=(4.2, 4.2), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1, zorder=0)
    axes.vlines(mean, middle - half, middle + half, color="0.3", lw=1.2)
    axes.plot(mean, there, "o", color="C0", ms=5)
    axes.set(xlabel="probability given to a name", ylabel="share of such names physically there")
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def by_label(rows: Sequence[Row], told: Mapping[str, Seen]) -> str:
    """Class first (outside: unexplained) of counted, the log probability, and what came instead."""
    noises = sorted({row["noise"] for row in rows})
    own: dict[str, list[Row]] = {}
    for row in rows:
        if row["what"] in ("single", "outside") and told[row["key"]].tellable:
            own.setdefault(row["hidden"][0], []).append(row)
    lines = []
    for label, some in own.items():
        good = [_as_hoped(r, told[r["key"]]) for r in some]
        cells = [
            share([g for g, r in zip(good, some, strict=True) if r["noise"] == n]) for n in noises
        ]
        logs = [log_probability(r, told[r["key"]]) for r in some]
        logs = [x for x in logs if x is not None] if some[0]["what"] == "single" else []
        wrong = [
            r
            for r, g in zip(some, good, strict=True)
            if not g or (r["what"] == "single" and named(r, 1) != r["hidden"])
        ]
        instead = Counter("+".join(named(r, 1)) or r.get("verdict", "error") for r in wrong)
        cells += [f"{np.mean(logs):.2f}" if logs else "-"]
        cells += [", ".join(f"{k} ({n})" if n > 1 else k for k, n in instead.most_common())]
        lines.append([label, *cells])
    head = ["hidden", *(f"{100 * n:g} %" for n in noises), "log probability", "named instead"]
    return table(head, lines)


def _as_hoped(row: Row, s: Seen) -> bool:
    if row.get("error"):
        return False
    if row["what"] in ("none", "outside"):
        return row["verdict"] == {"none": "adequate", "outside": "unexplained"}[row["what"]]
    return none_besides(row, s) if row["what"] == "pairs" else likeliest(row) in s.classes[0]


def misses(rows: Sequence[Row], told: Mapping[str, Seen]) -> list[str]:
    """Every counted case that came out otherwise."""
    out = []
    for r in rows:
        s = told[r["key"]]
        if (r["what"] == "none" or s.tellable) and not _as_hoped(r, s):
            if r.get("error"):
                out.append(f"- {r['key']}: {r['error']}")
                continue
            top = ", ".join(f"{c[0]} {c[1]:.2g}" for c in r["candidates"][:3])
            left = f"chi2 {r['chi2']['last']:.0f}, of the truth {r['chi2']['truth']:.0f}"
            out.append(
                f"- {r['key']}: {'+'.join(r['added']) or 'nothing'}, {r['verdict']}; {top}; {left}"
            )
    return out


def bic(row: Row) -> Row | None:
    """The plain rival's answer: the least chi-square + (numbers) ln (readings) of every effect
    fitted alone, and of none; from an oracle's line that has them all."""
    if not set(rig.NAMES) <= set(row["fits"]) or row["what"] == "pairs":
        return None
    scores = {
        k: chi2 + n * math.log(row["readings"])
        for k, (chi2, n) in row["fits"].items()
        if chi2 is not None
    }
    best = min(scores, key=lambda k: scores[k])
    return {k: row[k] for k in ("key", "what", "hidden", "noise")} | {
        "named": [best] if best else []
    }


def counted(rows: Sequence[Row]) -> str:
    """What a run says by itself, without an oracle, in Markdown: what the readings cannot tell
    counts as missed, as does each of two names for the same."""
    right = {"single": "missing", "none": "adequate", "outside": "unexplained", "pairs": "missing"}
    lines = [
        "| hidden, noise | verdict | named, none besides | names given 90 % or more: there |",
        "| --- | --- | --- | --- |",
    ]
    kinds = sorted({(r["what"], r["noise"]) for r in rows})
    groups = {f"{w}, {100 * n:g} %": [r for r in rows if (r["what"], r["noise"]) == (w, n)]
              for w, n in kinds}  # fmt: skip
    groups["a slipping brake alone"] = [
        r for r in rows if r["what"] == "single" and r["hidden"][0].startswith("brake_slip")
    ]
    for label, own in groups.items():
        sure = [(x, r) for r in own for x, p in r.get("candidates", ()) if p >= 0.9]
        shares = (
            [r.get("verdict") == right[r["what"]] for r in own],
            [set(r.get("added", ["-"])) == set(r["hidden"]) & set(rig.NAMES) for r in own],
            [x in r["hidden"] for x, r in sure],
        )
        lines.append(f"| {label} | {' | '.join(f'{sum(x)} of {len(x)}' for x in shares)} |")
    return "\n".join(lines)


def report(
    rows: Sequence[Row],
    oracle: Sequence[Row],
    others: Mapping[str, Sequence[Row]],
    picture: Path | None,
) -> str:
    """All of it, in Markdown."""
    told = {r["key"]: seen(r) for r in oracle if not r.get("error")}
    known = [r for r in rows if r["key"] in told]
    noises = sorted({r["noise"] for r in known})
    lists, points = calibration(given(known, told))
    if picture and points:
        draw(points, picture)
    worst = sorted((g for g in given(known, told) if not g[1] and g[0] >= 0.5), reverse=True)[:15]
    parts = [
        f"{len(known)} cases, {sum('error' in r for r in known)} broken; "
        f"{len(rows) - len(known)} that the oracle has not seen are left out.",
        summary(
            {f"noise {100 * n:g} %": [r for r in known if r["noise"] == n] for n in noises}, told
        ),
        by_label(known, told),
        "What came out otherwise (of cases that the oracle could tell):",
        "\n".join(misses(known, told)) or "- nothing",
        "Calibration:",
        lists,
        "The most confident names that are not physically there:",
        "\n".join(f"- {g[0]:.3f} {g[3]}{', of its class' if g[2] else ''}" for g in worst)
        or "- none",
    ]
    methods = {}
    for name, theirs in others.items():
        for method in dict.fromkeys(r.get("method", "") for r in theirs):
            methods[" ".join(filter(None, (name, method)))] = [
                r for r in theirs if r.get("method", "") == method
            ]
    least = [r for r in map(bic, (r for r in oracle if r["key"] in told)) if r]
    if least:
        methods["BIC, every effect refitted"] = least
    for name, theirs in methods.items():
        keys = {r["key"] for r in theirs} & {r["key"] for r in known}
        both = {"residyn": known, name: theirs}
        both = {k: [r for r in each if r["key"] in keys] for k, each in both.items()}
        parts += [f"Beside {name}, the same cases:", summary(both, told)]
    return "\n\n".join(parts)


def share(answers: Sequence[Any]) -> str:
    """ "97.5 % (39 of 40)"."""
    return f"{100 * np.mean(answers):.1f} % ({sum(answers)} of {len(answers)})" if answers else "-"


def table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    return "\n".join(
        "| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *lines)
    )
