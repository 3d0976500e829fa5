"""One mass on one spring: its answers are known in closed form, Coulomb friction included."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .engine import Pair, Setting, document


@dataclass(frozen=True)
class Cart:
    """A mass on a straight slide; q is its departure from the spring's rest, m."""

    mass: float
    """kg."""
    stiffness: float = 0.0
    """N/m."""
    damping: float = 0.0
    """N s/m."""

    joints = 1

    def fastest(self, gravity: Pair = (0.0, 0.0)) -> float:
        """Natural frequency, rad/s; it sets the time step."""
        del gravity  # a constant push along the slide changes no frequency
        return math.sqrt(self.stiffness / self.mass)

    def mjcf(
        self,
        *,
        gravity: Pair = (0.0, 0.0),
        frictionloss: tuple[float, ...] = (0.0,),
        setting: Setting | None = None,
    ) -> str:
        """The cart as a MuJoCo model; only gravity's first component (m/s^2) is along the slide."""
        (friction,) = frictionloss
        world = (
            '<body><joint name="cart" type="slide" axis="1 0 0" '
            f'stiffness="{float(self.stiffness)!r}" damping="{float(self.damping)!r}" '
            f'frictionloss="{float(friction)!r}"/>'
            f'<inertial pos="0 0 0" mass="{float(self.mass)!r}" diaginertia="1 1 1"/></body>'
        )
        return document(world, ("cart",), gravity, setting)
