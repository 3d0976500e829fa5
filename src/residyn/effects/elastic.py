"""Torques that follow the angle: the spring of Eq. 4, and the ways in which a spring is not one.

All of them derive from a potential, but for the drift: they move frequencies, not energy. What
tells them apart is how the frequency changes: with amplitude, with the sign of the angle, with
time, or by tying the joints to each other.
"""

import jax.numpy as jnp

from ..physics.effect import AbstractEffect, JointEffect, neighbours
from ..physics.motion import Scalar
from ..physics.parameter import ANGLE, CUBIC, STIFFNESS, STIFFNESS_RATE, param


class Spring(JointEffect):
    """Equivalent stiffness of a braked joint, Eq. 4 (Eq. 24: gearbox and brake in series)."""

    name = "spring"
    title = "Spring"
    equation = "k q"
    looks_like = "the ringing itself: sets the frequencies"
    source = "paper, Eq. 4 and 24"

    stiffness: Scalar = param("joint stiffness", STIFFNESS, sign="positive")

    def joint_torque(self, motion):
        return self.stiffness * motion.q


class CubicStiffness(JointEffect):
    """A spring that stiffens with deflection, as gearboxes do, or softens if negative."""

    name = "cubic_stiffness"
    title = "Cubic stiffness"
    family = "spring shape"
    equation = "k3 q^3"
    looks_like = "frequency changes with amplitude, and settles as the swing dies away"
    source = "Duffing 1918; Nayfeh and Mook, Nonlinear Oscillations, 1979, ch. 2"

    coefficient: Scalar = param("cubic stiffness", CUBIC)

    def joint_torque(self, motion):
        return self.coefficient * motion.q**3


class AsymmetricStiffness(JointEffect):
    """A spring that is stiffer to one side: k + s where q > 0, k - s where q < 0."""

    name = "asymmetric_stiffness"
    title = "Asymmetric stiffness"
    family = "spring shape"
    equation = "s |q|"
    looks_like = "swings wider and longer to one side, at every amplitude"
    source = "bilinear oscillator: Shaw and Holmes, J. Sound Vib. 90, 1983"
    rough = True

    stiffness: Scalar = param("half the difference of the two sides' stiffness", STIFFNESS)

    def joint_torque(self, motion):
        return self.stiffness * (2.0 * motion.beyond(0.0) - motion.q)


class DeadZone(JointEffect):
    """Backlash: inside a gap of half-width g the spring, or a part s of it, does not act.

    It stands beside the spring and takes s of its stiffness away inside the gap; s = k is a joint
    that is loose there.
    """

    name = "dead_zone"
    title = "Dead zone (backlash)"
    family = "spring shape"
    equation = "-s clip(q, -g, g)"
    looks_like = "frequency falls as the swing becomes as small as the gap"
    source = "Nordin and Gutman, Automatica 38, 2002 (backlash as a dead zone)"
    rough = True

    stiffness: Scalar = param(
        "stiffness lost inside the gap", STIFFNESS, sign="positive", as_spring=True
    )
    gap: Scalar = param(
        "half-width of the gap",
        ANGLE,
        sign="positive",
        silent=None,
        default=0.02,
        grid=(0.1, 0.3, 0.9),
    )

    def joint_torque(self, motion):
        gap = jnp.abs(self.gap)
        # clip(q, -g, g)
        return -self.stiffness * (motion.beyond(-gap) - motion.beyond(gap) - gap)


class StiffnessDrift(JointEffect):
    """A spring that changes slowly, as a brake or gearbox does when it warms up."""

    name = "stiffness_drift"
    title = "Stiffness drift"
    equation = "r t q, t from the recording's first sample"
    looks_like = "frequency changes with time, whatever the amplitude"
    source = "linear in time, the first term of any slow change"

    rate_of_change: Scalar = param("change of stiffness per second", STIFFNESS_RATE, name="rate")

    def joint_torque(self, motion):
        return self.rate_of_change * motion.t * motion.q


class CouplingStiffness(AbstractEffect):
    """A spring between neighbouring joints (a cable, a belt), off the stiffness diagonal."""

    name = "coupling_stiffness"
    title = "Stiffness between joints"
    equation = "k12 q2 at joint 1, k12 q1 at joint 2"
    looks_like = "mode shapes off: one joint's deflection pushes the other"
    source = "linear theory: a full symmetric stiffness matrix"

    stiffness: Scalar = param("stiffness between neighbouring joints", STIFFNESS)

    @classmethod
    def places(cls, mechanism):
        neighbours(cls.name, mechanism)
        return ()

    def torque(self, motion, mechanism):
        return tuple(self.stiffness * q for q in neighbours(self.name, mechanism, motion.q))
