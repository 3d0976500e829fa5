"""Many fits: bootstrap resamples over all devices, and folders of experiments that go on where a
killed run stopped."""

import json
import multiprocessing
import os
import resource
import subprocess
import sys
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import jax
import numpy as np
import pytest

import residyn
from residyn import cli
from residyn.fitting import batch as many
from residyn.fitting import lanes
from residyn.fitting.result_lines import ResultLines
from residyn.recordings.tables import InertiaTable

pytestmark = pytest.mark.usefixtures("compiled_in_less_time")

TABLE = InertiaTable(("cart",), ((2.0,),), ("m",))
T = np.arange(300) / 50.0


def ringing(seed=0, stiffness=50.0, noise=1e-3):
    """A cart on a spring and a damper, in closed form; m."""
    decay, fast = 0.1, np.sqrt(stiffness / 2.0 - 0.1**2)
    q = 0.1 * np.exp(-decay * T) * (np.cos(fast * T) + decay / fast * np.sin(fast * T))
    return q + noise * np.random.default_rng(seed).standard_normal(len(T))


def experiment(seed=0, stiffness=50.0):
    recording = residyn.Recording.from_arrays(T, ringing(seed, stiffness), noise=1e-3)
    return residyn.Experiment(TABLE, (recording,))


@pytest.fixture(scope="module")
def fit():
    return residyn.fit(experiment(), starts=1)


def test_bootstrap_spreads_as_the_errors_say(fit):
    found = residyn.bootstrap(fit, 200, seed=1, batch=64)
    assert found.names == tuple(n.name for n in fit.numbers)
    assert found.numbers.shape == (200, 2)
    assert found.converged.all()
    errors = np.array([n.std for n in fit.numbers])
    assert (np.abs(found.std / errors - 1) < 0.2).all()  # 200 draws: 5 % of one standard deviation
    low, high = found.interval(0.95).T
    np.testing.assert_allclose((high - low) / (2 * 1.96 * errors), 1.0, atol=0.25)
    values = np.array([n.value for n in fit.numbers])
    assert ((low < values) & (values < high)).all()


def test_the_batch_changes_nothing(fit):
    one, other = (residyn.bootstrap(fit, 10, seed=2, batch=b).numbers for b in (4, 10))
    np.testing.assert_allclose(one, other, rtol=1e-8)
    for draws in (1, 2.5):
        with pytest.raises(ValueError, match=f"draws = {draws}: must be a whole number"):
            residyn.bootstrap(fit, draws)
    with pytest.raises(ValueError, match=r"batch = 1.5: must be a whole number"):
        residyn.bootstrap(fit, 10, batch=1.5)


def fitted(batch, patch=setattr):
    """(names and their numbers, the widest batch and how many devices it was on)."""
    divided, own = [(0, 0)], lanes.run_descents

    def run(stacked, rest):
        leaf = jax.tree.leaves(stacked)[0]
        divided.append((len(leaf), len(leaf.sharding.device_set)))
        return own(stacked, rest)

    patch(lanes, "run_descents", run)
    each = residyn.fit_many([f"{x}.toml" for x in "abcde"], batch=batch)
    return {e.name: [n.value for n in e.fit.numbers] if e.fit else [] for e in each}, max(divided)


def test_two_devices_share_fits_and_experiments(folder, fit, monkeypatch):
    """The same numbers as one by one, and a broken file, or another length, is no hindrance."""
    script = folder / "two.py"
    script.write_text(
        "import json, jax, residyn\n"
        "from tests.fitting.test_batch import experiment, fitted\n"
        "assert len(jax.devices()) == 2\n"
        "found = residyn.bootstrap(residyn.fit(experiment(), starts=1), 10, seed=2, batch=3)\n"
        "print(json.dumps([found.numbers.tolist(), *fitted(1)]))\n"
    )
    rows = [f"{t:.3f},{q:.9f}" for t, q in zip(T, ringing(4, 45.0), strict=True)]
    (folder / "e.csv").write_text("t,q1\n" + "\n".join(rows[:200]) + "\n")
    (folder / "e.toml").write_text((folder / "a.toml").read_text().replace("a.csv", "e.csv"))
    monkeypatch.chdir(folder)
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=2"
    kept = str(jax.config.values["jax_compilation_cache_dir"])
    done = subprocess.run(
        [sys.executable, str(script)],
        env={
            "XLA_FLAGS": flags,
            "PYTHONPATH": f"{Path(__file__).parents[2]}",
            "PATH": "",
            "JAX_PLATFORMS": "cpu",
            "JAX_COMPILATION_CACHE_DIR": kept,
        },
        capture_output=True,
        text=True,
        check=True,
    )
    drawn, both, widest = json.loads(done.stdout)
    np.testing.assert_allclose(drawn, residyn.bootstrap(fit, 10, seed=2).numbers, rtol=1e-6)
    alone, _ = fitted(1, monkeypatch.setattr)
    assert [len(numbers) for numbers in alone.values()] == [2, 2, 0, 2, 2]
    together, shape = fitted(4, monkeypatch.setattr)
    assert (widest, shape) == ([2, 2], (4, 1))
    for found in (both, together):
        assert list(found) == list(alone)
        for name, numbers in alone.items():
            np.testing.assert_allclose(found[name], numbers, rtol=1e-5, atol=1e-9)


@pytest.fixture
def folder(tmp_path):
    for name, stiffness in (("a", 50.0), ("b", 60.0), ("d", 40.0)):
        rows = [f"{t:.3f},{q:.9f}" for t, q in zip(T, ringing(1, stiffness), strict=True)]
        (tmp_path / f"{name}.csv").write_text("t,q1\n" + "\n".join(rows) + "\n")
        (tmp_path / f"{name}.toml").write_text(
            '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[2.0]]\n'
            f'[[recordings]]\nfile = "{name}.csv"\nnoise = 1e-3\n'
        )
    (tmp_path / "c.toml").write_text('[inertia]\njoints = ["cart"]\n')
    return tmp_path


def test_one_broken_experiment_does_not_stop_the_rest(folder, capsys):
    out = folder / "all.jsonl"
    assert cli.main(["fit", "--each", str(folder), "--starts", "1", "--json", str(out)]) == 1
    told = [json.loads(line) for line in out.read_text().splitlines()]
    assert [Path(t["name"]).stem for t in told] == ["a", "b", "c", "d"]
    assert ["error" in t for t in told] == [False, False, True, False]
    values = [t["parameters"]["spring:cart.stiffness"]["value"] for t in told if "error" not in t]
    assert values == pytest.approx([50.0, 60.0, 40.0], rel=1e-2)
    printed = capsys.readouterr()
    assert "1 of 4 experiments could not be fitted" in printed.err
    assert printed.out.count("reduced chi2") == printed.out.count(" x noise; ") == 3


def test_what_a_fit_ends_with_each_ends_with(folder, capsys):
    """A fit that did not settle, one that is not physical, and what was understood of a file."""
    (folder / "c.toml").unlink()
    rows = (folder / "a.csv").read_text().splitlines()
    (folder / "a.csv").write_text("\n".join(["Time [s],Cart [m]", *rows[1:], ""]))
    grows = [f"{t:.3f},{q * np.exp(0.4 * t):.9f}" for t, q in zip(T, ringing(2), strict=True)]
    (folder / "b.csv").write_text("\n".join(["t,q1", *grows, ""]))
    out = folder / "all.jsonl"
    words = ["fit", "--each", str(folder), "--starts", "1", "--json", str(out)]
    assert cli.main(words) == 1
    printed, told = capsys.readouterr(), lines_of(out)
    assert [t["unphysical"] for t in told] == [[], ["damper:cart.damping"], []]
    assert [t["stands"] for t in told] == [True, True, True]
    assert "damper:cart.damping negative, which is not physical" in printed.out.splitlines()[1]
    assert "1 of 3 experiments" in printed.err
    assert told[0]["understood"] == ['a.csv: t from "Time [s]" in s, q1 from "Cart [m]" in m']
    assert f"residyn: a.toml: {told[0]['understood'][0]}\n" in printed.err
    (folder / "b.toml").unlink()
    told[2] |= {"converged": False, "stands": False}  # as one that did not settle
    out.write_text("".join(json.dumps(t) + "\n" for t in told))
    assert cli.main(words) == 1
    assert ", not settled (done before)" in capsys.readouterr().out.splitlines()[1]


def test_a_mistake_of_ours_in_one_does_not_stop_the_rest(folder, monkeypatch):
    own = many.load

    def load(path):
        if "b.toml" in path:
            raise IndexError("out of bounds")
        return own(path)

    monkeypatch.setattr(many, "load", load)
    files = [str(folder / f"{x}.toml") for x in "abd"]
    told = [each.told.get("error") for each in residyn.fit_many(files, starts=1)]
    assert told == [None, "this should not have happened, IndexError: out of bounds", None]


def test_processes_share_the_experiments(folder, capsys):
    (folder / "own.py").write_text(
        "from residyn.effects.friction import CoulombFriction\n\n\n"
        "class Stiction(CoulombFriction):\n"
        '    """Dry friction by another name."""\n\n    name = "stiction"\n'
    )
    out = folder / "all.jsonl"
    words = ["fit", "--each", str(folder), "--jobs", "2", "--starts", "1", "--json", str(out)]
    words += ["--effects", str(folder / "own.py"), "--with", "stiction"]
    assert cli.main(words) == 1
    told = {Path(t["name"]).stem: t for t in map(json.loads, out.read_text().splitlines())}
    assert sorted(told) == ["a", "b", "c", "d"]
    assert "error" in told["c"]
    alone = residyn.fit(residyn.load(folder / "a.toml"), effects=["coulomb_friction"], starts=1)
    theirs, ours = told["a"]["parameters"], alone.to_dict()["parameters"]
    for name, value in ours.items():
        other = theirs[name.replace("coulomb_friction", "stiction")]
        assert other["value"] == pytest.approx(value["value"], rel=1e-6, abs=1e-9)
    assert capsys.readouterr().out.count("reduced chi2") == 3


@pytest.mark.skipif(os.cpu_count() == 1, reason="one core")
@pytest.mark.parametrize(("copies", "shared"), [(1, False), (130, True)])
def test_a_large_folder_is_shared_among_the_cores(copies, shared, folder, capsys):
    text = (folder / "a.toml").read_text().replace("a.csv", "nowhere.csv")
    for i in range(copies):
        (folder / f"copy{i}.toml").write_text(text)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    assert cli.main(["fit", "--each", str(folder), "--starts", "1"]) == 1
    assert (resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime > before) is shared
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == copies + 4
    assert sum("nowhere.csv" in line for line in lines) == copies


@pytest.mark.parametrize("kind", ["threads", "dask", "dying"])
def test_any_executor_will_do(kind, folder, monkeypatch):
    monkeypatch.setattr(many, "AHEAD", 2)  # fewer than there are
    files = [str(folder / f"{n}.toml") for n in "abcd"]
    out = folder / "all.jsonl"
    next(residyn.fit_many(files[1:2], starts=1, out=out))
    if kind == "dask":
        distributed = pytest.importorskip("distributed")
        with distributed.Client(processes=False, dashboard_address=None) as client:
            found = list(residyn.fit_many(files, starts=1, out=out, executor=client.get_executor()))
    elif kind == "threads":
        with ThreadPoolExecutor(2) as pool:
            found = list(residyn.fit_many(files, starts=1, out=out, executor=pool))
    else:
        found = list(residyn.fit_many(files, starts=1, out=out, executor=Dying()))
    assert [Path(e.name).stem for e in found if e.before] == ["b"]
    assert {Path(e.name).stem for e in found} == set("abcd")
    bad = {Path(e.name).stem for e in found if "error" in e.told}
    assert bad == (set("acd") if kind == "dying" else {"c"})
    assert len(out.read_text().splitlines()) == 4


def test_what_cannot_be_sent_to_a_worker_is_a_line(folder):
    class Local(residyn.CoulombFriction):
        """A class that a worker cannot import."""

        name = "local"

    files, spawn = [str(folder / f"{n}.toml") for n in "ab"], multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn) as pool:
        found = list(residyn.fit_many(files, effects=[Local("cart")], executor=pool))
    assert sorted(Path(e.name).stem for e in found) == ["a", "b"]
    assert all("no result came from the worker, " in e.told["error"] for e in found)
    assert all("Local" in e.told["error"] for e in found)


class Dying(ThreadPoolExecutor):
    """What is left of a process pool whose workers were killed."""

    def submit(self, *what, **more):
        raise BrokenExecutor


def test_a_killed_run_goes_on(folder):
    files = [str(folder / f"{n}.toml") for n in "abd"]
    out = folder / "all.jsonl"
    first = next(residyn.fit_many(files, starts=1, out=out))
    assert first.fit is not None
    with out.open("a") as file:
        file.write('{"name": "half a li')  # killed while it wrote
    rest = list(residyn.fit_many(files, starts=1, out=out))
    assert [each.before for each in rest] == [True, False, False]
    assert rest[0].told == json.loads(json.dumps(first.told))
    assert len(out.read_text().splitlines()) == 3
    again = list(residyn.fit_many(files, starts=1, out=out))
    assert all(each.before for each in again)


def lines_of(out):
    return [json.loads(line) for line in out.read_text().splitlines()]


def test_what_differs_is_done_anew(folder):
    """TOML, data, effects, their source and options: a line of something else never counts."""
    file, out, own = str(folder / "a.toml"), folder / "all.jsonl", folder / "own.py"
    text = (
        "from residyn.effects.friction import CoulombFriction\n\n\n"
        "class Rubbing(CoulombFriction):\n"
        '    """Dry friction by another name."""\n\n    name = "rubbing"\n'
    )
    own.write_text(text)
    residyn.effects.load_effects(own)

    def run(**options):
        (each,) = residyn.fit_many([file], out=out, **({"starts": 1} | options))
        assert len(lines_of(out)) == 1
        assert lines_of(out)[0] == json.loads(json.dumps(each.told))
        return each

    assert not run().before
    assert run().before
    with_friction = run(effects=["rubbing:cart"])
    assert not with_friction.before
    assert "rubbing:cart.torque" in with_friction.told["parameters"]
    assert run(effects=["rubbing:cart"]).before
    own.write_text(text + "# edited\n")
    assert not run(effects=["rubbing:cart"]).before
    assert not run(starts=2).before
    (folder / "a.csv").write_bytes((folder / "b.csv").read_bytes())
    other = run(starts=2)
    assert not other.before
    assert other.told["parameters"]["spring:cart.stiffness"]["value"] == pytest.approx(60, rel=1e-2)
    toml = (folder / "a.toml").read_text().replace("2.0", "4.0")
    (folder / "a.toml").write_text(toml)
    heavy = run(starts=2)
    assert heavy.told["parameters"]["spring:cart.stiffness"]["value"] == pytest.approx(
        120, rel=1e-2
    )


def test_an_old_error_does_not_stay_beside_a_success(folder):
    out = folder / "all.jsonl"
    good = (folder / "a.csv").read_text()
    (folder / "a.csv").write_text("t,q1\n")
    files = [str(folder / f"{n}.toml") for n in "ac"]
    list(residyn.fit_many(files, starts=1, out=out))
    assert ["error" in told for told in lines_of(out)] == [True, True]
    (folder / "a.csv").write_text(good)
    list(residyn.fit_many(files[:1], starts=1, out=out))
    assert [(Path(t["name"]).stem, "error" in t) for t in lines_of(out)] == [("c", 1), ("a", 0)]


def test_experiments_without_a_file_are_told_apart_by_their_numbers(folder):
    out = folder / "all.jsonl"
    run = lambda *given: list(residyn.fit_many(given, starts=1, out=out))  # noqa: E731
    assert [each.before for each in run(experiment())] == [False]
    assert [each.before for each in run(experiment())] == [True]
    assert [each.before for each in run(experiment(seed=1))] == [False]


def test_a_file_cut_anywhere_loses_no_whole_line_and_has_none_twice(tmp_path):
    names = ["one", "two", "drei \u00e4"]
    digests = {name: f"{i}" * 8 for i, name in enumerate(names)}
    out = tmp_path / "all.jsonl"
    with closing(ResultLines(out, digests)) as lines:
        for name in names:
            lines.add({"name": name, "digest": digests[name], "value": float("inf")})
    whole = out.read_bytes()
    ends = [i for i, byte in enumerate(whole) if byte == ord("\n")]
    for cut in range(len(whole) + 1):
        out.write_bytes(whole[:cut])
        with closing(ResultLines(out, digests)) as lines:
            # The newline alone may be lost: the line is whole without it.
            assert list(lines.done) == names[: sum(end <= cut for end in ends)]
            for name in names:
                if name not in lines.done:
                    lines.add({"name": name, "digest": digests[name], "value": None})
        assert [told["name"] for told in lines_of(out)] == names
    assert not list(tmp_path.glob(".*"))


def test_two_runs_do_not_write_into_one_file(tmp_path, capsys):
    out = tmp_path / "all.jsonl"
    out.write_text('{"name": "x", "error": "old"}\n')
    with closing(ResultLines(out, {"x": "1"})) as first:  # which has replaced the file
        with pytest.raises(residyn.InputError, match=r"all\.jsonl: another run writes into it"):
            ResultLines(out, {"x": "1"})
        first.add({"name": "x", "digest": "1"})
    with closing(ResultLines(out, {"x": "1"})) as second:
        assert list(second.done) == ["x"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk here")
def test_a_full_disk_is_one_line():
    with (
        closing(ResultLines("/dev/full", {})) as lines,
        pytest.raises(residyn.InputError, match=r"/dev/full: cannot be written .No space left"),
    ):
        lines.add({"name": "x"})


def test_other_files_are_not_written_into(folder):
    (folder / "notes.txt").write_text("nothing of ours\n")
    with pytest.raises(residyn.InputError, match=r"notes\.txt: line 1"):
        next(residyn.fit_many([str(folder / "a.toml")], out=folder / "notes.txt"))
    with pytest.raises(residyn.InputError, match="twice"):
        next(residyn.fit_many([str(folder / "a.toml")] * 2))


@pytest.mark.parametrize("text", ['{"the only": "copy"}', "[1, 2", "a line", '{"name": "x"}\n{"b'])
def test_a_last_line_without_an_end_that_is_not_ours_stays(text, tmp_path):
    out = tmp_path / "notes.json"
    out.write_text(text)
    with pytest.raises(residyn.InputError, match=r"notes\.json: line [12]: no result of a fit"):
        ResultLines(out, {"x": "1"})
    assert out.read_text() == text
