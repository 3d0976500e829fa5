"""Evidence and numbers of a model without a random torque, by exact simulation.

A filter linearises. Where something sticks, its motion creeps a little where the true one holds,
and what should need no random torque seems to need some; along a ridge of numbers that do nearly
the same its iteration ends early. Without one the motion follows from its numbers and first states
alone, so the evidence is an integral over these: Laplace's method about the posterior mode, whose
residual and slopes are those of an exact simulation (MacKay, Information Theory, Inference and
Learning Algorithms, 2003, ch. 27). Readings, priors and scale are the filter's.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..filtering.trajectory import Scene, Trajectory
from ..fitting.problem import Unknowns
from ..fitting.result import Fit
from .evidence import non_normal_priors
from .linearised_fit import minimum


class Simulated(NamedTuple):
    """A model without a random torque."""

    log_evidence: float
    u: np.ndarray  # (P,) the posterior mode of its numbers, in prior widths,
    covariance: np.ndarray  # (P, P) and their covariance


def simulated(scene: Scene, t: Trajectory, fit: Fit) -> Simulated | None:
    """A model that was fitted by least squares, without a random torque; None where it was fitted
    in segments, whose first states are unknowns of their own, and where slopes are too steep for
    arithmetic.

    **Raises:** `FitError` where no motion goes with the fit's numbers.
    """
    n, problem, prior = scene.n, fit.problem, t.prior
    if any(r.recording.segment_of is not None for r in fit.fitted):
        return None
    width = np.sqrt(scene.noise(t).variance[: fit.unknowns.states.shape[1]])
    mean = np.zeros(fit.unknowns.states.shape)
    mean[:, :n] = scene.q[scene.begins]
    P, (R, S) = len(prior.mean), mean.shape

    def known(at: Unknowns) -> tuple[np.ndarray, np.ndarray]:
        u = prior.regressors(np.asarray(problem.numbers(at)))
        states = (problem.states(at) - mean) / width
        shared = np.arange(R)[:, None] == 0  # numbers are known once
        numbers = problem.scale.numbers / prior.slopes(u)
        off = np.concatenate([shared * u, states], axis=1)
        return off, np.concatenate([shared * numbers, problem.scale.states / width], axis=1)

    try:
        mode = minimum(problem, fit.unknowns, known=known)
        x, by = known(mode.at)
        square = np.zeros((P + R * S,) * 2)  # in standard deviations of the priors
        for r in range(R):
            i = np.r_[0:P, P + r * S : P + (r + 1) * S]
            each = np.append(by[0, :P], by[r, P:])
            square[np.ix_(i, i)] += mode.square[r] / np.outer(each, each)
        factor = cho_factor(square, lower=True)
    except np.linalg.LinAlgError:
        return None
    off, g = 0.0, scene.grid
    for r, recording in enumerate(scene.recordings):
        at, size = g.of(r), len(recording.time)
        seen = np.isfinite(recording.angle) & ~scene.wild[r]
        predicted = g.of_readings(r, mode.predicted[r, :size], seen)
        off += np.sum(np.where(g.seen[at], (g.angle[at] - predicted) ** 2 / g.variance[at], 0.0))
    u = x[0, :P]
    log = scene.highest - 0.5 * (off + np.sum(x**2)) - np.log(np.diag(factor[0])).sum()
    covariance = cho_solve(factor, np.eye(len(square)))[:P, :P]  # pyrefly: ignore[bad-index]
    log += non_normal_priors(t.effects, prior, u, covariance)
    return Simulated(float(log), u, covariance)
