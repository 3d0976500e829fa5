"""Sentences, tables and warnings in 80 columns; tables in LaTeX and as comma-separated values.

A `Table` is words in rows. The same one is printed in a terminal (`printed`) and shown on a page
(the macro `table` of `parts.html.j2`).
"""

import csv
import io
import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .latex import NEEDS
from .numbers import glued

WIDTH = 80


@dataclass(frozen=True)
class Table:
    """Rows under a head; a column is aligned to the right unless it is in `left`."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: Sequence[int] = (0,)
    marked: Sequence[int] = ()  # rows that a page shades


def filled(words: str, head: str = "", indent: int | None = None, width: int = WIDTH) -> list[str]:
    """Words in lines of 80 columns after a head; numbers stay with their units and errors."""
    further = " " * (len(head) if indent is None else indent)
    lines = textwrap.wrap(
        glued(words), width, initial_indent=head, subsequent_indent=further, break_on_hyphens=False
    )
    return [line.replace("\u00a0", " ") for line in lines]


def section(title: str, note: str) -> list[str]:
    """ "[[Title]]  note"."""
    return filled(note, f"[[{title}]]  ", 4)


def warned(warnings: Sequence[str], title: str = "Warnings") -> list[str]:
    """A section of warnings; nothing if there are none."""
    if not warnings:
        return []
    return [f"[[{title}]]", *(line for w in warnings for line in filled(w, "    - "))]


def printed(table: Table, indent: int = 4) -> list[str]:
    """A table for a terminal."""
    from rich.console import Console
    from rich.table import Table as Grid

    grid = Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(table.head))
    for i, name in enumerate(table.head):
        left = i in table.left
        grid.add_column(name, justify="left" if left else "right", no_wrap=not left)
    for row in table.rows:
        grid.add_row(*row)
    out = io.StringIO()
    Console(file=out, width=WIDTH - indent, markup=False, highlight=False, emoji=False).print(grid)
    return [f"{'':{indent}}{line}".rstrip() for line in out.getvalue().splitlines()]


def tabular(
    columns: str, head: Sequence[str], blocks: Iterable[Sequence[Sequence[str]]], over: str = ""
) -> str:
    """A LaTeX `tabular` of rows in blocks with a rule between them; empty blocks are left out.
    `over` are lines above the head."""
    text = [NEEDS, rf"\begin{{tabular}}{{{columns}}}", r"\toprule", over + _row(head)]
    for block in blocks:
        if block:
            text += [r"\midrule", *map(_row, block)]
    return "\n".join([*text, r"\bottomrule", r"\end{tabular}"]) + "\n"


def _row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def separated(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Comma-separated values, every digit; what is not known or not finite is left empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_cell(x) for x in row] for row in rows)
    return out.getvalue()


def _cell(x: object) -> str:
    if x is None or isinstance(x, str):
        return x or ""
    number = float(x)  # pyrefly: ignore[bad-argument-type]
    return repr(number) if math.isfinite(number) else ""
