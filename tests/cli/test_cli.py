"""The command: what it prints where, and how it ends."""

import fcntl
import io
import json
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from residyn.cli import main

STIFFNESS, DAMPING, MASS, NOISE = 100.0, 0.8, 1.0, 1e-4
COMPILING = ("fit", "diagnose", "simulate", "demo", "race")
CONTRACT = {
    "model",
    "parameters",
    "rmse",
    "noise",
    "reduced_chi2",
    "check_rmse",
    "modes",
    "starts",
    "agreeing_starts",
    "converged",
    "seconds",
    "warnings",
}


def ringing(time, angle, seed):
    """A cart on a spring and a damper, let go at rest; with noise."""
    rate = DAMPING / (2 * MASS)
    fast = np.sqrt(STIFFNESS / MASS - rate**2)
    wave = np.cos(fast * time) + rate / fast * np.sin(fast * time)
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(time))
    return angle * np.exp(-rate * time) * wave + noise


TOML = f"""
[inertia]
joints = ["cart"]
units = ["m"]
matrix = [[{MASS}]]

[[recordings]]
file = "one.csv"
noise = {NOISE}

[[recordings]]
file = "two.csv"
noise = {NOISE}
role = "check"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cart")
    time = np.arange(300) / 100
    for seed, (name, angle) in enumerate((("one", 0.05), ("two", -0.03))):
        lines = [
            f"{t:.2f},{float(q)!r}" for t, q in zip(time, ringing(time, angle, seed), strict=True)
        ]
        lines[7] = lines[7].split(",")[0] + ","  # a lost sample
        (folder / f"{name}.csv").write_text("\n".join(["t,q1", *lines, ""]))
    (folder / "cart.toml").write_text(TOML)
    (folder / "empty").mkdir()
    return folder


@pytest.fixture
def command(folder, monkeypatch, capsys):
    """Runs a command in the folder of the experiment."""
    monkeypatch.chdir(folder)

    def run(*words, stdin=None):
        if stdin is not None:
            monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin.encode())))
        cache = ["--no-cache"] if words and words[0] in COMPILING else []
        status = main([*words, *cache])
        out, err = capsys.readouterr()
        return SimpleNamespace(status=status, out=out, err=err)

    return run


def in_new_process(code, **options):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, **options
    )


# -- quick things ----------------------------------------------------------------------------


def test_help_loads_neither_jax_nor_matplotlib():
    end = in_new_process(
        "import sys, residyn.cli\n"
        "commands = 'fit', 'compare', 'diagnose', 'inertia', 'unload', 'race', 'simulate'\n"
        "helps = [[command, '--help'] for command in commands]\n"
        "for words in ([], ['--help'], *helps, ['--version'], ['fit', '--no-such']):\n"
        "    residyn.cli.main(words)\n"
        "heavy = {'jax', 'scipy', 'matplotlib', 'equinox', 'jinja2'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    assert end.returncode == 0, end.stderr


@pytest.mark.parametrize(
    "words",
    [(), ("--help",), ("-h",), ("fit", "--help"), ("diagnose", "--help"), ("demo", "-h")],
)
def test_help(command, words):
    end = command(*words)
    assert (end.status, end.err) == (0, "")
    assert "Usage: residyn" in end.out
    assert max(map(len, end.out.splitlines())) <= 80
    assert "..." not in end.out.partition("Commands:")[2]  # no description is cut


def test_help_names_the_options_of_the_contract(command):
    text = command("fit", "--help").out
    for option in ("EXPERIMENT", "--with EFFECT", "--starts N", "--method", "--json", "--report"):
        assert option in text


def test_version(command):
    import residyn

    assert command("--version").out == f"{residyn.__version__}\n"


# -- bad input: one line, exit status 2 ------------------------------------------------------

BAD = {
    "no experiment": (["fit"], "EXPERIMENT"),
    "no such command": (["fti"], "'fti'; did you mean 'fit'? see residyn --help"),
    "no such option": (["fit", "cart.toml", "--fast"], "--fast"),
    "no such file": (["fit", "none.toml"], "none.toml"),
    "a folder": (["fit", "."], "folder"),
    "not an experiment": (["fit", "one.csv"], "residyn new experiment.toml one.csv"),
    "no such effect": (["fit", "cart.toml", "--with", "coulomb"], "--with: there is no effect"),
    "no such rival": (["fit", "cart.toml", "--against", "gravty"], "--against: there is no effect"),
    "no such joint": (["fit", "cart.toml", "--with", "coulomb_friction:wheel"], "goes with cart"),
    "effect of arms": (["fit", "cart.toml", "--with", "inertia_error:elbow"], "[arm]"),
    "twice": (["fit", "cart.toml", "--with", "spring:cart"], "already"),
    "no such method": (["fit", "cart.toml", "--method", "magic"], "levenberg"),
    "no starts": (["fit", "cart.toml", "--starts", "0"], "--starts"),
    "starts without use": (
        ["fit", "cart.toml", "--method", "genetic", "--starts", "3"],
        "--starts",
    ),
    "starts in words": (["fit", "cart.toml", "--starts", "six"], "valid integer"),
    "a time in words": (["race", "cart.toml", "--seconds", "5min"], "for '--seconds': "),
    "a port that is none": (["explore", "demo", "--port=99999"], "65535"),
    "json nowhere": (["fit", "cart.toml", "--json", "no/such/folder.json"], "no/such/folder.json"),
    "report nowhere": (["fit", "cart.toml", "--report", "no/such.html"], "no/such.html"),
    "report into a folder": (["fit", "cart.toml", "--report", "."], "--report"),
    "report to a pipe": (["fit", "cart.toml", "--report", "-"], "must end in .html"),
    "both into one": (
        ["fit", "cart.toml", "--report", "x.html", "--json", "./x.html"],
        "same file",
    ),
    "json over input": (["fit", "cart.toml", "--json", "one.csv"], "input"),
    "report of another kind": (["diagnose", "cart.toml", "--report", "x.pdf"], "must end in .html"),
    "page of another kind": (["race", "cart.toml", "--report", "x"], "must end in .html"),
    "table of another kind": (["fit", "cart.toml", "--table", "x.pdf"], "must end in .tex or .csv"),
    "table nowhere": (["fit", "cart.toml", "--table", "no/x.tex"], "cannot be written"),
    "table over input": (["fit", "cart.toml", "--table", "one.csv"], "input"),
    "table into JSON": (["fit", "cart.toml", "--table", "a.csv", "--json", "./a.csv"], "same file"),
    "against itself": (
        ["fit", "cart.toml", "--with", "hysteresis:cart", "--against", "hysteresis"],
        "--against hysteresis: is the model",
    ),
    "each nowhere": (["fit", "--each", "nowhere"], "no such folder"),
    "each of nothing": (["fit", "--each", "empty"], "no experiment in it"),
    "each and one": (["fit", "cart.toml", "--each", "."], "--each . does not go with EXPERIMENT"),
    "each with no such effect": (
        ["fit", "--each", ".", "--with", "coulomb"],
        "--with: there is no effect",
    ),
    "jobs of one": (["fit", "cart.toml", "--jobs", "2"], "--jobs 2 goes with --each"),
    "no jobs": (["fit", "--each", ".", "--jobs", "0"], "--jobs"),
    "lines nowhere": (["fit", "--each", ".", "--json", "no/all.jsonl"], "cannot be written"),
    "lines over input": (["fit", "--each", ".", "--json", "cart.toml"], "is an input"),
    "race of nonsense": (
        ["race", "cart.toml", "--methods", "nonsense"],
        '--methods "nonsense": there',
    ),
    "race of no minimiser": (["race", "cart.toml", "--methods", "optax.x"], "optax has no such"),
    "race back in time": (["race", "cart.toml", "--seconds", "-3"], "for '--seconds': "),
    "race of nothing": (["race", "cart.toml", "--simulations", "0"], "for '--simulations': "),
    "race of two lengths": (
        ["race", "cart.toml", "--seconds", "1", "--simulations", "9"],
        "give one of them",
    ),
    "no such solver": (["race", "cart.toml", "--integrator", "Euler99"], "no such solver"),
    "no such suspect": (["diagnose", "cart.toml", "--with", "coulomb"], "coulomb_friction"),
    "demo nowhere": (["demo", "--report", "no/such.html"], "no/such.html"),
    "no catalogue entry": (["effects", "coulomb"], "coulomb_friction"),
    "no such picture": (
        ["effects", "spring", "--plot", "x.bmp"],
        "--plot x.bmp: must end in .png, .svg or .pdf",
    ),
    "set without value": (
        ["simulate", "cart.toml", "--set", "spring:cart.stiffness"],
        "NAME=VALUE",
    ),
    "set to words": (["simulate", "cart.toml", "--set", "spring:cart.stiffness=much"], "much"),
    "set too large": (
        ["simulate", "cart.toml", "--set", "spring:cart.stiffness=1e300"],
        "1e+30 at most",
    ),
    "set twice": (["simulate", "cart.toml", "--set", "a=1", "--set", "a=2"], "twice"),
    "set too little": (["simulate", "cart.toml", "--set", "damper:cart.damping=1"], "stiffness"),
    "set unknown": (
        ["simulate", "cart.toml", "--set", "coulomb_friction:cart.torque=1"],
        "--with coulomb_friction:cart",
    ),
    "too many angles": (["simulate", "cart.toml", "--q0", "1,2"], "--q0"),
    "negative noise": (["simulate", "cart.toml", "--noise", "-1"], "--noise"),
    "noise that is no number": (["simulate", "cart.toml", "--noise", "nan"], "--noise"),
    "noise without end": (["simulate", "cart.toml", "--noise", "inf"], "--noise"),
    "over the inputs": (["simulate", "cart.toml", "--out", "."], "one.csv"),
    "into a file": (["simulate", "cart.toml", "--out", "cart.toml"], "--out"),
}


@pytest.mark.parametrize(("words", "names"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line(command, folder, words, names):
    before = {path: path.read_bytes() for path in folder.glob("*.*")}
    end = command(*words)
    assert (end.status, end.out) == (2, "")
    assert end.err.startswith("residyn: ")
    assert end.err.count("\n") == 1
    assert names in end.err
    assert {path: path.read_bytes() for path in folder.glob("*.*")} == before


# -- the fit ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted(folder):
    """One run of `fit` that writes everything: its two files."""
    files = folder / "fit.json", folder / "fit.html"
    words = ["fit", str(folder / "cart.toml"), "--no-cache", "--json", str(files[0])]
    assert main([*words, "--report", str(files[1])]) == 0
    return json.loads(files[0].read_text()), files[1].read_text()


def test_json_keeps_the_contract(fitted):
    result, _ = fitted
    assert set(result) >= CONTRACT
    assert result["model"] == ["spring:cart", "damper:cart"]
    stiffness = result["parameters"]["spring:cart.stiffness"]
    assert set(stiffness) == {"value", "std", "unit"}
    assert stiffness["unit"] == "N/m"
    assert abs(stiffness["value"] - STIFFNESS) < 5 * stiffness["std"] < 0.05 * STIFFNESS
    assert result["check_rmse"]["cart"] == pytest.approx(NOISE, rel=0.2)
    assert set(result["modes"][0]) == {
        "frequency_hz",
        "frequency_hz_std",
        "damping_ratio",
        "damping_ratio_std",
    }


def test_report_is_written(fitted):
    assert "spring:" in fitted[1]


def test_a_table_is_latex_or_csv_by_its_name(command, folder, fitted):
    for name, begins in (("fit.csv", "name,value,std,unit\nspring:cart"), ("fit.tex", "% needs")):
        end = command("fit", "cart.toml", "--starts", "1", "--table", name)
        assert (end.status, f"table: {name}" in end.out) == (0, True)
        assert (folder / name).read_text().startswith(begins)


def test_two_models_side_by_side(command, fitted):
    words = ["fit", "cart.toml", "--with", "constant_torque", "--against", "nothing"]
    end = command(*words, "--json", "side.json")
    assert end.status == 0
    assert max(map(len, end.out.splitlines())) <= 80
    assert end.out.startswith("A: springs and dampers + constant torque\nB: springs and dampers\n")
    found = json.loads(Path("side.json").read_text())
    one, other = found["fits"]
    assert other["parameters"] == fitted[0]["parameters"]
    # Nothing pushes this cart: a number more gains about one in chi-square and costs ln N = 5.7.
    freedom = 299 - 4  # a sample was lost; two numbers, two initial states
    gain = other["reduced_chi2"] * freedom - one["reduced_chi2"] * (freedom - 1)
    assert found["bic"] == pytest.approx(np.log(299) - gain, abs=0.2)
    assert "for B (BIC lower by" in end.out
    end = command("fit", "cart.toml", "--against", "nothing", "--table", "x.csv")
    assert (end.status, end.err.count("\n")) == (2, 1)


def test_what_is_not_seen_is_a_warning_and_the_fit_stands(command):
    end = command("fit", "cart.toml", "--with", "hysteresis", "--json", "unseen.json")
    assert end.status == 0, end.err
    assert "hysteresis:cart is not seen in these recordings" in end.out
    found = json.loads(Path("unseen.json").read_text())["parameters"]["spring:cart.stiffness"]
    assert abs(found["value"] - STIFFNESS) < 5 * found["std"] < 0.1 * STIFFNESS


def test_json_on_standard_output_is_alone_there(command, fitted):
    end = command("fit", "cart.toml", "--json", "-")
    assert end.status == 0
    assert set(json.loads(end.out)) >= CONTRACT
    assert "spring:cart.stiffness" in end.err


def test_experiment_on_standard_input(command, fitted):
    end = command("fit", "-", stdin=TOML)
    assert end.status == 0
    assert "spring:cart.stiffness" in end.out
    assert end.err == ""  # no progress where nobody watches


def test_json_has_no_infinities():
    from residyn.runtime.json import finite

    inf, nan = float("inf"), float("nan")
    assert finite({"a": [1.0, inf], "b": (nan, "x", True)}) == {
        "a": [1.0, None],
        "b": [None, "x", True],
    }


def breaking_off(monkeypatch, error):
    import residyn.fitting

    def fit(*_, **__):
        raise error

    monkeypatch.setattr(residyn.fitting, "fit", fit)


def test_no_numbers_is_exit_status_1(command, monkeypatch):
    from residyn.fitting.result import FitError

    breaking_off(monkeypatch, FitError("no start led to finite numbers"))
    end = command("fit", "cart.toml")
    assert (end.status, end.out) == (1, "")
    assert end.err == "residyn: no start led to finite numbers\n"


def test_interrupt_is_one_line(command, monkeypatch):
    breaking_off(monkeypatch, KeyboardInterrupt())
    end = command("fit", "cart.toml")
    assert (end.status, end.err) == (130, "residyn: interrupted\n")


def test_ctrl_c_is_not_lost_while_memory_is_freed(command, monkeypatch):
    import residyn.fitting

    class Freed:
        def __del__(self):
            raise KeyboardInterrupt

    def fit(*_, **__):
        Freed()
        time.sleep(60)  # which the interrupt ends

    was = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(residyn.fitting, "fit", fit)
    end = command("fit", "cart.toml")
    signal.signal(signal.SIGINT, was)
    assert (end.status, end.err) == (130, "residyn: interrupted\n")


@pytest.mark.parametrize("error", [KeyError("oops"), np.linalg.LinAlgError("Singular matrix")])
def test_a_bug_is_one_line_too(command, monkeypatch, error):
    breaking_off(monkeypatch, error)
    end = command("fit", "cart.toml")
    assert end.status == 1
    assert end.err.count("\n") == 1
    assert "RESIDYN_TRACEBACK" in end.err
    monkeypatch.setenv("RESIDYN_TRACEBACK", "1")
    with pytest.raises(type(error)):
        command("fit", "cart.toml")


@pytest.mark.parametrize("words", ["Unable to allocate 30 GiB", "RESOURCE_EXHAUSTED: 46 GB"])
def test_too_little_memory_is_no_bug(command, monkeypatch, words):
    error = RuntimeError if "_" in words else MemoryError  # XLA's own is a RuntimeError
    breaking_off(monkeypatch, error(words))
    end = command("fit", "cart.toml", "--starts", "1000000000")
    assert (end.status, end.err) == (1, f"residyn: there is not enough memory: {words}\n")


def test_a_fit_that_did_not_settle_prints_and_is_exit_status_1(command, monkeypatch):
    class Rough:
        misses = False
        converged, stands, reason = False, False, "step limit reached"
        to_dict = staticmethod(dict)

        def __str__(self):
            return "rough numbers"

    import residyn.fitting

    monkeypatch.setattr(residyn.fitting, "fit", lambda *_, **__: Rough())
    end = command("fit", "cart.toml")
    assert (end.status, end.out) == (1, "rough numbers\n")
    assert end.err == "residyn: step limit reached\n"


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "grows.toml"),
        ("fit", "grows.toml", "--with", "quadratic_drag", "--against", "nothing"),
        ("compare", "grows.toml"),
        ("simulate", "grows.toml", "--out", "grown"),
        ("diagnose", "grows.toml", "--max-effects", "0"),
        ("plan", "grows.toml", "--max-effects", "0", "--tests", "1"),
    ],
)
def test_a_base_that_no_arm_has_is_exit_status_1_of_every_command(
    command, folder, words, monkeypatch
):
    """Of commands that search, only the fit at their end is real."""
    import residyn.diagnosis
    import residyn.fitting

    def found(experiment, **_):
        fit = residyn.fitting.fit(experiment, starts=1)
        budget = SimpleNamespace(stopped=None)
        return SimpleNamespace(fit=fit, base=fit, added=(), budget=budget)

    monkeypatch.setattr(residyn.diagnosis, "compare_fit", lambda fit, say: fit, raising=False)
    monkeypatch.setattr(residyn.diagnosis, "diagnose", found, raising=False)
    monkeypatch.setattr(residyn.diagnosis, "plan", lambda *_, **__: "a plan", raising=False)
    time = np.arange(300) / 100
    q = ringing(time, 0.05, 0) * np.exp(0.6 * DAMPING * time)
    rows = [f"{t:.2f},{float(x)!r}" for t, x in zip(time, q, strict=True)]
    (folder / "grows.csv").write_text("\n".join(["t,q1", *rows, ""]))
    head = TOML.split("[[recordings]]")[0]
    (folder / "grows.toml").write_text(f'{head}[[recordings]]\nfile = "grows.csv"\n')
    end = command(*words)
    assert end.status == 1
    assert end.out
    assert end.err.endswith("damper:cart.damping: negative, which is not physical\n")


# -- simulate --------------------------------------------------------------------------------

SET = ("--set", f"spring:cart.stiffness={STIFFNESS}", "--set", f"damper:cart.damping={DAMPING}")


def read(path):
    return np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)


def test_simulate_with_given_numbers(command, folder):
    end = command("simulate", "cart.toml", *SET, "--out", "given")
    assert end.status == 0
    assert end.err == (
        "begins with angles from the first readings, smoothed and rates of zero; --q0 and --v0 "
        "give others\n"
    )
    header = (folder / "given" / "one.csv").read_text().splitlines()[0]
    assert header == "t,q1"
    for name, angle in (("one", 0.05), ("two", -0.03)):
        time, q = read(folder / "given" / f"{name}.csv")
        true = ringing(time, angle, 0) - ringing(time, 0.0, 0)
        np.testing.assert_allclose(q, true, atol=2 * NOISE)


def test_simulate_leaves_no_folder_of_a_motion_that_runs_away(command, folder):
    numbers = "--set", "spring:cart.stiffness=-1e6", "--set", "damper:cart.damping=-1e3"
    end = command("simulate", "cart.toml", *numbers, "--out", "no/where")
    assert (end.status, end.out) == (1, "")
    assert "runs away" in end.err
    assert not (folder / "no").exists()


def test_simulate_begins_near_the_first_reading_however_late_it_is(command, folder):
    time = np.arange(300) / 100
    rows = zip(time, ringing(time, 0.05, 0), strict=True)
    lines = [f"{t:.2f},{'' if t < 1 else q}" for t, q in rows]
    (folder / "late.csv").write_text("\n".join(["t,q1", *lines, ""]))
    (folder / "late.toml").write_text(TOML.replace('"one.csv"', '"late.csv"\nstart = 0'))
    assert command("simulate", "late.toml", *SET, "--out", "late").status == 0
    _, q = read(folder / "late" / "late.csv")
    assert 0.01 < np.abs(q).max() < 0.06


def test_simulate_begins_where_it_is_told_and_adds_noise(command, folder):
    words = ("simulate", "cart.toml", *SET, "--q0", "0.2", "--v0", "0", "--out")
    assert command(*words, "still").err == ""
    end = command(*words[:-3], "--out", "still")
    assert end.err == "begins with rates of zero; --v0 gives others\n"
    for out, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        assert command(*words, out, "--noise", "1e-3", "--seed", seed).status == 0
    still, a, b, c = (read(folder / out / "one.csv")[1] for out in ("still", "a", "b", "c"))
    assert still[0] == 0.2
    assert np.std(a - still) == pytest.approx(1e-3, rel=0.2)
    assert (a == b).all()
    assert (a != c).all()


def test_simulate_knows_what_a_recording_has_for_itself(command, folder):
    """No load presses the first one; the second has a load, and no damping."""
    loaded = 'load = 2.0\nown = ["damper:cart"]'
    wrong = TOML.replace('role = "check"', loaded.replace("cart", "wheel"))
    (folder / "wrong.toml").write_text(wrong)
    end = command("fit", "wrong.toml")
    assert end.err.startswith('residyn: wrong.toml: two.csv: own: "damper:wheel": damper goes')
    (folder / "runs.toml").write_text(TOML.replace('role = "check"', loaded))
    more = ("damper:cart.damping (two.csv)=0", "load_friction:cart.coefficient=0.1")
    words = ["simulate", "runs.toml", "--with", "load_friction", *SET, "--q0", "0.05", "--v0", "0"]
    end = command(*words, "--out", "runs", *(x for each in more for x in ("--set", each)))
    assert (end.status, end.err) == (0, "")
    time, q = read(folder / "runs" / "one.csv")
    np.testing.assert_allclose(q, ringing(time, 0.05, 0) - ringing(time, 0.0, 0), atol=1e-5)
    # Dry friction alone takes 4 F / k from the amplitude of each cycle.
    time, q = read(folder / "runs" / "two.csv")
    assert np.interp(2 * np.pi / 10, time, q) == pytest.approx(0.05 - 4 * 0.2 / 100, abs=1e-4)
    end = command(*words, "--out", "runs", "--set", more[1])
    assert (end.status, end.err.count("\n")) == (2, 1)
    assert "damper:cart.damping (two.csv) not set" in end.err


def test_simulate_fits_first_when_nothing_is_set(command, folder, fitted):
    end = command("simulate", "cart.toml", "--out", "after")
    assert end.status == 0
    assert "spring:cart.stiffness" in end.err
    time, q = read(folder / "after" / "two.csv")
    np.testing.assert_allclose(q, ringing(time, -0.03, 0) - ringing(time, 0.0, 0), atol=NOISE)


# -- effects ---------------------------------------------------------------------------------


def names():
    from residyn.effects import CATALOGUE

    return list(CATALOGUE)


def test_effects_to_a_pipe_is_one_line_each(command):
    lines = command("effects").out.splitlines()
    assert [line.split("\t")[0] for line in lines] == ["name", *names()]
    assert {line.count("\t") for line in lines} == {3}


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_effects_in_a_terminal(width):
    from rich.console import Console

    from residyn.cli._effects import tabulate
    from residyn.effects import CATALOGUE

    out = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    tabulate(out, list(CATALOGUE.values()))
    assert isinstance(out.file, io.StringIO)
    lines = out.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    first = [line.split()[0] for line in lines if line[1:2].strip()]
    assert [word for word in first if word in CATALOGUE] == names()


@pytest.mark.parametrize("name", ["coulomb_friction", "coulomb_friction:elbow", "gravity"])
def test_one_effect_in_full(command, name):
    from residyn.effects import CATALOGUE

    end = command("effects", name)
    kind = CATALOGUE[name.partition(":")[0]]
    assert end.status == 0
    for words in (kind.equation, kind.looks_like, kind.source):
        assert words in end.out
    assert all(line == line.rstrip() for line in end.out.splitlines())


@pytest.mark.parametrize("words", [["effects"], ["effects", "spring"]])  # print's and rich's
def test_a_reader_that_leaves_is_no_error(words):
    read_end, write_end = os.pipe()
    os.close(read_end)
    code = f"import sys, residyn.cli; sys.exit(residyn.cli.main({words}))"
    end = subprocess.run(
        [sys.executable, "-c", code], stdout=write_end, stderr=subprocess.PIPE, check=False
    )
    os.close(write_end)
    assert end.stderr == b""
    assert end.returncode == 141


def test_on_a_terminal_a_line_is_wrapped_between_words():
    terminal, end = pty.openpty()
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("4H", 24, 60, 0, 0))
    words = ["fit", "x.toml", "--method", "magic"]
    code = f"import residyn.cli; residyn.cli.main({words})"
    subprocess.run([sys.executable, "-c", code], stderr=end, check=True)
    lines = os.read(terminal, 4096).decode().splitlines()
    os.close(end)
    os.close(terminal)
    assert len(lines) > 1
    assert max(map(len, lines)) <= 60
    assert " ".join(" ".join(lines).split()).endswith("or a minimiser such as optimistix.BFGS")


def test_ctrl_c_is_not_lost_where_a_library_catches_everything():
    end = in_new_process(
        "import os, signal, sys, types\n"
        # In the background of a script Ctrl-C is ignored, and a child begins so.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import residyn.__main__ as command\n"
        "def importing():\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    except BaseException:\n"
        "        pass\n"
        "    print('went on')\n"
        "sys.modules['residyn.cli'] = types.SimpleNamespace(main=importing)\n"
        "command.main()\n"
    )
    assert (end.returncode, end.stdout, end.stderr) == (130, "", "residyn: interrupted\n")


def test_garbage_is_collected_again_where_the_work_begins():
    end = in_new_process(
        "import gc, sys\n"
        "import residyn.__main__ as command\n"
        "from residyn.demo import experiment_file\n"
        "with experiment_file() as path:\n"
        "    sys.argv = ['residyn', 'fit', str(path)]\n"
        "    status = command.main()\n"
        "print(status, gc.isenabled(), gc.get_freeze_count() > 0)\n"
    )
    assert end.stdout.splitlines()[-1] == "0 True True"


def test_a_long_line_of_progress_keeps_its_spinner_and_its_clock(monkeypatch):
    from rich.console import Console

    from residyn.cli import _shell

    out = Console(file=io.StringIO(), width=60, force_terminal=True, color_system=None)
    monkeypatch.setattr(_shell, "console", lambda **_: out)
    with _shell.progress() as say:
        say("messung.csv (3 of 12): " + "friction of the elbow " * 5)
    assert isinstance(out.file, io.StringIO)
    (line,) = {x for x in out.file.getvalue().splitlines() if "messung" in x}
    assert "…" in line
    assert line.rstrip().endswith("0:00:00")
    assert "⠋" in line.split("messung")[0]


def test_the_defaults_are_pythons_own():
    import inspect

    from residyn.cli import _options
    from residyn.diagnosis import diagnose
    from residyn.fitting import DEFAULT_STARTS

    assert _options.STARTS == DEFAULT_STARTS
    most = inspect.signature(diagnose).parameters["max_effects"].default
    assert most == _options.MAX_EFFECTS
