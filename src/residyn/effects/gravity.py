"""Gravity in the plane of motion: a tilted table or, at 90 degrees, a pendulum."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..parameter import DIRECTION, TORQUE, param
from .base import AbstractEffect


class Gravity(AbstractEffect):
    """Gravity on each link, in the sine of the link's absolute angle, not linearised.

    With phi_1 = q1 and phi_2 = q1 + theta_2 + q2, link i pulls with M_i sin(phi_i - direction) on
    every joint that carries it. M_1 = (m1 rho1 + m2 l1) g and M_2 = m2 rho2 g for a pendulum, times
    sin(tilt) for a tilted table. `direction` is the angle at which the links would hang.
    """

    name = "gravity"
    equation = "M1 sin(phi1 - d) + M2 sin(phi2 - d)  on the links' absolute angles"
    looks_like = "frequency falls with amplitude; rest shifts on a tilted table"
    source = "Lagrange, with V = -sum M_i cos(phi_i - d)"

    moment1: Float[Array, ""] = param("gravity moment of link 1 (and what it carries)", TORQUE)
    moment2: Float[Array, ""] = param("gravity moment of link 2", TORQUE)
    direction: Float[Array, ""] = param(
        "angle at which the links would hang", DIRECTION, grid=(0.0, math.pi / 2)
    )

    @classmethod
    def places(cls, mechanism):
        mechanism.link_angles((0.0,) * len(mechanism.joints))
        return ()

    def torque(self, motion, mechanism):
        pull = tuple(
            moment * jnp.sin(angle - self.direction)
            for moment, angle in zip(
                (self.moment1, self.moment2), mechanism.link_angles(motion.q), strict=False
            )
        )
        # Link i turns with every joint before it: joint j feels the links from j on.
        return tuple(sum(pull[joint:]) for joint in range(len(pull)))
