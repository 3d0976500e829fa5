"""Drag of the air on links that sweep through it.

Where links move fast, the air resists with the square of the speed at which each piece of a link
moves across itself. That is a speed over the ground and not a joint's own: the second link drags on
the first joint, too, and a still elbow spares it nothing.
"""

import math

import jax.numpy as jnp

from ..physics.mechanism import ArmEffect, arm_of
from ..physics.motion import Scalar
from ..physics.parameter import Dimension, param

PER_LENGTH = Dimension("N s^2/m^3", "N s^2/m^3", lambda s: s.inertia / (s.swing * s.length**4))
# Gauss and Legendre's three points on a link of length 1: exact for the integrals here where the
# speed has one sign along the link.
_POINTS = tuple(0.5 + 0.5 * x for x in (-math.sqrt(0.6), 0.0, math.sqrt(0.6)))
_WEIGHTS = (5 / 18, 8 / 18, 5 / 18)


class AirDrag(ArmEffect):
    """Quadratic drag of the air on both links, strips of equal width: on a piece ds that moves
    across the link at u acts c u |u| ds, with c = density x drag coefficient x width / 2.

    The links are taken to reach from joint to joint, and link 2 to the end that `link_lengths`
    gives.
    """

    name = "air_drag"
    title = "Air drag of the links"
    family = "damping law"
    equation = "sum over links of the integral of J' c u |u| ds"
    looks_like = "large swings fall quickly, small ones hardly, both joints together"
    source = "Rayleigh, Theory of Sound, 1877; strip theory"
    dissipates = True

    coefficient: Scalar = param("drag of a metre of link at 1 m/s", PER_LENGTH, sign="positive")

    def torque(self, motion, mechanism):
        arm = arm_of(mechanism, self.name)
        l1, l2 = arm.link_lengths[0], arm.link_lengths[1]
        first, whole = motion.v[0], motion.v[0] + motion.v[1]
        carried = l1 * jnp.cos(arm.theta2 + motion.q[1])  # link 2 across itself, by q1'
        shoulder = 0.25 * l1**4 * first * jnp.abs(first)
        elbow = 0.0
        for point, weight in zip(_POINTS, _WEIGHTS, strict=True):
            lever = point * l2
            across = carried * first + lever * whole
            force = weight * l2 * across * jnp.abs(across)
            shoulder = shoulder + force * (carried + lever)
            elbow = elbow + force * lever
        return self.coefficient * shoulder, self.coefficient * elbow
