"""What an effect is: everything in f^k of Eq. 1.

`Z(q) q'' + f^w(q, q') + sum of effect torques = drive torque`. An effect gives one torque of that
sum, positive where it resists a positive angle or rate, so that a spring is `+k q`. The paper's
spring and damper are just the first two. To write one, subclass `JointEffect` (one joint) or
`AbstractEffect` (the whole mechanism), declare each number with `param`, and add the class to the
catalogue; CONTRIBUTING shows one.
"""

import abc
import dataclasses
from typing import ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .inertia import AbstractInertia
from .motion import JointMotion, Joints, Motion, Scalar
from .parameter import Memory, Parameter, parameters_of

BASE = "spring", "damper"
"""Names of the effects that every model has, at every joint (Eq. 4)."""


class AbstractEffect(eqx.Module):
    """A physical effect. Its numbers are declared with `residyn.param`; its words sit on the class.

    - `name`: what users call it.
    - `title`: its name in words, wherever people read ("Coulomb friction"); `name` if empty.
    - `family`: laws of one kind have one ("dry friction"); the title if empty.
    - `equation`, `looks_like`, `source`: one line each, for the catalogue.
    - `dissipates`: True if its power `torque . v` is never negative while its numbers have the sign
      that physics allows.
    - `dry`: True if its torque jumps where `motion.direction` does; the integrator then locates
      reversals and lets joints stick.
    - `rough`: True if its torque has corners, which ask for the short step of dry friction.
    - `memory`: its internal states, if it has any; it finds them in `motion.memory`.
    - `own_modes`: how many modes these add to the joints', as a body on a spring of its own does.
    - `follows`: True if `follow` does something.
    - `grips`: True if `crawls`, `holds`, `lost_speed` and `speed_spread` do something.
    - `senses`: True if it acts on the readings instead of the motion.
    - `of_angles`: True if its numbers mean something for readings of angles only.
    - `oscillates`: the field that holds a frequency of its own, which a fit starts from a spectrum.
    - `extends`: the effect that it is with its further numbers silent, if it is another one's law
      with more to it.
    - `of_load`: in proportion to the load that a recording states; where all state the same one, it
      cannot be told from Coulomb friction.
    - `of_frequency`: True if at one frequency it is a spring and a damper, so that it takes two
      joints, or two loads (`extra_mass`), to tell it from these.
    - `of_one_size`: True if one unknown scales all its strengths alike, as a tilt does gravity's.
    - `of_bearings`: True if it leaves with the air bearings (step 3 of the paper); None: not known,
      which step 3 then asks.
    """

    name: ClassVar[str]
    title: ClassVar[str] = ""
    family: ClassVar[str] = ""
    equation: ClassVar[str] = ""
    looks_like: ClassVar[str] = ""
    source: ClassVar[str] = ""
    dissipates: ClassVar[bool] = False
    dry: ClassVar[bool] = False
    rough: ClassVar[bool] = False
    memory: ClassVar[tuple[Memory, ...]] = ()
    own_modes: ClassVar[int] = 0
    follows: ClassVar[bool] = False
    grips: ClassVar[bool] = False
    senses: ClassVar[bool] = False
    of_angles: ClassVar[bool] = False
    oscillates: ClassVar[str | None] = None
    extends: ClassVar[str | None] = None
    of_load: ClassVar[bool] = False
    of_frequency: ClassVar[bool] = False
    of_one_size: ClassVar[bool] = False
    of_bearings: ClassVar[bool | None] = False

    @classmethod
    def places(cls, mechanism: AbstractInertia) -> tuple[str, ...]:
        """Where it can act, as in `name:place`; empty if it concerns the whole mechanism.

        **Raises:** `ValueError` if it makes no sense on this mechanism.
        """
        return ()

    @property
    def label(self) -> str:
        """`name`, or `name:place`."""
        return self.name

    @classmethod
    def titled(cls) -> str:
        """`title`, or the name without underscores."""
        return cls.title or cls.name.replace("_", " ").capitalize()

    @classmethod
    def kind(cls) -> str:
        """`family`, or the title."""
        return cls.family or cls.titled().lower()

    @property
    def place(self) -> str | None:
        """Where it acts; None for the whole mechanism."""
        return self.label.partition(":")[2] or None

    def bodies(self, mechanism: AbstractInertia) -> AbstractInertia:
        """The mechanism as this effect changes it; most do not."""
        return mechanism

    @abc.abstractmethod
    def torque(self, motion: Motion, mechanism: AbstractInertia) -> Joints:
        """Its torque on every joint, N m (or N), in the sense of Eq. 1's left side."""

    def upright(self, memory: Joints) -> tuple[Self, Joints]:
        """The same effect with its numbers of the sign that people write: a fit may find a positive
        shape number's mirror image, which every law must take for the same."""
        mirrored = {name: jnp.abs(getattr(self, name)) for name in self._shapes()}
        return dataclasses.replace(self, **mirrored), memory

    @property
    def mirrors(self) -> bool:
        """Whether `upright` could do anything."""
        return bool(self._shapes()) or type(self).upright is not AbstractEffect.upright

    def _shapes(self) -> list[str]:
        """Fields of its numbers that are positive and are no strengths."""
        return [p.field for p in parameters_of(self) if p.silent is None and p.sign == "positive"]

    # -- memory ------------------------------------------------------------------------------

    def begin(self, motion: Motion, mechanism: AbstractInertia) -> tuple[Scalar, ...]:
        """Its internal states at the first instant, where nothing better is known."""
        return (0.0,) * len(self.memory)

    def rate(self, motion: Motion, mechanism: AbstractInertia) -> tuple[Scalar, ...]:
        """d/dt of its internal states."""
        return (0.0,) * len(self.memory)

    def follow(self, motion: Motion, mechanism: AbstractInertia) -> tuple[Scalar, ...]:
        """Its internal states after a step that ended in `motion`, for a memory that jumps along
        with the motion instead of having a rate."""
        return motion.memory

    # -- dry friction ------------------------------------------------------------------------

    def jumps(self, motion: Motion, mechanism: AbstractInertia) -> tuple[Scalar | None, ...]:
        """Of a dry effect, for each joint, half the jump of its torque where the joint's direction
        flips, N m; None where there is none."""
        now = motion.direction

        def torque(joint: int, way: float) -> Scalar:
            turned = motion._replace(direction=(*now[:joint], way, *now[joint + 1 :]))
            return self.torque(turned, mechanism)[joint]

        return tuple(0.5 * (torque(j, 1.0) - torque(j, -1.0)) for j in range(len(now)))

    def lost_speed(self, motion: Motion, mechanism: AbstractInertia) -> Scalar:
        """Speed, m/s, that friction of a point takes from it in one `motion.grain`; below it the
        friction is smoothed. For effects that grip."""
        return 0.0

    def speed_spread(self, spread: Joints, mechanism: AbstractInertia) -> Scalar:
        """Standard deviation of that point's speed, m/s, where those of the joints' rates are
        these."""
        return 0.0

    def crawls(self, motion: Motion, mechanism: AbstractInertia) -> Scalar:
        """True where `holds` may return 1: where everything is all but at rest."""
        return False

    def holds(
        self, load: Joints, joints: Joints, motion: Motion, mechanism: AbstractInertia
    ) -> Scalar:
        """1 if, as slow as it is in `motion`, its friction brings everything to rest and holds it
        under this load, N m; else 0. Friction of each joint's own may take up to `joints`, N m, of
        the load, either way."""
        return 0.0

    # -- readings ----------------------------------------------------------------------------

    def reading(self, angles: tuple[Array, ...], mechanism: AbstractInertia) -> tuple[Array, ...]:
        """What the sensors say where the angles are these: one array per joint, rad or m."""
        return angles

    def delays(self, mechanism: AbstractInertia) -> Joints:
        """How late each joint's reading is, s."""
        return (0.0,) * len(mechanism.joints)


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

    def joint_rate(self, motion: JointMotion) -> tuple[Scalar, ...]:
        """d/dt of its internal states, given the motion of its joint alone."""
        return (0.0,) * len(self.memory)

    def joint_follow(self, motion: JointMotion) -> tuple[Scalar, ...]:
        """Its internal states after a step, given the motion of its joint alone."""
        return motion.memory

    def torque(self, motion, mechanism):
        own = mechanism.joints.index(self.joint)
        torque = self.joint_torque(motion.of(own))
        return tuple(torque if i == own else 0.0 for i in range(len(mechanism.joints)))

    def jumps(self, motion, mechanism):
        own = mechanism.joints.index(self.joint)
        here = motion.of(own)
        up, down = (self.joint_torque(here._replace(direction=s)) for s in (1.0, -1.0))
        return tuple(0.5 * (up - down) if i == own else None for i in range(len(motion.q)))

    def rate(self, motion, mechanism):
        return self.joint_rate(motion.of(mechanism.joints.index(self.joint)))

    def follow(self, motion, mechanism):
        return self.joint_follow(motion.of(mechanism.joints.index(self.joint)))


def joint_of(label: str, number: Parameter, joints: tuple[str, ...]) -> int | None:
    """Which of the joints a number of an effect with this label is of; None: of no one joint."""
    place = label.partition(":")[2]
    if number.joint is not None:
        return number.joint if number.joint < len(joints) else None
    return joints.index(place) if place in joints else None


def unit_of(label: str, number: Parameter, mechanism: AbstractInertia) -> str:
    """The unit of a number of an effect with this label."""
    units, joint = mechanism.units or (), joint_of(label, number, mechanism.joints)
    return number.dimension.unit(*(units if joint is None else units[joint : joint + 1]))


def neighbours(name: str, mechanism: AbstractInertia, x: Joints | None = None) -> Joints:
    """For each joint the sum of `x` at the joints next to it.

    **Raises:** `ValueError` if there is but one joint.
    """
    n = len(mechanism.joints)
    if n < 2:
        raise ValueError(f"{name} is about two joints; this experiment has one")
    values = (0.0,) * n if x is None else x
    return tuple(sum(values[j] for j in (i - 1, i + 1) if 0 <= j < n) for i in range(n))
