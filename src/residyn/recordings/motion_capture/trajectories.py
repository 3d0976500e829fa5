"""Marker trajectories on disk: where each named marker was, frame by frame.

Two formats. The CSV file that Vicon Nexus exports has a section `Trajectories`, whose head says the
frame rate, each marker's name above its three columns, and the unit; an empty cell is a lost
marker. C3D is the binary format that every motion capture system writes; the package ezc3d reads
it, an extra of this one. Both become metres on a clock that starts with the first frame.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import InputError, did_you_mean, inside, quote
from ...files import read_bytes, read_table_text
from ..csv import number_in

_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_HEAD = 200_000  # characters in which a Trajectories section must begin to be recognised
_LABELS = re.compile(r"LABELS[0-9]*")  # beyond 255 markers they go on in LABELS2


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Every marker of a file."""

    time: np.ndarray  # (N,) s from the first frame
    frame: np.ndarray  # (N,) int, the file's own number of each frame
    names: tuple[str, ...]  # one per marker, "Subject:Marker" where the file says the subject
    position: np.ndarray  # (N, markers, 3) m; NaN where a marker was lost

    def of(self, markers: Sequence[str]) -> np.ndarray:
        """(N, len(markers), 3) m: positions of these markers, named with or without a subject."""
        at = [_find(name, self.names) for name in markers]
        for i, column in enumerate(at):
            if column in at[:i]:
                one = quote(markers[at.index(column)])
                raise InputError(f"{one} and {quote(markers[i])} are the same marker of the file")
        return self.position[:, at]


def is_vicon(text: str) -> bool:
    """Whether a CSV file's text is one of marker trajectories."""
    head, name = text[:_HEAD], "trajectories"
    # The line is looked for only in what has the word.
    return name in head.lower() and any(_first_cell(line) == name for line in head.splitlines())


def read_trajectories(path: str | os.PathLike[str]) -> Trajectories:
    """Read a C3D file (by its extension) or a Vicon CSV file.

    **Raises:** `InputError`, also where the extra `c3d` is not installed.
    """
    if os.fspath(path).lower().endswith(".c3d"):
        return _read_c3d(path)
    text = read_table_text(path)
    with inside(os.fspath(path)):
        return _parse_vicon(text)


def _parse_vicon(text: str) -> Trajectories:
    """The first Trajectories section of the text of a Vicon CSV file."""
    rows = re.split("\r\n|\r|\n", text)
    top = next((i for i, row in enumerate(rows) if _first_cell(row) == "trajectories"), None)
    if top is None:
        raise InputError(
            'has no line "Trajectories": marker files are what Vicon exports as CSV, with its '
            "header lines, or C3D"
        )
    head = next((i for i in range(top, len(rows)) if _first_cell(rows[i]) == "frame"), None)
    if head is None or head < top + 3:
        raise InputError(
            f'line {top + 1}: after "Trajectories" must come a line with the frame rate (Hz), one '
            'with the names of the markers, and one that begins "Frame,Sub Frame,X,Y,Z"'
        )
    between = next((c for c in ";\t" if c in rows[head]), ",")
    table = [[cell.strip().strip('"') for cell in row.split(between)] for row in rows[top:]]
    with inside(f"line {top + 2}"):
        rate = _number(table[1][0], "the frame rate")
        if not 0 < rate < 1e6:
            raise InputError(f"{quote(table[1][0])} is no frame rate: must be above 0 (Hz)")
    axes = table[head - top]
    with inside(f"line {head}"):
        columns = _columns(table[head - top - 1], axes)
    first = head - top + 1
    with inside(f"line {top + first + 1}"):
        scale, first = _unit(table, first, columns)
    frames, values = [], []
    for i, row in enumerate(table[first:], first):
        if not any(row):
            break  # a blank line ends the section
        with inside(f"line {top + i + 1}"):
            frames.append(_frame(row[0], frames[-1] if frames else -1))
            cells = row + [""] * len(axes)  # a row may end early: what it does not reach is lost
            for name, x in columns.items():
                values.append([_number(cell, quote(name)) for cell in cells[x : x + 3]])
    if not frames:
        raise InputError(f"line {head + 1}: no frames come after the header")
    position = np.array(values).reshape(len(frames), len(columns), 3) * scale
    frame = np.array(frames)
    return Trajectories((frame - frame[0]) / rate, frame, tuple(columns), _unseen(position))


def _first_cell(row: str) -> str:
    return re.split(r"[,;\t]", row, maxsplit=1)[0].strip().strip('"').strip().lower()


def _number(cell: str, what: str) -> float:
    return number_in(cell.replace(",", "."), what, ".")  # no comma in a cell is a separator


def _columns(names: list[str], axes: list[str]) -> dict[str, int]:
    """Where each marker's X stands, Y and Z being the next two."""
    columns: dict[str, int] = {}
    for i, name in enumerate(names):
        if not name or [axis.upper() for axis in axes[i : i + 3]] != ["X", "Y", "Z"]:
            continue
        if name in columns:
            raise InputError(f"marker {quote(name)} appears twice")
        columns[name] = i
    if not columns:
        raise InputError(
            "names no marker: each marker's name must stand above its column X, which Y and Z "
            "follow"
        )
    return columns


def _unit(
    table: list[list[str]], row: int, columns: dict[str, int]
) -> tuple[np.ndarray | float, int]:
    """What the numbers are in, m, per marker, (markers, 1); and the row where they begin."""
    cells = table[row] if row < len(table) else [""]
    if cells[0] or not any(cells):  # Nexus writes millimetres, and a few tools drop the line
        return _METRES["mm"], row
    units = [cells[i].lower() if i < len(cells) else "" for i in columns.values()]
    for unit in units:
        if unit not in _METRES:
            raise InputError(f"unit {quote(unit)}: must be {', '.join(_METRES)}")
    return np.array([_METRES[unit] for unit in units])[:, None], row + 1


def _frame(cell: str, before: int) -> int:
    if not re.fullmatch(r"[0-9]{1,15}", cell):
        raise InputError(f"{quote(cell)} is no number of a frame")
    if int(cell) <= before:
        raise InputError(f"frame {int(cell)} comes after frame {before}: frames must go up")
    return int(cell)


def _read_c3d(path: str | os.PathLike[str]) -> Trajectories:
    where = os.fspath(path)
    start = read_bytes(path, "C3D file")[:2]
    with inside(where):
        try:
            import ezc3d
        except ImportError:
            why = "C3D files need the package ezc3d: pip install 'residyn[c3d]'"
            raise InputError(why) from None
        if start[1:] != b"\x50":  # the format's own mark
            raise InputError("is not a C3D file")
        try:
            contents = ezc3d.c3d(where)
            points = contents["parameters"]["POINT"]
            labels = [
                n for key in sorted(points) if _LABELS.fullmatch(key) for n in _value(points[key])
            ]
            rate = float(_value(points["RATE"])[0])
            unit = str((_value(points.get("UNITS", {})) or ["mm"])[0]).strip().lower() or "mm"
            position = np.array(contents["data"]["points"][:3], dtype=float).transpose(2, 1, 0)
            residual = np.asarray(contents["data"]["meta_points"]["residuals"])[0].T
            first = int(contents["header"]["points"]["first_frame"]) + 1
        except (OSError, RuntimeError, ValueError, KeyError, IndexError, TypeError) as error:
            why = str(error) or type(error).__name__
            raise InputError(f"is not a C3D file that can be read: {why}") from None
        names = [str(name).strip() for name in labels][: position.shape[1]]
        position = position[:, : len(names)].copy()
        if not position.size:
            raise InputError("has no frames of named markers")
        if unit not in _METRES:
            raise InputError(f"unit {quote(unit)} of POINT:UNITS: must be {', '.join(_METRES)}")
        if not 0 < rate < 1e6:
            raise InputError(f"POINT:RATE is {rate:g} Hz: must be above 0")
        if residual.shape == position.shape[:2]:
            position[residual < 0] = np.nan
    count = np.arange(len(position))
    scaled = _unseen(position * _METRES[unit])
    return Trajectories(count / rate, count + first, tuple(names), scaled)


def _value(parameter) -> list:
    return list(parameter.get("value", []))


def _unseen(position: np.ndarray) -> np.ndarray:
    """A marker is seen whole or not at all; one that is at the very origin was not seen."""
    lost = ~np.isfinite(position).all(axis=-1) | (position == 0).all(axis=-1)
    return np.where(lost[..., None], np.nan, position)


def _find(name: str, names: Sequence[str]) -> int:
    """Which of the file's `names` a user's name means."""
    if name in names:
        return names.index(name)
    short = [full.rpartition(":")[2] for full in names]
    found = [i for i, each in enumerate(short) if each == name]
    if len(found) == 1:
        return found[0]
    if found:
        both = " and ".join(quote(names[i]) for i in found)
        raise InputError(f"marker {quote(name)} could be {both}: give its full name")
    hint = did_you_mean(name, [*names, *short]) or f"the file has {listed(names)}"
    raise InputError(f"there is no marker {quote(name)}: {hint}")


def listed(names: Sequence[str]) -> str:
    """The names of a file's markers, for a line that says which there are."""
    return ", ".join(map(quote, names[:12])) + ", ..." * (len(names) > 12)
