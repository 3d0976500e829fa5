"""Torques that follow the rate: the damper of Eq. 4, and losses that are not proportional to it."""

import jax.numpy as jnp

from ..physics.effect import AbstractEffect, JointEffect, neighbours
from ..physics.motion import Scalar
from ..physics.parameter import DAMPING, QUADRATIC, param


class Damper(JointEffect):
    """Equivalent viscous damping of a braked joint, Eq. 4."""

    name = "damper"
    title = "Viscous damper"
    equation = "c q'"
    looks_like = "amplitude falls by the same share every cycle"
    source = "paper, Eq. 4"
    dissipates = True

    damping: Scalar = param("joint damping", DAMPING, sign="positive")

    def joint_torque(self, motion):
        return self.damping * motion.v


class QuadraticDrag(JointEffect):
    """Drag that grows as the square of the rate: air around a wide link, turbulent oil."""

    name = "quadratic_drag"
    title = "Quadratic drag"
    family = "damping law"
    equation = "c2 q' |q'|"
    looks_like = "large swings fall quickly, small ones hardly"
    source = "Rayleigh, Theory of Sound, 1877"
    dissipates = True

    coefficient: Scalar = param("quadratic drag", QUADRATIC, sign="positive")

    def joint_torque(self, motion):
        return self.coefficient * motion.v * jnp.abs(motion.v)


class CouplingDamping(AbstractEffect):
    """Damping between neighbouring joints: off the damping matrix's diagonal."""

    name = "coupling_damping"
    title = "Damping between joints"
    family = "damping law"
    equation = "c12 q2' at joint 1, c12 q1' at joint 2"
    looks_like = "the modes' damping ratios do not fit any two joint dampers"
    source = "linear theory: a full symmetric damping matrix"

    damping: Scalar = param("damping between neighbouring joints", DAMPING)

    @classmethod
    def places(cls, mechanism):
        neighbours(cls.name, mechanism)
        return ()

    def torque(self, motion, mechanism):
        return tuple(self.damping * v for v in neighbours(self.name, mechanism, motion.v))
