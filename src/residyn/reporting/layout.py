"""Sentences, tables and warnings in 80 columns; tables in LaTeX and as comma-separated values.

A `Table` is words in rows. The same one is printed in a terminal (`printed`), shown on a page (the
macro `table` of `parts.html.j2`) and typeset for a paper (`latex`).
"""

import csv
import io
import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .numbers import glued

WIDTH = 80
NUMBERS = 44
"""Columns of an effect's or law's numbers in a terminal, beside two columns of what it is."""
_SPECIAL = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "µ": r"\textmu{}",
    "\u00a0": r"\,",
    "\n": " ",
    **{c: f"${c}$" for c in "<>"},
    "×": r"$\times$",
    **{c: f"$^{x}$" for c, x in zip("²³⁶⁻", "236-", strict=True)},
}
_NUMBER = r"-?\d[\d.]*(?:e[+-]\d+)?"
_TYPESET = re.compile(
    rf"(?<![\w.]){_NUMBER}(?:\u00a0\+/-\u00a0{_NUMBER})?(?![\w.])|\^\d|[{re.escape(''.join(_SPECIAL))}]"
)
"""Numbers, each with its error, exponents of units, and what LaTeX needs written otherwise."""


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


def latex(*blocks: Table) -> str:
    """Rows in blocks, with a rule between them, under the head of the first one: a `tabular` of
    LaTeX, which needs the package booktabs. Empty blocks are left out."""
    head, left = blocks[0].head, blocks[0].left
    columns = "".join("l" if i in left else "r" for i in range(len(head)))
    lines = [r"% needs \usepackage{booktabs}", rf"\begin{{tabular}}{{{columns}}}", r"\toprule"]
    for i, rows in enumerate([[head], *(block.rows for block in blocks)]):
        rule = [r"\midrule"] if i and rows else []
        lines += rule + [" & ".join(map(typeset, row)) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"


def typeset(words: str) -> str:
    r"""Words as LaTeX shows them: "0.20 +/- 0.01 N m/rad^2" is `$0.20 \pm 0.01$\,N\,m/rad$^2$`."""

    def typed(found: re.Match[str]) -> str:
        if found[0] in _SPECIAL or found[0].isdigit():
            return _SPECIAL.get(found[0], found[0])
        number = found[0].replace("\u00a0+/-\u00a0", r" \pm ")
        return "$" + re.sub(r"e\+?(-?)0*(\d+)", r" \\times 10^{\1\2}", number) + "$"

    return _TYPESET.sub(typed, glued(words))


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
