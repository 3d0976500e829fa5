"""What an encoder's steps do to a smooth curve: known, and no failure of the model.

A reading is the angle rounded to the encoder's grid. Where noise shakes the angle by half a step or
more, rounding only adds some white noise. Where it does not, the rounding error follows the motion
and is anything but white; but then it can be computed, from the motion that the model predicts. And
where the joint moves by no more than a step or two, it hangs on a single bit, and its readings say
nothing that can be tested.
"""

from typing import NamedTuple

import numpy as np

from ..recordings.polynomial_spectrum import grid_step

_SHAKEN = 0.5  # steps: noise of this sigma makes the rounding error white
_LEAST = 0.05  # steps: no prediction is better than this
_WAVES = 30  # enough for a sawtooth blurred by _LEAST
_STEPS = 2.0  # range of a motion below which it hangs on single bits


class Grid(NamedTuple):
    """Values that a sensor can show: `origin` + k `step`, rad or m; `step` 0 is any value."""

    origin: float
    step: float

    @classmethod
    def of(cls, readings: np.ndarray) -> "Grid":
        """The grid of some readings."""
        values = np.unique(readings)
        step = grid_step(values) if len(values) > 1 else 0.0
        if step <= 0:
            return cls(0.0, 0.0)
        # Each gap is a small count of steps, so the counts are sure, and with them origin and step.
        count = np.concatenate([[0.0], np.cumsum(np.rint(np.diff(values) / step))])
        step, origin = np.polyfit(count, values, 1)
        return cls(float(origin), float(step))

    def matters(self, residual: np.ndarray) -> bool:
        """Whether so small a residual must have the pattern of the grid in it."""
        return self.step > 0 and self._shake(residual) < _SHAKEN * self.step

    def error(self, angle: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Mean rounding error of readings near `angle`, shaken by what is left of `residual`."""
        place, blur = (angle - self.origin) / self.step, self._shake(residual) / self.step
        wave = np.arange(1, _WAVES + 1)
        height = (-1.0) ** wave / (np.pi * wave) * np.exp(-2 * (np.pi * wave * blur) ** 2)
        return self.step * (np.sin(2 * np.pi * place[..., None] * wave) @ height)

    def _shake(self, residual: np.ndarray) -> float:
        spare = float(np.mean(residual**2)) - self.step**2 / 12
        return float(np.sqrt(max(spare, (_LEAST * self.step) ** 2)))


def hangs(time: np.ndarray, angle: np.ndarray, grid: Grid, period: float) -> np.ndarray:
    """Where (N,) the motion `angle` (N,) keeps within a step or two for a whole period (s);
    nowhere, if there is no period (0)."""
    if not period > 0:
        return np.zeros(len(time), bool)
    low = np.searchsorted(time, time - period / 2)
    high = np.maximum(np.searchsorted(time, time + period / 2), np.arange(len(time)) + 1)
    size = np.array([np.ptp(angle[a:b]) for a, b in zip(low, high, strict=True)])
    return size < _STEPS * grid.step
