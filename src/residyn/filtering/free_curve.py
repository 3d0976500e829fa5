"""A law as data: a curve of one variable, as an effect that every program holds.

A torque f(x) of the angle, the rate or time, or such a curve times the angle, the rate or the
direction of sliding. f is a sum of cubic B-splines, fine enough for any formula that `diagnosis`
writes, and its heights are data: no curve, no formula and no table needs a program of its own.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ..effects import JointEffect

HEIGHTS = 235
"""Of a curve: 232 pieces, a whole number of times as many as the 29 of the curves that `diagnosis`
tries, so that it holds each of those exactly. A sine of a twelfth of the range is within 2e-5."""


def curve(x: Any, low: Any, high: Any, heights: Any) -> Any:
    """A curve (HEIGHTS, ...) between `low` and `high` at x (...,); beyond them it is constant."""
    pieces = heights.shape[0] - 3
    at = jnp.clip((x - low) / (high - low), 0.0, 1.0) * pieces
    first = jnp.clip(jnp.floor(at), 0, pieces - 1)
    f = at - first
    four = (1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, 1 + 3 * f + 3 * f**2 - 3 * f**3, f**3
    index = first.astype(int)
    more = (1,) * (heights.ndim - 1)
    return sum(w.reshape(*w.shape, *more) * heights[index + i] for i, w in enumerate(four)) / 6


class FreeCurve(JointEffect):
    """A curve with given heights, as an effect without numbers."""

    name = "free_curve"
    title = "A free curve"
    variable: Any
    """(3,) shares of angle, rate and time."""
    factor: Any
    """(3,) shares of angle, rate and 1."""
    low: Any
    high: Any
    heights: Any
    """(HEIGHTS,)"""

    def joint_torque(self, motion):
        of, by = self.variable, self.factor
        x = of[0] * motion.q + of[1] * motion.v + of[2] * motion.t
        factor = by[0] * motion.q + by[1] * motion.v + by[2]
        return factor * curve(x, self.low, self.high, self.heights)


class FreeFriction(FreeCurve):
    """A curve times the direction of sliding."""

    name = "free_friction"
    dry = True

    def joint_torque(self, motion):
        return motion.direction * super().joint_torque(motion)


def no_curves() -> tuple[FreeCurve, ...]:
    """One of each, as a program holds them where a model has none."""
    data = np.eye(3)[0], np.eye(3)[2], np.zeros(()), np.ones(()), np.zeros(HEIGHTS)
    return FreeCurve("", *data), FreeFriction("", *data)
