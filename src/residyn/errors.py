"""One clear line for everything that is wrong with what a user gives.

A mistake in a file is not a bug: the user needs one line that names the file, the line or the key,
and what would be right. Every reader of input raises `InputError` with such a line, and nothing
else; `inside` adds where we are as the error travels outwards.
"""

import contextlib
import math
import os
import stat
from collections.abc import Iterator
from typing import Any

_LINE = 900
"""Characters of a line that anybody reads."""


class InputError(ValueError):
    """Wrong user input: one line naming file, line or key, and what would be right."""

    def __init__(self, message: str):
        # Names and cells come from files: they must not break the line, nor steer a terminal.
        line = " ".join(str(message).split())
        line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
        super().__init__(line if len(line) <= _LINE else f"{line[: _LINE // 2]} ... {line[-300:]}")


@contextlib.contextmanager
def inside(where: str) -> Iterator[None]:
    """Put `where` in front of any InputError raised within."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def quote(value: Any, most: int = 40) -> str:
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
    return text if len(text) <= most else text[: most - 3] + "..."


def number(
    key: str, value: Any, unit: str, *, above: float | None = None, least: float | None = None
) -> float:
    """`value` as a finite float, in `unit`, and greater than `above`, not less than `least`."""
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
    low = (above is not None and result <= above) or (least is not None and result < least)
    if low or not math.isfinite(result):
        raise InputError(f"{key} = {quote(value)}: must be {what}") from None
    return result


def flag(key: str, value: Any) -> bool:
    """`value`, which must be true or false."""
    if not isinstance(value, bool):
        raise InputError(f"{key} = {quote(value)}: must be true or false")
    return value


_LARGEST = {"TOML file": 10_000_000}
_LARGEST_RECORDING = 300_000_000
"""Bytes: a million samples of ten columns with every digit."""


def read_bytes(path: str | os.PathLike[str], kind: str) -> bytes:
    """The bytes of a file that is no larger than such files are; `kind` is what it should be, for
    the error's line."""
    where, most = os.fspath(path), _LARGEST.get(kind, _LARGEST_RECORDING)
    try:
        # A recording is read twice; a pipe could be read once, and some devices never end.
        if kind not in _LARGEST and not stat.S_ISREG((found := os.stat(path)).st_mode):
            what = "a folder" if stat.S_ISDIR(found.st_mode) else "no ordinary file"
            raise InputError(f"{where}: is {what}; a {kind} was expected")
        with open(path, "rb") as file:
            data = file.read(most + 1)
    except FileNotFoundError:
        raise InputError(f"{where}: there is no such file; a {kind} was expected") from None
    except IsADirectoryError:
        raise InputError(f"{where}: is a folder; a {kind} was expected") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{where}: cannot be read ({why}); a {kind} was expected") from None
    if len(data) > most:
        raise InputError(f"{where}: has more than {most / 1e6:g} MB, too large for a {kind}")
    return data


def read_text(path: str | os.PathLike[str], kind: str) -> str:
    """The text of a UTF-8 file."""
    return decode(read_bytes(path, kind), os.fspath(path), kind)


def read_table_text(path: str | os.PathLike[str]) -> str:
    """The text of a lab's table: UTF-8, UTF-16 if it begins so, else Latin-1 as Windows has it."""
    data = read_bytes(path, "CSV file")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        data = data.decode("utf-16", errors="replace").encode()
    if b"\0" in data:
        line = data.count(b"\n", 0, data.find(b"\0")) + 1
        raise InputError(f"{os.fspath(path)}, line {line}: is not text; a CSV file was expected")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def decode(data: bytes, where: str, kind: str) -> str:
    """`data` as text; a byte order mark at its start is dropped."""
    bad = data.find(b"\0")
    if bad < 0:
        try:
            return data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            bad = error.start
    line = data.count(b"\n", 0, bad) + 1
    raise InputError(f"{where}, line {line}: is not UTF-8 text; a {kind} in UTF-8 was expected")
