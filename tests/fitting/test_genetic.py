"""The genetic algorithm of the paper's step 2, on MuJoCo arms whose truth is known."""

import dataclasses
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn import errors
from residyn.cli import main
from residyn.fitting import Genetic, History, MissingExtra, methods
from residyn.fitting.genetic import Part, box, fold, search_of, traced_algorithm
from residyn.fitting.history import Watch, relative_error, watched
from residyn.fitting.multistart import beginning
from residyn.fitting.problem import ready
from residyn.recordings.tables import ArmTable
from residyn.reporting.figures import convergence
from tests.legible import legible

rig = pytest.importorskip("tests.rig")
pytest.importorskip("evosax")

pytestmark = pytest.mark.usefixtures("compiled_in_less_time")

SMALL = {"method": "genetic", "strategy": "CMA_ES", "population": 24, "generations": 160}
NOISE = 1e-3


@pytest.fixture(scope="module")
def experiment():
    """The paper's arm, released and read for 6 s."""
    arm, t = rig.paper_twin(0.3), np.arange(300) / 50
    truth, _ = rig.simulate(arm, t, np.array([0.2, -0.1]))
    q = truth + NOISE * np.random.default_rng(0).standard_normal(truth.shape)
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    recording = residyn.Recording.from_arrays(t, q, theta2=arm.theta2, noise=NOISE)
    return residyn.Experiment(table, (recording,))


@pytest.fixture(scope="module")
def levenberg(experiment):
    return residyn.fit(experiment, starts=2)


@pytest.fixture(scope="module")
def genetic(experiment):
    return residyn.fit(experiment, **SMALL)


def values(fit):
    return np.array([n.value for n in fit.numbers])


def test_stiffness_and_damping_are_recovered(genetic):
    """k to 1 % and c to 30 %: looser than Levenberg-Marquardt by far."""
    off = np.abs(values(genetic) / [16.67, 16.67, 0.1, 0.1] - 1)
    assert off[:2].max() < 0.01
    assert off[2:].max() < 0.3
    assert genetic.reduced_chi2 < 1.2


def test_the_same_fit_comes_back(genetic, levenberg):
    assert set(genetic.to_dict()) == set(levenberg.to_dict())
    assert [n.name for n in genetic.numbers] == [n.name for n in levenberg.numbers]
    np.testing.assert_allclose(
        [n.std for n in genetic.numbers], [n.std for n in levenberg.numbers], rtol=0.2
    )
    assert (genetic.starts, genetic.agreeing_starts, genetic.steps) == (1, 1, 160)
    assert "160 generations of 24 individuals (CMA_ES)" in genetic.reason
    assert genetic.converged
    assert "[[Parameters]]" in str(genetic)
    assert levenberg.history is None


def test_history_is_the_objective_of_equation_17(genetic):
    spent, objective = genetic.history.simulations, genetic.history.objective
    assert (spent[0], spent[-1], len(objective)) == (24, 24 * 160, 160)
    assert (np.diff(objective) <= 0).all()
    beside = genetic.recordings[0]
    size = np.linalg.norm(beside.recording.angle, axis=0)
    by_hand = np.sum(np.linalg.norm(beside.residual, axis=0) / size)
    assert objective[-1] == pytest.approx(by_hand, rel=1e-4)


def test_lost_readings_are_in_neither_norm(experiment):
    (recording,) = experiment.recordings
    angle = recording.angle.copy()
    angle[40:60, 0] = np.nan
    holed = dataclasses.replace(
        experiment, recordings=(dataclasses.replace(recording, angle=angle),)
    )
    with jax.enable_x64(True):
        begin = beginning(holed, (), 6)
        look = search_of(begin, Genetic())
        y = look.unknowns(jnp.full(8, 0.5))
        found = float(relative_error(look.problem, y))
        bare = residyn.simulate(
            begin.here.model.with_vector(look.problem.numbers(y)),
            recording.time,
            look.problem.states(y)[0, :2],
            look.problem.states(y)[0, 2:],
            steps=look.problem.steps,
        )
    off = np.linalg.norm(np.nan_to_num(np.asarray(bare.q) - angle), axis=0)
    assert found == pytest.approx(np.sum(off / np.linalg.norm(np.nan_to_num(angle), axis=0)), 1e-6)


def test_a_seed_gives_the_same_fit_again_and_another_one_another(experiment, genetic):
    assert np.array_equal(values(residyn.fit(experiment, **SMALL)), values(genetic))
    assert not np.array_equal(values(residyn.fit(experiment, seed=1, **SMALL)), values(genetic))


@pytest.mark.parametrize("initial", ["genes", "readings"])
def test_the_papers_algorithm_keeps_to_its_bounds(experiment, initial):
    """The true stiffness lies outside: the search ends at the bound and not beyond."""
    bounds = {"spring:shoulder.stiffness": (18.0, 30.0), "damper:elbow.damping": (0.3, 0.4)}
    said = []
    fit = residyn.fit(
        experiment,
        method="genetic",
        population=20,
        generations=30,
        bounds=bounds,
        initial=initial,
        progress=said.append,
    )
    found = {n.name: n.value for n in fit.numbers}
    for name, (low, high) in bounds.items():
        assert low <= found[name] <= high
    assert "(SimpleGA)" in fit.reason
    assert any("ended short of the least-squares minimum" in w for w in fit.warnings)
    shares = [words.share for words in said if isinstance(words, Part)]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_bounds_are_searched_logarithmically_where_only_the_order_is_known(experiment):
    with jax.enable_x64(True):
        here = ready(experiment, experiment.fit_recordings, ("cubic_stiffness:elbow",))
        found = box(here.model.fitted, here.typical(), {"damper:elbow.damping": (0.1, 0.2)})
        assert found.logarithmic.tolist() == [True, True, True, False, False]
        ends = [np.asarray(found.at(jnp.full(5, gene))) for gene in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(ends[0], found.low)
    np.testing.assert_allclose(ends[2], found.high)
    np.testing.assert_allclose(ends[1][:3], np.sqrt((found.low * found.high)[:3]))
    assert ends[1][3] == pytest.approx(0.15)
    assert ends[1][4] == pytest.approx(0.0, abs=1e-9 * found.high[4])
    truth = np.array([16.67, 16.67, 0.1])
    assert ((found.low[:3] < truth) & (truth < found.high[:3])).all()


def test_genes_beyond_a_bound_are_reflected():
    genes = jnp.array([-0.25, 0.25, 1.25, 2.25])
    np.testing.assert_allclose(fold(genes), [0.25, 0.25, 0.75, 0.25])


@pytest.mark.parametrize(
    ("more", "error", "words"),
    [
        ({"population": 3}, ValueError, "at least 4 individuals"),
        ({"generations": 0}, ValueError, "generations = 0"),
        ({"strategy": "Magic"}, ValueError, 'strategy = "Magic": evosax has .*CMA_ES'),
        ({"settings": {"magic": 1.0}}, ValueError, "magic is no setting of SimpleGA"),
        ({"initial": "guessed"}, ValueError, 'must be "genes" or "readings"'),
        ({"bounds": {"spring:knee.stiffness": (0, 1)}}, ValueError, "there is no such number"),
        ({"bounds": {"damper:elbow.damping": (1, 0)}}, ValueError, "the lower one first"),
        ({"magic": 1}, TypeError, "magic"),
    ],
)
def test_what_does_not_go_is_said(experiment, more, error, words):
    with pytest.raises(error, match=words):
        residyn.fit(experiment, method="genetic", **more)


def test_method_and_its_arguments_go_together(experiment):
    with pytest.raises(ValueError, match='method = "magic"'):
        residyn.fit(experiment, method="magic")
    with pytest.raises(TypeError, match='population is no argument of method="levenberg"'):
        residyn.fit(experiment, population=10)


# -- without evosax, and from the command line -----------------------------------------------


@pytest.fixture
def without_evosax(monkeypatch):
    def refuse(name):
        raise ModuleNotFoundError(f"No module named '{name}'", name=name)

    traced_algorithm.cache_clear()
    monkeypatch.setattr(errors, "importlib", SimpleNamespace(import_module=refuse))


@pytest.fixture
def folder(tmp_path, experiment, monkeypatch):
    (recording,) = experiment.recordings
    rows = np.column_stack([recording.time, recording.angle]).tolist()
    lines = ["t,q1,q2", *(",".join(repr(x) for x in row) for row in rows[:150]), ""]
    (tmp_path / "release.csv").write_text("\n".join(lines))
    (tmp_path / "arm.toml").write_text(
        "[arm]\nlink_lengths = [0.4, 0.4]\nshoulder = 1.1662\nelbow = 0.5790\ncoupling = 1.4384\n"
        f'[[recordings]]\nfile = "release.csv"\ntheta2 = 0.3\nnoise = {NOISE}\n'
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_missing_extra_is_one_line(experiment, without_evosax):
    with pytest.raises(MissingExtra, match=r"pip install 'residyn\[ga\]'"):
        residyn.fit(experiment, method="genetic")


def test_the_command_says_what_to_install(folder, without_evosax, capsys):
    assert main(["fit", "arm.toml", "--method", "genetic", "--no-cache"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "residyn: the genetic algorithm needs evosax: pip install 'residyn[ga]'\n"


def test_the_command_fits(folder, monkeypatch, capsys):
    """With fewer individuals than the paper's, to save time."""
    monkeypatch.setitem(methods.GENETIC, "genetic", Genetic(20, 40, "CMA_ES"))
    status = main(["fit", "arm.toml", "--method", "genetic", "--json", "-", "--no-cache"])
    out, err = capsys.readouterr()
    assert status in (0, 1)  # 1: it was still falling
    assert "40 generations of 20 individuals" in " ".join(err.split())
    found = json.loads(out)["parameters"]
    assert found["spring:elbow.stiffness"]["value"] == pytest.approx(16.67, rel=0.5)


# -- beside Levenberg-Marquardt ----------------------------------------------------------------


def test_levenberg_needs_fewer_simulations(experiment, genetic, levenberg, monkeypatch):
    with watched(Watch()) as watch:
        residyn.fit(experiment, starts=2)
    descent = watch.history
    assert (np.diff(descent.simulations) > 0).all()
    beside = levenberg.recordings[0]
    size = np.linalg.norm(beside.recording.angle, axis=0)
    objective = np.sum(np.linalg.norm(beside.residual, axis=0) / size)
    assert descent.objective[-1] == pytest.approx(objective, rel=1e-3)
    assert descent.until(1.01 * objective) < genetic.history.until(1.01 * objective) / 5
    assert descent.until(0.5 * objective) == float("inf")
    for narrow in (False, True):
        figure = convergence(
            [genetic.history, descent],
            ["CMA-ES", "Levenberg-Marquardt"],
            floor=float(objective),
            narrow=narrow,
        )
        words = legible(figure, monkeypatch)
        assert {"CMA-ES", "Levenberg-Marquardt", "simulations of the recordings"} <= set(words)
    assert figure.axes[0].get_xscale() == figure.axes[0].get_yscale() == "log"


def test_a_history_that_never_ran_is_drawn_too():
    empty = History(np.array([10.0]), np.array([np.inf]))
    assert convergence([empty], ["nothing"]).axes
