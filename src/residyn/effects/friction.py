"""Dry friction: a torque that knows which way the joint slides.

Its size does not fall with the rate, so it takes the same bite out of the amplitude every cycle
(4 F/k for a spring) and at last holds the joint still, off centre. The jump at rest is kept sharp:
the laws here use `motion.direction`, and the integrator finds the instants where it changes.
"""

import jax.numpy as jnp

from ..physics.effect import JointEffect
from ..physics.motion import Scalar
from ..physics.parameter import RATE, TORQUE, param


class CoulombFriction(JointEffect):
    """Coulomb friction: constant torque against the direction of sliding, holding up to it."""

    name = "coulomb_friction"
    title = "Coulomb friction"
    family = "dry friction"
    equation = "F sign(q')"
    looks_like = "amplitude falls by the same amount every cycle; rest comes early and off centre"
    source = "Coulomb 1785; paper, Eq. 10-11 (constant part of the friction)"
    dissipates = True
    dry = True

    level: Scalar = param("friction torque", TORQUE, sign="positive", name="torque")

    def joint_torque(self, motion):
        return self.level * motion.direction


class StribeckFriction(JointEffect):
    """Coulomb friction that is higher near rest, as of a lubricated or a well-worn contact."""

    name = "stribeck_friction"
    title = "Stribeck friction"
    family = "dry friction"
    equation = "(F + E exp(-(q'/w)^2)) sign(q')"
    looks_like = "as Coulomb friction, and the last swings stop short and stick farther off centre"
    source = "Stribeck 1902; Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994"
    dissipates = True
    dry = True
    extends = "coulomb_friction"

    level: Scalar = param("friction torque when fast", TORQUE, sign="positive", name="torque")
    excess: Scalar = param("more of it near rest", TORQUE, sign="positive")
    velocity: Scalar = param(
        "rate at which the excess fades",
        RATE,
        sign="positive",
        silent=None,
        default=0.1,
        grid=(0.04, 0.12, 0.4),
    )

    def joint_torque(self, motion):
        excess = self.excess * jnp.exp(-((motion.v / self.velocity) ** 2))
        return (self.level + excess) * motion.direction
