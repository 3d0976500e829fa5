"""Torques from outside: they do not care how the arm moves."""

import dataclasses
import math

import jax.numpy as jnp

from ..physics.effect import JointEffect
from ..physics.motion import Scalar
from ..physics.parameter import FREQUENCY, TORQUE, Dimension, Memory, param


class ConstantTorque(JointEffect):
    """A constant pull: a cable's, a spring's whose rest is elsewhere."""

    name = "constant_torque"
    title = "Constant torque"
    family = "offset"
    equation = "T"
    looks_like = "rings about a shifted rest, from the first cycle to the last"
    source = "Lagrange, with V = T q"

    level: Scalar = param("torque", TORQUE, name="torque")

    def joint_torque(self, motion):
        # In the shape of the motion, whatever that is.
        return self.level + 0.0 * motion.q


class PeriodicDisturbance(JointEffect):
    """A sinusoidal torque: a pump, a fan, an unbalanced disc, a swaying building.

    Its phase is each recording's own.
    """

    name = "periodic_disturbance"
    title = "Periodic disturbance"
    equation = "A sin(2 pi f t + phase)"
    looks_like = "a ringing that never dies, at a frequency that need not be a mode's"
    source = "forced vibration: den Hartog, Mechanical Vibrations, 1934"
    oscillates = "frequency"
    memory = (Memory("phase", Dimension("rad", "rad", lambda s: 3.0)),)

    level: Scalar = param("amplitude of the torque", TORQUE, sign="positive", name="torque")
    frequency: Scalar = param(
        "its frequency", FREQUENCY, sign="positive", silent=None, default=1.0, grid=(1.0,)
    )

    def upright(self, memory):
        turned = jnp.where(self.level < 0, memory[0] + math.pi, memory[0])
        # sin(-x + phase) = sin(x + pi - phase)
        phase = jnp.where(self.frequency < 0, math.pi - turned, turned)
        level, frequency = jnp.abs(self.level), jnp.abs(self.frequency)
        upright = dataclasses.replace(self, level=level, frequency=frequency)
        return upright, (jnp.remainder(phase, 2 * math.pi),)

    def joint_torque(self, motion):
        return self.level * jnp.sin(motion.memory[0])

    def joint_rate(self, motion):
        return (2.0 * math.pi * self.frequency,)
