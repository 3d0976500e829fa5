"""A recording on disk is a table that any tool can write.

One header line names the columns: `t` (s), `q1`, `q2`, ... (rad or m) and, for a driven recording,
`u1`, `u2`, ... (N m or N), in any order. Every further line is one sample; a sensor that lost it
leaves an empty cell or `nan`. Reading is strict, since a table that is silently misread fits some
other arm: whatever is not such a table is refused with the line where it stops being one.
"""

import os
import re
from collections.abc import Sequence
from typing import TextIO

import numpy as np

from ._input import InputError, quote, read_text

_EMPTY_CELL = re.compile(r"(?<![^,\n])[ \t]*(?![^,\n])")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|[+-]?nan", re.I)
_INFINITE = re.compile(r"[+-]?inf(?:inity)?", re.I)


def read_csv(
    path: str | os.PathLike[str], joints: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Read a recording of `joints` joints.

    **Returns:** time (N,) in s; angle (N, joints) in rad or m, NaN where a sample was lost; drive
    (N, joints) in N m or N, zero for a joint without its own column, or None if the file has no
    drive column; and the line number of each sample, (N,) int.
    """
    where = os.fspath(path)
    text = read_text(path, "CSV file").replace("\r\n", "\n").replace("\r", "\n")
    rows = text.split("\n")
    number = np.flatnonzero([bool(row.strip()) for row in rows]) + 1
    if not len(number):
        raise InputError(f'{where}: is empty; its first line must name the columns, as "t,q1"')
    names = _header(rows[number[0] - 1], f"{where}, line {number[0]}", joints)
    number = number[1:]
    rows = [rows[i - 1] for i in number]
    if not rows:
        raise InputError(f"{where}: has a header but no data rows")
    table = _fast(rows, len(names))
    if table is None:
        table = _slow(rows, number, names, where)
    infinite = np.argwhere(np.isinf(table))
    if len(infinite):
        row, column = infinite[0]
        raise InputError(f"{where}, line {number[row]}: {names[column]} is infinite")
    columns = dict(zip(names, table.T, strict=True))
    time = columns["t"].copy()
    _check_time(time, number, where)
    angle = np.stack([columns[f"q{j + 1}"] for j in range(joints)], axis=1)
    drive = None
    if any(name.startswith("u") for name in names):
        still = np.zeros_like(time)
        drive = np.stack([columns.get(f"u{j + 1}", still) for j in range(joints)], axis=1)
    return time, angle, drive, number


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
    try:
        with open(path_or_file, "w", encoding="utf-8", newline="") as file:
            file.write(text)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{os.fspath(path_or_file)}: cannot be written ({why})") from None


def _header(line: str, where: str, joints: int) -> list[str]:
    """The names of the columns."""
    names = [name.strip() for name in line.split(",")]
    angles = [f"q{j + 1}" for j in range(joints)]
    drives = [f"u{j + 1}" for j in range(joints)]
    right = f'the header must be "{",".join(["t", *angles])}", with {",".join(drives)} if driven'
    if "t" not in names:
        hint = "there is no column t"
        if all(_NUMBER.fullmatch(name) for name in names):
            hint = "the first line has numbers, not the names of the columns"
        elif len(names) == 1 and re.search(r"[;\t]", line):
            hint = "columns must be separated by commas"
        raise InputError(f"{where}: {hint}; {right}")
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"{where}: column {quote(name)} appears twice; {right}")
    for name in names:
        if re.fullmatch(r"q[1-9][0-9]*", name) and name not in angles:
            have = sum(bool(re.fullmatch(r"q[1-9][0-9]*", other)) for other in names)
            raise InputError(
                f"{where}: has {have} q columns, up to {quote(name)}, but the experiment has "
                f"{joints} joint{'s' * (joints > 1)}; {right}"
            )
        if name not in ("t", *angles, *drives):
            raise InputError(f"{where}: unknown column {quote(name)}; {right}")
    for name in angles:
        if name not in names:
            raise InputError(f"{where}: there is no column {name}; {right}")
    return names


def _fast(rows: list[str], width: int) -> np.ndarray | None:
    """The table by numpy's own parser, or None if that stumbles on anything."""
    for attempt in range(2):
        if attempt:
            rows = _EMPTY_CELL.sub("nan", "\n".join(rows)).split("\n")
        try:
            table = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
        except ValueError:
            continue
        return table if table.shape == (len(rows), width) else None
    return None


def _slow(rows: list[str], number: np.ndarray, names: Sequence[str], where: str) -> np.ndarray:
    """The table cell by cell: slow, and able to say which cell is wrong."""
    table = np.empty((len(rows), len(names)))
    for i, (row, line) in enumerate(zip(rows, number, strict=True)):
        cells = [cell.strip() for cell in row.split(",")]
        if len(cells) != len(names):
            raise InputError(
                f"{where}, line {line}: has {len(cells)} cell{'s' * (len(cells) > 1)}; "
                f"the header names {len(names)} columns"
            )
        for j, cell in enumerate(cells):
            if _INFINITE.fullmatch(cell):
                raise InputError(f"{where}, line {line}: {names[j]} is infinite")
            if cell and not _NUMBER.fullmatch(cell):
                raise InputError(
                    f"{where}, line {line}: {names[j]} = {quote(cell)} is no number; "
                    "a lost sample is an empty cell or nan"
                )
            table[i, j] = float(cell or "nan")
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
