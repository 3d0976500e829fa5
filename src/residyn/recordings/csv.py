"""A recording on disk is a table that any tool can write.

One header line names the columns: `t` (s), `q1`, `q2`, ... (rad or m) and, for a driven recording,
`u1`, `u2`, ... (N m or N), in any order. Every further line is one sample; a sensor that missed it
leaves an empty cell or `nan`. Files of a lab's own have other names and units (`_columns`), lines
above the header, semicolons, tabs or blanks between cells, decimal commas, quoted cells, and text
that is not UTF-8; those are recognised, and what was understood is told in one line.

Reading is strict, since a table that is silently misread fits some other arm: whatever is not such
a table is refused with the line where it stops being one. Numbers are parsed by NumPy, cells that
need more by Python's `csv`: importing pandas takes 0.4 s, a quarter of a whole command.
"""

import csv
import os
import re
from collections.abc import Sequence
from typing import NamedTuple, TextIO

import numpy as np

from ..errors import InputError, inside, quote
from ..files import read_table_text, write
from .columns import (
    Column,
    Joints,
    Layout,
    columns_of,
    guessed,
    is_unit_row,
    matched,
    understood,
)

_EMPTY_CELL = re.compile(r"(?<![^,\n])[ \t]*(?![^,\n])")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_LOST = re.compile(r"|[+-]?nan|#?n/?a|null|none", re.I)
_INFINITE = re.compile(r"[+-]?inf(?:inity)?", re.I)
_COMMENT = re.compile(r"\s*(?:#|%|//)\s*")
_SEPARATORS = (",", ";", "\t", " ")
_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}
_HEAD = 200
"""Lines in which the header must be."""


class Table(NamedTuple):
    """A recording as its file has it, in SI units."""

    time: np.ndarray
    """(N,) s."""
    angle: np.ndarray
    """(N, n) rad or m, NaN where one is missing."""
    drive: np.ndarray | None
    """(N, n) N m or N, zero for a joint without its own column; None if no joint has one."""
    line: np.ndarray
    """(N,) the line number of each sample."""
    stated: frozenset[str]
    """The columns whose unit is stated, by a key or the file itself."""
    understood: str = ""
    """What was made of the header, in one line; empty if there is nothing to say."""


def read_csv(
    path: str | os.PathLike[str], joints: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Read a recording of `joints` joints.

    **Returns:** time (N,) in s; angle (N, joints) in rad or m, NaN where one is missing; drive
    (N, joints) in N m or N, zero for a joint without its own column, or None if the file has no
    drive column; and the line number of each sample, (N,) int.
    """
    return read_lab_csv(path, Joints(tuple(f"q{j + 1}" for j in range(joints))), Layout())[:4]


def read_lab_csv(path: str | os.PathLike[str], joints: Joints, layout: Layout) -> Table:
    """Read a recording, as `layout` says or as the file itself has it.

    **Raises:** `InputError` that names the line.
    """
    where = os.fspath(path)
    text = read_table_text(path).replace("\r\n", "\n").replace("\r", "\n")
    rows = text.split("\n")
    number = np.flatnonzero([bool(row.strip()) for row in rows]) + 1
    if not len(number):
        raise InputError(f'{where}: is empty; its first line must name the columns, as "t,q1"')
    head, separator = _find_header(rows, number, joints, layout)
    top = number[head]
    with inside(f"{where}, line {top}"):
        header = _cells(_COMMENT.sub("", rows[top - 1], count=1), separator)
        if all(_NUMBER.fullmatch(cell) for cell in header):
            raise InputError(
                "the first line has numbers, not the names of the columns; write a line above it, "
                f'as "{separator.join(["t", *joints.angles])}"'
            )
        first, below = head + 1, []
        if first < len(number):
            below = _cells(_COMMENT.sub("", rows[number[first] - 1], count=1), separator)
            first, below = (first + 1, below) if is_unit_row(below) else (first, [])
        columns = columns_of(header, joints, layout, below)
    above = [rows[i - 1] for i in number[:head]]
    number = np.array([i for i in number[first:] if not _COMMENT.match(rows[i - 1])], dtype=int)
    rows = [rows[i - 1] for i in number]
    if not rows:
        raise InputError(f"{where}: has a header but no data rows")
    more = [] if separator == "," else [f"{_WORDS.get(separator, quote(separator))} between cells"]
    decimal = layout.decimal or _decimal(rows, separator, columns)
    if decimal == ",":
        more.append("decimal commas")
    if any(not _COMMENT.match(row) for row in above):
        more.append(f"header in line {top}")
    values = read_fast(rows, len(header), separator, decimal, columns)
    if values is None:
        values = read_slow(rows, number, len(header), separator, decimal, columns, where)
    infinite = np.argwhere(np.isinf(values))
    if len(infinite):
        row, column = infinite[0]
        raise InputError(f"{where}, line {number[row]}: {columns[column].name} is infinite")
    by_name = {c.name: x * c.factor for c, x in zip(columns, values.T, strict=True)}
    time = by_name["t"]
    _check_time(time, number, where)
    angle = np.stack([by_name[name] for name in joints.angles], axis=1)
    drive = None
    if any(name in by_name for name in joints.drives):
        still = np.zeros_like(time)
        drive = np.stack([by_name.get(name, still) for name in joints.drives], axis=1)
    stated = frozenset(column.name for column in columns if column.stated)
    return Table(time, angle, drive, number, stated, understood(columns, header, joints, more))


def guessed_columns(path: str | os.PathLike[str]) -> tuple[dict[str, str], dict[str, str]]:
    """What a file's columns may be, for a person to check: t is the one called so or the first, the
    angles are those in units of angle or length, or else all others that have numbers.

    **Returns:** header names and units by t, q1, ...

    **Raises:** `InputError` if no line is a header above numbers.
    """
    rows = [r for r in re.split(r"\r\n|\r|\n", read_table_text(path)) if r.strip()][:_HEAD]
    for i, row in enumerate(rows):
        for separator in _SEPARATORS:
            header = _cells(_COMMENT.sub("", row, count=1), separator)
            below = _cells(rows[i + 1], separator) if i + 1 < len(rows) else []
            named = is_unit_row(below)
            numbers = _cells(rows[i + 2], separator) if named and i + 2 < len(rows) else below
            ok = [bool(_NUMBER.fullmatch(cell.replace(",", "."))) for cell in numbers]
            if len(header) < 2 or len(numbers) != len(header) or sum(ok) < 2:
                continue
            if any(_NUMBER.fullmatch(cell.replace(",", ".")) for cell in header):
                continue
            at, units = guessed(header, below if named else [], ok)
            return {name: header[k] for name, k in at.items()}, units
    raise InputError(f"{os.fspath(path)}: has no line of names above columns of numbers")


def write_csv(
    path_or_file: str | os.PathLike[str] | TextIO,
    time: np.ndarray,
    angle: np.ndarray,
    drive: np.ndarray | None = None,
) -> None:
    """Write a recording so that `read_csv` gives back exactly these numbers.

    **Arguments:** `time` (N,) s; `angle` (N, n) or (N,), rad or m; `drive` like `angle`, N m or N.
    """
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or not len(time):
        raise InputError(f"time has shape {time.shape}: it must be one row of samples")
    names, columns = ["t"], [time]
    for letter, values in (("q", angle), ("u", drive)):
        if values is None:
            continue
        values = np.asarray(values, dtype=float)
        values = values[:, None] if values.ndim == 1 else values
        if values.ndim != 2 or len(values) != len(time) or not values.shape[1]:
            raise InputError(
                f"{letter} has shape {values.shape}: it must be ({len(time)}, joints) like time"
            )
        names += [f"{letter}{j + 1}" for j in range(values.shape[1])]
        columns += list(values.T)
    if len([n for n in names if n[0] == "u"]) > len([n for n in names if n[0] == "q"]):
        raise InputError("drive has more joints than angle")
    table = np.stack(columns, axis=1)
    if np.isinf(table).any() or np.isnan(time).any():
        raise InputError("time must be finite; angle and drive finite or NaN")
    # repr is the shortest text that reads back as the same number.
    lines = [",".join("" if x != x else repr(x) for x in row) for row in table.tolist()]
    text = "\n".join([",".join(names), *lines, ""])
    if not isinstance(path_or_file, (str, os.PathLike)):
        path_or_file.write(text)
        return
    write(path_or_file, text)


def _find_header(
    rows: list[str], number: np.ndarray, joints: Joints, layout: Layout
) -> tuple[int, str]:
    """Which of the lines that are not blank is the header, and what stands between its cells.

    The first line that names t and every q. If there is none, the line that names most of them:
    what it lacks is then said of it.
    """
    needed = {"t", *joints.angles}
    separators = _SEPARATORS if layout.separator is None else (layout.separator,)
    best: tuple[int, int, str] | None = None
    for i, line in enumerate(number[:_HEAD]):
        row, choices = _COMMENT.sub("", rows[line - 1], count=1), []
        for separator in separators:
            cells = _cells(row, separator)
            count = len(needed & set(matched(cells, joints, layout)))
            choices.append((count, 0 if separator == " " else len(cells), separator))
        count, _, separator = max(choices, key=lambda choice: choice[:2])
        if count == len(needed):
            return i, separator
        plain = row == rows[line - 1]  # no comment
        if count > best[0] if best else count or plain:
            best = count, i, separator
    return best[1:] if best else (0, separators[0])


def _cells(row: str, separator: str) -> list[str]:
    """The cells of a line, without quotes and the blanks around them."""
    if separator == " ":
        return row.split()
    if '"' not in row:
        return [cell.strip() for cell in row.split(separator)]
    return [cell.strip() for cell in next(csv.reader([row], delimiter=separator), [])]


def _decimal(rows: Sequence[str], separator: str, columns: Sequence[Column]) -> str:
    """A comma, if cells have commas and none has a point; else the point."""
    if separator == "," and not any('"' in row for row in rows[:_HEAD]):
        return "."
    comma = point = False
    for row in rows[:_HEAD]:
        cells = _cells(row, separator)
        for column in columns:
            cell = cells[column.at] if column.at < len(cells) else ""
            comma, point = comma or "," in cell, point or "." in cell
    return "," if comma and not point else "."


def read_fast(
    rows: list[str], width: int, separator: str, decimal: str, columns: Sequence[Column]
) -> np.ndarray | None:
    """The needed columns by NumPy's own parser, or None if that stumbles on anything."""
    if decimal == "," and (separator == "," or any("." in row for row in rows)):
        return None
    if separator == " ":
        if any(len(row.split()) != width for row in rows):
            return None
    elif any(row.count(separator) != width - 1 for row in rows) or any('"' in row for row in rows):
        return None
    text = "\n".join(rows)
    if decimal == ",":
        text = text.replace(",", ".")
    if separator not in (" ", ","):
        text = text.replace(",", " ").replace(separator, ",")
    for attempt in range(2):
        if attempt:
            text = _EMPTY_CELL.sub("nan", text)
        try:
            table = np.loadtxt(
                text.split("\n"),
                delimiter=None if separator == " " else ",",
                comments=None,
                ndmin=2,
                usecols=[column.at for column in columns],
            )
        except ValueError:
            continue
        return table if len(table) == len(rows) else None
    return None


def read_slow(
    rows: Sequence[str],
    number: np.ndarray,
    width: int,
    separator: str,
    decimal: str,
    columns: Sequence[Column],
    where: str,
) -> np.ndarray:
    """The needed columns cell by cell: slow, and able to say which cell is wrong."""
    table = np.empty((len(rows), len(columns)))
    for i, (row, line) in enumerate(zip(rows, number, strict=True)):
        cells = _cells(row, separator)
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) != width:
            many = f"has {len(cells)} cell{'s' * (len(cells) != 1)}"
            hint = (
                "; decimal commas need another separator, or quotes"
                if separator == "," and len(cells) > width
                else ""
            )
            raise InputError(
                f"{where}, line {line}: {many}; the header names {width} columns{hint}"
            )
        for j, column in enumerate(columns):
            cell = cells[column.at].replace("\u2212", "-")
            if _INFINITE.fullmatch(cell):
                raise InputError(f"{where}, line {line}: {column.name} is infinite")
            if _LOST.fullmatch(cell):
                table[i, j] = np.nan
                continue
            point = cell
            if decimal == "," and "." not in cell:
                point = cell.replace(",", ".")
            if not _NUMBER.fullmatch(point) or (decimal == "," and "." in cell):
                hint = "a missing sample is an empty cell or nan"
                if _NUMBER.fullmatch(cell.replace(",", ".")):
                    hint = f"the decimal sign is {quote(decimal)} here; decimal says which it is"
                raise InputError(
                    f"{where}, line {line}: {column.name} = {quote(cell)} is no number; {hint}"
                )
            table[i, j] = float(point.replace("d", "e").replace("D", "e"))
    return table


def _check_time(time: np.ndarray, number: np.ndarray, where: str) -> None:
    missing = np.flatnonzero(np.isnan(time))
    if len(missing):
        raise InputError(f"{where}, line {number[missing[0]]}: has no time; every row needs t")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        i = back[0] + 1
        raise InputError(
            f"{where}, line {number[i]}: t = {time[i]:.12g} does not come after the "
            f"t = {time[i - 1]:.12g} before it; time must increase from row to row"
        )
