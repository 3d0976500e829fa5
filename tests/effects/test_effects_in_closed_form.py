"""Effects that rigs showed, against closed forms."""

import numpy as np
import pytest
from scipy.linalg import expm

import residyn
from residyn.diagnosis.columns import candidates
from residyn.diagnosis.missing_torque import scene_of
from residyn.physics.motion import Motion
from residyn.recordings.tables import InertiaTable

pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


@pytest.mark.parametrize("rate", [2.0, -3.0])
def test_air_drags_on_a_straight_arm_as_on_one_link(rate):
    """The integral of c (s w)^2 s ds from 0 to L = l1 + l2 is c L^4 w^2 / 4."""
    arm = residyn.PlanarArm([0.3, 0.5], 1.0, 0.5, 0.6)
    torque = residyn.AirDrag(0.7).torque(Motion.at(0.0, [0.4, 0.0], [rate, 0.0]), arm)
    np.testing.assert_allclose(torque[0], 0.7 * 0.8**4 / 4 * rate * abs(rate), rtol=1e-12)


def test_air_drags_on_a_turning_elbow_as_on_its_link_alone():
    arm = residyn.PlanarArm([0.3, 0.5], 1.0, 0.5, 0.6)
    torque = residyn.AirDrag(0.7).torque(Motion.at(0.0, [0.4, 1.1], [0.0, 2.0]), arm)
    np.testing.assert_allclose(torque[1], 0.7 * 0.5**4 / 4 * 2.0**2, rtol=1e-12)


def test_dahls_friction_builds_up_exponentially_and_reverses():
    """From z = 0 over a way x: 1 - exp(-x/y); from there back over w: -1 + (1 + z) exp(-w/y)."""
    cart = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    dahl = residyn.DahlFriction("cart", level=3.0, way=0.02)
    there = Motion.at(0.0, [0.05], [1.0], [0.0, 0.0])._replace(turn=(0.05,))
    z = 1 - np.exp(-0.05 / 0.02)
    np.testing.assert_allclose(dahl.torque(there, cart)[0], 3.0 * z, rtol=1e-12)
    # It turned round at 0.05 within the step and is at 0.04 now.
    back = Motion.at(0.0, [0.04], [-1.0], [0.0, 0.0])._replace(turn=(0.05,))
    after = -1 + (1 + z) * np.exp(-0.01 / 0.02)
    np.testing.assert_allclose(dahl.torque(back, cart)[0], 3.0 * after, rtol=1e-12)
    np.testing.assert_allclose(np.array(dahl.follow(back, cart)), [after, 0.04], rtol=1e-12)


def test_dahls_friction_takes_coulombs_bite_where_it_is_stiff():
    """The amplitude falls by 4 F / k a cycle, but for the way over which it builds up."""
    cart = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    model = cart + residyn.Spring("cart", 100.0) + residyn.DahlFriction("cart", 0.2, 1e-3)
    t = np.linspace(0.0, 2 * np.pi / 10 * 3, 3001)
    q = np.asarray(residyn.simulate(model, t, [0.1], steps=6000).q)[:, 0]
    peaks = [q[0], *(q[i] for i in range(1, 3000) if q[i - 1] < q[i] >= q[i + 1])]
    np.testing.assert_allclose(np.diff(peaks), -4 * 0.2 / 100, rtol=0.05)


def test_cogging_repeats_and_derives_from_a_potential():
    cogging = residyn.Cogging("cart", sine=2.0, cosine=0.5, period=0.1)
    cart = residyn.ConstantInertia([[1.0]], ["cart"], ["m"])
    at = [float(cogging.torque(Motion.at(0.0, [q], [0.0]), cart)[0]) for q in (0.03, 0.13, 0.0)]
    np.testing.assert_allclose(at[0], at[1], rtol=1e-9)
    assert at[2] == 0.0


def relaxing(matrix, springs, dampers, joint, stiffness, time, start, t):
    """Angles (N, n) of linear joints with a Maxwell element, by the matrix exponential; it had
    relaxed before the release."""
    n = len(matrix)
    into = np.zeros(n)
    into[joint] = stiffness
    A = np.zeros((2 * n + 1, 2 * n + 1))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n, :n] = -np.linalg.solve(matrix, np.diag(springs) + np.diag(into))
    A[n : 2 * n, n : 2 * n] = -np.linalg.solve(matrix, np.diag(dampers))
    A[n : 2 * n, 2 * n] = np.linalg.solve(matrix, into)
    A[2 * n, joint], A[2 * n, 2 * n] = 1 / time, -1 / time
    step, x = expm(A * (t[1] - t[0])), np.concatenate([start, np.zeros(n), [start[joint]]])
    found = np.empty((len(t), n))
    for k in range(len(t)):
        found[k], x = x[:n], step @ x
    return found


MATRIX = np.array([[1.0, 0.3], [0.3, 0.5]])


def test_a_relaxing_spring_is_the_standard_linear_solid():
    t, start = np.arange(500) / 50, np.array([0.2, -0.1])
    model = residyn.ConstantInertia(MATRIX.tolist(), ["base", "tip"], ["rad", "rad"])
    model = model + residyn.Spring("base", 20.0) + residyn.Spring("tip", 12.0)
    model = model + residyn.Damper("base", 0.1) + residyn.Damper("tip", 0.05)
    model = model + residyn.Relaxation("tip", 3.0, 0.25)
    exact = relaxing(MATRIX, [20.0, 12.0], [0.1, 0.05], 1, 3.0, 0.25, start, t)
    np.testing.assert_allclose(residyn.simulate(model, t, start).q, exact, atol=2e-5)


def on_rubber(*extra_mass):
    """A mass of 1 kg on a spring that relaxes, released bare or with more on it."""
    t, noise, recordings = np.arange(400) / 50, 1e-4, []
    for i, extra in enumerate(extra_mass):
        q = relaxing(np.array([[1.0 + extra]]), [400.0], [1.0], 0, 120.0, 0.08, [0.02], t)
        q = q + noise * np.random.default_rng(i).standard_normal(q.shape)
        made = residyn.Recording.from_arrays(t, q, noise=noise, extra_mass=extra, name=f"run {i}")
        recordings.append(made)
    table = InertiaTable(("mass",), ((1.0,),), ("m",))
    return residyn.Experiment(table, tuple(recordings))


def test_two_loads_of_one_joint_show_a_relaxing_spring():
    experiment = on_rubber(0.0, 3.0)
    found = residyn.fit(experiment, effects=["relaxation:mass"], starts=2)
    assert found.reduced_chi2 < 1.2
    numbers = {n.name: n for n in found.numbers}
    for name, true in ("stiffness", 120.0), ("time", 0.08):
        number = numbers[f"relaxation:mass.{name}"]
        assert abs(number.value - true) < 4 * number.std < 0.2 * true
    assert "relaxation:mass" in [e.label for e in candidates(scene_of(experiment, ())[0], ())]


def test_one_load_of_one_joint_does_not():
    """At its one frequency it is a spring and a damper, and with these the readings choose none."""
    experiment = on_rubber(0.0, 0.0)
    with pytest.raises(ValueError, match="differ in extra_mass"):
        residyn.fit(experiment, effects=["relaxation"], starts=1)
    assert "relaxation:mass" not in [e.label for e in candidates(scene_of(experiment, ())[0], ())]


@pytest.mark.slow
def test_a_relaxing_spring_is_named_with_its_numbers():
    t, start, noise = np.arange(1500) / 100, np.array([0.2, -0.1]), 1e-3
    q = relaxing(MATRIX, [20.0, 12.0], [0.1, 0.05], 1, 3.0, 0.25, start, t)
    q = q + noise * np.random.default_rng(3).standard_normal(q.shape)
    recording = residyn.Recording.from_arrays(t, q, noise=noise)
    table = InertiaTable(("base", "tip"), MATRIX.tolist(), ("rad", "rad"))
    found = residyn.diagnose(residyn.Experiment(table, (recording,)))
    assert found.verdict == "missing"
    assert found.added == ("relaxation:tip",)
    for name, true in ("stiffness", 3.0), ("time", 0.25):
        number = found.parameters[f"relaxation:tip.{name}"]
        assert abs(number.value - true) < 4 * number.std < 0.2 * true


@pytest.mark.parametrize("sharpness", [10.0, 60.0])
def test_a_loop_that_yields_sharply_is_that_of_a_slipping_brake(sharpness):
    """Q z with z' = q'/y up to 1: a spring Q/y in series with a brake that holds Q. Steps that are
    too long for so sharp a corner round it; they do not make the motion diverge."""
    cart, t = residyn.ConstantInertia([[1.0]], ["cart"], ["m"]), np.linspace(0.0, 6.0, 601)
    loop = cart + residyn.Spring("cart", 50.0) + residyn.Hysteresis("cart", 0.5, 0.05, sharpness)
    brake = cart + residyn.Spring("cart", 60.0) + residyn.BrakeSlip("cart", 10.0, 0.05)
    expected = np.asarray(residyn.simulate(brake, t, [0.2]).q)
    assert 0.1 < np.ptp(expected[-100:]) < 0.2  # of 0.4 at first
    for steps, near in ((None, 0.02), (20_000, 1e-3)):
        found = np.asarray(residyn.simulate(loop, t, [0.2], steps=steps).q)
        np.testing.assert_allclose(found, expected, atol=near)
