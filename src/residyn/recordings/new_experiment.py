"""A first experiment file from a lab's recordings: what they tell is filled in, the rest is "?".

A "?" is a string where a number must stand, so that whoever forgets one is told its key.
"""

import json
import os
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError, quote
from .columns import UNKNOWN, Joints, Layout, quantity_of
from .csv import guessed_columns, read_lab_csv
from .reads import READS, reading_units
from .recording import Recording
from .sanity import not_free
from .tables import ArmTable

_ARM = """\
# What is no arm of two links takes [inertia] in its place (joints, units, matrix), and no theta2.
[arm]                     # two links, with the bearings on: `residyn inertia`
link_lengths = ["?", "?"] # m
shoulder = "?"            # I1 about the shoulder + m2 l1^2, kg m^2
elbow = "?"               # I2 about the elbow, kg m^2
coupling = "?"            # m2 rho2, kg m; rho2: from the elbow to link 2's centre of mass
"""
_AS_THEY_ARE = "no name says which column is which joint; the order is the file's"
_INERTIA = """\
[inertia]                 # a constant mass matrix
joints = {joints}
{units:<25} # "rad" or "m" each{unsaid}
{matrix:<25} # {unit}
"""
_UNSAID = "the file does not say:"
_UNITS = {
    ("rad",): "kg m^2",
    ("m",): "kg",
    ("m", "rad"): "kg where both joints are in m, kg m^2 in rad, kg m between them",
}


def experiment_text(files: Sequence[Path], folder: Path) -> str:
    """The text of an experiment file that is to stand in `folder`.

    **Raises:** `InputError` for a recording that is no table with a header.
    """
    tables, kinds, names, guessed = [], (), (), False
    for file in files:
        table, found, angles, unsaid = _entry(file, folder)
        if tables and len(found) != len(kinds):
            by_size = sorted([(angles, file), (names, files[0])], key=lambda each: len(each[0]))
            (few, lacking), (many, whole) = by_size
            lost = ", ".join(quote(name) for name in many if name not in few)
            raise InputError(
                f"{lacking}: has no column {lost}, as {whole} has: an experiment is of one "
                "mechanism, and each recording has all its joints"
            )
        if tables and found != kinds:
            raise InputError(
                f"{file}: has joints in {', '.join(found)}, {files[0]} in {', '.join(kinds)}: an "
                "experiment is of one mechanism; a column without a unit is taken to be in rad: "
                'write the unit behind its name, as "q1 (m)"'
            )
        tables.append(table)
        kinds, names, guessed = found, angles, guessed or unsaid
    n = len(kinds)
    head = _INERTIA.format(
        joints=toml_value([f"joint{j + 1}" for j in range(n)]),
        units=f"units = {toml_value(list(kinds))}",
        unsaid=f"; {_UNSAID} rad?" if guessed else "",
        matrix=f"matrix = {toml_value([['?'] * n] * n)}",
        unit=_UNITS[tuple(sorted(set(kinds)))],  # pyrefly: ignore[bad-index]
    )
    return "\n".join([_ARM if kinds == ArmTable.units else head, *tables])


def _entry(file: Path, folder: Path) -> tuple[str, tuple[str, ...], tuple[str, ...], bool]:
    """One `[[recordings]]` table, with a key for each thing that is seen in the recording; its
    joints' units and their columns, and whether the file leaves the unit of a joint open."""
    columns, units, ordered = guessed_columns(file)
    angles = list(columns)[1:]
    if not angles:
        raise InputError(f"{file}: has no column of angles beside {quote(columns['t'])}")
    read = [quantity_of(units.get(q, "rad")) or ("rad", 0) for q in angles]
    kinds, orders = tuple(base for base, _ in read), tuple(order for _, order in read)
    joints = Joints(tuple(columns[q] for q in angles), kinds, orders)
    reads = [READS[k] for k in orders]
    keys: dict[str, Any] = {}
    if list(columns.values()) != list(columns):
        keys["columns"] = columns
    if any(orders):
        keys["reads"] = reads[0] if len(set(reads)) == 1 else reads
    said = {} if ordered else {"columns": _AS_THEY_ARE}
    understood = ""
    for _ in range(6):
        table = read_lab_csv(file, joints, Layout(keys.get("columns"), keys.get("units")))
        understood = table.understood
        cut: dict[str, Any] = {key: keys.get(key) for key in ("start", "rest")}
        recording = Recording.from_arrays(
            table.time, table.angle, drive=table.drive, name=str(file), reads=reads, **cut
        )
        found = not_free(recording, reading_units(kinds, orders), table, keys)
        if found is None:
            break
        if not found.key:  # nothing but the recording itself settles it
            raise InputError(f"{file}: {found.words}")
        told = found.value != {"t": UNKNOWN}
        said[found.key] = found.words.split("; ")[0] if told else found.words
        old = keys.get(found.key)
        keys[found.key] = old | found.value if isinstance(old, dict) else found.value
    lines = ["[[recordings]]", f"file = {toml_value(os.path.relpath(file, folder or Path()))}"]
    if understood:
        lines += _comment(understood)
    unsaid = [x for x in columns if x not in units | keys.get("units", {})]
    if unsaid:
        each = (f"{x} in {'s' if x == 't' else 'rad'}" for x in unsaid)
        lines += _comment(f"{_UNSAID} {', '.join(each)}?")
    for key, value in keys.items():
        if key in said:
            lines += _comment(f"seen: {said[key]}")
        lines.append(f"{key} = {toml_value(value)}")
    if kinds == ArmTable.units:
        lines.append('theta2 = "?"              # elbow angle at rest, rad; 0: stretched out')
    return "\n".join([*lines, ""]), kinds, joints.names, unsaid not in ([], ["t"])


def _comment(words: str) -> list[str]:
    return textwrap.wrap(
        words, 80, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False
    )


def toml_value(value: Any) -> str:
    """A value as TOML writes it: a table, its keys words, or a list of what JSON writes alike."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml_value(x)}" for k, x in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False)
