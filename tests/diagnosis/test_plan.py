"""Tests to make: within the limits, where the models part, and what the recordings then say."""

import dataclasses
import json
import math

import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn.cli import main
from residyn.diagnosis.candidate_tests import (
    Sweep,
    best_tests,
    in_play,
    settings_of,
    settled,
)
from residyn.diagnosis.evidence import prior_of
from residyn.diagnosis.experiment_design import Quantity, entropy
from residyn.diagnosis.iteration import settle
from residyn.diagnosis.missing_torque import scene_of
from residyn.diagnosis.plan import InPlay, Plan
from residyn.diagnosis.result import ChannelError
from residyn.diagnosis.tried import Tried
from residyn.effects import (
    ConstantTorque,
    CubicStiffness,
    Damper,
    SensorOffset,
    Spring,
)
from residyn.recordings.limits import Limits
from residyn.recordings.tables import ArmTable, Bearing, InertiaTable
from residyn.reporting.plan import outcomes, setting_words
from tests.by_hand import NEXT

MASS, NOISE = 2.0, 1e-3
CART = InertiaTable(("cart",), ((MASS,),), ("m",))
ARM = ArmTable((0.4, 0.4), 1.2, 0.6, 1.4)
BASE = (Spring("cart", 80.0), Damper("cart", 0.5))


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def ringing(size, *more, seed=0, seconds=6.0, **where):
    """A cart let go at `size` m."""
    model = residyn.Model(residyn.ConstantInertia([[MASS]], joints=("cart",), units=("m",)))
    for effect in (*BASE, *more):
        model = model + effect
    time = np.arange(0.0, seconds, 0.02)
    q = np.asarray(residyn.simulate(model, time, [size]).q)
    q = q + NOISE * np.random.default_rng(seed).standard_normal(q.shape)
    return residyn.Recording.from_arrays(time, q, noise=NOISE, name=f"{size:g} m", **where)


def models_of(experiment, *added):
    """The base model, and with each effect, iterated to their evidence."""
    scene, base = scene_of(experiment, ())
    each = [(), *((x,) for x in added)]
    starts = [scene.start((*base, *x), prior_of(scene, (*base, *x))) for x in each]
    found = settle(scene, starts, 1.0)
    assert None not in found
    models = [
        Tried(tuple(e.label for e in x), *f, log_prior=0.0)
        for x, f in zip(each, found, strict=True)
    ]
    return scene, models


@pytest.fixture(scope="module")
def cubic():
    """A swing too small to show whether the spring is cubic."""
    experiment = residyn.Experiment(CART, (ringing(0.01),))
    return experiment, *models_of(experiment, CubicStiffness("cart"))


def limited(experiment, **limits):
    return dataclasses.replace(experiment, limits=Limits(**limits))


@pytest.mark.parametrize("largest", [0.02, 0.05])
def test_a_cubic_spring_is_told_by_the_largest_release(cubic, largest):
    experiment, scene, models = cubic
    (test,), _ = best_tests(limited(experiment, angle=largest), scene, models, np.array([0.5, 0.5]))
    assert test.release == {"cart": pytest.approx(largest)}
    assert test.entropy < math.log(2)
    assert test.helps


def test_a_larger_limit_tells_more(cubic):
    experiment, scene, models = cubic
    small, large = (
        best_tests(limited(experiment, angle=x), scene, models, np.array([0.5, 0.5]))[0][0]
        for x in (0.02, 0.1)
    )
    assert large.entropy < small.entropy
    assert large.difference > small.difference
    assert large.probability_right > small.probability_right


def test_a_load_that_is_not_spoken_of_is_put_on_only_where_it_tells_more(cubic):
    """A large release tells the two for certain, with a load or without."""
    experiment, scene, models = cubic

    def planned(**limits):
        given = limited(experiment, angle=0.2, **limits)
        return best_tests(given, scene, models, np.array([0.5, 0.5]))[0][0]

    bare, free = planned(), planned(extra_mass=(0.0, MASS))
    assert bare.extra_mass == 0
    assert free.extra_mass > 0
    assert bare.entropy == pytest.approx(free.entropy, abs=0.01)
    needed = planned(extra_mass=(0.5 * MASS, MASS))
    assert needed.extra_mass >= 0.5 * MASS


def test_where_the_models_cannot_part_nothing_helps(cubic):
    experiment, scene, models = cubic
    (test,), _ = best_tests(limited(experiment, angle=1e-4), scene, models, np.array([0.5, 0.5]))
    assert not test.helps
    assert test.entropy == pytest.approx(math.log(2), abs=0.05)
    words = "Nothing would help: no test within the limits would see whether cubic stiffness is"
    assert words.lower() in test.words.lower()


def test_a_second_test_adds_to_the_first(cubic):
    experiment, scene, models = cubic
    limits = limited(experiment, angle=0.02, duration=3.0)
    (first, second), _ = best_tests(limits, scene, models, np.array([0.5, 0.5]), tests=2)
    assert second.entropy < first.entropy


def test_what_the_recording_then_says_is_what_was_expected(cubic):
    """The release is made, with and without a cubic spring: the model that is right wins, as often
    as was promised, and by about the nats that were promised."""
    experiment, scene, models = cubic
    p = np.array([0.5, 0.5])
    test = best_tests(limited(experiment, angle=0.03), scene, models, p)[0][0]
    size = test.release["cart"]
    strength = models[1].best.valued()[-1].coefficient
    right = []
    for seed in range(4):
        for truth, effect in ((0, ()), (1, (CubicStiffness("cart", strength),))):
            made = ringing(size, *effect, seed=seed + 10, seconds=test.duration)
            both = residyn.Experiment(CART, (*experiment.recordings, made))
            _, after = models_of(both, CubicStiffness("cart"))
            logs = np.array([m.log_evidence for m in after])
            chance = np.exp(logs - np.logaddexp(*logs))
            right.append(chance[truth])
    assert np.mean(right) == pytest.approx(test.probability_right, abs=0.2)


def test_outcomes_are_what_the_models_do(cubic):
    experiment, scene, models = cubic
    bare = limited(experiment, angle=0.05, extra_mass=(0.0, 0.0))
    test = best_tests(bare, scene, models, np.array([0.5, 0.5]))[0][0]
    for outcome, model in zip(test.outcomes, models, strict=True):
        q = residyn.simulate(scene.model(model.best), [0.0, test.time], [test.release["cart"]]).q
        assert outcome.reading == pytest.approx(float(q[-1, 0]), abs=1e-5)
        assert outcome.std >= NOISE
    # A tenth of the release is not known: of what rings, a tenth of its size for good.
    rings = 0.1 * test.release["cart"] * math.exp(-0.5 * test.time / (2 * MASS))
    assert test.outcomes[0].std == pytest.approx(math.hypot(rings, NOISE), rel=0.1)


def test_no_test_tells_a_constant_torque_from_a_sensor_s_zero():
    """On a linear spring: both ring alike about a rest that the sensor reads."""
    pull = ConstantTorque("cart", 1.2)  # 15 mm of the spring
    experiment = residyn.Experiment(CART, (ringing(0.05, pull),))
    scene, (_, *models) = models_of(experiment, ConstantTorque("cart"), SensorOffset("cart"))
    limits = limited(experiment, angle=0.1, drive=2.0)
    (test,), _ = best_tests(limits, scene, models, np.array([0.5, 0.5]))
    assert not test.helps
    assert test.difference < 0.1
    assert test.probability_right == pytest.approx(0.5, abs=0.02)
    one, other = test.outcomes
    assert one.reading == pytest.approx(other.reading, abs=NOISE)


def test_a_gyroscope_s_readings_are_predicted_as_rates(cubic):
    """Weighed by its noise, and said in its unit."""
    (angles,), models, noise = cubic[0].recordings, cubic[2], 2e-3
    rates = np.gradient(angles.angle[:, 0], angles.time)[:, None]
    recording = residyn.Recording.from_arrays(angles.time, rates, noise=noise, reads="rate")
    limits = Limits(angle=0.05, extra_mass=(0.0, 0.0))
    experiment = residyn.Experiment(CART, (recording,), limits=limits)
    scene, _ = scene_of(experiment, ())
    (test,), _ = best_tests(experiment, scene, models, np.array([0.5, 0.5]))
    for outcome, model in zip(test.outcomes, models, strict=True):
        moved = scene.model(model.best), [0.0, test.time], [test.release["cart"]]
        rate = residyn.simulate(*moved, orders=(1,)).readings
        assert outcome.reading == pytest.approx(float(rate[-1, 0]), abs=1e-4)
        assert outcome.std >= noise
    assert (test.reads, test.unit) == ("rate", "m/s")
    table = outcomes(test)
    assert table.head[1].startswith("rate of the cart after")
    assert all(row[1].endswith(" m/s") for row in table.rows)


def test_a_quantity_is_narrowed_by_what_measures_it(cubic):
    """The damping: the longer and larger the swing, the better."""
    experiment, scene, models = cubic
    slopes = [np.eye(len(m.best.prior.mean))[1] for m in models]
    wanted = Quantity(np.array([m.best.numbers[1] for m in models]), slopes, np.zeros(2))
    p = np.array([0.9, 0.1])
    (test,), _ = best_tests(limited(experiment, angle=0.03), scene, models, p, quantity=wanted)
    std = math.sqrt(models[0].best.covariance[1, 1]) * models[0].best.prior.width[1]
    assert test.release["cart"] == pytest.approx(0.03)
    assert test.band < 1.96 * std


def test_a_sweep_of_the_motor_is_a_test(cubic):
    experiment, scene, models = cubic
    limits = limited(experiment, angle=1e-3, drive=1.0, extra_mass=(0.0, MASS))
    (test,), _ = best_tests(limits, scene, models, np.array([0.5, 0.5]))
    assert test.drive is not None
    assert test.drive.torque == pytest.approx(1.0)
    rings = math.sqrt(80.0 / (MASS + test.extra_mass)) / (2 * math.pi)  # Hz
    assert test.drive.low < rings < test.drive.high
    assert "drive the cart with 1.00 N" in test.words


def test_of_a_shorter_sweep_the_beginning_is_made(cubic):
    """The motor's torque as the test states it gives the readings that it predicts."""
    experiment, scene, models = cubic
    limits = limited(experiment, angle=1e-3, drive=20.0, extra_mass=(0.0, 0.0))
    (test,), _ = best_tests(limits, scene, models, np.array([0.5, 0.5]))
    assert test.drive is not None
    assert test.duration < experiment.recordings[0].duration
    time = np.linspace(0.0, test.duration, 500)
    torque = test.drive.at(time, test.duration)[:, None]
    drive = residyn.Drive(0.0, time[1], torque)
    for outcome, model in zip(test.outcomes, models, strict=True):
        q = residyn.simulate(scene.model(model.best), [0.0, test.time], [0.0], drive=drive).q
        assert outcome.reading == pytest.approx(float(q[-1, 0]), abs=NOISE)


# -- limits ------------------------------------------------------------------------------------


def arm(**limits):
    time = np.arange(200) / 50
    q = np.stack([0.2 * np.cos(9 * time), -0.1 * np.cos(15 * time)], axis=1)
    recording = residyn.Recording.from_arrays(time, q, noise=1e-3, theta2=0.1)
    bearings = (Bearing("elbow", 0.1, 1e-4),)
    return residyn.Experiment(ARM, (recording,), bearings, limits=Limits(**limits))


def settings_within(experiment):
    """Every test that is compared for springs and dampers."""
    scene, _ = scene_of(experiment, ())
    model = residyn.fitting.model_for(scene.mechanisms[0])
    return settings_of(experiment, scene, model.with_vector(jnp.array([20.0, 10.0, 0.1, 0.1])))


def test_every_test_is_within_the_limits():
    experiment = arm(
        angle=[0.3, 0.0], theta2=[-0.5, 0.5], air_bearings=True, duration=12.0, drive=[0.0, 2.0]
    )
    settings = settings_within(experiment)
    assert {abs(s.release[1]) for s in settings} == {0.0}
    assert max(abs(s.release[0]) for s in settings) == pytest.approx(0.3)
    assert all(-0.5 <= s.recording.theta2 <= 0.5 for s in settings)
    assert all(s.recording.air_bearings for s in settings)
    assert {s.recording.duration for s in settings} == {12.0}
    swept = [s.drive for s in settings if s.drive]
    still = [s for s in settings if s.drive]
    assert {s.joint for s in swept} == {"elbow"}
    assert max(s.torque for s in swept) == 2.0
    assert all(not s.release.any() for s in still)


@pytest.mark.parametrize("angle", [[0.3, 0.0], [0.0, 0.3], [0.3, 0.3]])
def test_every_release_is_compared_once(angle):
    """Also where a joint may not be released."""
    settings = settings_within(arm(angle=angle, theta2=[0.1, 0.1], air_bearings=True))
    releases = [tuple(s.release) for s in settings]
    assert len(releases) == len(set(releases))
    assert len(releases) == (3 if 0.0 in angle else 12)


@pytest.mark.parametrize(("n", "count"), [(1, 1), (3, 13), (6, 40)])
def test_joints_are_released_alike_against_each_other_and_alone(n, count):
    table = InertiaTable(tuple(f"q{i}" for i in range(n)), np.eye(n).tolist(), ("rad",) * n)
    time = np.arange(400) / 50
    q = 0.1 * np.cos(np.outer(time, 5.0 + np.arange(n)))
    recording = residyn.Recording.from_arrays(time, q, noise=1e-3)
    limits = Limits(angle=0.2, extra_mass=(0.0, 0.0))
    experiment = residyn.Experiment(table, (recording,), limits=limits)
    scene, _ = scene_of(experiment, ())
    model = residyn.fitting.model_for(scene.mechanisms[0])
    numbers = jnp.array([30.0] * n + [0.1] * n)
    settings = settings_of(experiment, scene, model.with_vector(numbers))
    signs = {tuple(np.sign(s.release)) for s in settings}
    assert len(signs) == count
    assert all(np.any(s) and tuple(-np.array(s)) not in signs for s in signs)
    assert {tuple(row) for row in np.eye(n)} <= signs


def test_without_limits_each_joint_goes_twice_as_far_as_it_did():
    """A metre is no radian: how far one joint goes says nothing of another one."""
    table = InertiaTable(("cart", "pendulum"), ((2.0, 0.1), (0.1, 0.5)), ("m", "rad"))
    time = np.arange(400) / 50
    q = np.stack([0.002 * np.cos(9 * time), 0.5 * np.cos(5 * time)], axis=1)
    recording = residyn.Recording.from_arrays(time, q, noise=1e-5)
    settings = settings_within(residyn.Experiment(table, (recording,)))
    largest = np.max(np.abs([s.release for s in settings]), axis=0)
    np.testing.assert_allclose(largest, [0.004, 1.0], rtol=0.1)


def test_a_test_has_the_numbers_that_runs_share():
    """Those that one run has for itself are not known of a run to come."""
    first, longer = (
        residyn.Recording.from_arrays(
            (time := np.arange(count) / 50),
            np.stack([0.2 * np.cos(9 * time), -0.1 * np.cos(15 * time)], axis=1),
            noise=1e-3, name=name, own=own,
        )
        for name, count, own in (("first", 200, ()), ("longer", 300, ("spring:elbow",)))
    )  # fmt: skip
    experiment = residyn.Experiment(ARM, (first, longer))
    assert experiment.run_of(longer) == 1
    settings = settings_within(experiment)
    assert {experiment.run_of(s.recording) for s in settings} == {0}


WRONG = {
    "angle = 0": "must be above 0 somewhere",
    "angle = -0.1": "must be a number not below 0",
    "angle = [0.1]": "one for each joint (shoulder, elbow)",
    'angle = "large"': "must be a number",
    "theta2 = 0.3": "must be two numbers (rad)",
    "theta2 = [1, 0]": "the lower one first",
    "extra_mass = [0, 1]": "for [inertia] only",
    "air_bearings = false": "there is no [[air_bearings]] table",
    "duration = 0": "must be a number above 0",
    "drive = [1, 2, 3]": "one for each joint",
    "drive = []": "must be one number, or 2, one for each joint (shoulder, elbow)",
    "angles = 0.3": 'did you mean "angle"?',
}


@pytest.mark.parametrize(("key", "words"), WRONG.items(), ids=WRONG)
@pytest.mark.parametrize("command", ["plan", "fit"])
def test_wrong_limits_are_one_line(tmp_path, monkeypatch, capsys, key, words, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.toml").write_text(
        "[arm]\nlink_lengths = [0.4, 0.4]\nshoulder = 1.2\nelbow = 0.6\ncoupling = 1.4\n"
        f'[[recordings]]\nfile = "x.csv"\n[limits]\n{key}\n'
    )
    assert main([command, "x.toml", "--no-cache"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("residyn: x.toml: [limits]: ")
    assert words in err


def test_limits_are_read(tmp_path):
    time = np.arange(100) / 50
    residyn.write_csv(tmp_path / "x.csv", time, np.cos(9 * time)[:, None])
    (tmp_path / "x.toml").write_text(
        '[inertia]\njoints = ["cart"]\nmatrix = [[2.0]]\nunits = ["m"]\n'
        '[[recordings]]\nfile = "x.csv"\nnoise = 1e-3\n'
        "[limits]\nangle = 0.02\nextra_mass = [0, 2]\nduration = 9\n"
    )
    found = residyn.load(tmp_path / "x.toml").limits
    assert found == Limits(angle=0.02, extra_mass=(0.0, 2.0), duration=9.0)


# -- what is printed ---------------------------------------------------------------------------


FOUND, RIVAL = NEXT.between
MODELS = (InPlay(FOUND, 0.7), InPlay(RIVAL, 0.3))


def a_plan(**changed):
    settings = {
        "models": MODELS,
        "left_out": 0.02,
        "unnamed": 0.0,
        "channels": None,
        "entropy": 0.61,
        "tests": (NEXT,),
        "tried": 144,
        "settled": False,
        "unexplained": 0.1,
        "joints": ("shoulder", "elbow"),
    }
    return Plan(**(settings | changed))


def test_a_plan_reads_in_80_columns():
    drive = Sweep("elbow", 2.0, 0.3, 4.5)
    more = dataclasses.replace(NEXT, drive=drive, release={"shoulder": 0.0, "elbow": 0.0})
    text = str(a_plan(tests=(NEXT, more)))
    assert max(map(len, text.splitlines())) <= 80
    words = " ".join(text.split())
    assert "Release the shoulder at 0.300 rad (17 deg) and the elbow at -0.100 rad (-6" in words
    assert "69 %  Coulomb friction at the elbow" in text
    assert "0.1000 +/- 0.0010 rad" in text
    assert "drive the elbow with 2.00 N m" in words


@pytest.mark.parametrize(("unit", "load"), [("rad", "kg m^2"), ("m", "kg"), ("", "kg m^2 or kg")])
def test_a_load_has_the_unit_of_the_inertia_that_it_adds_to(unit, load):
    test = dataclasses.replace(NEXT, extra_mass=0.2, units=(unit, "m"))
    assert f"with 0.200 {load} of load" in setting_words(test)


def test_where_one_reading_is_not_enough_it_says_so():
    close = tuple(dataclasses.replace(o, std=0.02) for o in NEXT.outcomes)
    text = " ".join(str(a_plan(tests=(dataclasses.replace(NEXT, outcomes=close),))).split())
    assert "That one reading is not enough" in text
    assert "not enough" not in str(a_plan())


def test_nothing_would_help_is_an_answer():
    worse = dataclasses.replace(NEXT, helps=False, entropy=0.6)
    plan = a_plan(tests=(worse,))
    assert not plan.helps
    assert "Nothing would help" in str(plan)
    assert "Nothing more is needed" in str(a_plan(tests=(), settled=True))


def test_what_is_no_model_with_names_is_said_and_not_planned_for():
    words = " ".join(str(a_plan(left_out=0.32, unnamed=0.3)).split())
    assert "A law without a name, which predicts no other test, has 30 %." in words
    assert "Less likely models share 2 %." in words
    assert "48 % Coulomb friction at the elbow" in words  # all that is printed adds up to 100 %
    law = a_plan(models=(), left_out=1.0, unnamed=1.0, unexplained=1.0, entropy=0.0, tests=())
    assert "No test is planned" in str(law)
    assert "None of them" not in str(law)
    columns = ChannelError("the columns of a and b are exchanged", 0.9999, True)
    otherwise = " ".join(str(dataclasses.replace(law, unnamed=0.0, channels=columns)).split())
    assert "the columns of a and b are exchanged (> 99 %)" in otherwise
    assert "Nothing more is needed" not in otherwise


def test_json_of_a_plan():
    found = json.loads(json.dumps(a_plan().to_dict(), allow_nan=False))
    assert [m["added"] for m in found["models"]] == [list(FOUND), list(RIVAL)]
    (test,) = found["tests"]
    assert {"between", "release", "theta2", "air_bearings", "extra_mass", "words"} <= set(test)
    assert test["outcomes"][0]["added"] == list(FOUND)
    assert test["difference_over_noise"] == NEXT.difference
    assert test["difference_over_noise_now"] == NEXT.now
    assert test["reading"] == {"joint": "elbow", "reads": "angle", "unit": "rad", "time": 3.2}
    assert not {"difference", "now", "joint", "time"} & set(test)  # each is said once
    assert found["helps"] is True


def test_models_in_play():
    names = ["a", "b", "c"]
    models, p, rest = in_play(names, np.log([0.2, 0.795, 0.005]))
    assert models == ["b", "a"]
    assert p.sum() == pytest.approx(1.0)
    assert rest == pytest.approx(0.005)
    # None of them where a law without a name has the rest.
    models, p, rest = in_play(names, np.log([0.2, 0.795, 0.005]) - 2000)
    assert (models, len(p), rest) == ([], 0, 1.0)
    many = np.log([0.9, *np.full(20, 0.005)])  # none of the others is likely by itself
    assert len(in_play([*range(21)], many)[0]) == 1
    assert settled(np.log([0.96, 0.04]))
    assert not settled(np.log([0.9, 0.1]))
    assert not settled(np.log([0.6, 0.01]))
    assert float(entropy(np.array([1.0, 0.0]))) == 0.0


def test_a_rounding_error_is_no_number_of_standard_errors():
    same = dataclasses.replace(NEXT, helps=False, difference=9.9e-17, now=0.0)
    assert "differ by less than 0.01 standard errors" in same.words
    assert "e-17" not in same.words


def test_what_tells_two_models_by_their_spread_alone_is_not_said_to_part_their_predictions():
    words = dataclasses.replace(NEXT, helps=True, difference=0.3, now=1.2).words
    assert "less than a standard error of all readings together" in words
    assert "1.2" not in words
    assert "where now it is" in dataclasses.replace(NEXT, helps=True, difference=3.0).words
