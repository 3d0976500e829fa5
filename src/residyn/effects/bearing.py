"""What the air bearings do beside carrying: drag and friction in the plane of the table.

Each bearing is a point of the arm that slides over the table with a velocity u; a force against u
acts on the joints through the point's Jacobian J, as J' F. One coefficient serves all bearings, and
leaves with them. Drag of the elbow bearing alone is exactly a damper at the shoulder; only the
wrist bearing's part, which ties the joints together and turns with the elbow, can be seen apart.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ..physics.effect import AbstractEffect
from ..physics.inertia import AbstractInertia
from ..physics.mechanism import arm_of
from ..physics.motion import Joints, Motion, Scalar
from ..physics.parameter import FORCE, POINT_DAMPING, POINT_QUADRATIC, param


class _Slip(NamedTuple):
    """How the bearings at one point slide: how many, |u| squared, and J'u."""

    bearings: Scalar
    square: Scalar
    generalised: Joints


def _slips(motion: Motion, mechanism: AbstractInertia) -> tuple[_Slip, _Slip]:
    """At the elbow and at the wrist."""
    arm = arm_of(mechanism, "a bearing")
    l1, l2 = arm.link_lengths[0], arm.link_lengths[1]
    first, whole = motion.v[0], motion.v[0] + motion.v[1]
    cross = l1 * l2 * jnp.cos(arm.theta2 + motion.q[1])
    inner, outer = l1**2 * first + cross * whole, l2**2 * whole + cross * first
    return (
        _Slip(arm.bearings[0], l1**2 * first**2, (l1**2 * first, 0.0)),
        _Slip(arm.bearings[1], first * inner + whole * outer, (inner + outer, outer)),
    )


class _BearingEffect(AbstractEffect):
    """A force against the sliding of every bearing."""

    of_bearings = True

    @classmethod
    def places(cls, mechanism):
        # In Python: the arm may be of another precision than that in force.
        if not sum(arm_of(mechanism, cls.name).bearings.tolist()) > 0:
            raise ValueError(f"{cls.name} is about air bearings; here is no [[air_bearings]]")
        return ()


class BearingDrag(_BearingEffect):
    """Viscous drag of the air film, in proportion to each bearing's velocity in the plane."""

    name = "bearing_drag"
    title = "Drag of the air bearings"
    family = "damping law"
    equation = "sum over bearings of J' d u"
    looks_like = "as joint dampers, but its share of each mode turns with the elbow angle"
    source = "paper, section 4 (left open there); Newtonian shear of the air film"
    dissipates = True

    coefficient: Scalar = param("drag of one bearing", POINT_DAMPING, sign="positive")

    def torque(self, motion, mechanism):
        return _sum(
            tuple(s.bearings * self.coefficient * g for g in s.generalised)
            for s in _slips(motion, mechanism)
        )


class BearingQuadraticDrag(_BearingEffect):
    """Drag in proportion to the square of each bearing's speed: of hoses, cables, moving air."""

    name = "bearing_quadratic_drag"
    title = "Quadratic drag of the air bearings"
    family = "damping law"
    equation = "sum over bearings of J' c |u| u"
    looks_like = "large swings fall quickly, small ones hardly, both joints together"
    source = "Rayleigh, Theory of Sound, 1877"
    dissipates = True

    coefficient: Scalar = param("quadratic drag of one bearing", POINT_QUADRATIC, sign="positive")

    def torque(self, motion, mechanism):
        return _sum(
            tuple(s.bearings * self.coefficient * _root(s.square) * g for g in s.generalised)
            for s in _slips(motion, mechanism)
        )


class BearingFriction(_BearingEffect):
    """Coulomb friction against each bearing's sliding in the plane: dust, a scratched table.

    At the elbow the sliding is the shoulder's own, and the friction as sharp as a joint's. At the
    wrist it turns in the plane and hardly ever stops but at the end; its direction is smoothed
    below the speed that friction takes away in one `grain` of the integrator, and where it can
    hold the whole arm that slow, it does.
    """

    name = "bearing_friction"
    title = "Friction of the air bearings"
    family = "dry friction"
    equation = "sum over bearings of J' f u/|u|"
    looks_like = "amplitude falls by the same amount every cycle, both joints; they stop together"
    source = "Coulomb 1785, for a point that slides in a plane"
    dissipates = True
    dry = True
    grips = True

    force: Scalar = param("friction force of one bearing", FORCE, sign="positive")

    def jumps(self, motion, mechanism):
        arm = arm_of(mechanism, self.name)
        return arm.bearings[0] * self.force * arm.link_lengths[0], None

    def torque(self, motion, mechanism):
        _, wrist = _slips(motion, mechanism)
        at_elbow = self.jumps(motion, mechanism)[0] * motion.direction[0]
        slow = self.lost_speed(motion, mechanism) ** 2
        speed = _root(wrist.square + slow)
        safe = jnp.where(speed > 0, speed, 1.0)
        # Where it neither slides nor has a grain (a linearisation at rest), it has no slope. The
        # second term makes the smoothing's loss at higher speeds fall with their fourth power.
        smooth = (1.0 + 0.5 * slow / safe**2) / safe
        at_wrist = jnp.where(speed > 0, wrist.bearings * self.force * smooth, 0.0)
        return at_elbow + at_wrist * wrist.generalised[0], at_wrist * wrist.generalised[1]

    def lost_speed(self, motion, mechanism):
        """Speed, m/s, that friction takes from the wrist in one grain of the integrator's time."""
        arm = arm_of(mechanism, self.name)
        # In the pose of rest, which is near enough and the same for all steps.
        (l1, l2), cos = arm.link_lengths, jnp.cos(arm.theta2)
        (a, b), (_, c) = arm.mass_matrix((0.0, 0.0))
        # Trace of J Z^-1 J', the wrist's inverse mass; J = (l1 n1 + l2 n2, l2 n2).
        both, tip, mixed = l1**2 + l2**2 + 2 * l1 * l2 * cos, l2**2, l2**2 + l1 * l2 * cos
        light = (both * c - 2 * mixed * b + tip * a) / (a * c - b * b)
        return motion.grain * arm.bearings[1] * jnp.abs(self.force) * light

    def speed_spread(self, spread, mechanism):
        l1, l2 = arm_of(mechanism, self.name).link_lengths
        return jnp.sqrt((l1 * spread[0]) ** 2 + (l2 * (spread[0] + spread[1])) ** 2)

    def crawls(self, motion, mechanism):
        _, wrist = _slips(motion, mechanism)
        return wrist.square <= self.lost_speed(motion, mechanism) ** 2

    def holds(self, load, joints, motion, mechanism):
        arm, (_, wrist) = arm_of(mechanism, self.name), _slips(motion, mechanism)
        (l1, l2), angle = arm.link_lengths, arm.theta2 + motion.q[1]
        sin, cos, limit = jnp.sin(angle), jnp.cos(angle), wrist.bearings * self.force
        # The force F at the wrist with J'F = load; along the two links' normals n1, n2 it is
        # F.n2 = load2 / l2 and F.n1 = (load1 - load2) / l1, less what the joints take: the elbow as
        # much as it can, the shoulder what leaves the smallest F. An arm stretched out can take
        # nothing else: there F.n1 is F.n2.
        at_elbow = load[1] - jnp.clip(load[1], -joints[1], joints[1])
        y, x = at_elbow / l2, (load[0] - at_elbow) / l1
        x = jnp.clip(y * cos, x - joints[0] / l1, x + joints[0] / l1)
        needed = x**2 + y**2 - 2 * x * y * cos
        slow = self.crawls(motion, mechanism)
        return jnp.where(slow & (limit > 0) & (needed <= (limit * sin) ** 2), 1.0, 0.0)


def _root(x: Scalar) -> Scalar:
    """Square root with a finite slope at 0."""
    x = jnp.maximum(x, 0.0)
    return jnp.where(x > 0, jnp.sqrt(jnp.where(x > 0, x, 1.0)), 0.0)


def _sum(parts) -> Joints:
    return tuple(a + b for a, b in zip(*parts, strict=True))
