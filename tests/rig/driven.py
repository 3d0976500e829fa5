"""Driven tests, step 1 of the paper: one joint led along a trajectory, the other braked.

The motor is a servo that turns the joint towards the trajectory with a spring and a damper of its
own; its torque is what the torque sensor reads. Friction acts in the driven joint, dry (MuJoCo's
own) and viscous. The brake of the other joint gives a little, as real ones do: it is a spring and a
damper, so that link 2 rings while link 1 is driven, and its angle is read like any other.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .arm import Arm
from .engine import Array, Pair, simulate

Trajectory = Callable[[Array], Array]
"""Wanted angle (rad) at times (s)."""

SHOULDER, ELBOW = 0, 1
PAPER_POSES = ((SHOULDER, 0.0), (SHOULDER, math.pi / 2), (ELBOW, 0.0))
"""Tests I, II and III: the driven joint, and the elbow's angle at rest (rad)."""
BANDWIDTH = 20.0
"""Of the servo, rad/s."""


def paper_trajectory(t: Array) -> Array:
    """Eq. 21 with the paper's numbers, rad."""
    return 0.7854 - 0.7854 * np.cos(0.3 * t - 0.028)


def sines(*waves: tuple[float, float, float]) -> Trajectory:
    """A sum of (amplitude rad, frequency Hz, phase rad)."""
    return lambda t: sum(
        (a * np.sin(2 * math.pi * f * t + p) for a, f, p in waves), np.zeros_like(t)
    )


def table_2_arm() -> Arm:
    """The set values of the paper's Table 2: Z11 = 2.9640 at theta2 = 0, I2 = 0.5920.

    The true m2 rho2 is not printed; the identified one stands for it.
    """
    coupling = 1.4384
    return Arm(0.4, 0.4, 2.9640 - 0.5920 - 0.8 * coupling, 0.5920, coupling)


@dataclass(frozen=True)
class Driven:
    """One driven test with its truth."""

    arm: Arm
    """Inertias and elbow angle at rest."""
    joint: int
    """The driven one: 0 the shoulder, 1 the elbow."""
    t: Array
    """s, N."""
    q: Array
    """Angles, rad, N x 2."""
    u: Array
    """Torques of the motors, N m, N x 2; zero at the braked joint."""

    @property
    def composite(self) -> float:
        """What the test sees of Eq. 2 on its diagonal, kg m^2, with the elbow where it stood."""
        mean = float(np.mean(self.q[:, 1])) if self.joint == SHOULDER else 0.0
        return float(self.arm.mass_matrix(mean)[self.joint, self.joint])

    def read(
        self, rng: np.random.Generator, angle_noise: float = 1e-3, torque_noise: float = 5e-3
    ) -> Driven:
        """As sensors read it: gaussian noise of angles (rad) and torque (shares of its largest)."""
        q = self.q + angle_noise * rng.standard_normal(self.q.shape)
        size = torque_noise * np.max(np.abs(self.u), axis=0)
        return replace(self, q=q, u=self.u + size * rng.standard_normal(self.u.shape))


def drive(
    arm: Arm,
    joint: int,
    t: Array,
    *,
    trajectory: Trajectory = paper_trajectory,
    coulomb: float = 0.0,
    viscous: float = 0.0,
    offset: float = 0.0,
    brake: Pair = (16.67, 0.1),
    hidden: Callable[[float, float], float] = lambda q, v: 0.0,
) -> Driven:
    """Lead one joint along a trajectory, at the times `t` (s); no noise.

    `coulomb` (N m), `viscous` (N m s/rad), `offset` (N m) and `hidden` (N m, of the angle and the
    rate) resist the driven joint; `brake` is the stiffness and damping of the other one.
    """
    inertia = float(arm.mass_matrix()[joint, joint])
    stiff, damp = inertia * BANDWIDTH**2, 1.4 * inertia * BANDWIDTH
    braked = 1 - joint
    bare = replace(arm, stiffness=_at(braked, brake[0]), damping=_pair(joint, viscous, brake[1]))
    step = 1e-4

    @functools.lru_cache(maxsize=1)  # two of a step's four stages are at one time
    def wanted(now: float) -> Pair:
        before, at, after = trajectory(np.array([now - step, now, now + step])).tolist()
        return at, (after - before) / (2 * step)

    def servo(now: float, angle: float, rate: float) -> float:
        target, speed = wanted(now)
        return stiff * (target - angle) + damp * (speed - rate)

    def torque(now: float, q: Array, v: Array) -> Pair:
        angle, rate = float(q[joint]), float(v[joint])
        return _at(joint, servo(now, angle, rate) - offset - hidden(angle, rate))

    start, speed = wanted(float(t[0]))
    q, v = simulate(
        bare,
        t,
        _at(joint, start),
        _at(joint, speed),
        frictionloss=_at(joint, coulomb),
        torque=torque,
    )
    u = np.zeros_like(q)
    rows = zip(t.tolist(), q[:, joint].tolist(), v[:, joint].tolist(), strict=True)
    u[:, joint] = [servo(*row) for row in rows]
    return Driven(arm, joint, t, q, u)


def paper_tests(
    arm: Arm | None = None, *, seconds: float = 42.0, rate: float = 100.0
) -> list[Driven]:
    """Tests I to III: the paper's trajectory, two turns of it, sampled at `rate` Hz.

    Its frictions are not printed: dry friction of 0.05 and 0.02 N m is a quarter to a half of what
    accelerating takes; the viscous one is the paper's joint damping, and the brakes give as its
    Eq. 24 has it.
    """
    arm, t = arm or table_2_arm(), np.arange(round(seconds * rate) + 1) / rate
    return [
        drive(replace(arm, theta2=theta2), joint, t, coulomb=(0.05, 0.02)[joint], viscous=0.1)
        for joint, theta2 in PAPER_POSES
    ]


def _at(joint: int, value: float) -> Pair:
    return (value, 0.0) if joint == SHOULDER else (0.0, value)


def _pair(joint: int, mine: float, other: float) -> Pair:
    return (mine, other) if joint == SHOULDER else (other, mine)
