"""Recordings in the formats that a lab already has: MATLAB's and Parquet, beside CSV.

The same table in other clothes. Columns are found and their units read as in a CSV file. MATLAB
keeps them as variables or as the fields of one struct, where `q` and `u` may also be matrices with
a column per joint.
"""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, inside
from ..files import check_ordinary, read_table_text
from .columns import Joints, Layout, Table, columns_of
from .csv import read_lab_csv
from .motion_capture.trajectories import is_vicon

_Columns = list[tuple[str, Any]]  # names and values, in the order of the file


def is_named_as_recording(path: str | os.PathLike[str]) -> bool:
    """Whether a file's name ends as only those of recordings do."""
    return Path(path).suffix.lower() in (".csv", ".c3d", *_READERS)


def has_markers(path: str | os.PathLike[str]) -> bool:
    """Whether a file has marker trajectories: a C3D file, or a CSV file with their header."""
    suffix = Path(path).suffix.lower()
    return suffix == ".c3d" or (suffix not in _READERS and is_vicon(read_table_text(path)))


def read_table(path: str | os.PathLike[str], joints: Joints, layout: Layout) -> Table:
    """Read a recording, in the format that its name ends in; else it is CSV.

    **Raises:** `InputError`.
    """
    reader = _READERS.get(Path(path).suffix.lower())
    if reader is None:
        return read_lab_csv(path, joints, layout)
    where = os.fspath(path)
    for key in ("separator", "decimal"):
        if getattr(layout, key) is not None:
            raise InputError(f"{where}: {key} is for CSV files; leave it out")
    check_ordinary(path, "recording")
    with inside(where):
        return _table(reader(where), joints, layout)


def _mat(path: str) -> _Columns:
    """The variables of a MATLAB file, or the fields of its struct."""
    from scipy.io import loadmat

    try:
        found = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise InputError(
            "is a MATLAB file of version 7.3, which is not read: save it with '-v7'"
        ) from None
    except Exception as error:  # SciPy checks little: damaged bytes end in errors of any kind
        why = str(error) or type(error).__name__
        raise InputError(f"is no MATLAB file that can be read: {why}") from None
    found = {name: value for name, value in found.items() if not name.startswith("__")}
    structs = [name for name, value in found.items() if isinstance(value, dict) and "t" in value]
    if "t" not in found and len(structs) > 1:
        raise InputError(
            f"has several structs with a field t ({', '.join(structs)}): keep one recording a file"
        )
    columns: _Columns = []
    for name, value in (found if "t" in found or not structs else found[structs[0]]).items():
        if name not in ("q", "u"):
            columns.append((name, value))
            continue
        matrix = np.asarray(value)
        matrix = matrix[:, None] if matrix.ndim == 1 else matrix
        if matrix.ndim != 2:
            raise InputError(f"{name} has shape {matrix.shape}: must be a row per time")
        columns += [(f"{name}{j + 1}", column) for j, column in enumerate(matrix.T)]
    return columns


def _parquet(path: str) -> _Columns:
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError:
        raise InputError(
            "Parquet files need the package pyarrow: pip install 'residyn[parquet]'"
        ) from None
    try:
        table = parquet.ParquetFile(path).read()
        found = list(zip(table.column_names, table.columns, strict=True))
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise InputError(f"is no Parquet file that can be read: {error}") from None
    columns: _Columns = []
    for name, column in found:
        if re.fullmatch("__.*__", name):
            continue  # an index that pandas wrote
        try:
            columns.append((name, column.cast(arrow.float64()).to_numpy()))
        except arrow.ArrowException:
            columns.append((name, None))
    return columns


_READERS: dict[str, Callable[[str], _Columns]] = {
    ".mat": _mat,
    ".parquet": _parquet,
    ".pq": _parquet,
}


def _table(content: _Columns, joints: Joints, layout: Layout) -> Table:
    header, values = [name.strip() for name, _ in content], [value for _, value in content]
    columns = columns_of(header, joints, layout)
    found: dict[str, np.ndarray] = {}
    for column in columns:
        value = values[column.at]
        try:
            if value is None or np.iscomplexobj(value):
                raise TypeError
            found[column.name] = np.atleast_1d(np.asarray(value, dtype=float).squeeze())
        except (TypeError, ValueError):
            raise InputError(f"{column.header} must have numbers") from None
    count = len(found["t"])
    for column in columns:
        if (shape := found[column.name].shape) != (count,):
            raise InputError(f"{column.header} has shape {shape}: must be ({count},), as long as t")
    # What a workspace has besides is nothing to speak of.
    used = {column.at for column in columns}
    header = [name if i in used else "" for i, name in enumerate(header)]
    return Table.of(found.values(), np.arange(count), columns, header, joints, counted="sample")
