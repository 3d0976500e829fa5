"""Random arms and releases, so that a benchmark speaks for a family of arms and not for one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from .arm import Arm
from .engine import Array, Pair, simulate

BAND: Pair = (0.2, 5.0)
"""Where both modes of a random arm lie, Hz."""
ALIKE: Pair = (0.2, 8.0)
"""Shoulder stiffness over elbow stiffness. Braked motors of one arm are alike; beyond this a
released shoulder throws a floppy elbow round and round, and the motion is chaotic."""


@dataclass(frozen=True)
class Case:
    """One recording with its truth."""

    arm: Arm
    q0: Array
    """Release angles, rad; the release is from rest."""
    frictionloss: Pair
    """Hidden Coulomb torque per joint, N m."""
    noise: float
    """Standard deviation of one reading, rad."""
    t: Array
    """s, N."""
    q: Array
    """What a sensor read, rad, N x 2."""
    truth: Array
    """The motion without noise, rad, N x 2."""


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def random_arm(
    rng: np.random.Generator,
    *,
    damping_ratio: Pair = (0.002, 0.05),
    shoulder: Pair = (0.3, 3.0),
    theta2: Pair = (-2.0, 2.0),
) -> Arm:
    """An arm that could be built: both modes in `BAND`, their damping ratios in range.

    `shoulder` (kg m^2) and `theta2` (rad) are the ranges of those two.
    """
    while True:
        whole = log_uniform(rng, *shoulder)
        l1, l2 = rng.uniform(0.25, 0.6, size=2)
        m2 = rng.uniform(0.3, 0.8) * whole / l1**2
        rho2 = rng.uniform(0.3, 1.0) * l2
        arm = Arm(
            l1=float(l1),
            l2=float(l2),
            shoulder=whole,
            elbow=float(m2 * (rho2**2 + (rng.uniform(0.15, 0.4) * l2) ** 2)),
            coupling=float(m2 * rho2),
            theta2=float(rng.uniform(*theta2)),
        )
        mass = arm.mass_matrix()
        stiffness = np.array([log_uniform(rng, 0.25, 2.5) for _ in range(2)])
        stiffness = (2.0 * math.pi * stiffness) ** 2 * np.diag(mass)
        if not ALIKE[0] <= stiffness[0] / stiffness[1] <= ALIKE[1]:
            continue
        wanted = np.array([log_uniform(rng, *damping_ratio) for _ in range(2)])
        damping = _joint_damping(mass, stiffness, wanted)
        made = replace(
            arm,
            stiffness=(float(stiffness[0]), float(stiffness[1])),
            damping=(float(damping[0]), float(damping[1])),
        )
        frequency, ratio = made.modes()
        inside = BAND[0] <= frequency[0] and frequency[-1] <= BAND[1]
        damped = np.all((ratio >= damping_ratio[0]) & (ratio <= damping_ratio[1]))
        if inside and damped and np.all(damping > 0.0):
            return made


def _joint_damping(mass: Array, stiffness: Array, ratio: Array) -> Array:
    """Joint dampers (N m s/rad) that give the two modes these damping ratios, to first order."""
    low = np.linalg.inv(np.linalg.cholesky(mass))
    squares, shapes = np.linalg.eigh(low @ np.diag(stiffness) @ low.T)
    shapes = low.T @ shapes
    return np.asarray(np.linalg.solve(shapes.T**2, 2.0 * ratio * np.sqrt(squares)), dtype=float)


def random_release(rng: np.random.Generator, amplitude: Pair = (0.05, 0.4)) -> Array:
    """Release angles (rad) of a static deflection: each joint's size in `amplitude`, either way."""
    return rng.uniform(*amplitude, size=2) * rng.choice([-1.0, 1.0], size=2)


def clean_cases(
    rng: np.random.Generator,
    count: int,
    *,
    amplitude: Pair = (0.05, 0.4),
    noise: float = 1e-3,
    damping_ratio: Pair = (0.002, 0.05),
    seconds: float = 20.0,
    rate: float = 100.0,
) -> Iterator[Case]:
    """Recordings with nothing hidden: springs and dampers are all. `rate` in Hz, `noise` in rad."""
    for _ in range(count):
        arm = random_arm(rng, damping_ratio=damping_ratio)
        yield _record(rng, arm, random_release(rng, amplitude), (0.0, 0.0), noise, seconds, rate)


def friction_cases(
    rng: np.random.Generator,
    count: int,
    *,
    amplitude: Pair = (0.05, 0.4),
    noise: float = 1e-3,
    share: Pair = (0.005, 0.05),
    damping_ratio: Pair = (0.002, 0.05),
    seconds: float = 20.0,
    rate: float = 100.0,
) -> Iterator[Case]:
    """Hidden Coulomb friction at one joint: a `share` of its spring torque at release."""
    for _ in range(count):
        arm = random_arm(rng, damping_ratio=damping_ratio)
        q0 = random_release(rng, amplitude)
        joint = int(rng.integers(2))
        torque = log_uniform(rng, *share) * arm.stiffness[joint] * abs(float(q0[joint]))
        hidden = (torque, 0.0) if joint == 0 else (0.0, torque)
        yield _record(rng, arm, q0, hidden, noise, seconds, rate)


def _record(
    rng: np.random.Generator,
    arm: Arm,
    q0: Array,
    frictionloss: Pair,
    noise: float,
    seconds: float,
    rate: float,
) -> Case:
    t = np.arange(round(seconds * rate) + 1) / rate
    truth, _ = simulate(arm, t, q0, frictionloss=frictionloss)
    measured = truth + noise * rng.standard_normal(truth.shape)
    return Case(arm, q0, frictionloss, noise, t, measured, truth)
