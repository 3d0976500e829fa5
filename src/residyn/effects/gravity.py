"""Gravity in the plane of motion: a tilted table or, at 90 degrees, a pendulum."""

import math

import jax
import jax.numpy as jnp
from jax.core import Tracer

from ..physics.effect import AbstractEffect
from ..physics.inertia import AbstractInertia
from ..physics.motion import Joints, Scalar
from ..physics.parameter import MOMENT, TORQUE, param

# A hanging link's angle from the vertical, rad, up to rounding of what users write for pi.
HANGING = 1e-4


class _Weight(AbstractEffect):
    """Gravity on the links of an arm."""

    family = "gravity"

    moment1: Scalar = param(
        "pull of link 1 (and what it carries) towards 0", MOMENT, joint=0, as_spring=True
    )
    moment2: Scalar = param("pull of link 2 towards 0", MOMENT, joint=1, as_spring=True)


class Pendulum(_Weight):
    """Gravity on links that hang straight down at rest, in the sine of their absolute angles.

    With phi_1 = q1 and phi_2 = q1 + theta_2 + q2, link i pulls with `M_i sin(phi_i)` on every joint
    that carries it: M_1 = (m1 rho1 + m2 l1) g and M_2 = m2 rho2 g. What hangs, or stands, at rest
    is in line with gravity, so that theta_2 is 0 (or pi); else it is `gravity`.
    """

    name = "pendulum"
    title = "Gravity of a pendulum"
    equation = "sum of M_i sin(phi_i), phi_i the links' absolute angles"
    looks_like = "frequency falls with amplitude, alike to both sides"
    source = "Lagrange, with V = sum of -M_i cos(phi_i)"

    @classmethod
    def places(cls, mechanism):
        for joint, angle in zip(mechanism.joints, _at_rest(mechanism, cls.name), strict=False):
            if not isinstance(angle, Tracer) and abs(math.sin(angle)) > HANGING:
                raise ValueError(
                    f"a pendulum hangs straight down at rest, and the link at {joint} is at "
                    f"{float(angle):.4g} rad then; name gravity"
                )
        return ()

    def torque(self, motion, mechanism):
        links = zip((self.moment1, self.moment2), mechanism.link_angles(motion.q), strict=False)
        return _carried(tuple(m * jnp.sin(x) for m, x in links))


class Gravity(_Weight):
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
    extends = "pendulum"
    of_one_size = True

    lateral1: Scalar = param("pull of link 1 across", TORQUE, joint=0)
    lateral2: Scalar = param("pull of link 2 across", TORQUE, joint=1)

    @classmethod
    def places(cls, mechanism):
        _at_rest(mechanism, cls.name)
        return ()

    def torque(self, motion, mechanism):
        moments, laterals = (self.moment1, self.moment2), (self.lateral1, self.lateral2)
        links = zip(moments, laterals, mechanism.link_angles(motion.q), strict=False)
        return _carried(tuple(m * jnp.sin(x) + lat * jnp.cos(x) for m, lat, x in links))


def _carried(pull: Joints) -> Joints:
    """Torque on each joint: link i turns with every joint before it, so joint j feels the links
    from j on."""
    return tuple(sum(pull[joint:]) for joint in range(len(pull)))


def _at_rest(mechanism: AbstractInertia, name: str) -> Joints:
    """The links' absolute angles where the joints are at 0.

    **Raises:** `ValueError` where a joint slides, or the links' directions are not known.
    """
    sliding = [j for j, u in zip(mechanism.joints, mechanism.units or (), strict=False) if u == "m"]
    if sliding:
        raise ValueError(
            f"{name} acts with the sine of an angle, and {sliding[0]} slides (m): what pulls "
            f"it down a slope is constant_torque:{sliding[0]}"
        )
    with jax.enable_x64(True):  # the mechanism may be of another precision than that in force
        return mechanism.link_angles((0.0,) * len(mechanism.joints))
