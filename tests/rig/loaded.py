"""The arm with more on it than springs and dampers, as far as MuJoCo has the physics itself.

Hinges take polynomial springs and dampers. Fixed tendons, whose length is a sum of joint angles,
give springs that tie the joints together or are slack over a range. A hand on a third hinge gives a
flexible wrist.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .arm import Arm
from .engine import Array, Pair, Setting, document

Polynomial = tuple[float, float, float]
"""Coefficients of a hinge's torque: k0 q + k1 q^2 + k2 q^3, or c0 v + c1 v|v| + c2 v^3."""


@dataclass(frozen=True)
class Tendon:
    """A spring and damper on the length a q1 + b q2; the spring is slack over a range of it."""

    arms: Pair
    """a, b."""
    stiffness: float = 0.0
    damping: float = 0.0
    slack: Pair = (0.0, 0.0)

    def mjcf(self) -> str:
        low, high = (float(x) for x in self.slack)
        joints = "".join(
            f'<joint joint="{name}" coef="{float(arm)!r}"/>'
            for name, arm in zip(("shoulder", "elbow"), self.arms, strict=True)
            if arm
        )
        return (
            f'<fixed stiffness="{float(self.stiffness)!r}" damping="{float(self.damping)!r}" '
            f'springlength="{low!r} {high!r}">{joints}</fixed>'
        )


@dataclass(frozen=True)
class Hand:
    """A body beyond link 2 on a flexible hinge at its end, the wrist."""

    inertia: float
    """About the wrist, kg m^2."""
    stiffness: float
    """N m/rad."""
    damping: float
    """N m s/rad."""
    mass: float
    """kg; of no matter to the motion while the centre is on the axis."""
    offset: float = 0.0
    """Of the centre of mass from the wrist, along link 2, m."""


def first_moment(arm: Arm) -> float:
    """m1 rho1 + m2 l1, kg m: what gravity feels of link 1 and of what it carries."""
    (m1, rho1, _), (m2, _, _) = arm.bodies()
    return m1 * rho1 + m2 * arm.l1


@dataclass(frozen=True)
class LoadedArm:
    """An arm with whatever MuJoCo can hide in it."""

    arm: Arm
    """Inertias as they are, a hand counted as if rigid. Its springs and dampers do not act."""
    springs: tuple[Polynomial, Polynomial]
    dampers: tuple[Polynomial, Polynomial]
    tendons: tuple[Tendon, ...] = ()
    hand: Hand | None = None

    @property
    def joints(self) -> int:
        return 3 if self.hand else 2

    def without_hand(self) -> Arm:
        """The two links alone."""
        if not self.hand:
            return self.arm
        arm, hand = self.arm, self.hand
        swung = hand.inertia + hand.mass * arm.l2 * (arm.l2 + 2.0 * hand.offset)
        return replace(
            arm,
            shoulder=arm.shoulder - hand.mass * arm.l1**2,
            elbow=arm.elbow - swung,
            coupling=arm.coupling - hand.mass * (arm.l2 + hand.offset),
            link1_moment=first_moment(arm) - hand.mass * arm.l1,
        )

    def fastest(self, gravity: Pair = (0.0, 0.0)) -> float:
        """Estimated bound (rad/s) on how fast the arm rings in any pose; it sets the time step."""
        pull = [max(p[0], k) for p, k in zip(self.springs, self.arm.stiffness, strict=True)]
        pull = [k + sum(t.stiffness for t in self.tendons) for k in pull]
        rigid = replace(self.arm, stiffness=(pull[0], pull[1])).fastest(gravity)
        if not self.hand:
            return rigid
        links, hand = self.without_hand(), self.hand
        # On a free arm the hand rings faster than on a held one, by link 2's give.
        mobility = max(_wrist_mobility(links, q2) for q2 in (-self.arm.theta2, math.pi / 2, 0.0))
        alone = hand.inertia - hand.mass * hand.offset**2
        return math.hypot(rigid, math.sqrt(hand.stiffness * (1.0 / alone + mobility)))

    def mjcf(
        self,
        *,
        gravity: Pair = (0.0, 0.0),
        frictionloss: tuple[float, ...] = (0.0, 0.0),
        setting: Setting | None = None,
    ) -> str:
        """The MuJoCo model: in-plane gravity in m/s^2, Coulomb friction in N m."""
        links = self.without_hand()
        names, pose = ("shoulder", "elbow"), links.theta2
        parts = [
            _hinge(name, spring, damper, friction) + _inertial(*body)
            for name, spring, damper, friction, body in zip(
                names, self.springs, self.dampers, frictionloss, links.bodies(), strict=False
            )
        ]
        tip = ""
        if self.hand:
            hand, names = self.hand, (*names, "hand")
            own = hand.inertia - hand.mass * hand.offset**2
            hinge = _hinge("hand", (hand.stiffness, 0.0, 0.0), (hand.damping, 0.0, 0.0), 0.0)
            tip = f"{hinge}{_inertial(hand.mass, hand.offset, own)}"
            tip = f'<body pos="{float(links.l2)!r} 0 0">{tip}</body>'
        place = f'pos="{float(links.l1)!r} 0 0" euler="0 0 {float(pose)!r}"'
        world = f"<body>{parts[0]}<body {place}>{parts[1]}{tip}</body></body>"
        tendons = "".join(t.mjcf() for t in self.tendons)
        return document(world, names, gravity, setting, tendons)


def _wrist_mobility(links: Arm, q2: float) -> float:
    """How fast a unit torque turns link 2, per kg m^2."""
    both: Array = np.ones(2)
    return float(both @ np.linalg.solve(links.mass_matrix(q2), both))


def _hinge(name: str, spring: Polynomial, damper: Polynomial, friction: float) -> str:
    stiff, damp = (" ".join(repr(float(x)) for x in p) for p in (spring, damper))
    return (
        f'<joint name="{name}" type="hinge" axis="0 0 1" stiffness="{stiff}" damping="{damp}" '
        f'frictionloss="{float(friction)!r}"/>'
    )


def _inertial(mass: float, centre: float, inertia: float) -> str:
    mass, centre, inertia = float(mass), float(centre), float(inertia)
    return (
        f'<inertial pos="{centre!r} 0 0" mass="{mass!r}" '
        f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
    )
