"""Two models of the same recordings, side by side.

Which one the readings speak for is told by BIC, chi-square + k ln N with k numbers and N readings
(Schwarz, Ann. Statist. 6, 1978). Where even the better model leaves more than noise, chi-square is
taken in units of what that one leaves (Burnham and Anderson, 2002, section 2.5), since a model that
is wrong cannot be surer of itself than it is right.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..fitting.result import Fit
from .fit import joint_errors
from .layout import Table, printed
from .names import HELD_OUT, base_name, upper
from .numbers import plain, times, with_error

_STRONG, _SLIGHT = 10.0, 2.0
"""Differences of BIC that are very strong evidence, and hardly any (Kass and Raftery, J. Am. Stat.
Assoc. 90, 1995)."""


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Two fits of one experiment. Print it; `to_dict()` is the JSON."""

    one: Fit
    other: Fit

    @property
    def bic(self) -> float:
        """BIC of the first model less that of the second one: below zero it speaks for the first,
        over the readings that both fits use."""
        fits = self.one, self.other  # put together again: they may have been cut differently
        sides = [[r for r in fit.whole if r.recording.role != "check"] for fit in fits]
        both = [a.used & b.used for a, b in zip(*sides, strict=True)]
        count = sum(int(used.sum()) for used in both)
        one, other = (
            sum(np.sum((r.residual / r.recording.noise)[used] ** 2) for r, used in each)
            for each in (zip(side, both, strict=True) for side in sides)
        )
        unit = max(1.0, min(one, other) / max(1, count))
        numbers = len(self.one.numbers) - len(self.other.numbers)
        return float((one - other) / unit + numbers * math.log(count))

    @property
    def verdict(self) -> str:
        """Which of them the readings speak for, in a sentence."""
        size, better = abs(self.bic), "A" if self.bic < 0 else "B"
        if size < _SLIGHT:
            return f"The readings do not tell A from B (BIC differs by {plain(size, 2)})."
        how = "clearly " if size > _STRONG else "somewhat "
        return f"The readings speak {how}for {better} (BIC lower by {plain(size, 3)})."

    def to_dict(self) -> dict[str, Any]:
        """The JSON: both fits, and `bic`, of the first less the second."""
        return {"fits": [self.one.to_dict(), self.other.to_dict()], "bic": self.bic}

    def __str__(self) -> str:
        sides = self.one, self.other
        errors = list(zip(*map(joint_errors, sides), strict=True))
        rows = [["reduced chi-square", *(plain(f.reduced_chi2) for f in sides)]]
        for pair in errors:
            cells = (f"{times(e.ratio)} x noise" for e in pair)
            rows.append([f"rms, {pair[0].joint}", *cells])
        for pair in errors if self.one.held_out else ():
            cells = (f"{times(e.check_ratio or math.nan)} x noise" for e in pair)
            rows.append([f"{HELD_OUT} rms, {pair[0].joint}", *cells])
        each = [{n.name: n for n in fit.own_numbers} for fit in sides]
        for n in {**each[1], **each[0]}.values():
            both = (own.get(n.name) for own in each)
            cells = (" +/- ".join(with_error(x.value, x.std)) if x else "-" for x in both)
            rows.append([f"{n.name}{'' if n.unit == '1' else f', {n.unit}'}", *cells])
        lines = [f"{x}: {base_name(fit)}" for x, fit in zip("AB", sides, strict=True)]
        lines += ["", *printed(Table(["[[Side by side]]", "A", "B"], rows), indent=0)]
        return "\n".join([*lines, "", self.verdict])


def headings(found: SideBySide) -> list[tuple[str, Fit]]:
    return [(upper(base_name(fit)), fit) for fit in (found.one, found.other)]
