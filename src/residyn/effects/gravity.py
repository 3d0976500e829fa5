"""Gravity in the plane of motion: a tilted table or, at 90 degrees, a pendulum."""

import jax
import jax.numpy as jnp

from ..physics.effect import AbstractEffect
from ..physics.motion import Scalar
from ..physics.parameter import MOMENT, TORQUE, param


class Gravity(AbstractEffect):
    """Gravity on each link, in the sine of the link's absolute angle, not linearised.

    With phi_1 = q1 and phi_2 = q1 + theta_2 + q2, link i pulls with
    `M_i sin(phi_i) + L_i cos(phi_i)` on every joint that carries it. For a pendulum, whose links
    hang at phi = 0, M_1 = (m1 rho1 + m2 l1) g, M_2 = m2 rho2 g and L = 0. For a table tilted in a
    direction d (that of the pull, from phi = 0), M = (...) g sin(tilt) cos(d) and
    L = -(...) g sin(tilt) sin(d). Both enter linearly, so that no direction is special.
    """

    name = "gravity"
    title = "Gravity"
    equation = "sum of M_i sin(phi_i) + L_i cos(phi_i), phi_i the links' absolute angles"
    looks_like = "frequency falls with amplitude; rest shifts on a tilted table"
    source = "Lagrange, with V = sum of -M_i cos(phi_i) + L_i sin(phi_i)"

    moment1: Scalar = param(
        "pull of link 1 (and what it carries) towards 0", MOMENT, joint=0, as_spring=True
    )
    moment2: Scalar = param("pull of link 2 towards 0", MOMENT, as_spring=True)
    lateral1: Scalar = param("pull of link 1 across", TORQUE, joint=0)
    lateral2: Scalar = param("pull of link 2 across", TORQUE)

    @classmethod
    def places(cls, mechanism):
        sliding = [
            j for j, u in zip(mechanism.joints, mechanism.units or (), strict=False) if u == "m"
        ]
        if sliding:
            raise ValueError(
                f"gravity acts with the sine of an angle, and {sliding[0]} slides (m): what pulls "
                f"it down a slope is constant_torque:{sliding[0]}"
            )
        with jax.enable_x64(True):  # the mechanism may be of another precision than that in force
            mechanism.link_angles((0.0,) * len(mechanism.joints))
        return ()

    def torque(self, motion, mechanism):
        parts = ((self.moment1, self.lateral1), (self.moment2, self.lateral2))
        pull = tuple(
            moment * jnp.sin(angle) + lateral * jnp.cos(angle)
            for (moment, lateral), angle in zip(
                parts, mechanism.link_angles(motion.q), strict=False
            )
        )
        # Link i turns with every joint before it: joint j feels the links from j on.
        return tuple(sum(pull[joint:]) for joint in range(len(pull)))
