"""Joints with dry friction that hold each other: what one withstands depends on the others."""

import jax
import numpy as np
import pytest

import residyn
from residyn.diagnosis import missing_torque
from tests.exact import dry_motion

ARM = residyn.PlanarArm((0.4, 0.4), shoulder=1.1662, elbow=0.579, coupling=1.4384, theta2=2.2)
STIFFNESS, DAMPING, FRICTION = np.array([18.0, 14.0]), np.array([0.15, 0.12]), np.array([0.1, 0.06])
START = np.array([0.3, -0.35])


def model_of(mechanism, stiffness, damping, friction) -> residyn.Model:
    model = residyn.Model(mechanism)
    for joint, k, c, f in zip(mechanism.joints, stiffness, damping, friction, strict=True):
        model = model + residyn.Spring(joint, k) + residyn.Damper(joint, c)
        model = model + residyn.CoulombFriction(joint, f)
    return model


def arm_torque(q, v):
    """Mass matrix and all torques but friction, written out (paper, Eq. 1)."""
    c, s = np.cos(2.2 + q[1]), np.sin(2.2 + q[1])
    h, g = 0.4 * 1.4384 * c, 0.4 * 1.4384 * s
    mass = np.array([[1.1662 + 0.579 + 2 * h, 0.579 + h], [0.579 + h, 0.579]])
    centrifugal = np.array([-g * v[1] * (2 * v[0] + v[1]), g * v[0] ** 2])
    return mass, -centrifugal - STIFFNESS * q - DAMPING * v


@pytest.fixture(scope="module")
def released():
    """Time, and the angles of an arm that comes to rest within 12 s."""
    time = np.arange(2000) / 100
    return time, dry_motion(arm_torque, FRICTION, np.append(START, [0.0, 0.0]), time)


def test_an_arm_with_friction_at_both_joints_comes_to_rest_and_stays(released):
    time, exact = released
    with jax.enable_x64(True):
        motion = residyn.simulate(model_of(ARM, STIFFNESS, DAMPING, FRICTION), time, START)
    q, v = np.asarray(motion.q), np.asarray(motion.v)
    assert np.abs(q - exact).max() < 1e-4  # of 0.35 rad
    assert np.ptp(q[time > 13], axis=0).max() < 1e-12
    assert np.abs(v[time > 13]).max() < 1e-12


def test_three_coupled_joints_stick_and_break_away_as_they_do():
    mass = np.array([[1.0, 0.6, 0.3], [0.6, 0.8, 0.35], [0.3, 0.35, 0.5]])
    k, c, f = np.array([30.0, 20.0, 12.0]), np.array([0.2, 0.1, 0.1]), np.array([0.5, 0.2, 0.3])
    time, start = np.arange(800) / 100, np.array([0.2, -0.1, 0.15])
    exact = dry_motion(lambda q, v: (mass, -k * q - c * v), f, np.append(start, np.zeros(3)), time)
    names, units = ("a", "b", "c"), ("rad",) * 3
    with jax.enable_x64(True):
        model = model_of(residyn.ConstantInertia(mass.tolist(), names, units), k, c, f)
        q = np.asarray(residyn.simulate(model, time, start).q)
    assert np.abs(q - exact).max() < 5e-4
    rests = np.diff(exact, axis=0) == 0.0
    alone = rests.any(axis=1) & ~rests.all(axis=1)
    assert np.count_nonzero(alone) > 50  # one is held while others move


def test_the_true_model_of_such_an_arm_lacks_no_torque(released):
    """The filter's friction, too, is that of joints that hold each other."""
    time, exact = released
    noise = 5e-4
    q = exact + noise * np.random.default_rng(1).standard_normal(exact.shape)
    with jax.enable_x64(True):
        model = model_of(ARM, STIFFNESS, DAMPING, FRICTION)
    found = missing_torque(model, residyn.Recording.from_arrays(time, q, noise=noise))
    assert found.share_of_spring.max() < 1e-3
