"""Every block of code in the documentation runs, and the site builds without a warning."""

import ast
import dataclasses
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from residyn.cli import _shell
from residyn.fitting import methods

ROOT = Path(__file__).parents[1]

_spec = importlib.util.spec_from_file_location("docs_blocks", ROOT / "docs" / "blocks.py")
blocks = importlib.util.module_from_spec(_spec)
sys.modules["docs_blocks"] = blocks
_spec.loader.exec_module(blocks)

# The tour first: the README repeats its commands, and finds the answers.
PAGES = sorted(blocks.pages(ROOT), key=lambda p: p.name != "index.md")


def name_of(path):
    return path.relative_to(ROOT).as_posix()


@pytest.fixture
def one_cache(monkeypatch):
    """The commands keep their compiled programs where the other tests do."""
    folder = Path(jax.config.values["jax_compilation_cache_dir"])
    monkeypatch.setattr("residyn.runtime.settings.cache_folder", lambda: folder)
    monkeypatch.setenv(_shell.TRACEBACK, "1")


@pytest.fixture
def short_search(monkeypatch):
    """The paper's 500 generations are not what is tested here."""
    for name, how in methods.GENETIC.items():
        short = dataclasses.replace(how, generations=20)
        monkeypatch.setitem(methods.GENETIC, name, short)


@pytest.mark.pages
@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_every_block_of_a_page_runs(path, tmp_path, one_cache, short_search):
    blocks.run(path.read_text(), name_of(path), tmp_path)
    if path.name == "index.md":
        shown = re.findall(r"\(made/index/([\w.]+)\)", path.read_text())
        assert shown
        assert set(shown) <= {p.name for p in blocks.made_in(tmp_path)}


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_what_is_not_run_says_why(path):
    text = path.read_text()
    told = text.count("<!-- not run:")
    assert told == sum(b.not_run is not None for b in blocks.blocks(text))
    assert text.count("<!-- output") == sum(b.output is not None for b in blocks.blocks(text))


WRITTEN = sorted([*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "benchmarks" / "README.md"])


@pytest.mark.parametrize("path", WRITTEN, ids=name_of)
def test_every_file_that_a_page_names_exists(path):
    """Paths from the root (`src/...`, `tests/...`), and modules of the package
    as `folder/module.py`. Files of an example block are the reader's own."""
    prose = re.sub(r"^```(?!text).*?^```", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    folders = "|".join(p.name for p in (ROOT / "src" / "residyn").iterdir() if p.is_dir())
    begins = f"(?:src|tests|docs|benchmarks|{folders})"
    named = re.findall(rf"(?<![\w/.-])({begins}/[\w./-]*\w/?)", prose)
    roots = ROOT, ROOT / "src" / "residyn"
    lost = {name for name in named if not any((root / name).exists() for root in roots)}
    assert not lost


def test_blocks_are_found_with_what_is_said_of_them():
    page = """
<!-- output from "b" to "c" -->
```python
print("a\\nb\\nc")
```
In a file, say `mine.py`:

```python
x = 1
```
<!-- not run: no recording -->
```sh
residyn fit other.toml
```
```
residyn effects
```
```text
not code
```
"""
    first, mine, left_out, plain = blocks.blocks(page)
    assert (first.language, first.output, first.line) == ("python", ("b", "c"), 4)
    assert (mine.title, left_out.not_run) == ("mine.py", "no recording")
    assert (plain.language, plain.not_run) == ("sh", None)


def test_what_follows_cd_runs_in_that_folder(tmp_path, one_cache):
    page = "```\nresidyn example rig\ncd rig\nresidyn new first.toml release.csv\n```\n"
    blocks.run(page, "page.md", tmp_path)
    assert (tmp_path / "rig" / "first.toml").exists()


@pytest.mark.parametrize(
    ("page", "says"),
    [
        ("```python\n1 / 0\n```\n", "page.md:2: ZeroDivisionError"),
        ("```sh\nresidyn effects spirng\n```\n", 'did you mean "spring"'),
        ("```sh\nrm -r /\n```\n", "only the command residyn is run"),
    ],
)
def test_a_block_that_fails_is_named(page, says, tmp_path, one_cache):
    with pytest.raises(AssertionError, match=re.escape(says)):
        blocks.run(page, "page.md", tmp_path)


def test_what_the_site_takes_from_the_package_is_there():
    """Also for its pictures, which `test_the_site_builds_strict` leaves out."""
    for node in ast.walk(ast.parse((ROOT / "docs" / "hooks.py").read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("residyn"):
            exec(ast.unparse(node), {})
        elif isinstance(node, ast.Constant) and re.fullmatch(r"residyn(\.\w+)+", str(node.value)):
            assert importlib.util.find_spec(node.value) is not None, node.value


def test_the_site_builds_strict(tmp_path):
    """Links, headings and the API; the pictures are left out, which take minutes."""
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    pytest.importorskip("mkdocstrings", reason="needs the extra docs")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path)]
    done = subprocess.run(
        words, cwd=ROOT, env={**os.environ, "RESIDYN_DOCS": "words"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    from residyn.effects import CATALOGUE

    page = (tmp_path / "effects" / "index.html").read_text()
    own = [n for n, kind in CATALOGUE.items() if kind.__module__.startswith("residyn.")]
    for name in own:  # another test may have registered its own effect
        assert f'id="{name}"' in page
