"""Two models of the same recordings, side by side.

Which one the readings speak for is told by BIC, chi-square + k ln N with k numbers and N readings
(Schwarz, Ann. Statist. 6, 1978). Where even the better model leaves more than noise, chi-square is
taken in units of what that one leaves (Burnham and Anderson, 2002, section 2.5), since a model that
is wrong cannot be surer of itself than it is right.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..fitting.result import Fit, RecordingFit
from .names import base_name, upper
from .numbers import plain, times, with_error

_LABEL, _CELL = 30, 25
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
        pairs = list(zip(_fitted(self.one), _fitted(self.other), strict=True))
        both = [a.used & b.used for a, b in pairs]
        count = sum(int(used.sum()) for used in both)
        chi2 = [
            sum(
                float(np.sum((r.residual / r.recording.noise)[used] ** 2))
                for r, used in zip(side, both, strict=True)
            )
            for side in zip(*pairs, strict=True)
        ]
        unit = max(1.0, min(chi2) / max(1, count))
        numbers = len(self.one.numbers) - len(self.other.numbers)
        return (chi2[0] - chi2[1]) / unit + numbers * math.log(count)

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
        lines = [f"{x}: {base_name(fit)}" for x, fit in zip("AB", sides, strict=True)]
        head = "[[Side by side]]".ljust(_LABEL) + "A".rjust(_CELL) + "B".rjust(_CELL)
        lines += ["", head]
        lines += [_row("chi-square per reading", [plain(f.reduced_chi2) for f in sides])]
        for role, words in (("fit", "rms"), ("check", "held-out rms")):
            for j, joint in enumerate(self.one.joints):
                sizes = [_times_noise(fit, role, j) for fit in sides]
                if not all(math.isnan(size) for size in sizes):
                    lines.append(_row(f"{words}, {joint}", [f"{times(x)} x noise" for x in sizes]))
        lines += ["", "[[Parameters]]  value +/- standard error"]
        each = [{n.name: n for n in fit.numbers} for fit in sides]
        for name in {n: None for fit in sides for n in (x.name for x in fit.numbers)}:
            cells = [
                " +/- ".join(with_error(n[name].value, n[name].std)) if name in n else "-"
                for n in each
            ]
            unit = next(n[name].unit for n in each if name in n)
            lines += [f"  {name}{'' if unit == '1' else f', {unit}'}", _row("", cells)]
        return "\n".join([*lines, "", self.verdict])


def _row(label: str, cells: Sequence[str]) -> str:
    return f"  {label:{_LABEL - 2}}" + "".join(cell.rjust(_CELL) for cell in cells)


def _fitted(fit: Fit) -> list[RecordingFit]:
    return [r for r in fit.whole if r.recording.role != "check"]


def _times_noise(fit: Fit, role: str, joint: int) -> float:
    """Rms residual of a joint in times the noise; NaN without such recordings."""
    parts = [
        (r.residual / r.recording.noise)[r.used[:, joint], joint]
        for r in fit.whole
        if (r.recording.role == "check") == (role == "check")
    ]
    left = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.sqrt(np.mean(left**2))) if len(left) else math.nan


def headings(found: SideBySide) -> list[tuple[str, Fit]]:
    """The two fits with what a report calls them."""
    return [(upper(base_name(fit)), fit) for fit in (found.one, found.other)]
