"""When the diagnosis of a case is right.

Only cases that the oracle could tell are counted in shares of success; a run that ended in an error
counts as a failure, for a user would have had nothing. The calibration curve takes every case,
counted or not: a probability has to be honest about faint effects too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Row = dict[str, Any]
TIE = 2.0
"""A wrong name whose fit is worse by less than this in chi-square could not be told from the right
one."""
NEAR = 1.05


def read(paths: Iterable[str | Path]) -> list[Row]:
    """All lines; of a case that was run twice, the later."""
    rows = [json.loads(line) for path in paths for line in Path(path).read_text().splitlines()]
    return list({(row["key"], row.get("method")): row for row in rows}.values())


def counts(row: Row) -> bool:
    """Whether success is asked for: the oracle could tell it, or the diagnosis broke down."""
    if row.get("error"):
        return row["error"] == "diagnose"
    return row["what"] == "none" or row["oracle"]["tellable"]


def exact(row: Row) -> bool:
    """The hidden effects are named, and nothing else."""
    return not row.get("error") and sorted(row["added"]) == sorted(row["hidden"])


def tied(row: Row) -> bool:
    """Exactly right, or one name instead that accounts for the readings as well as the truth."""
    one = not row.get("error") and len(row["added"]) == 1
    return exact(row) or (one and row.get("wrong_over_right", np.inf) < TIE)


def grouped(row: Row) -> bool:
    """Every hidden effect was added, or stands in the look-alike group of one that was."""
    if row.get("error"):
        return False
    groups = [set(group) for group in row["lookalikes"]]
    said = set(row["added"]).union(*[g for g in groups if g & set(row["added"])])
    return set(row["hidden"]) <= said


def first_right(row: Row) -> bool:
    return not row.get("error") and row["added"][:1] == row["hidden"][:1]


def verdict(wanted: str) -> Callable[[Row], bool]:
    return lambda row: not row.get("error") and row["verdict"] == wanted


def held_out(row: Row) -> bool | None:
    """Error over the last third, predicted, within 5 % of what the noise there amounts to."""
    held = row.get("held_out")
    return None if held is None else held["last"] <= NEAR * held["floor"]


def held_out_fair(row: Row) -> bool | None:
    """The same, beside a right model's error, whose numbers the noise has shifted, too."""
    held = row.get("held_out")
    if held is None or held["expected"] is None:
        return None
    return held["last"] <= NEAR * held["floor"] * max(1.0, held["expected"])


def left_over(row: Row) -> bool:
    """More is left after the ladder than the true motion leaves, beyond doubt."""
    return not row.get("error") and row["chi2"]["last"] - row["chi2"]["truth"] > 27.0


QUESTIONS: dict[str, tuple[tuple[str, Callable[[Row], bool | None]], ...]] = {
    "single": (
        ("first name right, none besides", exact),
        ("the same, or a name that fits as well", tied),
        ("first name right", first_right),
        ("truth named or a look-alike of a name", grouped),
        ('verdict "missing"', verdict("missing")),
        ("held-out error within 5 % of the noise", held_out),
        ("held-out error within 5 % of a right model's", held_out_fair),
    ),
    "none": (('verdict "adequate"', verdict("adequate")), ("no name", exact)),
    "outside": (
        ('verdict "unexplained"', verdict("unexplained")),
        (
            'verdict "unexplained", where names leave something',
            lambda row: verdict("unexplained")(row) if left_over(row) or row.get("error") else None,
        ),
    ),
    "pairs": (
        ("both named", lambda r: not r.get("error") and set(r["hidden"]) <= set(r["added"])),
        ("both named, none besides", exact),
        ("both named or look-alikes of names", grouped),
        ("held-out error within 5 % of the noise", held_out),
        ("held-out error within 5 % of a right model's", held_out_fair),
    ),
}


def share(answers: Sequence[bool | None]) -> str:
    """ "97.5 % (39 of 40)"."""
    known = [bool(a) for a in answers if a is not None]
    return f"{100 * np.mean(known):.1f} % ({sum(known)} of {len(known)})" if known else "-"


def table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Markdown."""
    return "\n".join(
        "| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *lines)
    )
