"""A recording on disk is a table that any tool can write.

One header line names the columns: `t` (s), `q1`, `q2`, ... (rad or m) and, for a driven recording,
`u1`, `u2`, ... (N m or N), in any order. Every further line is one sample; a sensor that missed it
leaves an empty cell or `nan`. Files of a lab's own have other names and units (`columns`), lines
above the header, semicolons, tabs or blanks between cells, decimal commas, quoted cells, and text
that is not UTF-8; those are recognised, and what was understood is told in one line.

Reading is strict, since a table that is silently misread fits some other arm: whatever is not such
a table is refused with the line where it stops being one. Importing pandas takes 0.4 s, a quarter
of a whole command; reading 2000 lines one by one, a fiftieth of that.
"""

import contextlib
import csv
import math
import os
import re
from collections.abc import Sequence
from typing import TextIO

import numpy as np

from ..errors import InputError, inside, quote
from ..files import read_table_text, write
from .arrays import check_table, check_time
from .columns import Column, Joints, Layout, Table, columns_of, guessed, is_unit_row, matched

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
_LOST = re.compile(r"|[+-]?nan|#?n/?a|null|none", re.I)
_INFINITE = re.compile(r"[+-]?inf(?:inity)?", re.I)
_COMMENT = re.compile(r"\s*(?:#|%|//)\s*")
_SEPARATORS = (",", ";", "\t", " ")
_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}
_HEAD = 200  # lines in which the header must be


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
    lines = _lines(read_table_text(path))
    if not lines:
        raise InputError(f'{where}: is empty; its first line must name the columns, as "t,q1"')
    head, separator = _find_header([row for _, row in lines[:_HEAD]], joints, layout)
    top = lines[head][0]
    with inside(f"{where}, line {top}"):
        header, *below = (_cells(_bare(row), separator) for _, row in lines[head : head + 2])
        if all(_NUMBER.fullmatch(cell) for cell in header):
            raise InputError(
                "the first line has numbers, not the names of the columns; write a line above it, "
                f'as "{separator.join(["t", *joints.angles])}"'
            )
        units = below[0] if below and is_unit_row(below[0]) else []
        columns = columns_of(header, joints, layout, units)
    rows = [each for each in lines[head + 1 + bool(units) :] if not _COMMENT.match(each[1])]
    if not rows:
        raise InputError(f"{where}: has a header but no data rows")
    decimal = layout.decimal or _decimal([row for _, row in rows[:_HEAD]], separator, columns)
    values = _values(rows, len(header), separator, decimal, columns, where)
    number = np.array([line for line, _ in rows])
    infinite = np.argwhere(np.isinf(values))
    if len(infinite):
        i, j = infinite[0]
        raise InputError(f"{where}, line {number[i]}: {columns[j].name} is infinite")
    time = values[:, [c.name for c in columns].index("t")]
    check_time(time, lambda i: f"{where}, line {number[i]}")
    more = [] if separator == "," else [f"{_WORDS.get(separator, quote(separator))} between cells"]
    more += ["decimal commas"] if decimal == "," else []
    above = any(not _COMMENT.match(row) for _, row in lines[:head])
    more += [f"header in line {top}"] if above else []
    return Table.of(values.T, number, columns, header, joints, more)


def guessed_columns(path: str | os.PathLike[str]) -> tuple[dict[str, str], dict[str, str], bool]:
    """What a file's columns may be, for a person to check: t is the one called so, in s or the
    first, the angles are those in units of angle or length, or else all others that have numbers.

    **Returns:** header names and units by t, q1, ..., and whether names say which angle is which.

    **Raises:** `InputError` if no line is a header above numbers.
    """
    where, rows = os.fspath(path), _lines(read_table_text(path))[:_HEAD]
    above_numbers, with_t, above_one = [], [], []
    for i, (line, _) in enumerate(rows):
        for separator in _SEPARATORS:
            header, *below = (_cells(_bare(each), separator) for _, each in rows[i : i + 3])
            units = below.pop(0) if below and is_unit_row(below[0]) else []
            if len(header) < 2 or any(map(_is_number, header)):
                continue
            first = below[0] if below else []
            ok = [
                bool(name and cell) and bool(_is_number(cell) or _LOST.fullmatch(cell))
                for name, cell in zip(header, first, strict=False)
            ]
            if len(first) == len(header) and sum(ok) > 1 and any(map(_is_number, first)):
                above_numbers.append((line, header, units, ok))
                continue
            found = line, header, units, [bool(cell) for cell in header]
            if "t" in matched(header, Joints(()), Layout()):
                with_t.append(found)
            elif len(first) == len(header) and any(map(_is_number, first)):
                above_one.append(found)  # as where times are no numbers
    # Without numbers below, whoever reads the file says what is wrong there.
    if not above_numbers + with_t + above_one:
        raise InputError(f"{where}: has no line of names above columns of numbers")
    line, header, units, numeric = (above_numbers + with_t + above_one)[0]
    at, known, ordered = guessed(header, units, numeric)
    names = [header[k] for k in at.values()]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"{where}, line {line}: two columns are called {quote(name)}: each must have a "
                "name of its own"
            )
    return dict(zip(at, names, strict=True)), known, ordered


def write_csv(
    path_or_file: str | os.PathLike[str] | TextIO,
    time: np.ndarray,
    angle: np.ndarray,
    drive: np.ndarray | None = None,
) -> None:
    """Write a recording so that `read_csv` gives back exactly these numbers.

    **Arguments:** `time` (N,) s; `angle` (N, n) or (N,), rad or m; `drive` like `angle`, N m or N.
    """
    time, angle = check_table(time, angle)
    columns = {"t": time} | {f"q{j + 1}": column for j, column in enumerate(angle.T)}
    if drive is not None:
        _, drive = check_table(time, drive, "drive")
        columns |= {f"u{j + 1}": column for j, column in enumerate(drive.T)}
        if drive.shape[1] > angle.shape[1]:
            raise InputError("drive has more joints than angle")
    table = np.stack(list(columns.values()), axis=1)
    # repr is the shortest text that reads back as the same number.
    lines = [",".join("" if x != x else repr(x) for x in row) for row in table.tolist()]
    text = "\n".join([",".join(columns), *lines, ""])
    if isinstance(path_or_file, str | os.PathLike):
        write(path_or_file, text)
    else:
        path_or_file.write(text)


def _lines(text: str) -> list[tuple[int, str]]:
    """The lines that are not blank, each with its number."""
    return [(i, row) for i, row in enumerate(re.split("\r\n|\r|\n", text), 1) if row.strip()]


def _bare(row: str) -> str:
    """A line without the sign of a comment, behind which some write their header."""
    return _COMMENT.sub("", row, count=1)


def _find_header(rows: list[str], joints: Joints, layout: Layout) -> tuple[int, str]:
    """Which line is the header, the first that names t and every q, or else the one that names most
    of them, of which is then said what it lacks; and what stands between its cells."""
    needed = {"t", *joints.angles}
    separators = _SEPARATORS if layout.separator is None else (layout.separator,)
    best: tuple[int, int, str] | None = None
    for i, row in enumerate(rows):
        choices = []
        for separator in separators:
            cells = _cells(_bare(row), separator)
            count = len(needed & set(matched(cells, joints, layout)))
            choices.append((count, 0 if separator == " " else len(cells), separator))
        count, _, separator = max(choices, key=lambda choice: choice[:2])
        if count == len(needed):
            return i, separator
        if count > best[0] if best else count or not _COMMENT.match(row):
            best = count, i, separator
    return best[1:] if best else (0, separators[0])


def _cells(row: str, separator: str) -> list[str]:
    """The cells of a line, without quotes and the blanks around them."""
    if separator == " ":
        return row.split()
    if '"' not in row:
        return [cell.strip() for cell in row.split(separator)]
    csv.field_size_limit(max(csv.field_size_limit(), len(row)))  # a cell may be as long as its row
    return [cell.strip() for cell in next(csv.reader([row], delimiter=separator), [])]


def _decimal(rows: Sequence[str], separator: str, columns: Sequence[Column]) -> str:
    """A comma, if cells have commas and none has a point; else the point."""
    each = [_cells(row, separator) for row in rows]
    used = "".join(cells[c.at] for cells in each for c in columns if c.at < len(cells))
    return "," if "," in used and "." not in used else "."


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell.replace(",", ".")))


def _values(
    rows: Sequence[tuple[int, str]],
    width: int,
    separator: str,
    decimal: str,
    columns: Sequence[Column],
    where: str,
) -> np.ndarray:
    """(N, columns) the numbers of the needed columns, as they stand."""
    plain = all('"' not in row and row.count(separator) == width - 1 for _, row in rows)
    if plain and decimal == "." and separator != " ":
        # All at once, if all cells that are wanted are numbers as NumPy reads them.
        lines, at = [row for _, row in rows], [column.at for column in columns]
        with contextlib.suppress(ValueError):
            return np.loadtxt(lines, delimiter=separator, usecols=at, comments=None, ndmin=2)
    wanted = [(column.at, column.name) for column in columns]
    table = []
    for line, row in rows:
        try:  # not `inside`, which would take as long again
            cells = _cells(row, separator)
            while len(cells) > width and not cells[-1]:
                cells.pop()
            if len(cells) != width:
                raise InputError(_wrong_width(cells, width, separator))
            table.append([number_in(cells[at], name, decimal) for at, name in wanted])
        except InputError as error:
            raise InputError(f"{where}, line {line}: {error}") from None
    return np.array(table)


def _wrong_width(cells: Sequence[str], width: int, separator: str) -> str:
    count = len(cells)
    said = f"has {count} cell{'s' * (count != 1)}; the header names {width} columns"
    if separator == "," and count > width and not any("." in cell for cell in cells):
        said += (
            "; a comma between cells cannot be the decimal sign too: decimal commas need another "
            "separator, as semicolons, or quotes"
        )
    return said


def number_in(cell: str, name: str, decimal: str) -> float:
    """The number in a cell of a column; NaN for a missing one.

    **Raises:** `InputError`.
    """
    cell = cell.replace("\u2212", "-")
    point = cell if decimal == "." else cell.replace(",", ".")
    if _NUMBER.fullmatch(point) and not (decimal == "," and "." in cell):
        return float(point.replace("d", "e").replace("D", "e"))
    if _LOST.fullmatch(cell):
        return math.nan
    if _INFINITE.fullmatch(cell):
        raise InputError(f"{name} is infinite")
    hint = "a missing sample is an empty cell or nan"
    if name == "t":
        hint = "times are in s or a unit of it, counted from any instant"
    if _is_number(cell):
        hint = f"the decimal sign is {quote(decimal)} here; decimal says which it is"
    raise InputError(f"{name} = {quote(cell)} is no number; {hint}")
