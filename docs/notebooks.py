"""The notebooks of `notebooks/`: read, run without Jupyter, and turned into pages.

In the repository they have no outputs. The site's build (`hooks.py`) runs them to show what they
print and draw; `tests/test_demo_and_notebooks.py` runs them, so that no cell fails a reader.
"""

import ast
import contextlib
import io
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Shown:
    """What comes of a code cell: what it prints, and its last line's value if that is a figure."""

    text: str
    figure: Any = None


def paths(root: Path) -> list[Path]:
    """All notebooks, in order."""
    return sorted((root / "notebooks").glob("*.ipynb"))


def cells(path: Path) -> list[tuple[str, str]]:
    """(kind, source) of each cell: "markdown" or "code", without lines meant for Jupyter alone."""
    found = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        lines = "".join(cell["source"]).splitlines()
        if cell["cell_type"] == "code":
            lines = [line for line in lines if not line.startswith("%")]
        found.append((cell["cell_type"], "\n".join(lines).strip("\n")))
    return found


def run(path: Path) -> list[Shown]:
    """Execute a notebook's code cells in order, in one namespace.

    JAX's precision and the catalogue of effects, which a notebook may change, are put back.

    **Raises:** `AssertionError`, with the notebook and the cell, for a cell that fails.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    shown = []
    with _left_as_it_was():
        for number, source in enumerate((s for kind, s in cells(path) if kind == "code"), 1):
            where = f"{path.name}, code cell {number}"
            try:
                shown.append(_run(source, where, names))
            except Exception as error:
                raise AssertionError(f"{where}: {type(error).__name__}: {error}") from error
    return shown


def _run(source: str, where: str, names: dict[str, Any]) -> Shown:
    body, last, value = ast.parse(source), None, None
    if body.body and isinstance(body.body[-1], ast.Expr):
        last = ast.Expression(body.body.pop().value)
    words = io.StringIO()
    with contextlib.redirect_stdout(words):
        exec(compile(body, where, "exec"), names)
        if last is not None:
            value = eval(compile(last, where, "eval"), names)
        figure = value if hasattr(value, "savefig") else None
        if value is not None and figure is None:
            print(repr(value))
    return Shown(words.getvalue(), figure)


@contextlib.contextmanager
def _left_as_it_was() -> Iterator[None]:
    os.environ.setdefault("MPLBACKEND", "Agg")
    import jax

    from residyn import effects

    wide, catalogue = jax.config.values["jax_enable_x64"], dict(effects.CATALOGUE)
    try:
        yield
    finally:
        jax.config.update("jax_enable_x64", wide)
        effects.CATALOGUE.clear()
        effects.CATALOGUE.update(catalogue)


# -- pages -----------------------------------------------------------------------------------

SITE = "notebooks"
_TO_DOCS = re.compile(r"\]\(\.\./docs/([\w.-]+\.md)")
_TO_NOTEBOOK = re.compile(r"\]\(([\w-]+)\.ipynb\)")
_FROM_DOCS = re.compile(r"\]\(\.\./notebooks/([\w-]+)\.ipynb\)")


def made(shown: list[Shown], folder: Path) -> None:
    """Write what a run showed, for `page`."""
    for number, each in enumerate(shown, 1):
        (folder / f"{number}.txt").write_text(each.text, encoding="utf-8")
        if each.figure is not None:
            each.figure.savefig(folder / f"{number}.svg")


def page(path: Path, folder: Path | None) -> str:
    """A notebook in Markdown, with what `made` wrote into a folder, if there is one."""
    parts, number = [], 0
    for kind, source in cells(path):
        if kind == "markdown":
            text = _TO_DOCS.sub(r"](../\1", source)
            text = text.replace("../CONTRIBUTING.md", "../contributing.md")
            text = text.replace("../benchmarks/README.md", "../benchmarks.md")
            parts.append(_TO_NOTEBOOK.sub(r"](\1.md)", text))
            continue
        number += 1
        parts.append(f"```python\n{source}\n```")
        if folder is None:
            continue
        lines = (folder / f"{number}.txt").read_text(encoding="utf-8").rstrip().splitlines()
        if lines:
            parts.append("\n".join(['```{ .text .output title="prints" }', *lines, "```"]))
        if (folder / f"{number}.svg").exists():
            drawn = source.splitlines()[-1]
            parts.append(f"![What `{drawn}` draws](../made/{path.stem}/{number}.svg)")
    parts.append(f"As a notebook: `notebooks/{path.name}` in the repository.")
    return "\n\n".join(parts) + "\n"


def on_the_site(markdown: str) -> str:
    """A page of `docs/` with its links to notebooks as the site has them."""
    return _FROM_DOCS.sub(rf"]({SITE}/\1.md)", markdown)
