"""Numbers as people read them: a unit of a fitting size, and no more digits than are known.

`measured` is the one place where a value meets its standard error in text.
"""

import math
import re

_SMALLER = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"))
_BARE = ((1.0, ""), (1e-3, "×10⁻³"), (1e-6, "×10⁻⁶"))  # of a joint whose unit is not known
_CERTAIN = 0.995
_STICKS = re.compile(
    r"(?<=[\d±<>=]) (?=[\d±%])|(?<=\bp) (?=[<=])|(?<=[\d?]) (?=\+/-)|(?<=\+/-) "
    r"|(?<=[\d?]) (?=(?:N|kg|[mµ]?m|[mµ]?rad|deg|s|Hz|nats|x)\b)|(?<=\bx) (?=noise)"
    r"|(?:(?<=\bN)|(?<=\bkg)|(?<=\bN m)|(?<=\(rad)|(?<=\(m)) (?=[ms]\b)"
)
"""Spaces of numbers with signs and units, and inside units."""


def prefixed(unit: str | None, size: float) -> tuple[float, str]:
    """The unit in which a quantity of this size reads as 0.1 or more.

    **Returns:** the size of that unit in `unit`, and its name; "" is a number of unknown unit.
    """
    choices = _BARE if not unit else ((1.0, unit),)
    if unit and unit.startswith(("rad", "m")):
        choices = [(factor, prefix + unit.replace("^2", "²")) for factor, prefix in _SMALLER]
    if not (math.isfinite(size) and size > 0):
        return choices[0]
    return next((c for c in choices if abs(size) >= 0.1 * c[0]), choices[-1])


def amount(value: float, unit: str | None, digits: int = 3) -> str:
    """`value`, given in `unit`, as text: 0.00123 rad reads "1.23 mrad"."""
    factor, name = prefixed(unit, abs(value))
    return f"{plain(value / factor, digits)} {name}".strip()


def plain(value: float, digits: int = 3) -> str:
    """`value` to some significant digits, without an exponent where people would write none."""
    if not math.isfinite(value):
        return "?"
    if value == 0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    if -4 <= power < max(6, digits):
        return f"{value:.{max(0, digits - 1 - power)}f}"
    return f"{value:.{digits - 1}e}"


def with_error(value: float, std: float) -> tuple[str, str]:
    """Value and standard error as text, both ending at the error's second digit."""
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return plain(value, 6), plain(std, 2)
    last = math.floor(math.log10(std)) - 1
    size = max(abs(value), std)
    if last < -9 or size >= 1e6 or size < 1e-4:
        digits = min(max(1, math.floor(math.log10(size)) - last), 15)  # a float has no more
        return f"{value:.{digits}e}", f"{std:.1e}"
    # z: what rounds to nothing has no sign.
    return f"{value:z.{max(0, -last)}f}", f"{std:.{max(0, -last)}f}"


def measured(value: float, std: float, unit: str = "1") -> str:
    """ "0.2003 +/- 0.0012 N m"; without the error where it is NaN, "?" where it has no bound."""
    after = "" if unit in ("1", "") else f" {unit}"
    if not math.isfinite(std):
        return f"{plain(value, 4)}{' +/- ?' if std == math.inf else ''}{after}"
    return f"{' +/- '.join(with_error(value, std))}{after}"


def times(value: float) -> str:
    """How many times, to two digits: 0.98 reads "1.0", as the third digit says nothing."""
    if value >= 1e4:
        return f"{value:.1e}"
    return f"{value:.{0 if value >= 9.95 else 1}f}" if value >= 0.1 else plain(value, 2)


def change(before: float, after: float, three: bool = False) -> str:
    """How a size goes: "falls from 46 to 15", "rises from 1.0 to 1.1", "stays 1.0"; `three`
    digits."""
    first, last = (plain(x) if three else times(x) for x in (before, after))
    if first == last:
        return f"stays {times(before)}"
    return f"{'falls' if after < before else 'rises'} from {first} to {last}"


def percent(probability: float) -> str:
    """A probability: never 100 %, as nothing measured is certain."""
    if not math.isfinite(probability):
        return "?"
    if probability > _CERTAIN:
        return "> 99 %"
    return "< 1 %" if probability < 1 - _CERTAIN else f"{100 * probability:.0f} %"


def share(part: float) -> str:
    """A share as per cent: "3.1 %", "< 0.01 %"."""
    if not math.isfinite(part):
        return "?"
    return "< 0.01 %" if 0 < part < 1e-4 else f"{plain(100 * part, 2)} %"


def nats(log_evidence: float) -> str:
    """A log evidence relative to the best model's."""
    if not math.isfinite(log_evidence):
        return "-"
    if abs(log_evidence) < 0.05:
        return "0"
    return f"{log_evidence:.1f}" if abs(log_evidence) < 99.95 else f"{log_evidence:.0f}"


def p_value(p: float, threshold: float) -> str:
    """A p-value beside the threshold that it is compared with."""
    size = p_size(p)
    return f"p {size if size[0] == '<' else f'= {size}'}, threshold {threshold:g}"


def p_size(p: float) -> str:
    """A p-value; less than 1e-12 is hardly more than rounding."""
    return "< 1e-12" if p < 1e-12 else f"{p:.1g}" if p < 0.095 else f"{p:.2f}"


def glued(words: str) -> str:
    """With spaces that do not break where numbers stay with their signs and units."""
    return _STICKS.sub("\u00a0", words)
