"""A fit as tables for a paper: LaTeX with the package booktabs and no other, and CSV.

In LaTeX a value ends where its standard error begins: the error has one digit, or two if the first
is a 1. The CSV has every digit.
"""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from ..reporting.numbers import plain, prefixed

if TYPE_CHECKING:
    from .result import Fit

NEEDS = r"% needs \usepackage{booktabs}"
_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "µ": r"\textmu{}",
    "²": "$^2$",
    "³": "$^3$",
} | {c: f"\\{c}" for c in "&%$#_{}"}
# Of a joint whose unit is not known.
_FACTORS = {"×10⁻³": r"$\times 10^{-3}$", "×10⁻⁶": r"$\times 10^{-6}$"}


# -- the fit ---------------------------------------------------------------------------------


def latex(fit: "Fit") -> str:
    """Numbers with errors, modes, residuals."""
    rows = []
    for n in fit.numbers:
        label, _, _ = n.name.rpartition(".")
        error = measured(n.value, n.std) if n.determined else "not determined"
        rows.append([effect(label), escaped(n.words), error, unit(n.unit)])
    ending: list[list[str]] = []
    for i, m in enumerate(fit.modes, 1):
        frequency = measured(m.frequency_hz, m.frequency_hz_std)
        ending.append([f"mode {i}", "natural frequency", frequency, "Hz"])
        damping = measured(m.damping_ratio, m.damping_ratio_std)
        ending.append([f"mode {i}", "damping ratio", damping, "1"])
    left: list[list[str]] = []
    for name, what in (("rmse", "rms residual"), ("check_rmse", "rms residual, held out")):
        for _, joint, size, own in (row for row in residuals(fit) if row[0] == name):
            factor, short = prefixed(own, size)
            left.append([escaped(joint), what, scientific(plain(size / factor)), unit(short)])
    left.append(["all", r"reduced $\chi^2$", scientific(plain(fit.reduced_chi2)), "1"])
    return table("llrl", ["Where", "Quantity", "Value", "Unit"], [rows, ending, left])


def comma_separated(fit: "Fit") -> str:
    """One line for each number: name, value, std, unit."""
    rows: list[Sequence[object]] = [(n.name, n.value, n.std, n.unit) for n in fit.numbers]
    for i, m in enumerate(fit.modes, 1):
        rows.append((f"mode{i}.frequency", m.frequency_hz, m.frequency_hz_std, "Hz"))
        rows.append((f"mode{i}.damping_ratio", m.damping_ratio, m.damping_ratio_std, "1"))
    rows += [(f"{name}:{joint}", x, None, unit) for name, joint, x, unit in residuals(fit)]
    rows.append(("reduced_chi2", fit.reduced_chi2, None, "1"))
    return lines(("name", "value", "std", "unit"), rows)


def residuals(fit: "Fit") -> list[tuple[str, str, float, str]]:
    """(name, joint, value, unit) of every rms residual, and of the noise."""
    units = fit.experiment.units or ("",) * len(fit.joints)
    each = [("rmse", fit.rmse), ("check_rmse", fit.check_rmse), ("noise", fit.noise)]
    return [
        (name, joint, float(x), u)
        for name, sizes in each
        if sizes is not None
        for joint, u, x in zip(fit.joints, units, sizes, strict=True)
    ]


# -- LaTeX -----------------------------------------------------------------------------------


def table(
    columns: str, head: Sequence[str], blocks: Iterable[Sequence[Sequence[str]]], over: str = ""
) -> str:
    """A `tabular` of rows in blocks with a rule between them; empty blocks are left out. `over`
    are lines above the head."""
    text = [NEEDS, rf"\begin{{tabular}}{{{columns}}}", r"\toprule", over + _row(head)]
    for block in blocks:
        if block:
            text += [r"\midrule", *map(_row, block)]
    return "\n".join([*text, r"\bottomrule", r"\end{tabular}"]) + "\n"


def _row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def measured(value: float, std: float) -> str:
    r"""`$16.67 \pm 0.02$`; the value alone where its error is not known."""
    if not math.isfinite(value):
        return "--"
    if not (math.isfinite(std) and std > 0):
        return scientific(plain(value, 4))
    last = _last_digit(std)
    size = math.floor(math.log10(max(abs(value), std)))
    if -4 < size < 6 and last <= 0:
        return rf"${value:.{-last}f} \pm {std:.{-last}f}$"
    digits = max(0, size - last)
    parts = rf"{value / 10**size:.{digits}f} \pm {std / 10**size:.{digits}f}"
    return rf"$({parts}) \times 10^{{{size}}}$"


def _last_digit(std: float) -> int:
    """Power of ten at which an error ends."""
    power = math.floor(math.log10(std))
    first = round(std / 10.0**power, 1)
    if first >= 9.5:
        return power  # it is rounded up to 10, which has two digits
    return power - 1 if first < 2 else power


def scientific(number: str) -> str:
    r"""A number as `plain` writes it, in mathematics: `1.2e-05` is `$1.2 \times 10^{-5}$`."""
    if number == "?":
        return "--"
    digits, _, power = number.partition("e")
    return rf"${digits} \times 10^{{{int(power)}}}$" if power else f"${digits}$"


def unit(name: str) -> str:
    r"""A unit in upright letters: `N m/rad^2` is `N\,m/rad$^2$`."""
    if name in _FACTORS:
        return _FACTORS[name]
    text = "".join(_SPECIAL.get(c, c) if c != "^" else c for c in name)
    parts = text.split("^")
    raised = [f"$^{{{part[:1]}}}${part[1:]}" for part in parts[1:]]
    return "".join([parts[0], *raised]).replace(" ", r"\,") or "1"


def escaped(words: str) -> str:
    """Words that LaTeX shows as they are."""
    return "".join(_SPECIAL.get(c, c) for c in words)


def effect(label: str) -> str:
    """`coulomb_friction:elbow` is "coulomb friction, elbow"."""
    name, _, place = label.partition(":")
    return escaped(name.replace("_", " ") + (f", {place}" if place else ""))


# -- CSV -------------------------------------------------------------------------------------


def lines(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Comma-separated values; what is not known or not finite is left empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_cell(x) for x in row] for row in rows)
    return out.getvalue()


def _cell(x: object) -> object:
    if x is None:
        return ""
    if isinstance(x, str):
        return x
    number = float(x)  # pyright: ignore[reportArgumentType]
    return repr(number) if math.isfinite(number) else ""
