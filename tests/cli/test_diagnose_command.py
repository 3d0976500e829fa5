"""`residyn diagnose`: its outputs, its exit statuses, and what it says in one line; the search is
replaced by results made by hand."""

import dataclasses
import json
import math
import re

import pytest

import residyn.diagnosis
from residyn.cli import main
from residyn.diagnosis.result import Budget
from residyn.fitting import FitError
from tests import by_hand

pytestmark = pytest.mark.usefixtures("pictures_not_written")


@pytest.fixture(scope="module")
def found():
    return {name: getattr(by_hand, name)() for name in ("missing", "adequate", "unexplained")}


CART = """
[inertia]
joints = ["cart"]
units = ["m"]
matrix = [[1.0]]

[[recordings]]
file = "one.csv"
noise = 1e-4
"""


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """Runs `diagnose` where only the reading is real; what it asked for is in `asked`."""
    (tmp_path / "cart.toml").write_text(CART)
    rows = (f"{i / 100:.2f},{0.05 * math.cos(i / 10)!r}" for i in range(300))
    (tmp_path / "one.csv").write_text("\n".join(["t,q1", *rows, ""]))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("residyn.cli._work.set_up_jax", lambda cache: None)
    asked = {}

    def run(*words, result=None):
        def diagnose(experiment, **named):
            asked.update(named)
            if isinstance(result, Exception):
                raise result
            return result

        monkeypatch.setattr(residyn.diagnosis, "diagnose", diagnose, raising=False)
        status = main(["diagnose", "cart.toml", *words])
        return status, *capsys.readouterr(), asked

    return run


def test_the_command_passes_everything_on(command, found):
    words = ["--with", "coulomb_friction", "--with", "hysteresis", "--max-effects", "2"]
    words += ["--starts", "4", "--budget", "12.5"]
    status, out, err, asked = command(*words, result=found["missing"])
    assert (status, err) == (0, "")
    assert out == f"{found['missing']}\n"
    del asked["progress"]
    assert asked == {
        "effects": ["coulomb_friction", "hysteresis"],
        "max_effects": 2,
        "starts": 4,
        "budget": 12.5,
    }


def test_the_command_writes_json_and_a_report(command, found, tmp_path):
    status, out, err, _ = command("--json", "-", "--report", "d.html", result=found["adequate"])
    assert status == 0
    assert json.loads(out)["verdict"] == "adequate"
    assert err.endswith("report: d.html\n")
    page = (tmp_path / "d.html").read_text()
    assert re.search(r"<h2>\s*cart.toml: springs and dampers\s*</h2>", page)


@pytest.mark.parametrize(
    ("words", "result", "status", "line"),
    [
        (["--max-effects", "-1"], None, 2, "--max-effects"),
        (["--max-effects", "some"], None, 2, "--max-effects"),
        (["--budget", "0"], None, 2, "'--budget'"),
        (["--budget", "-3"], None, 2, "'--budget'"),
        (["--budget", "nan"], None, 2, "--budget"),
        (["--budget", "soon"], None, 2, "--budget"),
        (["--json", "one.csv"], None, 2, "input"),
        ([], ValueError('there is no effect "wind"'), 2, "wind"),
        ([], FitError("no start led to finite numbers"), 1, "no start"),
    ],
)
def test_the_command_complains_in_one_line(command, words, result, status, line):
    ended, out, err, _ = command(*words, result=result)
    assert (ended, out) == (status, "")
    assert err.startswith("residyn: ")
    assert err.count("\n") == 1
    assert line in err


@pytest.mark.parametrize(
    ("effects", "status"),
    [((), 1), (("hysteresis:elbow",), 0)],  # an effect that is not seen: the other numbers hold
)
def test_numbers_that_did_not_settle_are_exit_status_1(command, found, effects, status):
    fit = by_hand.a_fit(effects, by_hand.SLIP, 1.02, converged=False, reason="step limit reached")
    unseen = [dataclasses.replace(n, value=0.0 if "hysteresis" in n.name else n.value)
              for n in fit.numbers]  # fmt: skip
    rough = dataclasses.replace(fit, numbers=tuple(unseen))
    step = dataclasses.replace(found["adequate"].ladder[0], fit=rough)
    ended, out, err, _ = command(result=dataclasses.replace(found["adequate"], ladder=(step,)))
    assert ended == status
    assert "[[Models]]" in out
    assert err == "residyn: step limit reached\n" * status


def test_ctrl_c_in_the_search_prints_the_best_so_far(command):
    stopped = by_hand.missing(budget=Budget(4, 40, "interrupted"))
    status, out, err, _ = command(result=stopped)
    assert status == 130
    assert out.startswith("The search was stopped by Ctrl-C")
    assert "[[Models]]" in out
    assert err == "residyn: interrupted: the best so far is above\n"


def test_ctrl_c_before_there_is_anything_says_so(command, monkeypatch):
    def interrupted(*words):
        raise KeyboardInterrupt

    monkeypatch.setattr("residyn.cli._work.load", interrupted)
    status, out, err, _ = command()
    assert (status, out, err) == (130, "", "residyn: interrupted\n")
