"""Which column of a lab's table is what, and in which unit.

A column is found by what the experiment file says (`columns`), else by its name: `t`, `q1`, `u1`,
"Time", or the joint's own name ("Shoulder", "Schulter"), in any case. Its unit is what the file
says (`units`), else what stands in its name ("Time [ms]", "Shoulder (deg)", "t/ms") or in a row of
units below it, else SI. Nothing is guessed in silence: what was understood is told in one line.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError, did_you_mean, quote
from .reads import PER_TIME, READS

_TIMES = ("t", "time", "zeit", "temps", "tiempo", "tempo")
_JOINTS = {
    "shoulder": ("schulter", "épaule", "hombro", "spalla", "ombro"),
    "elbow": ("ellbogen", "ellenbogen", "coude", "codo", "gomito", "cotovelo"),
}
"""The arm's joints, from the base on, in the languages of `_TIMES`."""
_DEGREE = 0.017453292519943295
_UNITS: dict[str, dict[str, tuple[float, str]]] = {
    "s": {
        "s": (1.0, "sec secs second seconds sekunden"),
        "ms": (1e-3, "msec millisecond milliseconds millisekunden"),
        "us": (1e-6, "µs μs usec microsecond microseconds"),
        "ns": (1e-9, "nsec nanosecond nanoseconds"),
    },
    "rad": {
        "rad": (1.0, "radian radians radiant"),
        "deg": (_DEGREE, "° º degree degrees grad"),
        "mrad": (1e-3, "milliradian milliradians"),
    },
    "m": {
        "m": (1.0, "meter meters metre metres"),
        "cm": (1e-2, "centimeter centimeters"),
        "mm": (1e-3, "millimeter millimeters"),
    },
    "N m": {"N m": (1.0, ""), "mN m": (1e-3, "")},
    "N": {"N": (1.0, "newton newtons"), "mN": (1e-3, "")},
}
"""By quantity: the units it may have, how many of the SI unit each is, and other spellings."""
for _base in ("rad", "m"):
    for _per in PER_TIME[1:]:
        _UNITS[_base + _per] = {
            unit + _per: (size, " ".join(word + _per for word in words.split()))
            for unit, (size, words) in _UNITS[_base].items()
        }
_UNITS["rad/s"]["rpm"] = (6 * _DEGREE, "1/min rev/min")
_UNITS["m/s^2"]["g"] = (9.80665, "")
_SPELLED = (
    (re.compile(r"/sec\b"), "/s"),
    (re.compile(r"/s(?:²|\*\*2|2|/s)$"), "/s^2"),
    (re.compile(r"[\s*·-]"), ""),  # N*m, N·m, N-m
    (re.compile(r"^1(?=/s)"), "rad"),
    (re.compile(r"^dps$"), "deg/s"),
)

UNKNOWN = "?"
"""A unit that the file does not tell; its column's numbers stay as they are."""
_JOINTS_OWN = re.compile(r"([qu])[1-9][0-9]*")
_BRACKETS = re.compile(r"(.*?)[\s,_/]*[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]\s*")
_BETWEEN = re.compile(r",?\s+in\s+|\s*/\s*|_|,\s*", re.I)  # name and unit, without brackets
_LONGEST = 24  # letters of a unit that stands without brackets, with what stands before it


@dataclass(frozen=True)
class Layout:
    """How a table is to be read: the keys of these names in `[[recordings]]`; None is not said."""

    columns: Mapping[str, str] | None = None
    units: Mapping[str, str] | None = None
    separator: str | None = None
    decimal: str | None = None

    def __post_init__(self):
        for key, example in (
            ("columns", '{ t = "Time [ms]", q1 = "Shoulder (deg)" }'),
            ("units", '{ t = "ms", q1 = "deg" }'),
        ):
            table, right = getattr(self, key), f"must be a table, as {example}"
            if table is None:
                continue
            if not isinstance(table, Mapping) or not table:
                raise InputError(f"{key} = {quote(table)}: {right}")
            for name, value in table.items():
                if not re.fullmatch(r"t|[qu][1-9][0-9]*", str(name)):
                    raise InputError(
                        f"{key} has {quote(name)}: its keys are t, q1, ... and u1, ..."
                    )
                if not isinstance(value, str) or not value.strip():
                    raise InputError(f"{key}: {name} = {quote(value)}: {right}")
        names = [value.strip() for value in (self.columns or {}).values()]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"columns has {quote(name)} twice: each must be one column")
        if self.decimal not in (None, ".", ","):
            raise InputError(f'decimal = {quote(self.decimal)}: must be "." or ","')
        if self.separator is not None:
            one = isinstance(self.separator, str) and len(self.separator) == 1
            if not one or self.separator.isalnum() or self.separator in "\"'.+-\n\r":
                raise InputError(
                    f'separator = {quote(self.separator)}: must be one character, as ";", or "\\t"'
                )
            if self.separator == self.decimal:
                raise InputError(f"separator and decimal are both {quote(self.decimal)}")


class Column(NamedTuple):
    """A column that is needed."""

    name: str  # "t", "q1", "u1"
    at: int
    header: str
    unit: str
    factor: float  # what turns its numbers into s, rad, m, N m or N
    stated: bool = False  # whether its unit is said, by a key or in the file


class Joints(NamedTuple):
    """Names and units of the joints, as far as they are known."""

    names: tuple[str, ...]
    units: tuple[str, ...] | None = None
    orders: tuple[int, ...] = ()  # which derivative was read of each joint; () is angles

    @property
    def angles(self) -> list[str]:
        """The columns that must be there, beside t."""
        return [f"q{j + 1}" for j in range(len(self.names))]

    @property
    def drives(self) -> list[str]:
        """The columns that may be there."""
        return [f"u{j + 1}" for j in range(len(self.names))]

    @property
    def how_many(self) -> str:
        """The number of joints, in words."""
        return f"{len(self.names)} joint{'s' * (len(self.names) > 1)}"

    def quantities(self, name: str) -> tuple[str, ...]:
        """The SI units that a column may be in."""
        if name == "t":
            return ("s",)
        j = int(name[1:]) - 1
        both = ("N m", "N")
        if name[0] == "q":
            per_time = PER_TIME[self.orders[j] if self.orders else 0]
            both = ("rad" + per_time, "m" + per_time)
        return both if self.units is None else (both[self.units[j] == "m"],)


def matched(header: Sequence[str], joints: Joints, layout: Layout) -> dict[str, list[int]]:
    """By name, the columns that could be it; the first of them that the header has counts."""
    found: dict[str, list[int]] = {}
    folded = [cell.casefold() for cell in header]
    bare = [_parts(cell)[0].casefold() for cell in header]
    for name in ("t", *joints.angles, *joints.drives):
        wanted = (layout.columns or {}).get(name, "").strip()
        if wanted:
            tries = [(header, wanted), (folded, wanted.casefold()), (bare, wanted.casefold())]
        else:
            own = _TIMES if name == "t" else (name,)
            if name[0] == "q":
                joint = joints.names[int(name[1:]) - 1].casefold()
                own = (name, joint, *_JOINTS.get(joint, ()))
            tries = [(names, word) for word in own for names in (folded, bare)]
        for names, word in tries:
            at = [i for i, cell in enumerate(names) if cell == word]
            if at:
                found[name] = at
                break
    return found


def columns_of(
    header: Sequence[str], joints: Joints, layout: Layout, below: Sequence[str] = ()
) -> list[Column]:
    """The columns that are needed: t, every q and the u that are there; `below` is a row of units.

    **Raises:** `InputError` for a column that is missing or there twice, and for a unit that is
    unknown or of another quantity.
    """
    found = matched(header, joints, layout)
    right = (
        f"must have the columns {','.join(['t', *joints.angles])}, and {','.join(joints.drives)} "
        "if driven"
    )
    has = ", ".join(map(quote, filter(None, header)))
    used = {at[0] for at in found.values()}
    free = [cell for i, cell in enumerate(header) if i not in used]
    for name in [*(layout.columns or {}), *(layout.units or {})]:
        if name not in ("t", *joints.angles, *joints.drives):
            raise InputError(f"there is no joint for {name}: {joints.how_many}")
    for name, wanted in (layout.columns or {}).items():
        if name not in found:
            line = f"columns: there is no column {quote(wanted)} for {name}; it has {has}"
            raise InputError("; ".join(filter(None, [line, did_you_mean(wanted, free)])))
    for name in ("t", *joints.angles):
        if name not in found:
            may = [cell for cell in free if _known(_parts(cell)[1], *joints.quantities(name))]
            one = may[0] if len(may) == 1 else "..."
            raise InputError(
                f"there is no column {name}; {right}, or say which column is what, as "
                f"columns = {{ {name} = {quote(one)} }}; it has {has}"
            )
    for at in found.values():
        if len(at) > 1:
            raise InputError(f"column {quote(header[at[0]])} appears twice; {right}")
    own = [_JOINTS_OWN.fullmatch(cell) for cell in header]
    extra = next((m for i, m in enumerate(own) if m and i not in used), None)
    if extra and layout.columns is None:
        have = sum(each is not None and each[1] == extra[1] for each in own)
        raise InputError(
            f"has {have} {extra[1]} columns, up to {quote(extra[0])}, but the experiment has "
            f"{joints.how_many}; {right}"
        )
    if len(used) < len(found):
        raise InputError(f"one column stands for two of {', '.join(found)}; {right}")
    columns = []
    for name, (i, *_) in found.items():
        unit = _unit(name, header[i], below[i] if i < len(below) else "", joints, layout)
        columns.append(Column(name, i, header[i], *unit))
    return columns


def understood(columns: Sequence[Column], header: Sequence[str], more: Sequence[str]) -> str:
    """What was made of the header, in one line; empty if it is as this package writes it."""
    usual = all(c.header == c.name and c.factor == 1.0 for c in columns)
    used = {c.at for c in columns}
    ignored = [quote(cell) for i, cell in enumerate(header) if i not in used and cell]
    if usual and not ignored and not more:
        return ""
    each = []
    for c in columns:
        source = f" from {quote(c.header)}" * (c.header != c.name)
        each.append(c.name + source + f" in {c.unit}" * (c.unit != ""))
    said = [", ".join(each), *more]
    if ignored:
        rest = f" and {len(ignored) - 4} more" * (len(ignored) > 4)
        said.append(f"not read: {', '.join(ignored[:4])}{rest}")
    return "; ".join(said)


class Table(NamedTuple):
    """A recording as its file has it, in SI units."""

    time: np.ndarray  # (N,) s
    angle: np.ndarray  # (N, n) rad or m, NaN where one is missing
    drive: np.ndarray | None
    """(N, n) N m or N, zero for a joint without its own column; None if no joint has one."""
    line: np.ndarray  # (N,) the line number of each sample, or its own number (`counted`)
    stated: frozenset[str]  # the columns whose unit is stated, by a key or the file itself
    understood: str = ""
    """What was made of the header, in one line; empty if there is nothing to say."""
    counted: str = "line"
    """What `line` counts: "line", or "sample" from 0 on where a file has no lines."""

    def lines_at(self, time: np.ndarray) -> np.ndarray:
        """(N,) lines of these instants, or of the next ones that have one."""
        return self.line[np.searchsorted(self.time, time).clip(max=len(self.time) - 1)]

    @classmethod
    def of(
        cls,
        values: Iterable[np.ndarray],
        line: np.ndarray,
        columns: Sequence[Column],
        header: Sequence[str],
        joints: Joints,
        more: Sequence[str] = (),
        counted: str = "line",
    ) -> "Table":
        """From the columns' values (N,), in their own units; `more` is said of the file."""
        found = {c.name: x * c.factor for c, x in zip(columns, values, strict=True)}
        drive = None
        if any(name in found for name in joints.drives):
            still = np.zeros_like(found["t"])
            drive = np.stack([found.get(name, still) for name in joints.drives], axis=1)
        return cls(
            found["t"],
            np.stack([found[name] for name in joints.angles], axis=1),
            drive,
            line,
            frozenset(column.name for column in columns if column.stated),
            understood(columns, header, more),
            counted,
        )


def is_unit_row(cells: Sequence[str]) -> bool:
    """Whether a row below the header has units and nothing else: `s`, `[deg]`, or empty cells."""
    words = [_bare_unit(cell) for cell in cells if cell.strip()]
    known = [word for word in words if _known(word, *_UNITS)]
    return bool(known) and len(known) * 2 > len(words)


def guessed(
    header: Sequence[str], below: Sequence[str], numeric: Sequence[bool]
) -> tuple[dict[str, int], dict[str, str], bool]:
    """Which columns may be t and the angles, or rates where there are no angles; the units of
    these, where the file says them; and whether names say which of them is which joint's, or they
    are as the file has them."""
    words = [_bare_unit(c) for c in below] or [_parts(cell)[1] for cell in header]
    bare = [_parts(cell)[0].casefold() for cell in header]
    plain = [i for i, ok in enumerate(numeric) if ok]
    called = [i for i, name in enumerate(bare) if name in _TIMES]
    timed = [i for i in plain if _known(words[i], "s")]
    # Times that are no numbers are refused by whoever reads them, not passed over.
    time = [*(i for i in called if numeric[i]), *timed, *called, *plain][0]
    rest = [i for i in plain if i != time and not re.fullmatch("u[1-9][0-9]*", bare[i])]
    called = [i for i in rest if re.fullmatch("q[1-9][0-9]*", bare[i])]
    orders = {i: seen[1] for i in rest if (seen := quantity_of(words[i]))}
    sized = [i for i, order in orders.items() if order == min(orders.values())]
    angles = called or sized or rest
    order = _named_order([bare[i] for i in angles])
    at = {"t": time} | {f"q{j + 1}": angles[i] for j, i in enumerate(order or range(len(angles)))}
    said = {
        name: words[i]
        for name, i in at.items()
        if (i in timed if name == "t" else quantity_of(words[i]))
    }
    return at, said, bool(order)


def _named_order(names: Sequence[str]) -> list[int]:
    """Joints from the base on, as their names say: shoulder and elbow, or the numbers in them;
    empty if they do not."""
    each = range(len(names))
    says = [set(re.findall(r"[^\W\d_]+", name)) for name in names]
    shoulder, elbow = (
        {i for i in each if says[i] & {joint, *words}} for joint, words in _JOINTS.items()
    )
    shoulder, elbow = shoulder - elbow, elbow - shoulder
    if len(names) == 2 and len(shoulder) < 2 and len(elbow) < 2 and shoulder | elbow:
        return sorted(each, key=lambda i: (i not in shoulder, i in elbow))
    numbers = [tuple(map(int, re.findall(r"\d+", name))) for name in names]
    if len(names) == 1 or (all(numbers) and len(set(numbers)) == len(names)):
        return sorted(each, key=lambda i: numbers[i])
    return []


def _unit(
    name: str, header: str, below: str, joints: Joints, layout: Layout
) -> tuple[str, float, bool]:
    kinds = joints.quantities(name)
    allowed = ", ".join(unit for kind in kinds for unit in _UNITS[kind])
    own = (layout.units or {}).get(name)
    if own == UNKNOWN:
        return "", 1.0, True
    if own is not None:
        where, word = f"units: {name} = {quote(own)}", own.strip()
    else:
        word = _bare_unit(below) if below else _parts(header)[1]
        where = f"column {quote(header)} is in {quote(word)}"
    if not word:
        return (kinds[0] if len(kinds) == 1 else ""), 1.0, False
    for kind in kinds:
        unit = _known(word, kind)
        if unit is not None:
            return unit, _UNITS[kind][unit][0], True
    if name[0] == "q" and own is None and (seen := quantity_of(word)) is not None:
        base, order = seen
        settled = f"reads = {quote(READS[order])} says what it is"
        if any(kind in ("rad" + PER_TIME[order], "m" + PER_TIME[order]) for kind in kinds):
            settled = f"units under [inertia] says that this joint is in {base}"
        raise InputError(f"{where}: must be {allowed}, or {settled}")
    hint = f'; if it is one of these, units = {{ {name} = "..." }} says which' * (own is None)
    raise InputError(f"{where}: must be {allowed}{hint}")


def quantity_of(word: str) -> tuple[str, int] | None:
    """Of a unit of readings: "rad" or "m", and the order of the derivative (`READS`)."""
    for order, per_time in enumerate(PER_TIME):
        for base in ("rad", "m"):
            if _known(word, base + per_time):
                return base, order
    return None


def _known(word: str, *kinds: str) -> str | None:
    """The unit of one of these quantities that a word means, or None."""
    plain = word.casefold()
    for pattern, instead in _SPELLED:
        plain = pattern.sub(instead, plain)
    for kind in kinds:
        if word in _UNITS[kind]:
            return word
        for unit, (_, others) in _UNITS[kind].items():
            if plain in (*others.split(), unit.casefold().replace(" ", "")):
                return unit
    return None


def _bare_unit(cell: str) -> str:
    return cell.strip().strip("[](){}<>").strip()


def _parts(cell: str) -> tuple[str, str]:
    """A header's name and its unit: "Time [ms]" is ("Time", "ms")."""
    cell = cell.strip()
    found = _BRACKETS.fullmatch(cell)
    if found and found[1]:
        return found[1].strip(), found[2]
    for mark in _BETWEEN.finditer(cell, max(1, len(cell) - _LONGEST)):
        if _known(unit := cell[mark.end() :], *_UNITS):
            return cell[: mark.start()], unit
    return cell, ""
