"""The demo says what is hidden; every cell of every notebook runs, and none has outputs in the
repository. In one file, so in one process: the second notebook has the demo's programs."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from residyn.cli import _options, main
from residyn.demo import HIDDEN

ROOT = Path(__file__).parents[1]

_spec = importlib.util.spec_from_file_location("docs_notebooks", ROOT / "docs" / "notebooks.py")
notebooks = importlib.util.module_from_spec(_spec)
sys.modules["docs_notebooks"] = notebooks
_spec.loader.exec_module(notebooks)

ALL = notebooks.paths(ROOT)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A place of its own, and no window."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_demo_from_end_to_end(folder, monkeypatch, capsys):
    monkeypatch.setattr(_options, "STARTS", 2)  # more find the same numbers, later
    status = main(["demo", "--json", "demo.json", "--no-cache"])
    out, err = capsys.readouterr()
    assert status == 0, err
    assert "residyn-demo.html" in out
    assert (folder / "residyn-demo.html").stat().st_size > 100_000
    result = json.loads((folder / "demo.json").read_text())
    assert (result["verdict"], result["added"]) == ("missing", [HIDDEN])
    found = result["fit"]["parameters"][f"{HIDDEN}.torque"]["value"]
    assert found == pytest.approx(0.2, rel=0.02)
    assert result["ladder"][-1]["reduced_chi2"] < 1.2
    first = "Dry friction at the elbow is missing (> 99 %)."
    for said in (
        first,
        "11 x",
        "1.0 x",
        "held out",
        "17.5-20.0 s",
        f"Hidden was: {HIDDEN}. Right.",
    ):
        assert said in out
    assert first in (ROOT / "README.md").read_text()


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_every_cell_runs(path, folder):
    if path.stem.startswith("04"):
        pytest.importorskip("evosax", reason="needs the extra ga")
    if path.stem.startswith("06"):
        pytest.importorskip("optax", reason="comes with the extra ga")
    shown = notebooks.run(path)
    assert any(each.text for each in shown)
    assert not list(folder.iterdir()), "a notebook writes no files"


def test_there_are_six():
    assert [path.stem[:2] for path in ALL] == ["01", "02", "03", "04", "05", "06"]


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_outputs_are_stripped(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_the_page_shows_every_cell(path, tmp_path):
    shown = [notebooks.Shown(f"line {i}\n") for i, (k, _) in enumerate(notebooks.cells(path))]
    notebooks.made(shown, tmp_path)
    page = notebooks.page(path, tmp_path)
    assert page.startswith("# ")
    assert "%matplotlib" not in page
    for kind, source in notebooks.cells(path):
        assert kind != "code" or source in page
    assert "](../docs/" not in page
    assert ".ipynb)" not in page


def test_a_cell_that_fails_is_named(tmp_path):
    cell = {"cell_type": "code", "source": ["%matplotlib inline\n", "assert 1 + 1 == 3"]}
    path = tmp_path / "wrong.ipynb"
    path.write_text(json.dumps({"cells": [cell]}))
    with pytest.raises(AssertionError, match=r"wrong\.ipynb, code cell 1: AssertionError"):
        notebooks.run(path)
