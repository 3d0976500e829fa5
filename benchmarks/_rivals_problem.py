"""What the rivals are given, what they give back, and the referee who measures all alike."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from tests import rig

DT = 0.01
NOISE = 1e-3
OFF = 0.4
"""How far the start of those that need one is off, either way."""
RELEASES = ((0.2, -0.1), (-0.15, 0.2), (0.25, 0.05), (0.1, 0.25), (-0.2, -0.2))


class Missing(Exception):
    """A package that is not installed, and what to install for it."""


class TooSlow(Exception):
    """A method that was stopped at its time limit."""


class Answer(NamedTuple):
    """What a method found: k1, k2, c1, c2, the initial states (R, 4), seconds of its parts."""

    numbers: np.ndarray
    states: np.ndarray
    seconds: dict[str, float] = {}  # noqa: RUF012  never written to


@dataclass(frozen=True)
class Problem:
    """R recordings of one arm, read at the times `t` (N,), and a start."""

    arm: rig.Arm
    t: np.ndarray
    truth: np.ndarray
    """The motions without noise, rad, R x N x 2."""
    q: np.ndarray
    """What the sensors read, rad, R x N x 2."""
    start: np.ndarray
    """k1, k2, c1, c2, each 40 % off, for those that need a start."""
    noise: float = NOISE
    limit: float = math.inf
    """Seconds that a fit may take, for those that can be stopped."""

    @property
    def numbers(self) -> np.ndarray:
        """The true k1, k2, c1, c2."""
        return np.array([*self.arm.stiffness, *self.arm.damping])

    @property
    def states(self) -> np.ndarray:
        """First guesses of the initial states (R, 4): the first readings, at rest."""
        return np.hstack([self.q[:, 0], np.zeros_like(self.q[:, 0])])

    @property
    def inertia(self) -> np.ndarray:
        """shoulder, elbow, l1 * coupling (kg m^2), elbow angle at rest (rad)."""
        arm = self.arm
        return np.array([arm.shoulder, arm.elbow, arm.l1 * arm.coupling, arm.theta2])

    def again(self, seed: int) -> "Problem":
        """The same motions with other noise, and with a start that is off in other directions."""
        rng = np.random.default_rng(seed)
        q = self.truth + self.noise * rng.standard_normal(self.truth.shape)
        start = self.numbers * np.where(rng.random(4) < 0.5, 1 - OFF, 1 + OFF)
        return replace(self, q=q, start=start)


def problem(name: str, seed: int = 0) -> Problem:
    """The problem of this name: "reference", "short", "long" or "five"."""
    seconds = {"reference": 20.0, "short": 5.0, "long": 60.0, "five": 20.0}[name]
    arm = rig.paper_twin(0.3)
    if name == "long":
        arm = replace(arm, damping=(arm.damping[0] / 5, arm.damping[1] / 5))
    t = np.arange(round(seconds / DT)) * DT
    releases = RELEASES if name == "five" else RELEASES[:1]
    truth = np.stack([rig.simulate(arm, t, np.array(q0))[0] for q0 in releases])
    return Problem(arm, t, truth, truth, np.empty(4)).again(seed)


def rates(t, y, inertia, k1, k2, c1, c2):
    """Eq. 1 in Python scalars, for SciPy's integrators."""
    q1, q2, v1, v2 = y
    shoulder, d, s, theta2 = inertia
    cross, bend = s * math.cos(theta2 + q2), s * math.sin(theta2 + q2)
    a, b = shoulder + d + 2 * cross, d + cross
    f1 = bend * (2 * v1 * v2 + v2 * v2) - k1 * q1 - c1 * v1
    f2 = -bend * v1 * v1 - k2 * q2 - c2 * v2
    det = a * d - b * b
    return v1, v2, (d * f1 - b * f2) / det, (a * f2 - b * f1) / det


def cost_of(given: Problem, answer: Answer) -> float:
    """Sum of squared residuals over sigma^2: every answer is simulated anew, to 1e-10."""
    total = 0.0
    if not (np.all(np.isfinite(answer.numbers)) and np.all(np.isfinite(answer.states))):
        return math.inf
    inertia = given.inertia.tolist()
    for q, state in zip(given.q, answer.states, strict=True):
        args = (inertia, *answer.numbers.tolist())
        ends = (given.t[0], given.t[-1])
        out = solve_ivp(rates, ends, state, "DOP853", given.t, args=args, rtol=1e-10, atol=1e-12)
        if out.y.shape[1] < len(given.t):
            return math.inf
        total += float(np.sum((out.y[:2].T - q) ** 2))
    return total / given.noise**2
