"""Corners of a torque: the motion, and how it changes with where a corner is.

A mass that flies freely through a gap between two springs has a motion in closed form.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from residyn.effects import DeadZone, Hysteresis, Spring
from residyn.physics.mechanism import ConstantInertia
from residyn.physics.model import Model
from residyn.simulation.simulate import simulate, steps_for

pytestmark = pytest.mark.usefixtures("float64")
SWING, STIFFNESS, GAP = 0.3, 9.0, 0.04
TIME = np.linspace(0.0, 20.0, 801)


def free_play(stiffness: float, gap: float) -> np.ndarray:
    """(N,) of a unit mass let go at SWING: half a sine beyond the gap, a straight line inside."""
    pace = np.sqrt(stiffness)
    quarter, speed = 0.5 * np.pi / pace, (SWING - gap) * pace
    half = 2 * quarter + 2 * gap / speed
    turns = np.floor((TIME + quarter) / half)
    since = TIME + quarter - turns * half  # it came out of the gap
    beyond = gap + (SWING - gap) * np.sin(pace * since)
    inside = gap - speed * (since - 2 * quarter)
    return (-1.0) ** turns * np.where(since < 2 * quarter, beyond, inside)


def model(stiffness, gap) -> Model:
    mechanism = ConstantInertia(((1.0,),), ("joint",), ("rad",))
    return Model(mechanism, (Spring("joint", stiffness), DeadZone("joint", stiffness, gap)))


@pytest.mark.parametrize(("finer", "off", "wrong"), [(1, 3e-4, 2e-3), (4, 1e-5, 2e-4)])
def test_a_motion_through_a_gap_and_its_slopes_are_those_in_closed_form(finer, off, wrong):
    numbers = jnp.array([STIFFNESS, GAP])
    steps = finer * steps_for(model(*numbers), TIME[-1])

    def motion(numbers):
        return simulate(model(*numbers), TIME, [SWING], steps=steps).q[:, 0]

    np.testing.assert_allclose(motion(numbers), free_play(STIFFNESS, GAP), atol=off)
    d = 1e-6
    for i, found in enumerate(np.asarray(jax.jacfwd(motion)(numbers)).T):
        up, down = (free_play(*(numbers + s * d * (np.arange(2) == i))) for s in (1, -1))
        slope = (up - down) / (2 * d)
        assert np.sqrt(np.mean((found - slope) ** 2)) < wrong * np.sqrt(np.mean(slope**2))


def test_corners_of_an_internal_states_rate_are_integrated_too():
    """Bouc and Wen's equations by SciPy: the rate of z turns where the joint does."""
    torque, angle, start = 0.3, 0.15, 1.0 - np.exp(-SWING / 0.15)

    def rates(_, x):
        q, v, z = x
        loaded = abs(z) if v * z > 0 else 0.0
        return v, -STIFFNESS * q - torque * z, v / angle * (1.0 - loaded)

    how = {"rtol": 1e-11, "atol": 1e-13, "max_step": 2e-3}
    exact = solve_ivp(rates, (0.0, TIME[-1]), (SWING, 0.0, start), t_eval=TIME, **how).y[0]
    mechanism = ConstantInertia(((1.0,),), ("joint",), ("rad",))
    bouc_wen = Model(mechanism, (Spring("joint", STIFFNESS), Hysteresis("joint", torque, angle)))
    steps = 4 * steps_for(bouc_wen, TIME[-1])
    np.testing.assert_allclose(
        simulate(bouc_wen, TIME, [SWING], steps=steps).q[:, 0], exact, atol=1e-6
    )


def test_a_joint_that_is_loose_at_rest_is_integrated_in_single_precision_too():
    with jax.enable_x64(False):
        loose = model(STIFFNESS, GAP)
        time = TIME.astype(np.float32)
        found = simulate(loose, time, [SWING], steps=steps_for(loose, 20.0)).q[:, 0]
    np.testing.assert_allclose(found, free_play(STIFFNESS, GAP), atol=1e-3)
