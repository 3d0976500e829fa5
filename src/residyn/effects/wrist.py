"""A flexible third joint: the hand beyond the wrist rings against link 2.

The arm's inertias count the hand as if it were rigid, so its inertia leaves the elbow's, and it
pushes back through the wrist's spring and damper. Written with the hand's own frequency and
damping ratio, that push is in proportion to its inertia: without a hand it is exactly absent.
"""

import math

import equinox as eqx
import jax.numpy as jnp

from ..physics.mechanism import ArmEffect, arm_of
from ..physics.motion import Scalar
from ..physics.parameter import ANGLE, FREQUENCY, INERTIA, RATE, RATIO, Memory, param


class WristFlexibility(ArmEffect):
    """A hand on a flexible wrist J3, its centre of mass on the wrist's axis.

    Its internal states are its deflection d against link 2 and its absolute rate; with w = 2 pi f,
    d'' = -w^2 d - 2 zeta w d' - (q1'' + q2'').
    """

    name = "wrist_flexibility"
    title = "Flexible wrist"
    equation = "-I3 (w^2 d + 2 zeta w d') at both joints, d the hand's deflection"
    looks_like = "a third frequency, mostly at the elbow"
    source = "paper, section 2.1 (J3, neglected there)"
    memory = (Memory("deflection", ANGLE), Memory("rate", RATE))
    own_modes = 1

    inertia: Scalar = param("inertia of the hand about the wrist", INERTIA, sign="positive")
    frequency: Scalar = param(
        "frequency of the hand alone, arm held",
        FREQUENCY,
        sign="positive",
        silent=None,
        default=5.0,
        grid=(0.4, 0.7, 1.1, 1.7, 2.5, 3.7, 5.5, 8.0),
    )
    damping_ratio: Scalar = param(
        "damping ratio of the hand alone",
        RATIO,
        sign="positive",
        silent=None,
        default=0.02,
    )

    def bodies(self, mechanism):
        arm = arm_of(mechanism, self.name)
        return eqx.tree_at(lambda arm: arm.elbow, arm, arm.elbow - self.inertia)

    def _push(self, motion) -> Scalar:
        deflection, rate = motion.memory
        w = 2.0 * math.pi * self.frequency
        damping = jnp.abs(self.damping_ratio * w)
        return w**2 * deflection + 2 * damping * (rate - sum(motion.v))

    def torque(self, motion, mechanism):
        push = -self.inertia * self._push(motion)
        return push, push

    def begin(self, motion, mechanism):
        return 0.0, sum(motion.v)

    def rate(self, motion, mechanism):
        return motion.memory[1] - sum(motion.v), -self._push(motion)
