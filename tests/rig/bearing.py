"""Forces of the air bearings, points of the arm that slide over the table.

A bearing at the elbow joint or at the wrist, the end of link 2, has the plane velocity u = J q' and
feels a force against u, which acts on the joints as J^T. All in the frame of link 1.

*Friction.* At the elbow u is the shoulder's own rate times l1, so dry friction there is dry
friction of the shoulder, and MuJoCo's. At the wrist the direction of u turns in the plane, and
MuJoCo has no such thing but contacts. There it is f u / |u|, smoothed below a creeping speed. That
stays small against every speed that matters, but would let a stopped arm drift: so where the arm
has stopped, and a force within the friction could hold it, it is held.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arm import Arm
from .engine import Pair
from .stepping import LINKS, SHORT, Now, mujoco

GRAIN = 2e-7
"""Time (s) that the friction takes to stop the wrist from the creeping speed."""
SLOW = 30.0
"""How many creeping speeds count as standing, if friction can hold the arm there. It would creep as
fast under 0.9994 of what friction bears."""
UNITS: tuple[Pair, Pair] = ((1.0, 0.0), (0.0, 1.0))


@dataclass(frozen=True)
class Plane:
    """Plane velocities, and forces on the joints, of the bearings of one arm."""

    arm: Arm

    def wrist_velocity(self, q: Sequence[float], v: Sequence[float]) -> Pair:
        """m/s, along and across link 1."""
        arm = self.arm
        angle, swing = arm.theta2 + q[1], arm.l2 * (v[0] + v[1])
        return -swing * math.sin(angle), arm.l1 * v[0] + swing * math.cos(angle)

    def from_wrist(self, q: Sequence[float], force: Pair) -> Pair:
        """Torques (N m) on the joints of a force (N) at the wrist."""
        arm = self.arm
        angle = arm.theta2 + q[1]
        elbow = arm.l2 * (force[1] * math.cos(angle) - force[0] * math.sin(angle))
        return arm.l1 * force[1] + elbow, elbow

    def to_wrist(self, q: Sequence[float], torque: Sequence[float]) -> Pair:
        """The force (N) at the wrist that acts as these torques; link 2 must not be in line."""
        arm = self.arm
        angle = arm.theta2 + q[1]
        across = (torque[0] - torque[1]) / arm.l1
        along = (across * math.cos(angle) - torque[1] / arm.l2) / math.sin(angle)
        return along, across

    def mobility(self) -> float:
        """About the most that a unit force at the wrist sets it moving by, in any pose, 1/kg."""
        bound, theta2 = 0.0, self.arm.theta2
        for q2 in (-theta2, math.pi - theta2, math.pi / 2.0 - theta2):
            jacobian = np.array([self.wrist_velocity((0.0, q2), v) for v in UNITS]).T
            inverse = jacobian @ np.linalg.solve(self.arm.mass_matrix(q2), jacobian.T)
            bound = max(bound, float(np.trace(inverse)))
        return bound

    def drag(
        self, q: Sequence[float], v: Sequence[float], places: Sequence[str], power: int, size: float
    ) -> Pair:
        """Torques that resist: a force `size` |u|^power against the motion, at every bearing."""
        first = second = 0.0
        for place in places:
            if place == "elbow":
                speed = self.arm.l1 * abs(v[0])
                first += size * speed ** (power - 1) * self.arm.l1**2 * v[0]
            else:
                x, y = self.wrist_velocity(q, v)
                strength = size * math.hypot(x, y) ** (power - 1)
                torques = self.from_wrist(q, (strength * x, strength * y))
                first, second = first + torques[0], second + torques[1]
        return first, second


class WristFriction:
    """Dry friction of a bearing at the wrist, in any direction of the plane."""

    def __init__(self, plane: Plane, force: float, joints: Pair) -> None:
        """`force` is the friction (N), `joints` that of the joints themselves (N m)."""
        self.plane, self.force, self.joints = plane, force, joints
        self.braking = force * plane.mobility()
        """The most it slows the wrist, m/s^2."""
        self.creep = self.braking * GRAIN
        """The speed below which it is smoothed, m/s."""

    def torque(self, _: float, q: Sequence[float], v: Sequence[float]) -> Pair:
        x, y = self.plane.wrist_velocity(q, v)
        share = self.force / math.sqrt(x * x + y * y + self.creep * self.creep)
        return self.plane.from_wrist(q, (share * x, share * y))

    def limit(self, now: Now) -> float:
        """Steps shrink with the speed; zero where the arm is held."""
        speed = math.hypot(*self.plane.wrist_velocity(now.q, now.v))
        if speed < SLOW * self.creep and self.holds(now):
            return 0.0
        change = math.hypot(*self.plane.wrist_velocity(now.q, now.a)) + self.braking
        return max(0.3 * (speed + self.creep) / change, SHORT)

    def holds(self, now: Now) -> bool:
        """Has the arm stopped, and could friction bear what pulls at it?"""
        arm, q = self.plane.arm, now.q
        slow = 10.0 * SLOW * self.creep / min(arm.l1, arm.l2)
        if max(abs(now.v[0]), abs(now.v[1])) > slow or abs(math.sin(arm.theta2 + q[1])) < 1e-6:
            return False
        mujoco.mj_forward(now.model, now.data)
        own, free = self.torque(now.t, q, now.v), now.data.qfrc_smooth
        pull = [float(x) + y for x, y in zip(free, own, strict=False)]
        if len(now.v) > LINKS:  # a hand that swings on pulls as well
            column = np.zeros(len(now.v))
            mujoco.mj_mulM(now.model, now.data, column, np.eye(len(column))[-1])
            swing = float(free[-1] / column[-1])
            pull = [x - float(c) * swing for x, c in zip(pull, column, strict=False)]
        need = self.plane.to_wrist(q, pull)
        if math.hypot(*need) <= self.force:
            return True
        # What the joints bear themselves is whatever leaves least to the wrist: all of it, or one
        # of them bears its most and the other what suits best.
        if all(abs(x) <= most for x, most in zip(pull, self.joints, strict=True)):
            return True
        for full, other in ((0, 1), (1, 0)):
            unit = self.plane.to_wrist(q, UNITS[other])
            for sign in (-1.0, 1.0):
                rest = list(pull)
                rest[full] -= sign * self.joints[full]
                x, y = self.plane.to_wrist(q, rest)
                best = (x * unit[0] + y * unit[1]) / (unit[0] ** 2 + unit[1] ** 2)
                best = min(max(best, -self.joints[other]), self.joints[other])
                if math.hypot(x - best * unit[0], y - best * unit[1]) <= self.force:
                    return True
        return False
