"""One clear line for everything that is wrong with what a user gives.

A mistake in a file is not a bug: the user needs one line that names the file, the line or the key,
and what would be right. Every reader of input raises `InputError` with such a line, and nothing
else; `inside` adds where we are as the error travels outwards.
"""

import contextlib
import difflib
import importlib
import math
from collections.abc import Iterable, Iterator
from typing import Any

LARGEST = 1e30
"""In any unit, this and more is no measured number."""
_LINE = 900
"""Characters of a line that anybody reads."""


class InputError(ValueError):
    """Wrong user input: one line naming file, line or key, and what would be right."""

    def __init__(self, message: str):
        # Names and cells come from files: they must not break the line, nor steer a terminal.
        line = " ".join(str(message).split())
        line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
        super().__init__(line if len(line) <= _LINE else f"{line[: _LINE // 2]} ... {line[-300:]}")


class MissingExtra(ImportError):
    """A package that only an extra of this one brings is not installed: one line that says so."""


def extra(module: str, needed: str) -> Any:
    """A module of a package that only an extra of this one brings.

    **Raises:** `MissingExtra` in the words `needed` if that package is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if (error.name or "").partition(".")[0] != module.partition(".")[0]:
            raise
        raise MissingExtra(needed) from None


@contextlib.contextmanager
def inside(where: str) -> Iterator[None]:
    """Put `where` in front of any InputError raised within."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def quote(value: Any) -> str:
    """How a user would recognise what they wrote, shortened."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = f'"{value}"'
    else:
        try:
            text = str(value)
        except ValueError:  # Python refuses to print integers of thousands of digits
            text = "a huge number"
    return text if len(text) <= 40 else text[:37] + "..."


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """A hint at the known word that is closest to a wrong one; empty if none is close."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)
    return f"did you mean {quote(close[0])}?" if close else ""


def number(
    key: str, value: Any, unit: str, *, above: float | None = None, least: float | None = None
) -> float:
    """`value` as a float of at most `LARGEST`, in `unit`, and greater than `above`, not less than
    `least`."""
    what = f"a number ({unit})"
    if above is not None:
        what = f"a number above {above:g} ({unit})"
    elif least is not None:
        what = f"a number not below {least:g} ({unit})"
    try:
        if isinstance(value, (bool, str, bytes)):
            raise TypeError
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if LARGEST < abs(result) < math.inf:
        what += f", {LARGEST:g} at most"
    with contextlib.suppress(ValueError):
        if isinstance(value, str) and math.isfinite(float(value.replace(",", "."))):
            what += f", without quotes{', with a decimal point' * (',' in value)}"
    low = (above is not None and result <= above) or (least is not None and result < least)
    if low or not abs(result) <= LARGEST:
        raise InputError(f"{key} = {quote(value)}: must be {what}") from None
    return result


def flag(key: str, value: Any) -> bool:
    """`value`, which must be true or false."""
    if not isinstance(value, bool):
        raise InputError(f"{key} = {quote(value)}: must be true or false")
    return value


def entries(key: str, value: Any, right: str, count: int | None = None) -> list[Any]:
    """`value`, a list, a tuple or an array, as a list; of `count` entries, if that is given.

    `right` says what would be right.
    """
    found = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(found, list | tuple) or count not in (None, len(found)):
        raise InputError(f"{key} = {quote(value)}: must be {right}")
    return list(found)
