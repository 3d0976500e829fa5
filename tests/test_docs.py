"""Every block of code in the documentation runs, and the site builds without a warning."""

import ast
import dataclasses
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import residyn
from residyn import demo
from residyn.cli import _shell
from residyn.diagnosis.candidate_tests import Sweep
from residyn.diagnosis.compare import OwnNumbers
from residyn.diagnosis.detectable import Atlas, Detectable
from residyn.diagnosis.law import Formula
from residyn.diagnosis.plan import InPlay, Plan
from residyn.diagnosis.result import ChannelError
from residyn.errors import InputError
from residyn.fitting import batch, methods
from residyn.fitting.history import History
from residyn.fitting.race import Race, Raced, Run
from residyn.procedure.over_models import ModeOver, OverModels, Spread
from residyn.procedure.unloaded import BareCheck, Pose, Unloading
from residyn.reporting.side_by_side import SideBySide
from residyn.runtime.json import finite
from tests import by_hand

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


JSON = first_cells((ROOT / "docs" / "json.md").read_text())


def keys_of_json(command):
    """Paths of the keys of a command's JSON, as docs/json.md has them."""
    found = []
    for key in JSON[command]:
        # One that begins with a dot stands beside the one before it.
        beside = found[-1][:-1] if key.startswith(".") else ()
        found.append((*beside, *key.removeprefix(".").split(".")))
    return found


def paths(told, at=()):
    """The same of a JSON, each with whether it is null or empty."""
    if isinstance(told, dict) and told:
        for key, value in told.items():
            yield from paths(value, (*at, key))
    elif isinstance(told, list) and told and isinstance(told[0], dict):
        for each in told:
            yield from paths(each, (*at[:-1], at[-1] + "[]"))
    else:
        yield at, told in (None, [], {})


def described(path, empty, key):
    """Whether a key of the page is this path, or is part of what is null or empty here."""
    if not all(a == b or b.isupper() or b == "*" for a, b in zip(path, key, strict=False)):
        return False
    longer = len(path) - len(key)
    return longer == 0 or (longer > 0 and key[-1] == "*") or (longer < 0 and empty)


def two_lines(out):
    """What --each writes of an experiment with a fit and of one without, put together."""
    fit = by_hand.a_fit()

    def fitting(*given):
        return fit
        yield

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch, "fitting", fitting)
        assert len(list(batch.fit_many([fit.experiment, "not_there.toml"], out=out))) == 2
    one, other = map(json.loads, out.read_text().splitlines())
    return one | other


def an_unloading():
    fit, known = by_hand.a_fit(), Spread(0.5, 0.49, 0.51, 0.005, 0.2, 0.5, 0.3)
    mode = ModeOver(known, known, 1.0)
    models, poses = (InPlay((), 1.0),), ((0.3, (mode,)),)
    over = OverModels(models, 0.0, poses, by_hand.NEXT, "damping_ratio", by_hand.JOINTS)
    pose = Pose(0.3, fit.model, fit.model, fit.modes, fit.modes)
    check = BareCheck(fit.recordings[1], fit.modes, fit)
    errors, step_1 = None, None  # of which nothing is written
    return Unloading(fit, (pose,), (), (check,), np.eye(3), errors, step_1, 1.0, over)


def a_race():
    fit, history = by_hand.a_fit(), History.of([(1.0, 0.1, 2.0), (9.0, 0.2, 0.01)])
    each = Raced("levenberg", "Levenberg-Marquardt", "a start", (Run("x", 0, fit, history, 0.2),))
    return Race(fit.experiment, fit.model.labels, (each,), 1, "each method's own")


def a_diagnosis():
    number = {"a": (0.2, 0.01, "N m")}
    law = dataclasses.replace(by_hand.a_law(), formula=Formula("a x^3", ("power",), number, 3.0))
    return by_hand.missing(laws=(law,), channels=ChannelError("q1 and q2 exchanged", 0.9, True))


def a_plan():
    models = InPlay((by_hand.FOUND,), 0.7), InPlay((by_hand.RIVAL,), 0.3)
    test = dataclasses.replace(by_hand.NEXT, drive=Sweep("elbow", 2.0, 0.3, 4.5))
    columns = ChannelError("q1 and q2 exchanged", 0.9, True)
    told = models, 0.02, 0.01, columns, 0.61, (test,), 144, False, 0.1, by_hand.JOINTS
    return Plan(*told)


def an_atlas():
    size = 0.1, 0.02, 0.2, 0.04
    one = Detectable(
        "backlash:elbow",
        "stiffness",
        "N m/rad",
        {"gap": 0.01},
        {"gap": "rad"},
        *size,
        by_hand.FOUND,
    )
    return Atlas((one,), by_hand.JOINTS, ("rad", "rad"), (1e-3, 1e-3), 20.0)


def a_comparison():
    found = by_hand.a_comparison(by_hand.a_fit(), 6.0, 1e-13)
    return dataclasses.replace(found, runs=(OwnNumbers(by_hand.FOUND, "a.csv", 2.0),))


def inertias():
    with demo.experiment_file() as shipped:
        return residyn.inertia(residyn.load(shipped.parents[1] / "driven" / "driven.toml"))


WRITTEN_AS_JSON = {
    "fit": by_hand.a_fit,
    "fit --against": lambda: SideBySide(by_hand.a_fit(), by_hand.a_fit()),
    "fit --each": None,
    "compare": a_comparison,
    "diagnose": a_diagnosis,
    "plan": a_plan,
    "inertia": inertias,
    "unload": an_unloading,
    "race": a_race,
    "effects --detectable": an_atlas,
}


def test_the_page_of_the_json_has_a_table_for_each():
    assert [command for command, keys in JSON.items() if keys] == list(WRITTEN_AS_JSON)


@pytest.mark.parametrize("command", WRITTEN_AS_JSON)
def test_the_page_of_the_json_has_the_keys_that_are_written(command, tmp_path):
    make = WRITTEN_AS_JSON[command]
    told = two_lines(tmp_path / "two.jsonl") if make is None else finite(make().to_dict())
    keys = keys_of_json(command)
    if command in ("fit --each", "compare"):
        keys += keys_of_json("fit")
    found = list(paths(told))
    unknown = [p for p, empty in found if not any(described(p, empty, key) for key in keys)]
    gone = [key for key in keys if not any(described(p, empty, key) for p, empty in found)]
    assert (unknown, gone) == ([], [])


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
