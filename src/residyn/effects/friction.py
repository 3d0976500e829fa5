"""Dry friction: a torque that knows only which way the joint slides.

Its size does not fall with the rate, so it takes the same bite out of the amplitude every cycle
(4 F/k for a spring) and at last holds the joint still, off centre. The jump at rest is kept sharp:
the laws here use `motion.direction`, and the integrator finds the instants where it changes.
"""

from ..motion import Scalar
from ..parameter import TORQUE, param
from .base import JointEffect


class CoulombFriction(JointEffect):
    """Coulomb friction: constant torque against the direction of sliding, holding up to it."""

    name = "coulomb_friction"
    equation = "F sign(q')"
    looks_like = "amplitude falls by the same amount every cycle; rest comes early and off centre"
    source = "Coulomb 1785; paper, Eq. 10-11 (constant part of the friction)"
    dissipates = True
    dry = True

    level: Scalar = param("friction torque", TORQUE, sign="positive", name="torque")

    def joint_torque(self, motion):
        return self.level * motion.direction
