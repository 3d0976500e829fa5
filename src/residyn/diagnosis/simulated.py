"""Evidence and numbers of a model without a random torque, by exact simulation.

A filter linearises. Where something sticks, its motion creeps a little where the true one holds,
and what should need no random torque seems to need some; along a ridge of numbers that do nearly
the same its iteration ends early. Without one the motion follows from its numbers and first states
alone, so the evidence is an integral over these: Laplace's method about the posterior mode, whose
residual and slopes are those of an exact simulation (MacKay, Information Theory, Inference and
Learning Algorithms, 2003, ch. 27). Readings, priors and scale are the filter's.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..filtering.trajectory import Scene, Trajectory
from ..fitting.problem import Problem, Unknowns
from ..fitting.result import Fit, FitError
from .evidence import SETTLED, half_normals
from .linearised_fit import Minimum, minimum

_STEPS = 30  # of Levenberg and Marquardt, at the most
_DAMPING = 1e-3, 1e6  # relative to the squares of each unknown: of the first that fails, at most


class Simulated(NamedTuple):
    """A model without a random torque."""

    log_evidence: float
    u: np.ndarray  # (P,) the posterior mode of its numbers, in prior widths,
    covariance: np.ndarray  # (P, P) and their covariance


class _Posterior(NamedTuple):
    """The density of numbers and first states, all in standard deviations of their priors."""

    x: np.ndarray  # (P + R S,)
    found: Minimum
    cost: float  # -2 log of it, but for constants: squared whitened residuals, and of `x`
    square: np.ndarray  # (P + R S)^2, half the cost's second derivatives, to Gauss and Newton
    slope: np.ndarray  # (P + R S,) half its first ones


def _mode(problem: Problem, t: Trajectory, mean, width, begin: np.ndarray) -> _Posterior:
    """From a least-squares fit, which knows of no priors, by Levenberg and Marquardt; `mean` (R, S)
    and `width` (S,) of the first states.

    **Raises:** `FitError` where the motion runs away from the beginning; `LinAlgError` where slopes
    are too steep for arithmetic (Stribeck's velocity at nothing).
    """
    scale, P, (R, S) = problem.scale, len(t.prior.mean), mean.shape
    n = problem.recorded.angles.shape[-1]
    known = np.append(np.zeros(P + 2 * n), np.ones(S - 2 * n))  # to the fit, of internal states

    def at(x: np.ndarray) -> _Posterior:
        numbers, states = t.prior.numbers(x[:P]), mean + width * x[P:].reshape(R, S)
        y = Unknowns(numbers / np.asarray(scale.numbers), states / np.asarray(scale.states))
        found = minimum(problem, y, most=0)
        cost = found.cost - float(np.sum((known[P:] * y.states) ** 2)) + float(x @ x)
        square, slope = np.eye(len(x)), x.copy()
        for r in range(R):
            i = np.r_[0:P, P + r * S : P + (r + 1) * S]
            each = np.append(
                t.prior.slopes(x[:P]) / np.asarray(scale.numbers),
                width / np.asarray(scale.states)[r],
            )
            own = np.append(np.zeros(P), y.states[r])
            square[np.ix_(i, i)] += (found.square[r] - np.diag(known)) * np.outer(each, each)
            slope[i] += (found.slope[r] - known * own) * each
        return _Posterior(x, found, cost, square, slope)

    here, damping = at(begin), 0.0
    for _ in range(_STEPS):
        size = damping * np.diag(np.diag(here.square))
        try:
            there = at(here.x - cho_solve(cho_factor(here.square + size), here.slope))
        except FitError:
            there = here._replace(cost=math.inf)
        gain = here.cost - there.cost
        if gain > 0:
            here, damping = there, 0.1 * damping if damping > _DAMPING[0] else 0.0
        else:
            damping = max(10 * damping, _DAMPING[0])
        if 0 < gain < 2 * SETTLED or damping > _DAMPING[1]:
            break
    return here


def simulated(scene: Scene, t: Trajectory, fit: Fit) -> Simulated | None:
    """A model that was fitted by least squares, without a random torque; None where it was fitted
    in segments, whose first states are unknowns of their own, and where slopes are too steep for
    arithmetic.

    **Raises:** `FitError` where no motion goes with the fit's numbers.
    """
    n = scene.n
    if any(r.recording.segment_of is not None for r in fit.fitted):
        return None
    states = np.asarray(fit.problem.states(fit.unknowns))
    width = np.sqrt(scene.noise(t).variance[: states.shape[1]])
    mean = np.zeros_like(states)
    mean[:, :n] = scene.q[scene.begins]
    u = t.prior.regressors(np.asarray(fit.problem.numbers(fit.unknowns)))
    begin = np.append(u, ((states - mean) / width).ravel())
    try:
        mode = _mode(fit.problem, t, mean, width, begin)
        factor = cho_factor(mode.square, lower=True)
    except np.linalg.LinAlgError:
        return None
    off, g = 0.0, scene.grid
    for r, recording in enumerate(scene.recordings):
        at, size = g.of(r), len(recording.time)
        seen = np.isfinite(recording.angle) & ~scene.wild[r]
        predicted = g.of_readings(r, mode.found.predicted[r, :size], seen)
        off += np.sum(np.where(g.seen[at], (g.angle[at] - predicted) ** 2 / g.variance[at], 0.0))
    x, P = mode.x, len(u)
    log = scene.highest - 0.5 * (off + x @ x) - np.log(np.diag(factor[0])).sum()
    covariance = cho_solve(factor, np.eye(len(x)))[:P, :P]  # pyrefly: ignore[bad-index]
    log += half_normals(t.effects, t.prior, x[:P], np.sqrt(np.diag(covariance)))
    return Simulated(float(log), x[:P], covariance)
