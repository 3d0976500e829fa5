"""Several runs of one rig: what a recording states of itself, and numbers that it has alone."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn.diagnosis.columns import Columns
from residyn.diagnosis.compare import own_numbers
from residyn.diagnosis.evidence import prior_of
from residyn.effects import SensorDelay, SensorOffset
from residyn.effects.own_numbers import with_own
from residyn.errors import InputError
from residyn.filtering.law import each_number
from residyn.filtering.trajectory import Scene
from residyn.physics.mechanism import ConstantInertia
from residyn.recordings.recording import Recording
from residyn.recordings.tables import InertiaTable

MASS, STIFFNESS, DAMPING, FRICTION, COEFFICIENT = 1.5, 200.0, 0.4, 0.2, 0.03
NOISE = 2e-5
TABLE = InertiaTable(("cart",), ((MASS,),), ("m",))

pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def release(load=0.0, friction=FRICTION, seed=0, rate=100.0, **more):
    """A cart pulled 0.1 m and let go; its friction, and what its load adds to it."""
    cart = ConstantInertia([[MASS]], ["cart"], ["m"], load=load)
    model = cart + residyn.Spring("cart", STIFFNESS) + residyn.Damper("cart", DAMPING)
    model = model + residyn.CoulombFriction("cart", friction)
    if load:
        model = model + residyn.LoadFriction("cart", COEFFICIENT)
    t = np.arange(0.0, 5.0, 1 / rate)
    q = np.asarray(residyn.simulate(model, t, [0.1], steps=2000).q)
    noise = NOISE * np.random.default_rng(seed).standard_normal(q.shape)
    return Recording.from_arrays(t, q + noise, noise=NOISE, name=f"run{seed}", load=load, **more)


def number(fit, name):
    return next(n for n in fit.numbers if n.name == name)


def test_friction_of_a_load_is_told_from_friction_without_one():
    runs = release(2.0, seed=1), release(12.0, seed=2), release(6.0, seed=3, role="check")
    fit = residyn.fit(
        residyn.Experiment(TABLE, runs), effects=["coulomb_friction", "load_friction"]
    )
    for name, true in (
        ("coulomb_friction:cart.torque", FRICTION),
        ("load_friction:cart.coefficient", COEFFICIENT),
        ("damper:cart.damping", DAMPING),
    ):
        found = number(fit, name)
        assert abs(found.value - true) < 4 * found.std, name
    assert fit.check_rmse is not None
    assert fit.check_rmse[0] < 1.2 * NOISE  # under a load that was never fitted


def test_friction_of_a_load_decays_as_its_closed_form_says():
    """Without a damper the amplitude falls by 4 mu N / k every cycle."""
    cart = ConstantInertia([[MASS]], ["cart"], ["m"], load=10.0)
    model = cart + residyn.Spring("cart", STIFFNESS) + residyn.LoadFriction("cart", COEFFICIENT)
    cycle = 2 * np.pi * np.sqrt(MASS / STIFFNESS)
    q = np.asarray(residyn.simulate(model, [0.0, cycle, 2 * cycle], [0.1], steps=400).q)[:, 0]
    np.testing.assert_allclose(np.diff(q), -4 * COEFFICIENT * 10.0 / STIFFNESS, rtol=1e-4)


def test_friction_of_a_load_is_offered_only_where_a_load_is_stated():
    with pytest.raises(ValueError, match=r"load_friction .* no recording states a load"):
        residyn.fit(residyn.Experiment(TABLE, (release(),)), effects=["load_friction"])


def test_a_load_that_some_recordings_lack_is_said():
    warnings = residyn.Experiment(TABLE, (release(3.0, seed=1), release(seed=2))).warnings
    assert "run2: load is not given, as it is for run1; 0 N is taken" in warnings


def test_a_run_has_numbers_of_its_own():
    """Runs of other friction and other sampling; what they share is found from both."""
    runs = (
        release(seed=1),
        release(friction=0.35, seed=2, rate=60.0, own=["coulomb_friction:cart"]),
    )
    experiment = residyn.Experiment(TABLE, runs)
    fit = residyn.fit(experiment, effects=["coulomb_friction"])
    assert 0.9 < fit.reduced_chi2 < 1.1
    for name, true in (
        ("coulomb_friction:cart.torque", FRICTION),
        ("coulomb_friction:cart.torque (run2)", 0.35),
        ("spring:cart.stiffness", STIFFNESS),
    ):
        found = number(fit, name)
        assert abs(found.value - true) < 4 * found.std, name
    base = residyn.fit(experiment)  # what is not in the model needs no numbers
    assert [n.name for n in base.numbers] == ["spring:cart.stiffness", "damper:cart.damping"]


@pytest.mark.parametrize(
    ("effect", "label", "fields"),
    [
        ("stribeck_friction", "stribeck_friction:cart", 3),
        ("hysteresis", "hysteresis:cart", 3),
        ("sensor_offset:cart", "sensor_offset:cart", 1),
        ("brake_slip", "brake_slip:cart", 2),
    ],
)
def test_an_effect_with_own_numbers_is_that_effect_at_those_numbers(effect, label, fields):
    from residyn.effects import effects_named
    from residyn.physics.motion import Motion
    from residyn.physics.parameter import parameters_of

    cart = ConstantInertia([[MASS]], ["cart"], ["m"])
    (plain,) = effects_named(effect, cart)
    own = with_own(plain, ((1, "one"), (2, "two")))
    assert own.label == label
    assert len(parameters_of(own)) == 3 * fields
    values = {p.field: 0.3 + 0.1 * i for i, p in enumerate(parameters_of(own))}
    own = dataclasses.replace(own, **values)
    motion = Motion.at(0.0, [0.2], [0.5], [0.1] * len(own.memory))._replace(turn=(0.2,))
    for run in (0, 1, 2):
        at = dataclasses.replace(
            plain,
            **{p.field: values[p.field + (f"_{run}" if run else "")] for p in parameters_of(plain)},
        )
        here = ConstantInertia([[MASS]], ["cart"], ["m"], run=run)
        assert own.torque(motion, here) == at.torque(motion, here)
        assert own.rate(motion, here) == at.rate(motion, here)
        assert own.follow(motion, here) == at.follow(motion, here)
        assert own.delays(here) == at.delays(here)
        angles = (jnp.asarray([0.2]),)
        assert own.reading(angles, here) == at.reading(angles, here)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ('own = "spring:cart"', r'a.csv: own = "spring:cart": must be a list of effects'),
        ('own = ["spring:cart"]\nrole = "check"', r'role = "check" nothing tells its own numbers'),
        ("load = -1", r"a.csv: load = -1: must be"),
    ],
)
def test_bad_keys_are_told_in_one_line(tmp_path, keys, says):
    run = release()
    rows = np.column_stack([run.time, run.angle])
    for name in ("a.csv", "b.csv"):
        np.savetxt(tmp_path / name, rows, delimiter=",", header="t,q1", comments="")
    (tmp_path / "x.toml").write_text(
        '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[1.5]]\n'
        '[[recordings]]\nfile = "b.csv"\n'
        f'[[recordings]]\nfile = "a.csv"\n{keys}\n'
    )
    with pytest.raises(InputError, match=says):
        residyn.load(tmp_path / "x.toml")


def test_runs_sampled_otherwise_with_wild_readings_and_let_go_by_hand_give_one_fit():
    """One is read slowly and unevenly, one has spikes, one begins in the hand that pulls it."""
    whole, fast, slow = release(seed=4), release(seed=5, rate=250.0), release(seed=6, rate=400.0)
    rng = np.random.default_rng(7)
    some = np.sort(rng.choice(len(slow.time), 150, replace=False))
    spiked = np.array(fast.angle)
    spiked[[200, 511, 512, 900]] += 0.02
    pulled = 0.1 * np.sin(np.linspace(0.0, np.pi / 2, 80)) ** 2
    pulled = np.concatenate([pulled, np.full(60, 0.1)])[:, None]
    pulled = pulled + NOISE * rng.standard_normal(pulled.shape)
    clock = np.arange(len(pulled) + len(whole.time)) / 100.0
    by_hand = np.concatenate([pulled, whole.angle])
    runs = (
        Recording.from_arrays(slow.time[some], slow.angle[some], name="slow"),
        Recording.from_arrays(fast.time, spiked, name="spiked"),
        Recording.from_arrays(clock, by_hand, name="by hand", start="release"),
    )
    assert runs[2].time[0] >= 1.4 - 0.02  # no part of the pull
    fit = residyn.fit(residyn.Experiment(TABLE, runs), effects=["coulomb_friction"])
    assert [int(r.wild.sum()) for r in fit.recordings] == [0, 4, 0]
    for name, true in (
        ("spring:cart.stiffness", STIFFNESS),
        ("damper:cart.damping", DAMPING),
        ("coulomb_friction:cart.torque", FRICTION),
    ):
        found = number(fit, name)
        assert abs(found.value - true) < 4 * found.std, name
    assert fit.reduced_chi2 < 1.2


def test_own_must_leave_one_recording_to_compare_with():
    runs = [release(seed=i, own=["damper:cart"]) for i in (1, 2)]
    with pytest.raises(InputError, match=r'run1: own: "damper:cart" is in every fitted recording'):
        residyn.fit(residyn.Experiment(TABLE, tuple(runs)))


def test_own_names_an_effect_that_exists():
    runs = release(seed=1), release(seed=2, own=["dampr:cart"])
    with pytest.raises(ValueError, match=r'there is no effect "dampr"; did you mean "damper"'):
        residyn.fit(residyn.Experiment(TABLE, runs))


@pytest.mark.parametrize(("friction", "differs"), [(FRICTION, False), (1.2 * FRICTION, True)])
def test_whether_runs_are_the_same_is_told_by_evidence(friction, differs):
    runs = release(seed=1), release(friction=friction, seed=2, own=["coulomb_friction:cart"])
    found = residyn.compare(residyn.Experiment(TABLE, runs), effects=["coulomb_friction"])
    (run,) = found.runs
    assert (run.effect, run.recording) == ("coulomb_friction:cart", "run2")
    assert (run.probability > 0.5) == differs
    assert abs(run.log_odds) > 3
    assert found.to_dict()["runs"][0]["probability"] == run.probability
    words = "differs in run2 from" if differs else "is the same in run2 as in"
    assert any(f"coulomb_friction:cart {words} the other recordings" in w for w in found.words)


@pytest.mark.parametrize(
    "own",
    [pytest.param(["spring:far"], marks=pytest.mark.slow), ["spring:near", "spring:far"]],
)
def test_each_place_of_an_effect_is_asked_by_itself(own):
    """Two carts in a row, let go twice alike: no spring needs numbers of its own."""
    table = InertiaTable(("near", "far"), ((1.0, 0.2), (0.2, 0.8)), ("m", "m"))
    carts = ConstantInertia(table.matrix, table.joints, table.units)
    model = carts + residyn.Spring("near", 100.0) + residyn.Spring("far", 160.0)
    model = model + residyn.Damper("near", 0.3) + residyn.Damper("far", 0.3)
    t = np.arange(0.0, 2.0, 0.02)
    q = np.asarray(residyn.simulate(model, t, [0.1, -0.05], steps=500).q)
    read = q + NOISE * np.random.default_rng(0).standard_normal((2, *q.shape))
    first = Recording.from_arrays(t, read[0], noise=NOISE, name="first")
    second = Recording.from_arrays(t, read[1], noise=NOISE, name="second", own=own)
    found = own_numbers(residyn.Experiment(table, (first, second)))
    assert [(x.effect, x.recording) for x in found] == [(x, "second") for x in own]
    assert all(x.log_odds < -3 for x in found)


@pytest.mark.parametrize(
    ("effect", "field"), [(SensorOffset("cart"), "offset"), (SensorDelay("cart"), "delay")]
)
def test_a_filter_reads_each_run_by_its_own_numbers(effect, field):
    t = np.arange(0.0, 2.0, 0.02)
    runs = [Recording.from_arrays(t, 0.1 * np.cos(9 * t)[:, None], noise=NOISE) for _ in range(2)]
    carts = [ConstantInertia([[MASS]], ["cart"], ["m"], run=run) for run in (0, 1)]
    scene = Scene(runs, carts, [np.zeros((len(t), 1), bool)] * 2)
    second = scene.grid.of(1)

    def readings(effect, **numbers):
        begun = scene.start([effect], prior_of(scene, [effect]))
        here = [numbers.get(n.field, 0.0) for _, n in each_number([effect])]
        begun.u[: len(here)] = begun.prior.regressors(np.array(here))
        return np.asarray(scene.linearised(begun).seen)[:, 0]

    own = with_own(effect, ((1, "second"),))
    found = readings(own, **{f"{field}_1": 0.01})
    plain, moved = readings(effect), readings(effect, **{field: 0.01})
    assert found[second] == pytest.approx(moved[second])
    assert found[scene.grid.of(0)] == pytest.approx(plain[scene.grid.of(0)])
    assert np.abs(moved - plain)[second].max() > 1e-3
    spring = [residyn.Spring("cart")]
    columns = Columns(scene, scene.start(spring, prior_of(scene, spring)), [own], [])
    shared, apart = columns.inputs[1][:, 0].T
    assert not shared[second].any()
    assert not apart[scene.grid.of(0)].any()
    assert shared[scene.grid.of(0)].any()
    assert apart[second].any()


def test_a_sensor_set_anew_is_told_by_evidence():
    """A ringing cart by its closed form."""
    t, decay = np.arange(0.0, 5.0, 0.0125), 0.5 * DAMPING / MASS
    pace = np.sqrt(STIFFNESS / MASS - decay**2)
    q = 0.1 * np.exp(-decay * t) * (np.cos(pace * t) + decay / pace * np.sin(pace * t))
    read = q + NOISE * np.random.default_rng(0).standard_normal((2, len(t)))
    own = ["sensor_offset:cart"]
    first = Recording.from_arrays(t, read[0][:, None], noise=NOISE, name="first")
    second = Recording.from_arrays(t, read[1][:, None] + 1e-3, noise=NOISE, name="second", own=own)
    (run,) = own_numbers(residyn.Experiment(TABLE, (first, second)), own)
    assert run.log_odds > 10


def test_effects_of_a_fit_have_own_numbers_where_the_experiment_says_so():
    own = ["coulomb_friction:cart", "damper:cart"]
    runs = release(seed=1), release(friction=0.35, seed=2, own=own)
    experiment = residyn.Experiment(TABLE, runs)
    (damper, friction) = own_numbers(experiment, ["coulomb_friction"])
    fit = residyn.fit(experiment, effects=["coulomb_friction"])
    assert own_numbers(experiment, fit.model.effects[2:]) == (damper, friction)
    assert damper.log_odds < -3
    assert friction.log_odds > 3


def test_a_diagnosis_fits_each_run_s_own_numbers_also_beside_runs_that_have_others():
    runs = (
        release(seed=1),
        release(seed=2, own=["hysteresis:cart"]),
        release(friction=0.35, seed=3, own=["coulomb_friction:cart"]),
    )
    experiment = residyn.Experiment(TABLE, runs)
    found = residyn.diagnose(experiment, effects=["coulomb_friction"], max_effects=0)
    run3 = number(found.fit, "coulomb_friction:cart.torque (run3)")
    assert run3.std < 0.01
    assert abs(run3.value - 0.35) < 4 * run3.std
    assert found.fit.reduced_chi2 < 1.1


@pytest.mark.slow
def test_a_diagnosis_of_runs_that_may_differ_names_what_they_share():
    runs = (
        release(seed=1),
        release(friction=0.35, seed=2, own=["coulomb_friction:cart"]),
    )
    found = residyn.diagnose(residyn.Experiment(TABLE, runs), max_effects=1)
    assert found.added == ("coulomb_friction:cart",)
    assert len(found.missing) == 2
    (said,) = [line for line in found.fit.warnings if "own = " in line]
    assert said.startswith('run2: own = ["coulomb_friction:cart"]')
    assert said.endswith("--with coulomb_friction:cart begins with it")
