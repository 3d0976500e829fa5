"""What an effect is: everything in f^k of Eq. 1.

`Z(q) q'' + f^w(q, q') + sum of effect torques = drive torque`. An effect gives one torque of that
sum, positive where it resists a positive angle or rate, so that a spring is `+k q`. The paper's
spring and damper are just the first two. To write one, subclass `JointEffect` (one joint) or
`AbstractEffect` (the whole mechanism), declare each number with `param`, and add the class to the
catalogue; CONTRIBUTING shows one.
"""

import abc
from typing import ClassVar

import equinox as eqx

from ..mechanism import AbstractMechanism
from ..motion import JointMotion, Joints, Motion, Scalar


class AbstractEffect(eqx.Module):
    """A physical effect. Its numbers are declared with `residyn.param`; its words sit on the class.

    - `name`: what users call it.
    - `equation`, `looks_like`, `source`: one line each, for the catalogue.
    - `dissipates`: True if its power `torque . v` is never negative while its numbers have the sign
      that physics allows.
    - `dry`: True if its torque jumps where `motion.direction` does; the integrator then locates
      reversals and lets joints stick.
    - `of_bearings`: True if it leaves with the air bearings (step 3 of the paper).
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    looks_like: ClassVar[str]
    source: ClassVar[str]
    dissipates: ClassVar[bool] = False
    dry: ClassVar[bool] = False
    of_bearings: ClassVar[bool] = False

    @classmethod
    def places(cls, mechanism: AbstractMechanism) -> tuple[str, ...]:
        """Where it can act, as in `name:place`; empty if it concerns the whole mechanism.

        **Raises:** `ValueError` if it makes no sense on this mechanism.
        """
        return ()

    @property
    def label(self) -> str:
        """`name`, or `name:place`."""
        return self.name

    def bodies(self, mechanism: AbstractMechanism) -> AbstractMechanism:
        """The mechanism as this effect changes it; most do not."""
        return mechanism

    @abc.abstractmethod
    def torque(self, motion: Motion, mechanism: AbstractMechanism) -> Joints:
        """Its torque on every joint, N m (or N), in the sense of Eq. 1's left side."""


class JointEffect(AbstractEffect):
    """An effect at one joint, whose torque depends on that joint's own motion."""

    joint: str = eqx.field(static=True)

    @classmethod
    def places(cls, mechanism):
        return mechanism.joints

    @property
    def label(self):
        return f"{self.name}:{self.joint}"

    @abc.abstractmethod
    def joint_torque(self, motion: JointMotion) -> Scalar:
        """Its torque, given the motion of its joint alone (every entry of `motion` a scalar)."""

    def torque(self, motion, mechanism):
        own = mechanism.joints.index(self.joint)
        torque = self.joint_torque(motion.of(own))
        return tuple(torque if i == own else 0.0 for i in range(len(mechanism.joints)))
