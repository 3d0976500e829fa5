"""Errors of the inertia side: Eq. 3 as printed, and inertias that are off by some share."""

import equinox as eqx
import jax.numpy as jnp

from ..physics.effect import AbstractEffect
from ..physics.mechanism import ArmEffect, arm_of
from ..physics.motion import Scalar
from ..physics.parameter import RATIO, param


class PrintedInertiaTorque(ArmEffect):
    """Eq. 3 as printed, minus the energy-conserving form: turns the one into the other.

    The printed f^w = [l1 h (q2'^2 - q1'^2) sin th, -l1 h q1'^2 sin th] has the opposite sign and
    does not conserve energy. It is kept to show that, and has nothing to fit.
    """

    name = "printed_inertia_torque"
    title = "Inertia torque as printed (Eq. 3)"
    equation = "f^w as printed in Eq. 3 - energy-conserving f^w"
    looks_like = "large swings that gain or lose energy for no reason; nothing at small ones"
    source = "paper, Eq. 3"

    share: Scalar = param("share of the printed form", RATIO, default=1.0, silent=0.0, fitted=False)

    def torque(self, motion, mechanism):
        arm, v = arm_of(mechanism, self.name), motion.v
        s = arm.link_lengths[0] * arm.coupling * jnp.sin(arm.theta2 + motion.q[1])
        printed = s * (v[1] ** 2 - v[0] ** 2), -s * v[0] ** 2
        conserving = mechanism.inertia_torque(motion.q, v)
        return tuple(self.share * (p - c) for p, c in zip(printed, conserving, strict=True))


class InertiaError(AbstractEffect):
    """One of the arm's three inertias is off by a share: the true one is the given one times
    (1 + share). A share of 0.3: it is 30 % larger than given.
    """

    name = "inertia_error"
    title = "Inertia error"
    equation = "Z(q) with shoulder, elbow or coupling times (1 + share)"
    looks_like = "modes and mode shapes off together; free motion shows only ratios (Eq. 9)"
    source = "paper, Eq. 9 and section 2.2"

    part: str = eqx.field(static=True)
    share: Scalar = param("error of the given inertia, as a share of it", RATIO)

    @classmethod
    def places(cls, mechanism):
        arm_of(mechanism, cls.name)
        return ("shoulder", "elbow", "coupling")

    @property
    def label(self):
        return f"{self.name}:{self.part}"

    def bodies(self, mechanism):
        return eqx.tree_at(
            lambda arm: getattr(arm, self.part),
            mechanism,
            getattr(mechanism, self.part) * (1.0 + self.share),
        )

    def torque(self, motion, mechanism):
        return (0.0,) * len(mechanism.joints)
