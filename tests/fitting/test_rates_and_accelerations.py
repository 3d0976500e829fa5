"""Gyroscopes and accelerometers: the motion is MuJoCo's, read as a derivative."""

import dataclasses

import jax
import numpy as np
import pytest

import residyn
from residyn.errors import InputError
from residyn.recordings.csv import write_csv
from residyn.recordings.reads import angles_from
from residyn.recordings.recording import Recording
from residyn.recordings.tables import ArmTable, InertiaTable
from tests import rig

TIME = np.arange(1000) * 0.01
ARM = dataclasses.replace(rig.paper_twin(0.6), stiffness=(25.0, 12.0), damping=(0.25, 0.1))
TABLE = ArmTable((ARM.l1, ARM.l2), ARM.shoulder, ARM.elbow, ARM.coupling)
FRICTION = 0.05
TOML = f"""
[arm]
link_lengths = [{ARM.l1}, {ARM.l2}]
shoulder = {ARM.shoulder}
elbow = {ARM.elbow}
coupling = {ARM.coupling}

[[recordings]]
file = "run.csv"
theta2 = {ARM.theta2}
"""


@pytest.fixture(scope="module")
def motion():
    return rig.trace(ARM, TIME, [0.2, -0.25], frictionloss=[0.0, FRICTION])


def read(motion, reads, seed=1):
    """Readings of each joint with noise of 0.3 % of their rms, and that noise."""
    kinds = {"angle": motion.q, "rate": motion.v, "acceleration": motion.a}
    x = np.stack([kinds[kind][:, j] for j, kind in enumerate(reads)], axis=1)
    sigma = 0.003 * np.sqrt(np.mean(x**2, axis=0))
    return x + sigma * np.random.default_rng(seed).standard_normal(x.shape), sigma


@pytest.mark.parametrize(
    "reads",
    [
        ("angle", "rate"),
        pytest.param(("rate", "rate"), marks=pytest.mark.slow),
        pytest.param(("acceleration", "acceleration"), marks=pytest.mark.slow),
    ],
)
def test_numbers_are_found_within_their_errors(motion, reads):
    x, sigma = read(motion, reads)
    recording = Recording.from_arrays(TIME, x, theta2=ARM.theta2, reads=reads)
    # Jumps of the acceleration pass for noise, in part.
    assert np.all(np.abs(recording.noise / sigma - 1) < (0.6 if reads[0] == reads[1] else 0.2))
    fit = residyn.fit(residyn.Experiment(TABLE, (recording,)), effects=["coulomb_friction:elbow"])
    for n, true in zip(fit.numbers, [*ARM.stiffness, *ARM.damping, FRICTION], strict=True):
        assert abs(n.value - true) < 4 * n.std, n.name
    assert fit.reduced_chi2 < 1.15


@pytest.mark.slow
def test_friction_is_named_from_accelerations():
    """Where friction turns round, an acceleration jumps."""
    cart = rig.Cart(mass=1.5, stiffness=200.0, damping=0.4)
    run = rig.trace(cart, TIME, [0.1], frictionloss=[0.2])
    x = run.a + 0.005 * np.std(run.a) * np.random.default_rng(2).standard_normal(run.a.shape)
    table = InertiaTable(("cart",), ((1.5,),), ("m",))
    recording = Recording.from_arrays(TIME, x, reads="acceleration")
    found = residyn.diagnose(residyn.Experiment(table, (recording,)))
    assert found.added == ("coulomb_friction:cart",)
    level = found.fit.numbers[2]
    assert abs(level.value - 0.2) < 4 * level.std
    assert "mm/s²" in str(found)


def test_a_simulation_reads_the_derivatives_of_its_motion():
    with jax.enable_x64(True):
        oscillator = residyn.ConstantInertia([[1.0]], ["cart"], ["m"]) + residyn.Spring("cart", 9.0)
        path = [residyn.simulate(oscillator, TIME, [0.5], orders=(k,)).readings for k in (0, 1, 2)]
    for found, true in zip(
        path, (np.cos(3 * TIME), -3 * np.sin(3 * TIME), -9 * np.cos(3 * TIME)), strict=True
    ):
        np.testing.assert_allclose(np.asarray(found)[:, 0], 0.5 * true, atol=5e-5)


def test_integrals_of_readings_are_angles_but_for_their_drift(motion):
    """A gyroscope's zero and its noise would carry an integral away."""
    for k, derivative in ((1, motion.v), (2, motion.a)):
        found = angles_from(TIME, derivative + 0.01, (k, k))
        inner = slice(100, -100)
        off = np.std((found - motion.q)[inner], axis=0) / np.std(motion.q[inner], axis=0)
        assert np.all(off < 0.3)


def test_units_of_rates_are_read_from_the_header(motion, tmp_path):
    x, _ = read(motion, ("angle", "rate"))
    write_csv(tmp_path / "run.csv", TIME, np.degrees(x))
    text = (tmp_path / "run.csv").read_text()
    (tmp_path / "run.csv").write_text(text.replace("t,q1,q2", "t [s],q1 [deg],q2 [deg/s]"))
    (tmp_path / "rig.toml").write_text(TOML + 'reads = ["angle", "rate"]\n')
    recording = residyn.load(tmp_path / "rig.toml").recordings[0]
    np.testing.assert_allclose(recording.angle, x, rtol=1e-12)
    assert recording.reads == ("angle", "rate")
    assert residyn.load(tmp_path / "rig.toml").reading_units == ("rad", "rad/s")


@pytest.mark.parametrize(
    ("header", "keys", "says"),
    [
        ("t,q1,q2", 'reads = "speed"', 'reads = "speed": must be "angle", "rate", "acceleration"'),
        ("t,q1,q2", 'reads = ["rate"]', "one word for each of 2 joints"),
        ("t,q1,q2 [deg/s]", "", 'reads = "rate" says what it is'),
        ("t,q1,q2 [mm]", "", "must be rad, deg, mrad, or units under [inertia] says"),
        ("t,q1,q2 [deg]", 'reads = "rate"', "must be rad/s, deg/s, mrad/s, rpm"),
    ],
)
def test_what_is_wrong_with_reads_is_one_line(motion, tmp_path, header, keys, says):
    write_csv(tmp_path / "run.csv", TIME, motion.q)
    text = (tmp_path / "run.csv").read_text().replace("t,q1,q2", header)
    (tmp_path / "run.csv").write_text(text)
    (tmp_path / "rig.toml").write_text(TOML + keys + "\n")
    with pytest.raises(InputError) as error:
        residyn.load(tmp_path / "rig.toml")
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_what_does_not_go_with_rates_is_said(motion):
    gyroscopes = Recording.from_arrays(TIME, motion.v, reads="rate", noise=1e-3, name="gyroscopes")
    encoders = Recording.from_arrays(TIME, motion.q, noise=1e-3, name="encoders")
    with pytest.raises(InputError, match="read the same of each joint"):
        residyn.Experiment(TABLE, (gyroscopes, encoders))
    with pytest.raises(InputError, match=r"sensor_offset:elbow is of readings of angles"):
        residyn.fit(residyn.Experiment(TABLE, (gyroscopes,)), effects=["sensor_offset:elbow"])


def test_a_friction_that_another_first_angle_undoes_is_not_determined():
    """Of a spin-down read as a rate, k q0 is a torque as constant as friction."""
    time, noise = np.arange(0, 20, 0.05), 1e-3
    rate = 5.4 * np.exp(-0.1 * time) - 0.4 + np.random.default_rng(0).normal(0, noise, len(time))
    run = residyn.Recording.from_arrays(time, rate, reads="rate", noise=noise)
    wheel = InertiaTable(("wheel",), ((0.02,),), ("rad",))
    fit = residyn.fit(residyn.Experiment(wheel, (run,)), effects=["coulomb_friction"], starts=1)
    assert [n.determined for n in fit.numbers] == [True, True, False]
    assert abs(fit.numbers[1].value - 0.002) < 4 * fit.numbers[1].std < 1e-4
    assert any("friction:wheel.torque is not determined" in words for words in fit.warnings)
