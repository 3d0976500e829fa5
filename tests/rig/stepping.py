"""Taking MuJoCo from one sample to the next: long steps, and short ones where a torque turns.

*Friction.* MuJoCo treats dry friction as a soft constraint: the joint is braked towards zero
velocity at the rate b = 1/step (larger would be unstable) with at most the friction torque, so a
reversal comes about one step early. As one comes near, the steps therefore shrink, down to `SHORT`;
elsewhere the torque is saturated or the joint sticks, and the long step keeps its order. The
constraint's softness, which lets a stuck joint creep, is also cut below what MJCF can ask for.

*Corners.* A hidden law may say before every step how long a step it bears. `until` is the usual
answer where it jumps or bends: steps shrink as the place comes near, one short step crosses it, and
no long step ever straddles it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco as _mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

mujoco: Any = _mujoco  # compiled, so a type checker cannot see into it

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Now:
    """Where the arm is at the beginning of a step: time, angles and rates, memories."""

    t: float
    q: list[float]
    v: list[float]
    a: list[float]
    z: list[float]
    model: Any
    data: Any


Limit = Callable[[Now], float]
"""The longest step (s) that a torque bears from here. Zero says that friction in the plane holds
both links: they then stand still until the next long step asks again."""
Settle = Callable[[float, Array, Array, Array], ArrayLike]
"""What the memories become at the end of a step, from (t, q, v, z)."""

SHORT = 1e-7
"""The step (s) across a reversal of a joint with friction, or a corner."""
NEAR = 1e-9
"""Closer to a corner than this (rad or rad/s), a step may as well begin at the corner itself."""
LINKS = 2
FIRM = 1e4
"""Friction (N m) that holds a link against anything."""
STUCK = 1e-7
"""Speed (rad/s or m/s) under which a joint with friction counts as stuck."""
SOFTNESS = 1e-2
"""The constraint's regularisation, as a share of the least that MJCF's solimp allows."""


def until(distance: float, rate: float, turn: float = 0.0) -> float:
    """A step (s) that stays short of a corner ahead, or crosses it if that is near enough.

    `distance` is that of the state from the corner, with sign, and changes at `rate`, which itself
    changes at `turn`. A corner that is left behind, or sat upon, asks for nothing.
    """
    away = abs(distance)
    if away < NEAR or (distance * rate >= 0.0 and distance * turn >= 0.0):
        return math.inf
    return max(0.6 * away / (abs(rate) + math.sqrt(rate * rate + 2.0 * abs(turn) * away)), SHORT)


class Advance:
    """Takes the state over a sampling interval."""

    def __init__(
        self, model: Any, data: Any, friction: Array, limit: Limit | None, settle: Settle | None
    ) -> None:
        self.model, self.data = model, data
        self.limit, self.settle = limit, settle
        self.friction = friction
        self.rough = np.flatnonzero(friction > 0.0).tolist()
        self.step = 0.0
        self.held = False
        # MuJoCo makes this inverse inertia the scale of the regularisation, and nothing else of it.
        model.dof_invweight0[:] *= SOFTNESS

    def __call__(self, span: float, steps: int) -> None:
        long = span / steps
        if not (self.rough or self.limit or self.settle):
            self.set_step(long)
            mujoco.mj_step(self.model, self.data, steps)
            return
        for _ in range(steps):
            self.carefully(long)

    def carefully(self, long: float) -> None:
        """One long step, in as many short ones as it takes."""
        data, drives = self.data, self.model.nv
        left = long
        while left > 1e-9 * long:
            bearable = self.limit(self.now()) if self.limit else math.inf
            self.hold(bearable <= 0.0)
            if self.held and self.model.nv == LINKS:
                data.time += left
                mujoco.mj_forward(self.model, data)
                return
            bearable = left if self.held else min(bearable, self.before_reversal())
            step = left / math.ceil(max(left / bearable, 1.0) - 1e-9)
            self.set_step(step)
            mujoco.mj_step(self.model, data)
            if self.settle:
                data.act[drives:] = self.settle(data.time, data.qpos, data.qvel, data.act[drives:])
            left -= step

    def hold(self, still: bool) -> None:
        """Stop both links, or let them go; whatever hangs on them stays free."""
        if still:
            self.data.qvel[:LINKS] = 0.0
        if still != self.held:
            self.held = still
            self.model.dof_frictionloss[:LINKS] = FIRM if still else self.friction[:LINKS]

    def now(self) -> Now:
        data, act = self.data, self.data.act[self.model.nv :]
        q, v, a, z = (x.tolist() for x in (data.qpos, data.qvel, data.qacc, act))
        return Now(data.time, q, v, a, z, self.model, data)

    def before_reversal(self) -> float:
        """The longest step (s) before some joint with friction stops.

        Only its own deceleration matters: the other joint's friction can jump only where that one
        stops, and breaking away is continuous.
        """
        bearable = math.inf
        for joint in self.rough:
            v, a = float(self.data.qvel[joint]), float(self.data.qacc[joint])
            if v * a < 0.0 and abs(v) > STUCK:
                bearable = min(bearable, until(v, a))
        return bearable

    def accelerations(self) -> Array:
        """At the present state, rad/s^2."""
        if self.held and self.model.nv == LINKS:
            return np.zeros(LINKS)
        for joint in self.rough:  # a sliding joint's friction at its full size, however slow it is
            if abs(float(self.data.qvel[joint])) > STUCK:
                self.model.dof_solref[joint, 1] = -1.0 / SHORT
        self.step = 0.0
        mujoco.mj_forward(self.model, self.data)
        return self.data.qacc.copy()

    def set_step(self, step: float) -> None:
        if step != self.step:
            self.step = self.model.opt.timestep = step
            self.model.dof_solref[:, 1] = -1.0 / step
