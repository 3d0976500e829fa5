"""`--table`: LaTeX or CSV by the file's ending, and paths that cannot be."""

import numpy as np
import pytest

from residyn.cli import main

TOML = """
[inertia]
joints = ["cart"]
units = ["m"]
matrix = [[1.0]]

[[recordings]]
file = "cart.csv"
noise = 1e-4
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cart")
    time = np.arange(300) / 100
    q = 0.05 * np.exp(-0.4 * time) * np.cos(10.0 * time)
    q += 1e-4 * np.random.default_rng(0).standard_normal(len(time))
    lines = [f"{t:.2f},{x:.6f}" for t, x in zip(time, q, strict=True)]
    (folder / "cart.csv").write_text("\n".join(["t,q1", *lines, ""]))
    (folder / "cart.toml").write_text(TOML)
    return folder


@pytest.fixture
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def test_fit_writes_either_table(here, capsys):
    words = ["fit", "cart.toml", "--starts", "1", "--no-cache", "--table"]
    for name, begins in (("fit.csv", "name,value,std,unit\nspring:cart"), ("fit.tex", "% needs")):
        assert main([*words, name]) == 0
        assert (here / name).read_text().startswith(begins)
        assert f"table: {name}" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--table", "fit.pdf"], "--table fit.pdf: must end in .tex or .csv"),
        (["--table", "fit"], "must end in .tex or .csv"),
        (["--table", "-"], "must end in .tex or .csv"),
        (["--table", "none/fit.tex"], "cannot be written"),
        (["--table", "cart.csv"], "is an input of this experiment"),
        (["--table", "a.csv", "--json", "./a.csv"], "--table and --json are the same file"),
        (["--table", "a.csv", "--report", "a.csv"], "--table and --report are the same file"),
    ],
)
def test_a_table_that_cannot_be_is_refused(here, capsys, command, words, says):
    before = (here / "cart.csv").read_text()
    assert main([command, "cart.toml", *words]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert (here / "cart.csv").read_text() == before
