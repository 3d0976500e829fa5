"""Numbers, units and words as LaTeX shows them, with the package booktabs and no other.

A value ends where its standard error begins: the error has one digit, or two if the first is a 1.
"""

import math
import re

from .numbers import plain

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


def measured(value: float, std: float) -> str:
    r"""`$16.67 \pm 0.02$`; the value alone where its error is not known."""
    if not math.isfinite(value):
        return "--"
    if not (math.isfinite(std) and std > 0):
        return scientific(plain(value, 4))
    last = _last_digit(std)
    size = math.floor(math.log10(max(abs(value), std)))
    if -4 < size < 6 and last <= 0:
        return rf"${value:z.{-last}f} \pm {std:.{-last}f}$"
    digits = max(0, size - last)
    parts = rf"{value / 10**size:z.{digits}f} \pm {std / 10**size:.{digits}f}"
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
    if number in ("?", "--"):
        return "--"
    digits, _, power = number.partition("e")
    return rf"${digits} \times 10^{{{int(power)}}}$" if power else f"${digits}$"


def unit(name: str) -> str:
    r"""A unit in upright letters: `N m/rad^2` is `N\,m/rad$^2$`."""
    if name in _FACTORS:
        return _FACTORS[name]
    text = "".join(_SPECIAL.get(c, c) if c != "^" else c for c in name)
    return re.sub(r"\^(.)", r"$^{\1}$", text).replace(" ", r"\,") or "1"


def escaped(words: str) -> str:
    """Words that LaTeX shows as they are."""
    return "".join(_SPECIAL.get(c, c) for c in words)
