"""The race: what is counted, what is the same for all, and what cannot be asked."""

import dataclasses
import json
import math
import re
import sys
from typing import Any

import jax
import numpy as np
import pytest

import residyn
from residyn.cli import main
from residyn.demo import experiment_file
from residyn.fitting import METHODS, MissingExtra, Race, genetic, least_squares
from residyn.fitting.history import Watch
from residyn.fitting.methods import GENETIC
from residyn.fitting.problem import ready
from residyn.fitting.race import ONE, TEN

pytestmark = pytest.mark.usefixtures("compiled_in_less_time")

ALL = [*METHODS, "optimistix.BFGS"]


@pytest.fixture(scope="module")
def experiment():
    model = residyn.PlanarArm([0.4, 0.4], 1.1662, 0.5790, 1.4384, theta2=0.3)
    model = model + residyn.Spring("shoulder", 16.7) + residyn.Spring("elbow", 16.7)
    model = model + residyn.Damper("shoulder", 0.1) + residyn.Damper("elbow", 0.1)
    time = np.arange(200) / 50
    with jax.enable_x64(True):
        angle = np.asarray(residyn.simulate(model, time, [0.25, -0.15]).q)
    angle = angle + 1e-3 * np.random.default_rng(0).standard_normal(angle.shape)
    recording = residyn.Recording.from_arrays(time, angle, noise=1e-3, theta2=0.3)
    table = residyn.recording.ArmTable((0.4, 0.4), 1.1662, 0.5790, 1.4384)
    return residyn.Experiment(table, (recording,))


@pytest.fixture(scope="module")
def raced(experiment) -> Race:
    return residyn.race(experiment, methods=ALL, simulations=1000)


@pytest.fixture(scope="module")
def demo():
    with experiment_file() as file:
        yield file


def test_every_objective_is_that_of_a_fit_by_the_same_method(experiment, raced):
    assert [each.name for each in raced.methods] == ALL
    for each in raced.methods:
        own: dict[str, Any] = {}
        if each.name in GENETIC:
            own = {"generations": 1000 // GENETIC[each.name].population, "seed": 0}
        fit = residyn.fit(experiment, method=each.name, **own)
        assert each.median.objective == pytest.approx(fit.objective, rel=1e-9)


def test_steps_of_descents_are_counted_with_every_direction(experiment, monkeypatch):
    evaluations, compressed = [], least_squares.compressed

    def counted(problem, *given):
        jax.debug.callback(lambda steps: evaluations.append(int(steps)), problem.steps)
        return compressed(problem, *given)

    monkeypatch.setattr(least_squares, "compressed", counted)
    # Two recordings: of shapes that no other test has, so that the program is traced here. One more
    # is held out, and takes no part.
    check = dataclasses.replace(experiment.recordings[0], role="check")
    three = dataclasses.replace(experiment, recordings=(*2 * experiment.recordings, check))
    (each,) = residyn.race(three, methods=["levenberg"]).methods
    jax.effects_barrier()
    # Four numbers, and four initial states of each recording: eight directions, and the motion.
    simulations = sum(9 * steps / min(evaluations) for steps in evaluations)
    assert simulations == 2 * each.median.simulations  # once before the race, to compile


def test_individuals_are_counted_as_they_are_simulated(experiment, monkeypatch):
    ran, objective = [], genetic.objective_of

    def counted(look, genes):
        jax.debug.callback(lambda _: ran.append(1), genes)
        return objective(look, genes)

    monkeypatch.setattr(genetic, "objective_of", counted)
    # Two recordings: of shapes that no other test has, so that the program is traced here.
    two = dataclasses.replace(experiment, recordings=2 * experiment.recordings)
    (each,) = residyn.race(two, methods=["cma_es"], simulations=100).methods
    jax.effects_barrier()
    assert each.median.simulations == 100
    # The first generation of 20 was run once before, to compile.
    assert len(ran) == 120


def test_histories_grow(raced):
    by = {each.name: each.median for each in raced.methods}
    for name, method in GENETIC.items():
        assert by[name].simulations == 1000 // method.population * method.population
    assert by["random"].simulations % 9 == 100 % 9  # a hundred that are drawn
    assert by["optimistix.BFGS"].simulations % 9 == 0
    for run in by.values():
        history = run.history
        assert np.all(np.diff(history.simulations) >= 0)
        assert np.all(np.diff(history.objective) <= 0)
        assert np.all(np.diff(history.seconds) >= 0)


def test_what_was_spent_until_an_objective_is_read_off_the_history(raced):
    for each in raced.methods:
        ten, one = (each.within(x * raced.least) for x in (TEN, ONE))
        assert ten.simulations <= one.simulations
        reached = each.median.history.objective[-1] <= ONE * raced.least
        assert math.isfinite(one.simulations) == reached


def test_gradients_need_fewer_simulations_than_a_search(raced):
    by = {each.name: each for each in raced.methods}
    descent = by["levenberg"].within(ONE * raced.least).simulations
    assert descent < by["cma_es"].within(ONE * raced.least).simulations


def test_numbers_are_measured_in_standard_errors_of_the_best(raced):
    assert raced.best is not None
    assert np.all(raced.off(raced.best) == 0)
    by = {each.name: each.median for each in raced.methods}
    # Both minima are nearly the same, if not quite: Eq. 17 weighs the joints otherwise.
    assert np.max(raced.off(by["levenberg"])) < 3.0


def test_seeds_differ_and_are_told(experiment):
    found = residyn.race(experiment, methods=["cma_es"], repeats=2, simulations=200)
    (each,) = found.methods
    assert [run.seed for run in each.runs] == [0, 1]
    assert each.runs[0].objective != each.runs[1].objective
    assert each.worst.objective >= each.median.objective
    assert len(found.to_dict()["methods"][0]["seeds"]) == 2
    assert "the worst" in str(found)


def test_a_method_may_be_handed_over(experiment):
    optimistix = pytest.importorskip("optimistix")
    found = residyn.race(
        experiment, methods=["levenberg", optimistix.LevenbergMarquardt(1e-6, 1e-6)]
    )
    own, other = (each.median.objective for each in found.methods)
    assert own == pytest.approx(other, rel=1e-3)


def test_an_interrupted_race_keeps_what_is_done(experiment):
    def news(name, seed, watch):
        if name == "cma_es":
            raise KeyboardInterrupt

    found = residyn.race(experiment, methods=["levenberg", "cma_es"], simulations=200, news=news)
    assert [each.name for each in found.methods] == ["levenberg"]
    assert found.interrupted == "cma_es"
    assert "interrupted while cma_es" in str(found)


def test_a_method_of_optax_by_its_name(experiment):
    optax = pytest.importorskip("optax")
    by_name = residyn.fit(experiment, method="optax.adam", steps=3)
    handed = residyn.fit(experiment, method=optax.adam(0.02), steps=3)
    assert by_name.objective == pytest.approx(handed.objective, rel=1e-12)
    assert by_name.history.simulations.tolist() == [9, 18, 27]
    assert by_name.history.objective[-1] < by_name.history.objective[0]
    assert by_name.objective == pytest.approx(by_name.history.objective[-1], rel=1e-4)


def test_a_line_search_is_counted_as_it_is_run(experiment):
    fit = residyn.fit(experiment, method="optax.lbfgs", steps=3)
    spent = np.diff(fit.history.simulations, prepend=0.0)
    # At each point that is looked at along the line: the motion, and eight directions.
    assert np.all(spent % 9 == 0)
    assert np.all(spent >= 18)


def test_segments_cost_simulations_but_their_objective_is_another_problems(experiment):
    watch = Watch()
    with jax.enable_x64(True):
        for recordings in (experiment.recordings, 2 * experiment.recordings):
            here = ready(experiment, recordings, ())
            wild = [np.zeros(r.angle.shape, bool) for r in recordings]
            problem, states = here.problem(here.model.with_vector(here.typical()), wild)
            watch.descended(problem, problem.scaled(here.typical(), states), 1)
    assert [row[0] for row in watch.rows] == [9, 18]
    assert watch.rows[0][2] == watch.rows[1][2] < math.inf


def test_a_watch_stops_where_nothing_is_counted(monkeypatch):
    clock = iter(np.arange(100.0))
    monkeypatch.setattr("residyn.fitting.history.time.perf_counter", lambda: next(clock))
    watch = Watch(most_seconds=3.0)  # at 0
    with watch.paused():  # from 1 to 2
        pass
    assert watch.seconds == 2.0  # at 3, less 1
    assert watch.over()


def test_budgets_and_methods_that_cannot_be(experiment, monkeypatch):
    with pytest.raises(ValueError, match="did you mean genetic"):
        residyn.race(experiment, methods=["genetics"])
    with pytest.raises(ValueError, match=r'methods = "levenberg": must be a list, as \["leven'):
        residyn.race(experiment, methods="levenberg")
    with pytest.raises(ValueError, match="is there twice"):
        residyn.race(experiment, methods=["levenberg", "levenberg"])
    with pytest.raises(ValueError, match="optimistix has no such"):
        residyn.race(experiment, methods=["optimistix.Nonsense"])
    with pytest.raises(ValueError, match="seconds = -1"):
        residyn.race(experiment, methods=["levenberg"], seconds=-1)
    for repeats in (0, 1.5):
        with pytest.raises(ValueError, match=f"repeats = {repeats}: must be a whole number"):
            residyn.race(experiment, methods=["levenberg"], repeats=repeats)
    monkeypatch.setitem(sys.modules, "evosax.algorithms", None)
    with pytest.raises(MissingExtra, match=r"residyn\[ga\]"):
        residyn.race(experiment, methods=["levenberg", "cma_es"])


def test_the_command_writes_what_it_found(demo, tmp_path, capsys):
    out = {name: tmp_path / name for name in ("race.json", "race.html", "race.csv")}
    words = [
        "race",
        str(demo),
        "--methods",
        "levenberg,cma_es",
        "--simulations",
        "400",
        "--no-cache",
    ]
    words += ["--json", str(out["race.json"]), "--report", str(out["race.html"])]
    assert main([*words, "--table", str(out["race.csv"])]) == 0
    told = json.loads(out["race.json"].read_text())
    assert [m["name"] for m in told["methods"]] == ["levenberg", "cma_es"]
    keys = {"objective", "simulations", "seconds", "parameters"}
    keys |= {"within_10_percent", "within_1_percent"}
    assert all(keys <= set(m) for m in told["methods"])
    page = out["race.html"].read_text()
    assert page.count('type="checkbox"') == 2
    for i in range(2):  # each switch hides a curve of both pictures
        assert f'#switch-{i}:not(:checked)) [id$="-curve-{i}"]' in page
        assert len(re.findall(rf'id="(?:simulations|seconds)-curve-{i}"', page)) == 2
    assert "<script" not in page
    assert len(out["race.csv"].read_text().splitlines()) == 3
    assert "least objective (Eq. 17)" in capsys.readouterr().out


def test_a_race_without_the_extra_is_one_line(demo, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "evosax.algorithms", None)
    assert main(["race", str(demo), "--no-cache"]) == 2
    error = capsys.readouterr().err.strip()
    assert "pip install 'residyn[ga]'" in error
    assert len(error.splitlines()) == 1


def test_the_command_knows_the_methods_of_the_library():
    from residyn.cli import _options

    assert tuple(METHODS) == _options.METHODS
