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

import residyn
from residyn.cli import _shell
from residyn.errors import InputError
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


# -- pages of reference ----------------------------------------------------------------------


def first_cells(page):
    """By heading, what stands in backticks in the first cells of the tables below it."""
    found = {}
    for section in re.split(r"^## ", page, flags=re.MULTILINE):
        heading, _, text = section.partition("\n")
        rows = re.findall(r"^\| (`.*?) \|", text, flags=re.MULTILINE)
        found[heading.strip("`[]")] = [x for row in rows for x in re.findall("`([^`]+)`", row)]
    return found


EXPERIMENT_FILE = ROOT / "docs" / "experiment-file.md"
TABLES = {
    "arm": "[arm]\nlink_lengths = [0.4, 0.4]\nshoulder = 1.0\nelbow = 0.5\ncoupling = 1.0\n",
    "inertia": '[inertia]\njoints = ["cart"]\nmatrix = [[1.0]]\n',
    "air_bearings": '[[air_bearings]]\njoint = "elbow"\nmass = 0.1\ninertia = 0.01\n',
    "recordings": '[[recordings]]\nfile = "release.csv"\n',
    "limits": "[limits]\n",
    "integrator": '[integrator]\nsolver = "Tsit5"\n',
}


@pytest.mark.parametrize("table", ["", *TABLES])
def test_the_page_of_the_experiment_file_has_the_keys_that_are_read(table, tmp_path):
    """They are what the line that refuses an unknown key says that there are."""
    told = {name: keys for name, keys in first_cells(EXPERIMENT_FILE.read_text()).items() if keys}
    overview, *sections = told
    assert sections == list(TABLES)
    without = "arm" if table == "inertia" else "inertia"
    unknown = {table: "zzz = 0\n"}
    texts = [text + unknown.get(name, "") for name, text in TABLES.items() if name != without]
    path = tmp_path / "experiment.toml"
    path.write_text(unknown.get("", "") + "".join(texts))
    with pytest.raises(InputError, match='unknown key "zzz": ') as refused:
        residyn.load(path)
    known = str(refused.value).rpartition(" has ")[2].split(", ")
    assert sorted(told[table or overview]) == sorted(known)


def test_the_examples_of_the_experiment_file_are_read(tmp_path):
    page = EXPERIMENT_FILE.read_text()
    assert sum(b.language == "toml" for b in blocks.blocks(page)) == 2
    blocks.run(page, "experiment-file.md", tmp_path)
    (cart,) = residyn.load(tmp_path / "cart.toml").recordings
    assert (cart.time[0], cart.time[-1]) == (2.5, 18.0)


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
