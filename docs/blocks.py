"""The code on a page of the documentation: found, and run in order.

The site's build (`hooks.py`) runs a page to show what its code prints and draws;
`tests/test_docs.py` runs every page, so that no reader meets a command that fails. What is run:

- `python` blocks, which share their names over a page;
- `sh` blocks (and blocks without a language whose lines all begin with `residyn` or `cd`): each
  line that begins with `residyn` goes through the command's own entry point, which must return 0;
  what follows `cd FOLDER` runs in that folder;
- `toml` and `python` blocks with a `title`: files, written before what follows. Where there is no
  title, the line above the block may name the file: "... a file, say `my_effects.py`:";
- `toml` blocks without: read, as an experiment if they are a whole one, and left alone. What
  follows finds the demo's own `experiment.toml`.

A comment just above a block says how to treat it:

- `<!-- not run: REASON -->`: leave it out; a reader of the source sees why;
- `<!-- output -->`: the site shows below it what it prints; `<!-- output from "WORDS" -->` begins
  at the first line that begins so, `<!-- output to "WORDS" -->` stops there.
"""

import contextlib
import hashlib
import io
import os
import pickle
import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_FENCE = re.compile(
    r"(?P<comments>(?:^[ ]*<!--[^\n]*-->\n(?:[ ]*\n)?)*)"
    r"^(?P<indent>[ ]*)```(?P<head>[^\n`]*)\n(?P<text>.*?)^(?P=indent)```[ ]*$",
    re.MULTILINE | re.DOTALL,
)
_NAMED = re.compile(r"`([\w./-]+\.(?:py|toml))`[^`]*:\s*\Z")
_LOADED: dict[bytes, Any] = {}  # experiments of this process, by what they hold
_KNOWN: dict[tuple, Any] = {}  # and results, by what was asked


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    language: str
    text: str
    title: str | None
    """File that it is, if it is one."""
    line: int
    """Of the page, where its text begins."""
    not_run: str | None
    """Why it is left out."""
    output: tuple[str, str] | None
    """None if what it prints is not shown; else the words it is shown from and up to, or ""."""
    span: tuple[int, int]
    """Place in the page, comments included."""


def blocks(page: str) -> list[Block]:
    """All blocks of a page that could be run, or are left out for a reason."""
    found = []
    for match in _FENCE.finditer(page):
        language, _, rest = match["head"].strip().partition(" ")
        text = "".join(
            line.removeprefix(match["indent"]) for line in match["text"].splitlines(keepends=True)
        )
        lines = [line for line in text.splitlines() if line.strip()]
        if not language and lines and all(line.startswith(("residyn ", "cd ")) for line in lines):
            language = "sh"
        if language not in ("python", "sh", "toml"):
            continue
        title = re.search(r'title="([^"]+)"', rest)
        named = _NAMED.search(page[: match.start()].rstrip())
        comments = match["comments"]
        why = re.search(r"<!-- not run: (.+?) -->", comments)
        output = re.search(r'<!-- output(?: from "([^"]+)")?(?: to "([^"]+)")? -->', comments)
        found.append(
            Block(
                language=language,
                text=text,
                title=title[1] if title else named[1] if named and language != "sh" else None,
                line=page.count("\n", 0, match.start("text")) + 1,
                not_run=why[1] if why else None,
                output=None if output is None else (output[1] or "", output[2] or ""),
                span=match.span(),
            )
        )
    return found


def run(page: str, name: str, folder: Path) -> list[str]:
    """Run a page in a folder, where it finds the files of the demo.

    **Returns:** what each block of `blocks(page)` printed; "" where it was not run.

    **Raises:** `AssertionError`, with the page and the line, for a block that fails.
    """
    from residyn import demo

    names: dict[str, Any] = {"__name__": "__main__"}
    printed = []
    with demo.experiment_file() as shipped:
        for file in shipped.parent.glob("*.*"):
            if not (folder / file.name).exists():
                shutil.copy(file, folder / file.name)
    with contextlib.chdir(folder), _on_path(folder), _shared_results():
        for block in blocks(page):
            words = io.StringIO()
            where = f"{name}:{block.line}"
            if block.not_run is None:
                try:
                    with contextlib.redirect_stdout(words):
                        _run(block, where, names)
                except Exception as error:
                    raise AssertionError(f"{where}: {type(error).__name__}: {error}") from error
            printed.append(words.getvalue())
    return printed


@contextlib.contextmanager
def _on_path(folder: Path) -> Iterator[None]:
    """Python finds the modules that a page writes, and forgets them."""
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]


def _run(block: Block, where: str, names: dict[str, Any]) -> None:
    if block.title:
        path = Path(block.title)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text, encoding="utf-8")
    elif block.language == "toml":
        _read(block.text)
    elif block.language == "python":
        # As lines of a file further down, so that a traceback points into the page.
        exec(compile("\n" * (block.line - 1) + block.text, where, "exec"), names)
    else:
        for line in block.text.replace("\\\n", " ").splitlines():
            _command(shlex.split(line, comments=True), line)


def _read(text: str) -> None:
    """Check an experiment that nothing is done with; of a part of one, that it is TOML."""
    import residyn

    if {"recordings"} < set(tomllib.loads(text)):
        path = Path("shown.toml")
        path.write_text(text, encoding="utf-8")
        residyn.load(path)
        path.unlink()


def _command(words: list[str], line: str) -> None:
    from residyn import effects
    from residyn.cli import main

    if not words:
        return
    if words[0] == "cd":
        os.chdir(words[1])
        return
    if words[0] != "residyn":
        raise ValueError(f"only the command residyn is run here, not {line!r}; say why not to run")
    said = io.StringIO()
    # A process of its own would forget the effects that a command brought along.
    before = dict(effects.CATALOGUE)
    try:
        with contextlib.redirect_stderr(said):
            status = main(words[1:])
    finally:
        effects.CATALOGUE.clear()
        effects.CATALOGUE.update(before)
    if status != 0:
        raise ValueError(f"{line!r} ended with {status}: {said.getvalue().strip()}")


@contextlib.contextmanager
def _shared_results() -> Iterator[None]:
    """A page that shows a command and then the same in Python waits for the answer once: a fit, a
    comparison or a diagnosis of the same recordings with the same arguments is the one that was had
    before, on this page or on another."""
    from residyn import diagnosis, fitting
    from residyn.recordings import experiment

    homes = {"load": experiment, "fit": fitting, "compare_fit": diagnosis, "diagnose": diagnosis}
    real = {name: getattr(home, name) for name, home in homes.items()}

    def load(path):
        # One object for the same readings: results refer to the recordings that they are of.
        found = real["load"](path)
        return _LOADED.setdefault(hashlib.sha256(pickle.dumps(found)).digest(), found)

    def once(name, subject, said, call):
        key = (name, id(subject), *sorted(said.items()))
        if key not in _KNOWN:
            _KNOWN[key] = subject, call()  # the subject too, lest its id be used again
        return _KNOWN[key][1]

    def shared(name):
        def same(experiment, **named):
            # The defaults that a command spells out, and Python need not.
            said = {"effects": (), "starts": 6, "max_effects": 3, "method": "levenberg"}
            said |= {"budget": None, **named}
            said.pop("progress", None)
            said["effects"] = tuple(said["effects"])
            if not all(isinstance(e, str) for e in said["effects"]):
                return real[name](experiment, **named)
            return once(name, experiment, said, lambda: real[name](experiment, **named))

        return same

    def compare_fit(fit, *progress):
        return once("compare", fit, {}, lambda: real["compare_fit"](fit, *progress))

    new = {"load": load, "fit": shared("fit"), "diagnose": shared("diagnose")}
    _put(homes, {**new, "compare_fit": compare_fit})
    try:
        yield
    finally:
        _put(homes, real)


def _put(homes, calls) -> None:
    import residyn

    for name, home in homes.items():
        setattr(home, name, calls[name])
        vars(residyn).pop(name, None)  # what the package has imported lazily before


def pages(root: Path) -> list[Path]:
    """The pages whose code is run."""
    return [root / "README.md", *sorted((root / "docs").glob("*.md"))]


def made_in(folder: Path) -> list[Path]:
    """Pictures and reports that a page's code made."""
    return sorted(
        p for p in folder.rglob("*") if p.suffix in (".svg", ".png", ".html") and os.path.isfile(p)
    )
