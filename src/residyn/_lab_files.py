"""Recordings in the formats that a lab already has: MATLAB's and Parquet, beside CSV.

The same table in other clothes. Columns are called as in the CSV file, `t`, `q1`, `q2`, ... and,
for a driven recording, `u1`, `u2`, ..., in the same units. MATLAB keeps them as variables or as the
fields of one struct, where `q` and `u` may also be matrices with a column per joint.
"""

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ._csv import read_csv
from ._input import InputError, inside, quote, read_text
from ._trajectories import is_vicon

Table = tuple[np.ndarray, np.ndarray, np.ndarray | None]


def has_markers(path: str | os.PathLike[str]) -> bool:
    """Whether a file has marker trajectories: a C3D file, or a CSV file with their header."""
    suffix = Path(path).suffix.lower()
    if suffix == ".c3d":
        return True
    return suffix not in _READERS and is_vicon(read_text(path, "CSV file"))


def read_table(path: str | os.PathLike[str], joints: int) -> Table:
    """Read a recording of `joints` joints, in the format that its name ends in; else it is CSV.

    **Returns:** time (N,) s; angle (N, joints) rad or m, NaN where lost; drive (N, joints) or None.

    **Raises:** `InputError`.
    """
    reader = _READERS.get(Path(path).suffix.lower())
    if reader is None:
        return read_csv(path, joints)[:3]
    where = os.fspath(path)
    if not Path(path).is_file():
        what = "is a folder" if Path(path).is_dir() else "there is no such file"
        raise InputError(f"{where}: {what}; a recording was expected")
    with inside(where):
        return _table(reader(where), joints)


def _mat(path: str) -> Mapping[str, Any]:
    """The variables of a MATLAB file, or the fields of its struct."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise InputError(
            "is a MATLAB file of version 7.3, which is not read: save it with '-v7'"
        ) from None
    except (MatReadError, OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise InputError(f"is no MATLAB file that can be read: {error}") from None
    found = {name: value for name, value in found.items() if not name.startswith("__")}
    structs = [name for name, value in found.items() if isinstance(value, dict) and "t" in value]
    if "t" not in found and len(structs) > 1:
        raise InputError(
            f"has several structs with a field t ({', '.join(structs)}): keep one recording a file"
        )
    columns = found if "t" in found or not structs else found[structs[0]]
    wide: dict[str, Any] = {}
    for name, value in columns.items():
        if name in ("q", "u"):
            matrix = np.asarray(value)
            matrix = matrix[:, None] if matrix.ndim == 1 else matrix
            if matrix.ndim != 2:
                raise InputError(f"{name} has shape {matrix.shape}: must be a row per time")
            wide |= {f"{name}{j + 1}": column for j, column in enumerate(matrix.T)}
    # A workspace has other variables too; only those that could be meant are looked at.
    return wide | {n: v for n, v in columns.items() if re.fullmatch(r"t|[qu][1-9][0-9]*", n)}


def _parquet(path: str) -> Mapping[str, Any]:
    """The columns of a Parquet file."""
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError:
        raise InputError(
            "Parquet files need the package pyarrow: pip install 'residyn[parquet]'"
        ) from None
    try:
        table = parquet.ParquetFile(path).read()
    except (arrow.ArrowException, OSError) as error:
        raise InputError(f"is no Parquet file that can be read: {error}") from None
    columns = {}
    for name in table.column_names:
        if re.fullmatch(r"__.*__", name):  # an index that pandas wrote
            continue
        if not re.fullmatch(r"t|[qu][1-9][0-9]*", name):
            raise InputError(f"unknown column {quote(name)}: must be t, q1, ... and u1, ...")
        try:
            columns[name] = table.column(name).cast(arrow.float64()).to_numpy()
        except arrow.ArrowException:
            raise InputError(f"column {name} must have numbers") from None
    return columns


_READERS: dict[str, Callable[[str], Mapping[str, Any]]] = {
    ".mat": _mat,
    ".parquet": _parquet,
    ".pq": _parquet,
}


def _table(columns: Mapping[str, Any], joints: int) -> Table:
    """The recording in these columns."""
    angles = [f"q{j + 1}" for j in range(joints)]
    drives = [f"u{j + 1}" for j in range(joints)]
    right = f"must have {', '.join(['t', *angles])}, and {', '.join(drives)} if driven"
    for name in ("t", *angles):
        if name not in columns:
            raise InputError(f"there is no {name}; {right}")
    for name in columns:
        if name not in ("t", *angles, *drives):
            raise InputError(
                f"has {name}, but the experiment has {joints} joint{'s' * (joints > 1)}; {right}"
            )
    found: dict[str, np.ndarray] = {}
    for name, value in columns.items():
        try:
            if np.iscomplexobj(value):
                raise TypeError
            found[name] = np.atleast_1d(np.asarray(value, dtype=float).squeeze())
        except (TypeError, ValueError):
            raise InputError(f"{name} must have numbers") from None
    count = len(found["t"])
    for name, column in found.items():
        if column.shape != (count,):
            raise InputError(f"{name} has shape {column.shape}: must be ({count},), as long as t")
    drive = None
    if any(name in found for name in drives):
        still = np.zeros_like(found["t"])
        drive = np.stack([found.get(name, still) for name in drives], axis=1)
    return found["t"], np.stack([found[name] for name in angles], axis=1), drive
