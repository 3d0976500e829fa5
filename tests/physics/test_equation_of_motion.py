"""Eq. 1 against closed forms and against an independent simulator (MuJoCo)."""

import dataclasses
import math
import warnings

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn import ConstantInertia, CoulombFriction, Damper, Gravity, PlanarArm, Spring
from residyn.effects import PrintedInertiaTorque
from residyn.physics.modal import (
    at_rest,
    equilibrium,
    fastest,
    modes_of,
    state_matrices,
    state_matrix,
)
from residyn.physics.motion import Motion
from residyn.simulation.simulate import march

rig = pytest.importorskip("tests.rig")

pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def arm_of(case_arm) -> residyn.Model:
    """Our model of the rig's arm."""
    bodies = PlanarArm(
        [case_arm.l1, case_arm.l2],
        case_arm.shoulder,
        case_arm.elbow,
        case_arm.coupling,
        case_arm.theta2,
    )
    model = residyn.Model(bodies)
    for joint, k, c in zip(bodies.joints, case_arm.stiffness, case_arm.damping, strict=True):
        model = model + Spring(joint, k) + Damper(joint, c)
    return model


def energy(model, nodes):
    """Kinetic plus spring energy at every node, J."""
    springs = jnp.stack([e.stiffness for e in model.effects if e.name == "spring"])

    def one(q, v):
        return model.mechanism.kinetic_energy(tuple(q), tuple(v)) + 0.5 * jnp.sum(springs * q**2)

    q, v, _ = jnp.split(nodes.ends, 3, axis=1)
    return np.asarray(jax.jit(jax.vmap(one))(q, v / nodes.h))


@pytest.fixture
def undamped():
    arm = PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.7)
    return arm + Spring("shoulder", 16.67) + Spring("elbow", 16.67)


def test_energy_is_kept_over_1000_periods(undamped):
    period = 2 * np.pi / 2.27  # the slow mode
    drift = []
    for size in (0.15, 0.075):
        steps = int(1000 * period * fastest(undamped) / size)
        nodes = march(undamped, 0.0, 1000 * period, [0.4, -0.3], [0.0, 0.0], steps=steps)
        total = energy(undamped, nodes)
        drift.append(np.abs(total / total[0] - 1).max())
    # What is lost is the integrator's: it falls with the fifth power of the step.
    assert drift[0] < 1e-3
    assert drift[1] < drift[0] / 20


def test_printed_inertia_torque_does_not_keep_energy(undamped):
    printed = undamped + PrintedInertiaTorque()
    ratios = []
    for steps in (2000, 8000):
        nodes = march(printed, 0.0, 10.0, [0.1, -0.05], [0.0, 0.0], steps=steps)
        total = energy(printed, nodes)
        ratios.append(np.abs(total / total[0] - 1).max())
    assert ratios[1] > 0.02
    # Not the integrator's doing: smaller steps change nothing.
    assert ratios[1] == pytest.approx(ratios[0], rel=1e-3)


def test_eq_3_as_printed_is_what_the_effect_adds_up_to(undamped):
    q, v = (0.2, -0.1), (0.5, -0.8)
    arm = undamped.mechanism
    s = 0.4 * 1.4384 * np.sin(0.7 + q[1])
    printed = s * np.array([v[1] ** 2 - v[0] ** 2, -(v[0] ** 2)])
    added = PrintedInertiaTorque().torque(Motion.at(0.0, q, v), arm)
    total = np.array(arm.inertia_torque(q, v)) + np.array(added)
    np.testing.assert_allclose(total, printed, rtol=1e-12)


def test_closed_form_inertia_torque_is_lagranges(undamped):
    arm = undamped.mechanism
    q, v = (0.3, -0.4), (0.7, 0.2)
    generic = residyn.AbstractMechanism.inertia_torque(arm, q, v)
    np.testing.assert_allclose(arm.inertia_torque(q, v), generic, rtol=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_simulation_agrees_with_mujoco(seed):
    rng = np.random.default_rng([7, seed])
    arm = rig.random_arm(rng)
    q0 = rig.random_release(rng)
    t = np.arange(2001) * 0.01
    theirs, _ = rig.simulate(arm, t, q0)
    ours = residyn.simulate(arm_of(arm), t, q0)
    assert np.abs(np.asarray(ours.q) - theirs).max() < 1e-5


@pytest.mark.parametrize("seed", range(4))
def test_dry_friction_agrees_with_mujoco(seed):
    """Sticking included. The rig itself is good to about 1e-5 rad here."""
    case = next(rig.friction_cases(np.random.default_rng([11, seed]), 1))
    model = arm_of(case.arm)
    for joint, level in zip(model.mechanism.joints, case.frictionloss, strict=True):
        model = model + CoulombFriction(joint, level) if level else model
    ours = residyn.simulate(model, case.t, case.q0)
    amplitude = np.abs(case.q0).max()
    assert np.abs(np.asarray(ours.q) - case.truth).max() < 0.0005 * amplitude


def test_coulomb_friction_against_its_closed_form():
    """A mass on a spring loses 4 F/k of amplitude every cycle and rests off centre."""
    mass, k, level, start = 0.5685, 712.6, 0.5, 0.02
    cart = ConstantInertia([[mass]], ["cart"], ["m"])
    model = cart + Spring("cart", k) + CoulombFriction("cart", level)
    w, d = np.sqrt(k / mass), level / k
    halves = np.arange(0, int((start / d + 1) / 2) + 1)
    turns = residyn.simulate(model, np.append(halves * np.pi / w, 3.0), [start]).q[:, 0]
    expected = (-1.0) ** halves * (start - 2 * d * halves)
    np.testing.assert_allclose(turns[:-1], expected, atol=1e-3 * start)
    rest = expected[np.argmax(np.abs(expected) <= d)]
    assert turns[-1] == pytest.approx(rest, abs=2e-6)
    assert abs(rest) > d / 10  # off centre


def test_gravity_agrees_with_mujoco():
    arm = dataclasses.replace(rig.paper_twin(0.4), link1_moment=1.3)
    q0 = np.array([0.3, -0.2])
    t = np.arange(1001) * 0.01
    for gravity in (rig.HANGING, rig.tilt(0.05, 2.0)):
        theirs, _ = rig.simulate(arm, t, q0, gravity=gravity)
        # Link 1 at rest lies along +x. V = -(moments . gravity).
        along, across = gravity
        model = arm_of(arm) + Gravity(
            1.3 * along, arm.coupling * along, -1.3 * across, -arm.coupling * across
        )
        ours = residyn.simulate(model, t, q0)
        assert np.abs(np.asarray(ours.q) - theirs).max() < 1e-5


def test_a_double_pendulum_agrees_with_mujoco():
    arm = dataclasses.replace(rig.paper_twin(0.0), link1_moment=1.3)
    q0, t = np.array([0.9, -0.4]), np.arange(1001) * 0.01
    theirs, _ = rig.simulate(arm, t, q0, gravity=rig.HANGING)
    along = rig.HANGING[0]
    ours = residyn.simulate(
        arm_of(arm) + residyn.Pendulum(1.3 * along, arm.coupling * along), t, q0
    )
    assert np.abs(np.asarray(ours.q) - theirs).max() < 1e-5


@pytest.mark.slow
def test_every_adjoint_gives_the_same_motion_and_gradient(undamped):
    model = undamped + Damper("elbow", 0.1)
    t = jnp.linspace(0.0, 3.0, 50)

    def loss(stiffness, adjoint):
        moved = model.with_values({"spring:elbow.stiffness": stiffness})
        return jnp.sum(residyn.simulate(moved, t, [0.2, -0.1], steps=150, adjoint=adjoint).q ** 2)

    value, slope = jax.value_and_grad(loss)(16.0, None)
    for adjoint in (diffrax.RecursiveCheckpointAdjoint(), diffrax.DirectAdjoint()):
        other, other_slope = jax.value_and_grad(loss)(16.0, adjoint)
        assert float(other) == pytest.approx(float(value), rel=1e-10)
        assert float(other_slope) == pytest.approx(float(slope), rel=1e-8)
    forward = jax.jvp(lambda k: loss(k, diffrax.ForwardMode()), (16.0,), (1.0,))[1]
    assert float(forward) == pytest.approx(float(slope), rel=1e-8)
    finite = (loss(16.0 + 1e-5, None) - loss(16.0 - 1e-5, None)) / 2e-5
    assert float(finite) == pytest.approx(float(slope), rel=1e-5)


def test_sensitivity_through_stick_and_slip_is_the_finite_difference():
    cart = ConstantInertia([[0.5685]], ["cart"], ["m"])
    model = cart + Spring("cart", 712.6) + Damper("cart", 0.3) + CoulombFriction("cart", 0.4)
    t = jnp.linspace(0.0, 2.0, 200)

    def motion(numbers):
        return residyn.simulate(model.with_vector(numbers), t, [0.02], steps=500).q[:, 0]

    numbers = model.vector()
    exact = np.asarray(jax.jacfwd(motion)(numbers))
    for i, size in enumerate((1e-4, 1e-5, 1e-6)):
        step = jnp.zeros(3).at[i].set(size)
        finite = np.asarray(motion(numbers + step) - motion(numbers - step)) / (2 * size)
        # The instant of sticking moves with the numbers: a few samples there may differ.
        off = np.abs(finite - exact[:, i]) > 2e-3 * np.abs(exact[:, i]).max()
        assert off.mean() < 0.02


def test_drive_torque_moves_the_arm_as_in_mujoco():
    rng = np.random.default_rng(5)
    arm = rig.random_arm(rng)
    t = np.arange(1001) * 0.01
    torque = np.stack([np.sin(2.0 * t), 0.5 * np.cos(3.1 * t)], axis=1)
    theirs, _ = rig.simulate(arm, t, np.zeros(2), drive=torque)
    ours = residyn.simulate(arm_of(arm), t, [0.0, 0.0], drive=residyn.Drive(0.0, 0.01, torque))
    assert np.abs(np.asarray(ours.q) - theirs).max() < 1e-5


def test_steps_must_be_given_under_tracing(undamped):
    model = undamped

    def late(k):
        moved = model.with_values({"spring:elbow.stiffness": k})
        return residyn.simulate(moved, jnp.linspace(0.0, 1.0, 9), [0.1, 0.0]).q[-1, 0]

    with pytest.raises(ValueError, match="give steps="):
        jax.grad(late)(16.0)


def test_single_precision_works_too():
    with jax.enable_x64(False):
        model = PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.7) + Spring("shoulder", 16.67)
        model = model + Spring("elbow", 16.67) + CoulombFriction("elbow", 0.05)
        q = residyn.simulate(model, np.arange(200) * 0.01, [0.1, 0.0]).q
        assert q.dtype == jnp.float32
        assert np.isfinite(q).all()


def test_single_precision_after_double_is_silent(undamped):
    model = undamped + residyn.Hysteresis("elbow", 0.1, 0.05)

    def last(stiffness):
        stiffer = model.with_values({"spring:elbow.stiffness": stiffness})
        return residyn.simulate(stiffer, [0.0, 1.0], [0.2, -0.1], steps=20).q[-1, 1]

    wide = last(16.0)
    with jax.enable_x64(False), warnings.catch_warnings():
        warnings.simplefilter("error")
        assert float(last(16.0)) == pytest.approx(float(wide), rel=1e-4)
        assert jax.grad(last)(16.0).dtype == jnp.float32


@pytest.mark.parametrize("joints", [1, 3, 5])
def test_constant_inertia_of_any_size_rings_at_its_eigenfrequencies(joints):
    rng = np.random.default_rng(joints)
    root = rng.normal(size=(joints, joints))
    matrix, k = root @ root.T + joints * np.eye(joints), rng.uniform(5, 50, joints)
    model = residyn.Model(ConstantInertia(matrix))
    for name, each in zip(model.mechanism.joints, k, strict=True):
        model = model + Spring(name, each)
    expected = np.sqrt(np.linalg.eigvals(np.linalg.solve(matrix, np.diag(k))).real) / (2 * np.pi)
    np.testing.assert_allclose(residyn.modes(model).frequency_hz, np.sort(expected), rtol=1e-10)


def block(stiffness, damping, *more):
    """Joints of 1 kg m^2 by themselves, on springs and dampers."""
    model = residyn.Model(ConstantInertia(np.eye(len(stiffness))))
    for name, k, c in zip(model.mechanism.joints, stiffness, damping, strict=True):
        model = model + Spring(name, k) + Damper(name, c)
    for effect in more:
        model = model + effect
    return model


@pytest.mark.parametrize(
    ("stiffness", "damping", "ratio"),
    [
        (1.0, 0.1, 0.05),
        (1.0, 10.0, 5.0),
        (1.0, 2.0 - 1e-7, 1.0),
        (1.0, 2.0 + 1e-7, 1.0),
        (1.0, -0.1, -0.05),
        (1.0, -10.0, -5.0),
        (-1.0, 0.0, -1.0),
        (-1.0, 0.1, -math.hypot(2.0, 0.1) / 2),  # it moves away, however much it is damped
    ],
)
def test_natural_frequency_and_damping_ratio_of_one_joint(stiffness, damping, ratio):
    frequency, found = residyn.modes(block([stiffness], [damping]))
    np.testing.assert_allclose(frequency, [1 / (2 * np.pi)], rtol=1e-6)
    np.testing.assert_allclose(found, [ratio], rtol=1e-6)


def test_what_nothing_pulls_back_has_frequency_0():
    frequency, ratio = residyn.modes(block([0.0, 4.0], [0.5, 0.4]))
    np.testing.assert_allclose(frequency, [0.0, 1 / np.pi], rtol=1e-9)
    np.testing.assert_allclose(ratio, [np.inf, 0.1], rtol=1e-9)


def test_overdamped_joints_are_paired_by_their_shapes():
    """Joints with slow eigenvalues -0.1 and -3.8, fast ones -9.9 and -26.2: not by size."""
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])  # the same two, in coupled coordinates
    plain = block([1.0, 100.0], [10.0, 30.0])
    matrices = [np.asarray(state_matrix(plain))]
    matrices += [np.kron(np.eye(2), turn) @ matrices[0] @ np.kron(np.eye(2), turn.T)]
    for matrix in (matrices[0], matrices[1], np.array(matrices)):
        frequency, ratio = modes_of(plain, matrix)
        np.testing.assert_allclose(frequency - np.array([1, 10]) / (2 * np.pi), 0, atol=1e-9)
        np.testing.assert_allclose(ratio - np.array([5.0, 1.5]), 0, atol=1e-9)


@pytest.mark.parametrize("damping", [0.4, 10.0])
@pytest.mark.parametrize(
    "more",
    [
        [residyn.DahlFriction("q1", 0.0, 0.02)],
        [residyn.PeriodicDisturbance(j, 0.1, 1.0) for j in ("q1", "q2")],
        # Of its z = q / angle, at rest a spring of torque / angle.
        [residyn.Hysteresis(j, 0.3, 0.1) for j in ("q1", "q2")],
    ],
)
def test_internal_states_are_no_modes(more, damping):
    model = block([1.0, 2.0], [damping, 0.4], *more)
    added = 3.0 if more[0].name == "hysteresis" else 0.0
    w2, c = np.array([1.0, 2.0]) + added, np.array([damping, 0.4])
    found = jax.jit(residyn.modes)(model)
    np.testing.assert_allclose(found.frequency_hz, np.sqrt(w2) / (2 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(found.damping_ratio, c / (2 * np.sqrt(w2)), rtol=1e-6)
    slope = jax.jacfwd(
        lambda k: residyn.modes(model.with_values({"spring:q1.stiffness": k})).frequency_hz
    )(1.0)
    expected = [1 / (4 * np.pi * np.sqrt(w2[0])), 0.0]
    np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-9)


def test_a_second_derivative_of_modes_is_refused():
    """JAX has no derivatives of eigenvectors; the first one is that of a joint by itself."""

    def ratio(damping):
        model = ConstantInertia([[2.0]], ["x"]) + Spring("x", 8.0) + Damper("x", damping)
        return residyn.modes(model).damping_ratio[0]

    slope = jax.grad(ratio)
    assert slope(1.0) == pytest.approx(1 / (2 * math.sqrt(2.0 * 8.0)), rel=1e-5)
    with pytest.raises(NotImplementedError):
        jax.grad(slope)(1.0)


def test_a_flexible_wrist_adds_a_mode():
    arm = PlanarArm([0.4, 0.4], 1.1662, 0.5790, 1.4384, 0.0)
    model = arm + Spring("shoulder", 16.0) + Spring("elbow", 16.0) + Damper("elbow", 5.0)
    found = residyn.modes(model + residyn.effects.WristFlexibility(0.0, 5.0, 0.02))
    for own, plain, hand in zip(found, residyn.modes(model), (5.0, 0.02), strict=True):
        np.testing.assert_allclose(own, [*plain, hand], rtol=1e-6)


@pytest.mark.parametrize(
    ("matrix", "how", "words"),
    [
        ([[2.0, 1.0], [0.0, 3.0]], {}, "must be finite and symmetric"),
        ([[2.0, np.nan], [np.nan, 3.0]], {}, "must be finite and symmetric"),
        ([[1.0, 2.0], [2.0, 1.0]], {}, "must be positive definite"),
        ([[-1.0]], {}, "must be positive definite"),
        ([[0.0, 0.0], [0.0, 1.0]], {}, "must be positive definite"),
        ([[0.9, 0.3], [0.3, 0.1]], {}, "must be positive definite"),  # but for rounding, singular
        (np.eye(2), {"joints": ["a", "a"]}, "no two may be alike"),
        (np.eye(2), {"units": ["rad"]}, 'must be "rad" or "m" for each of 2 joints'),
        (np.eye(2), {"units": ["deg", "m"]}, 'must be "rad" or "m"'),
    ],
)
def test_masses_that_there_cannot_be_are_refused(matrix, how, words):
    with pytest.raises(ValueError, match=words):
        ConstantInertia(matrix, **how)


@pytest.mark.parametrize(
    "change",
    [{"shoulder": -1.0}, {"elbow": 0.0}, {"coupling": 5.0}, {"elbow": np.nan}, {"theta2": np.inf}],
)
def test_an_arm_that_there_cannot_be_is_refused(change):
    given = {"shoulder": 1.1662, "elbow": 0.579, "coupling": 1.4384} | change
    ((name, value),) = change.items()
    with pytest.raises(ValueError, match=rf"{name} = {value}.*must be finite, and shoulder\*elbow"):
        PlanarArm([0.4, 0.4], **given)


def test_traced_and_mapped_arms_are_taken_as_they_are():
    def frequency(elbow):
        arm = PlanarArm([0.4, 0.4], 1.1662, elbow, 1.4384)
        return residyn.modes(arm + Spring("shoulder", 16.0) + Spring("elbow", 16.0)).frequency_hz[0]

    inertias = jnp.array([0.5, 0.6])
    arms = PlanarArm([0.4, 0.4], 1.1662, inertias, 1.4384)  # a pytree of two
    assert jax.tree.map(lambda x: -x, arms).elbow.tolist() == (-inertias).tolist()
    found = jax.jit(jax.vmap(jax.grad(frequency)))(inertias)
    for slope, elbow in zip(found, inertias, strict=True):
        finite = (frequency(elbow + 1e-6) - frequency(elbow - 1e-6)) / 2e-6
        assert float(slope) == pytest.approx(float(finite), rel=1e-5)


def test_traced_masses_are_taken_as_they_are():
    def frequency(mass):
        bodies = ConstantInertia(jnp.reshape(mass, (1, 1)))
        return residyn.modes(bodies + Spring("q1", 9.0)).frequency_hz[0]

    slope = jax.jit(jax.grad(frequency))(4.0)
    assert float(slope) == pytest.approx(-0.5 * 3.0 * 4.0**-1.5 / (2 * np.pi))


def test_bearings_on_and_off_and_the_papers_frequencies():
    """From the paper's own numbers: 0.3494 Hz with bearings and 0.5182 Hz without."""
    arm = PlanarArm([0.4, 0.4], 1.1662, 0.5790, 1.4384, 0.0)
    bearings = [residyn.AirBearing(j, 1.9635, 0.00245437) for j in ("elbow", "wrist")]
    bare = residyn.without_bearings(arm, bearings)
    again = residyn.with_bearings(bare, bearings)
    assert float(again.coupling) == pytest.approx(1.4384)
    found = []
    for bodies in (arm, bare):
        model = bodies + Spring("shoulder", 16.2717) + Spring("elbow", 16.1601)
        model = model + Damper("shoulder", 0.0754) + Damper("elbow", 0.1522)
        found.append(float(residyn.modes(model).frequency_hz[0]))
    assert found == pytest.approx([0.3494, 0.5182], abs=5e-5)


def test_dry_friction_of_a_bearing_damps_no_mode():
    """A linearisation at rest has no slope of a force that jumps there."""
    arm = PlanarArm([0.4, 0.4], 1.1662, 0.5790, 1.4384, 0.4, bearings=[1, 1])
    model = arm + Spring("shoulder", 16.0) + Spring("elbow", 16.0)
    rubbed = model + residyn.BearingFriction(0.05)
    pairs = zip(residyn.modes(model), residyn.modes(rubbed), strict=True)
    for clean, found in pairs:
        np.testing.assert_allclose(found, clean, atol=1e-9)


@pytest.mark.parametrize("tilted", [False, True])
def test_concrete_state_matrices_are_those_of_any_other_program(undamped, tilted):
    """Where an arm rests is found outside of the compiled program for concrete numbers."""
    model = undamped + Damper("elbow", 0.3)
    if tilted:  # a hanging elbow: it rests far from where its spring is slack
        model = model + Gravity(2.0, 1.5, 1.2, 0.4)
    q, matrix = at_rest(model)
    np.testing.assert_allclose(q, equilibrium(model), atol=1e-10)
    np.testing.assert_allclose(matrix, state_matrix(model), rtol=1e-9, atol=1e-9)
    assert (np.abs(q).max() > 0.01) == tilted
    rows = np.asarray(model.vector()) * np.array([[1.0], [1.1], [0.8]])
    for found, row in zip(state_matrices(model, rows), rows, strict=True):
        there = state_matrix(model.with_vector(jnp.asarray(row)))
        np.testing.assert_allclose(found, there, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("times", "q0", "words"),
    [
        ([0.0, 1.0], 0.1, r"q0 has shape \(\); it must have a number for each joint: shoulder"),
        ([0.0, 1.0], [0.1, 0.0, 0.0], r"q0 has shape \(3,\)"),
        ([0.0, 1.0], [np.nan, 0.0], "q0 = .*: all numbers must be finite"),
        (10.0, [0.1, 0.0], "times has shape"),
        ([], [0.1, 0.0], "times has 0 instants"),
        ([0.0], [0.1, 0.0], "times has 1 instants"),
        ([0.0, np.nan, 1.0], [0.1, 0.0], "must be finite"),
        ([0.0, 1.0, 0.5], [0.1, 0.0], "must increase"),
    ],
)
def test_arrays_of_other_shapes_or_not_finite_are_refused(undamped, times, q0, words):
    with pytest.raises(ValueError, match=words):
        residyn.simulate(undamped, times, q0)
    with pytest.raises(TypeError, match="PlanarArm is no model"):
        residyn.simulate(undamped.mechanism, times, q0)
    with pytest.raises(ValueError, match="must be two numbers"):
        residyn.PlanarArm(0.4, shoulder=1.2, elbow=0.6, coupling=1.4)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"steps": 0}, ValueError, "steps = 0: must be a whole number, at least one"),
        ({"steps": 2.7}, ValueError, "steps = 2.7: must be a whole number"),
        ({"steps": True}, ValueError, "steps = true: must be a whole number"),
        ({"orders": (1,)}, ValueError, r"orders = \(1,\): must be 0, 1 or 2 for each of shoulder"),
        ({"orders": (0, 5)}, ValueError, r"orders = \(0, 5\)"),
        ({"z0": [1.0]}, ValueError, r"z0 has shape \(1,\); .* internal state: none"),
        ({"drive": np.zeros((5, 2))}, TypeError, "ndarray is no drive"),
        (
            {"drive": residyn.Drive(0.0, 0.1, np.zeros((5, 3)))},
            ValueError,
            r"values has shape \(5, 3\); it must be \(M, 2\)",
        ),
        (
            {"drive": residyn.Drive(0.0, 0.0, np.zeros((5, 2)))},
            ValueError,
            "spacing = 0: must be positive",
        ),
    ],
)
def test_impossible_arguments_of_a_simulation_are_refused(undamped, given, error, words):
    with pytest.raises(error, match=words):
        residyn.simulate(undamped, [0.0, 1.0], [0.1, 0.0], **given)


def test_a_motion_that_too_few_steps_do_not_follow_is_not_finite_traced_or_not(undamped):
    times, q0 = np.linspace(0.0, 60.0, 50), np.array([0.25, -0.15])

    def last(steps):
        return lambda q0: residyn.simulate(undamped, times, q0, steps=steps).q[-1]

    enough = residyn.steps_for(undamped, 60.0)
    for steps, finite in ((10, False), (enough, True)):
        for run in (last(steps), jax.jit(last(steps))):
            assert np.isfinite(run(q0)).all() == finite


def test_a_known_model_chooses_its_steps_beside_traced_states(undamped):
    times, q0 = np.linspace(0.0, 1.0, 5), np.array([0.1, -0.05])
    found = jax.jit(lambda q0: residyn.simulate(undamped, times, q0).q)(q0)
    np.testing.assert_allclose(found, residyn.simulate(undamped, times, q0).q, atol=1e-12)
    traced = jax.jit(lambda t: residyn.simulate(undamped, t, q0, steps=50).q)(times)
    np.testing.assert_allclose(traced, found, atol=1e-6)
    with pytest.raises(ValueError, match="give steps="):
        jax.jit(lambda t: residyn.simulate(undamped, t, q0).q)(times)


def test_what_is_no_model_and_numbers_that_are_several_are_told(undamped):
    for given in (undamped.mechanism, "arm"):
        with pytest.raises(TypeError, match=f"{type(given).__name__} is no model"):
            residyn.modes(given)
    several = undamped + Damper("elbow", [0.1, 0.2])
    for call in (residyn.modes, lambda m: residyn.simulate(m, [0.0, 1.0], [0.1, 0.0], steps=20).q):
        with pytest.raises(ValueError, match=r"damper:elbow.damping has shape \(2,\): must be one"):
            call(several)
        axes = jax.tree.map(lambda x: 0 if np.shape(x) == (2,) else None, several)
        axes = eqx.tree_at(lambda m: m.mechanism, axes, None)
        found = jax.tree.leaves(jax.vmap(call, (axes,))(several))
        assert all(np.isfinite(x).all() and len(x) == 2 for x in found)
    with pytest.raises(ValueError, match="3 values: the model has 2 fitted numbers: spring:should"):
        undamped.with_vector(np.ones(3))


def test_a_model_shows_its_numbers_and_refuses_a_joint_that_is_not_there():
    arm = residyn.PlanarArm([0.4, 0.4], shoulder=1.2, elbow=0.6, coupling=1.4)
    model = arm + residyn.Spring("elbow", 16.7) + residyn.InertiaError("coupling")
    assert str(model).splitlines() == [
        "PlanarArm: shoulder, elbow",
        "    spring:elbow.stiffness        16.7 N m/rad",
        "    inertia_error:coupling.share  0",
    ]
    with pytest.raises(ValueError, match="spring:wrist: spring goes with shoulder, elbow"):
        arm + residyn.Spring("wrist", 3.0)
