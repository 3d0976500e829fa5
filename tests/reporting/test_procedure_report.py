"""The pages of steps 1 and 3, and the band of the ring-down."""

import dataclasses
import html
import re

import numpy as np
import pytest

import residyn
from residyn import demo
from residyn.cli import main
from residyn.diagnosis.plan import InPlay
from residyn.fitting import model_for
from residyn.physics.bearings import with_bearings
from residyn.procedure.carried import Carried
from residyn.procedure.over_models import ModeOver, OverModels, Spread
from residyn.procedure.ringdown import ring_down
from residyn.recordings.experiment import Experiment
from residyn.reporting import figures as plot
from residyn.reporting import render_page
from tests import by_hand
from tests.legible import legible
from tests.procedure.test_unload import BOTH, GROWS, PAPER, STEP_2, from_numbers

NASTY = "<b>& 'arm'"


pytestmark = pytest.mark.usefixtures("float64", "pictures_not_written")


@pytest.fixture(scope="module")
def found():
    return residyn.unload(Experiment(PAPER, (from_numbers(STEP_2, noise=1e-3),), BOTH))


def words_of(page):
    text = re.sub(r"<(style|picture).*?</\1>|<[^>]*>", " ", page, flags=re.S)
    return " ".join(html.unescape(text).replace("\u00a0", " ").split())


def alone(found, **parts):
    """The same result with other errors than its own."""
    count = len(found.fit.numbers)
    nothing = {
        "numbers": np.zeros((count, count)),
        "unseen": np.zeros((0, count)),
        "inertia": np.zeros((3, 3)),
        "moved": np.zeros((count, 3)),
    }
    return dataclasses.replace(found, errors=Carried(**{**nothing, **parts}))


# -- the band --------------------------------------------------------------------------------


def test_the_band_is_that_of_the_one_number_which_is_not_known(found):
    """Against the model with that number 1.96 standard errors up and down."""
    times, name, std = np.linspace(0.0, 8.0, 161), "spring:shoulder.stiffness", 0.05
    square = np.zeros((4, 4))
    square[0, 0] = std**2
    assert found.fit.numbers[0].name == name
    sides = alone(found, numbers=square).ring_downs(times, draws=800)
    q0 = found.fit.recordings[0].state[:2]
    for side, model in zip(sides, (found.model, found.unloaded), strict=True):
        value = found.fit.numbers[0].value
        up, down = (
            np.asarray(
                residyn.simulate(model.with_values({name: value + sign * 1.96 * std}), times, q0).q
            )
            for sign in (1, -1)
        )
        width, wanted = side.high - side.low, np.abs(up - down)
        loud = wanted > 0.3 * wanted.max()
        assert loud.sum() > 50
        np.testing.assert_allclose(width[loud], wanted[loud], rtol=0.15)
        path = np.asarray(side.path.q)
        assert ((side.low - 1e-9 <= path) & (path <= side.high + 1e-9))[loud].all()


def test_an_error_of_the_inertias_moves_the_numbers_with_it(found):
    """Eq. 9: inertias and numbers, all wrong by one share, leave the arm on its bearings as it is,
    and not the one in orbit."""
    values = np.array([PAPER.shoulder, PAPER.elbow, PAPER.coupling])
    numbers = found.fit.model.vector()
    moved = np.outer(numbers, values) / (values @ values)
    covariance = 1e-4 * np.outer(values, values)
    on, off = alone(found, inertia=covariance, moved=moved).ring_downs(np.linspace(0.0, 5.0, 101))
    assert np.max(on.high - on.low) < 1e-6
    assert np.max(off.high - off.low) > 1e-3


def test_there_is_no_band_where_a_number_is_open(found):
    unseen = np.zeros((1, 4))
    unseen[0, 2] = 0.1
    times = np.linspace(0.0, 2.0, 21)
    for side in alone(found, unseen=unseen).ring_downs(times):
        assert side.low is None
        assert side.high is None
    on, off = found.ring_down(times)
    for side, path in zip(found.ring_downs(times, draws=3), (on, off), strict=True):
        np.testing.assert_array_equal(np.asarray(side.path.q), np.asarray(path.q))


def test_there_is_a_band_where_what_is_open_leaves_the_motion_as_it_is():
    """Drag of the elbow's bearing alone is a damper at the shoulder: the two are told by their sum,
    which is all that the arm on its bearings asks for."""
    ride = (residyn.AirBearing("elbow", 1.0, 0.01),)
    arm = with_bearings(residyn.PlanarArm([0.4, 0.4], 1.2, 0.6, 1.4), ride)
    model = model_for(arm, ["bearing_drag"]).with_values(
        {**STEP_2, "bearing_drag.coefficient": 0.1}
    )
    assert model.labels[2:] == ("damper:shoulder", "damper:elbow", "bearing_drag")
    unseen = np.array([[0.0, 0.0, 0.4**2, 0.0, -1.0]]) * 0.1
    errors = Carried(1e-8 * np.eye(5), unseen, np.zeros((3, 3)), np.zeros((5, 3)))
    told = model, errors, np.linspace(0.0, 8.0, 81), np.array([0.2, -0.1]), 100
    on, off = (ring_down(m, *told) for m in (model, model.without("bearing_drag")))
    assert off.low is None
    assert 0 < np.max(on.high - on.low) < 0.01


def test_the_picture_shows_the_motion_until_it_is_gone(found):
    on, off = found.ring_downs(draws=0)
    longest = max(1 / (2 * np.pi * m.frequency_hz * m.damping_ratio) for m in found.with_bearings)
    assert float(on.path.t[-1]) == pytest.approx(min(3 * longest, 25 / 0.3494), rel=0.02)
    assert np.array_equal(on.path.t, off.path.t)


@pytest.mark.parametrize("narrow", [False, True])
def test_no_word_of_a_picture_is_cut_or_covered(found, narrow, monkeypatch):
    sides = found.ring_downs(draws=20)
    words = legible(plot.ring_down(found, sides, narrow=narrow), monkeypatch)
    assert {"on its bearings", "without bearings", "shoulder", "elbow"} <= set(words)
    assert sum("(rad)" in w or "(mrad)" in w for w in words) == 2


# -- the pages -------------------------------------------------------------------------------


def test_the_page_of_step_3(found):
    page = render_page(found, NASTY)
    text = words_of(page)
    assert NASTY not in page
    assert NASTY in text
    assert "<script" not in page
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    mode = found.without_bearings[0]
    assert f"Without its bearings the arm rings at {mode.frequency_hz:.3f}" in text
    assert "95 %" in text
    assert "2 air bearings, 3.927 kg" in text
    for warning in found.warnings:
        assert warning in text
    assert "not physical" not in text.lower()


def test_bands_over_all_models_and_the_test_that_narrows_them(found):
    frequency = Spread(0.52, 0.50, 0.54, 0.01, 0.7, 0.2, 0.1)
    damping = Spread(0.009, 0.008, 0.010, 5e-4, 0.1, 0.8, 0.1)
    mode = ModeOver(frequency, damping, 0.9)
    models = InPlay((by_hand.FOUND,), 0.9), InPlay((), 0.1)
    test = dataclasses.replace(by_hand.NEXT, band=0.004)
    joints = found.fit.joints
    over = OverModels(models, 0.0, ((0.3, (mode,)),), test, "frequency_hz", joints)
    made = dataclasses.replace(found, over_models=over)
    said = "The frequency of mode 1 is what is known worst: +/- 0.020 Hz (95 %)"
    assert said in " ".join(str(made).split())
    assert max(map(len, str(over).splitlines())) <= 80
    text = words_of(render_page(made, "over"))
    assert said.replace("+/-", "±") in text
    assert "Coulomb friction at the elbow 90 %" in text
    assert "1 frequency 0.500 to 0.540 Hz 70 % 20 % 10 %" in text


def test_the_page_says_what_is_not_physical():
    found = residyn.unload(Experiment(PAPER, (from_numbers(GROWS, noise=1e-3),), BOTH))
    text = words_of(render_page(found, "grows"))
    assert "Mode 1 without bearings (theta2 = 0 rad) grows" in text
    assert "grows: not physical" in text
    assert "mode 1 (grows: not physical)" in text  # in the fit's own chapter


def test_the_commands_write_them(tmp_path, capsys):
    folder = tmp_path / "rig"
    assert main(["example", str(folder), "driven"]) == 0
    said = capsys.readouterr().out.splitlines()[-1].removeprefix("next: residyn ").split()
    report = tmp_path / "step1.html"
    assert main([*said, "--report", str(report), "--no-cache"]) == 0
    assert f"report: {report}" in capsys.readouterr().out
    text = words_of(report.read_text())
    step_1 = residyn.inertia(residyn.load(folder / "driven.toml"))
    assert f"coupling {step_1.coupling.value:.4f} ±" in text
    assert (
        step_1.to_toml().split()
        == text[text.index("[arm]") :].split()[: len(step_1.to_toml().split())]
    )
    assert main([*said, "--report", str(folder / "driven.toml"), "--no-cache"]) == 2
    step_1 = dataclasses.replace(step_1, problem="what was found is no arm's inertia")
    assert "Not physical: what was found is no arm's inertia." in words_of(
        render_page(step_1, "driven")
    )


def test_the_example_of_step_3_is_what_the_rig_does_in_orbit(tmp_path, capsys):
    """As printed by `residyn example`, and in the README."""
    from pathlib import Path

    from tests.rig.arm import paper_twin
    from tests.rig.unloaded import off_bearings

    readme = (Path(__file__).parents[2] / "README.md").read_text()
    line = next(x for x in readme.splitlines() if x.startswith("residyn unload "))
    command = demo.EXAMPLES["bearings"][2].split()
    assert set(command) - {"residyn"} <= set(line.split())
    experiment = residyn.load(demo.write_example("bearings", tmp_path)[0])
    found = residyn.unload(experiment, effects=[w for w in command if w.startswith("bearing_")])
    assert found.physical
    frequency, damping = off_bearings(paper_twin(0.3)).modes()
    first = found.without_bearings[0]
    assert first.frequency_hz == pytest.approx(frequency[0], rel=1e-3)
    assert first.damping_ratio == pytest.approx(damping[0], rel=0.05)


def test_a_fit_with_negative_damping_ends_with_1(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.arange(400) / 50
    noise = 1e-3 * np.random.default_rng(0).standard_normal(400)
    toml = '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[2.0]]\n[[recordings]]\n'
    (tmp_path / "x.toml").write_text(toml + 'file = "x.csv"\nnoise = 1e-3\n')
    for rate, status in ((0.2, 1), (-0.2, 0)):
        q = 0.02 * np.exp(rate * t) * np.cos(5 * t) + noise
        np.savetxt("x.csv", np.column_stack([t, q]), delimiter=",", header="t,q1", comments="")
        assert main(["fit", "x.toml", "--no-cache", "--json", "x.json"]) == status
        out, err = capsys.readouterr()
        assert ("grows: not physical" in out) == (status == 1)
        assert ("damper:cart.damping: negative, which is not physical" in err) == (status == 1)
        assert (tmp_path / "x.json").exists()
