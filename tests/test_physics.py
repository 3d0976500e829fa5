"""Eq. 1 against closed forms and against an independent simulator (MuJoCo)."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn import ConstantInertia, CoulombFriction, Damper, Gravity, PlanarArm, Spring
from residyn.effects import PrintedInertiaTorque
from residyn.motion import Motion
from residyn.simulate import fastest, march

rig = pytest.importorskip("tests.rig")


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


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


def energy(model, q, v):
    stored = sum(
        0.5 * e.stiffness * x**2
        for e, x in zip([e for e in model.effects if e.name == "spring"], q, strict=True)
    )
    return model.mechanism.kinetic_energy(tuple(v), tuple(q * 0 + q)) * 0 + (
        0.5 * v @ np.array(model.mechanism.mass_matrix(tuple(q))) @ v + stored
    )
