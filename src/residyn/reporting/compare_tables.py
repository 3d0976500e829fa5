"""The tables of a comparison, for a terminal of 80 columns."""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..diagnosis.forecast import Error
from ..diagnosis.residuals import Cell, Part
from .compare_words import chance
from .numbers import amount, plain, prefixed
from .words import times as ratio

if TYPE_CHECKING:
    from ..diagnosis.compare import Comparison

_LABEL, _COLUMN = 32, 16
_MOST = (80 - _LABEL) // _COLUMN


def lines(found: "Comparison") -> list[str]:
    """The whole printout, a string per line: the verdict, the fit, and all tables."""
    verdict = textwrap.wrap(" ".join(found.words), 80, break_on_hyphens=False)
    return [*verdict, "", str(found.fit), *_where(found), *_held_out(found), *_horizon(found)]


def _where(found: "Comparison") -> list[str]:
    at, total = found.where, found.where.total

    def cell(c: Cell) -> str:
        share = 100 * c.energy / total if total > 0 else 0.0
        return f"{share:5.1f} %{_times(c.ratio):>8}"

    def rows(parts: Sequence[Part]) -> list[str]:
        return [_row(_range(p), [cell(c) for c in p.cells]) for p in parts]

    out = ["[[Where]]  share of the squared residual, and rms in times the noise"]
    out += [_row("", at.joints), _row("all", [cell(c) for c in at.joint])]
    chances = [chance(w.p) if w.p == w.p else "-" for w in at.white.values()]
    out.append(_row("white noise?", chances))
    out += ["  by time since the start, s", *rows(at.time)]
    for joint, unit, parts in zip(at.joints, at.units, at.amplitude, strict=True):
        size, name = prefixed(unit, parts[0].stop if parts else 1.0)
        scaled = [p._replace(start=p.start / size, stop=p.stop / size) for p in parts]
        out.append(f"  by amplitude of the swing at the {joint}, {name}".rstrip(", "))
        out += rows(scaled)
    return [*out, "  by frequency, Hz", *rows(at.frequency)]


def _range(part: Part) -> str:
    span = f"{_edge(part.start)} - {_edge(part.stop)}"
    return f"{span:<16}{part.name}"


def _edge(x: float) -> str:
    return plain(x, 3) if x < 100 else f"{x:.0f}"


def _times(x: float) -> str:
    return f"{ratio(x)} x" if x == x else "-"


def _row(label: str, cells: Sequence[str]) -> str:
    shown = [f"{c[: _COLUMN - 1]:>{_COLUMN}}" for c in cells[:_MOST]]
    more = " ..." if len(cells) > _MOST else ""
    return f"    {label:<{_LABEL - 4}}{''.join(shown)}{more}".rstrip()


def _held_out(found: "Comparison") -> list[str]:
    held = found.held_out
    if held is None:
        return []
    head = {
        "check recordings": "[[Held out]]  check recordings: only their initial states were fitted",
        "last third": "[[Held out]]  the last third, predicted from a fit of the first two",
    }
    errors = {"held out": held.held_out, "where it was fitted": held.fitted}
    out = [head[held.what], _row("", found.fit.joints)]
    for label, error in errors.items():
        out.append(_row(label, _sizes(error, found)))
        out.append(_row("", [_times(x) for x in error.ratio]))
    if held.held_out.expected is not None:
        expected = [_times(x) for x in held.held_out.expected]
        out.append(_row("a right model would leave", expected))
    return out


def _sizes(error: Error, found: "Comparison") -> list[str]:
    units = found.where.units
    return [amount(x, u) for x, u in zip(error.rmse, units, strict=True)]


def _horizon(found: "Comparison") -> list[str]:
    horizon = found.horizon
    if horizon is None:
        return []
    head = (
        "error of predictions against the time ahead, from a fit of the first "
        f"{plain(horizon.seconds)} s; in brackets what a right model would leave"
    )
    out = textwrap.wrap(head, 80, initial_indent="[[Horizon]]  ", subsequent_indent=" " * 13)
    out += [_row("s ahead", found.fit.joints)]
    out.append(_row("0 (where it was fitted)", [_times(x) for x in horizon.fitted.ratio]))
    for a in horizon.ahead:
        expected = a.error.expected
        cells = [
            _times(x) + ("" if expected is None else f" ({ratio(expected[j])})")
            for j, x in enumerate(a.error.ratio)
        ]
        out.append(_row(f"{plain(a.start)} - {plain(a.stop)}", cells))
    return out
