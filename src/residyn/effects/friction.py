"""Dry friction: a torque that knows which way the joint slides.

Its size does not fall with the rate, so it takes the same bite out of the amplitude every cycle
(4 F/k for a spring) and at last holds the joint still, off centre. The jump at rest is kept sharp:
the laws here use `motion.direction`, and the integrator finds the instants where it changes.
"""

import jax.numpy as jnp

from ..physics.effect import JointEffect
from ..physics.motion import Scalar
from ..physics.parameter import ANGLE, RATE, RATIO, TORQUE, Dimension, Memory, param

# Coefficient of friction, times the radius at which it rubs where the joint turns.
GRIP = Dimension("m", "1", lambda s: 1.0)


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


class DahlFriction(JointEffect):
    """Dry friction that gives a little before it slides: the contact's asperities bend first.

    z, the friction torque over its level, follows the angle: over a way x in one direction it goes
    to +1 or -1 as 1 - exp(-|x|/y), so dz/dq = (sign(q') - z) / y. With y = 0 it is Coulomb's.
    Its internal states are z and the angle at which it was that.
    """

    name = "dahl_friction"
    title = "Dahl friction (presliding)"
    family = "dry friction"
    equation = "F z, dz/dq = (sign(q') - z) / y"
    looks_like = "as Coulomb friction while it swings; the last swings ring on and come to rest"
    source = "Dahl 1968; Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994"
    rough = True
    follows = True
    memory = (Memory("z", RATIO), Memory("angle", ANGLE))

    level: Scalar = param("friction torque", TORQUE, sign="positive", name="torque")
    way: Scalar = param(
        "deflection over which it builds up",
        ANGLE,
        sign="positive",
        silent=None,
        default=0.02,
        grid=(0.1, 0.3),
    )

    def begin(self, motion, mechanism):
        # Where a slow pull from rest to the first angle leaves it.
        q = motion.q[mechanism.joints.index(self.joint)]
        return self._moved(0.0, 0.0, q), q

    def _moved(self, z, start, end):
        """z after the joint has gone from one angle to another without turning round."""
        way = end - start
        to = jnp.sign(way)
        return to + (z - to) * jnp.exp(-jnp.abs(way / self.way))

    def _now(self, motion):
        # First as far as the joint went before it turned round, then to where it is now.
        z, start = motion.memory
        return self._moved(self._moved(z, start, motion.turn), motion.turn, motion.q)

    def joint_torque(self, motion):
        return self.level * self._now(motion)

    def joint_follow(self, motion):
        return self._now(motion), motion.q


class LoadFriction(JointEffect):
    """Coulomb friction in proportion to a load, which the recordings state.

    One coefficient serves all recordings, whatever presses each. At a joint that turns it is the
    coefficient of friction times the radius at which it rubs.
    """

    name = "load_friction"
    title = "Friction in proportion to the load"
    family = "dry friction"
    equation = "mu N sign(q'), N the recording's load"
    looks_like = "as Coulomb friction, and more of it under more load"
    source = "Amontons 1699; Coulomb 1785"
    dissipates = True
    dry = True
    of_load = True

    coefficient: Scalar = param("coefficient of friction", GRIP, sign="positive")

    @classmethod
    def places(cls, mechanism):
        # In Python: the mechanism may be of another precision than that in force.
        if not float(getattr(mechanism, "load", 0.0)) > 0:
            raise ValueError(
                f"{cls.name} is about what presses a joint; no recording states a load (load, N)"
            )
        return mechanism.joints

    def joint_torque(self, motion):
        """Under a load of 1 N."""
        return self.coefficient * motion.direction

    def torque(self, motion, mechanism):
        return tuple(mechanism.load * x for x in super().torque(motion, mechanism))

    def jumps(self, motion, mechanism):
        each = super().jumps(motion, mechanism)
        return tuple(None if x is None else mechanism.load * x for x in each)
