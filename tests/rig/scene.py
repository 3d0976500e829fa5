"""What the size of a random effect is measured by: the bare arm's own swing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arm import Arm
from .cases import log_uniform
from .engine import Array

Values = dict[str, float]


@dataclass(frozen=True)
class Scene:
    """What a draw may look at."""

    rng: np.random.Generator
    arm: Arm
    swing: Array
    """Largest angle of each joint, rad."""
    speed: Array
    """Largest velocity of each joint, rad/s."""
    share: float
    given: bool
    """Was the share asked for?"""
    bearings: tuple[str, ...]
    seconds: float
    joint: int = 0

    @property
    def stiffness(self) -> float:
        return self.arm.stiffness[self.joint]

    @property
    def angle(self) -> float:
        return float(self.swing[self.joint])

    @property
    def rate(self) -> float:
        return float(self.speed[self.joint])

    @property
    def torque(self) -> float:
        """The effect's, N m."""
        return self.share * self.stiffness * self.angle

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def spread(self, low: float, high: float) -> float:
        """Log-uniform."""
        return log_uniform(self.rng, low, high)


def swings(arm: Arm, q0: Array) -> tuple[Array, Array]:
    """Largest angles (rad) and velocities (rad/s) in 20 s, small motion without damping."""
    low = np.linalg.inv(np.linalg.cholesky(arm.mass_matrix()))
    squares, shapes = np.linalg.eigh(low @ np.diag(arm.stiffness) @ low.T)
    pulses, shapes = np.sqrt(squares), low.T @ shapes
    parts = shapes * np.linalg.solve(shapes, q0)
    phase = np.outer(np.linspace(0.0, 20.0, 4001), pulses)
    angles, rates = np.cos(phase) @ parts.T, np.sin(phase) @ (parts * pulses).T
    return np.max(np.abs(angles), axis=0), np.max(np.abs(rates), axis=0)
