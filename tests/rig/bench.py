"""Where hidden effects come together: one arm, one torque, one memory, one step limit.

A law gives the torque on the left side of Z q'' + f + sum of torques = drive, so a resisting one is
positive; the bench turns the sign for MuJoCo.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from .arm import Arm
from .bearing import Plane, WristFriction
from .engine import Array, Memory, Pair, Torque
from .loaded import Hand, LoadedArm, Tendon, first_moment
from .stepping import Limit, Now

Floats = Sequence[float]
Law = Callable[[float, Floats, Floats], Pair]


@dataclass(frozen=True)
class Cell:
    """One memory z of one joint: its rate, its torque, and what it becomes when a step ends."""

    joint: int
    start: float
    torque: Callable[[float, float, float], float]
    """(q, v, z) -> N m"""
    rate: Callable[[float, float, float], float] = lambda q, v, z: 0.0
    settle: Callable[[float, float], float] = lambda q, z: z
    limit: Callable[[float, float, float, float], float] = lambda q, v, a, z: math.inf
    """(q, v, a, z) -> s"""


class Bench:
    """An arm on which hidden effects are put, one after the other."""

    def __init__(self, arm: Arm, q0: Floats, bearings: Sequence[str]) -> None:
        self.given, self.q0, self.bearings = arm, q0, bearings
        # Other inertias may want other bodies, but never another pull of gravity on link 1.
        self.true = replace(arm, link1_moment=first_moment(arm))
        self.springs = [[k, 0.0, 0.0] for k in arm.stiffness]
        self.dampers = [[c, 0.0, 0.0] for c in arm.damping]
        self.friction = [0.0, 0.0]
        self.gravity: Pair = (0.0, 0.0)
        self.tendons: list[Tendon] = []
        self.hand: Hand | None = None
        self.laws: list[Law] = []
        self.cells: list[Cell] = []
        self.limits: list[Limit] = []
        self.offset, self.scale, self.delay = [0.0, 0.0], [1.0, 1.0], [0.0, 0.0]
        self.wrist_friction = 0.0

    def joint_law(self, joint: int, law: Callable[[float, float, float], float]) -> None:
        """A torque (N m) of one joint's own (t, q, v)."""
        if joint:
            self.laws.append(lambda t, q, v: (0.0, law(t, q[1], v[1])))
        else:
            self.laws.append(lambda t, q, v: (law(t, q[0], v[0]), 0.0))

    def joint_limit(self, joint: int, limit: Callable[[float, float, float], float]) -> None:
        """The longest step (s), from one joint's (q, v, a)."""
        self.limits.append(lambda now: limit(now.q[joint], now.v[joint], now.a[joint]))

    def finish(self) -> None:
        """What needs to know of all effects: friction in the plane."""
        if self.wrist_friction:
            joints = (self.friction[0], self.friction[1])
            friction = WristFriction(Plane(self.given), self.wrist_friction, joints)
            self.laws.append(friction.torque)
            self.limits.append(friction.limit)

    def system(self) -> LoadedArm:
        springs, dampers = (
            ((x[0][0], x[0][1], x[0][2]), (x[1][0], x[1][1], x[1][2]))
            for x in (self.springs, self.dampers)
        )
        return LoadedArm(self.true, springs, dampers, tuple(self.tendons), self.hand)

    def applied(self) -> Torque | None:
        """The laws as MuJoCo wants them: one torque on the joints."""
        if not self.laws:
            return None
        laws, rest = self.laws, (0.0,) if self.hand else ()

        def torque(t: float, q: Array, v: Array) -> tuple[float, ...]:
            angles, rates = q.tolist(), v.tolist()
            first = second = 0.0
            for law in laws:
                one, two = law(t, angles, rates)
                first, second = first - one, second - two
            return first, second, *rest

        return torque

    def memory(self) -> Memory | None:
        """All cells in one."""
        if not self.cells:
            return None
        cells, joints = self.cells, 3 if self.hand else 2

        def rate(_: float, q: Array, v: Array, z: Array) -> list[float]:
            each = zip(cells, z.tolist(), strict=True)
            return [c.rate(float(q[c.joint]), float(v[c.joint]), x) for c, x in each]

        def torque(_: float, q: Array, v: Array, z: Array) -> list[float]:
            out = [0.0] * joints
            for c, x in zip(cells, z.tolist(), strict=True):
                out[c.joint] -= c.torque(float(q[c.joint]), float(v[c.joint]), x)
            return out

        def settle(_: float, q: Array, __: Array, z: Array) -> list[float]:
            return [c.settle(float(q[c.joint]), x) for c, x in zip(cells, z.tolist(), strict=True)]

        return Memory([c.start for c in cells], rate, torque, settle)

    def limit(self) -> Limit | None:
        """The least of all limits."""
        limits = list(self.limits)
        for i, cell in enumerate(self.cells):

            def of_cell(now: Now, cell: Cell = cell, i: int = i) -> float:
                j = cell.joint
                return cell.limit(now.q[j], now.v[j], now.a[j], now.z[i])

            limits.append(of_cell)
        return (lambda now: min(limit(now) for limit in limits)) if limits else None
