"""The evidence of a model without a random torque, by exact simulation.

A filter linearises. Where something sticks, its motion creeps a little where the true one holds,
and what should need no random torque seems to need some. Without one the motion follows from its
numbers and first states alone, so the evidence is an integral over these: Laplace's method about
the least-squares fit, whose residual and slopes are those of an exact simulation (MacKay,
Information Theory, Inference and Learning Algorithms, 2003, ch. 27). Readings, priors and scale are
the filter's.
"""

import math

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..filtering.kalman import Evidences
from ..filtering.trajectory import Scene, Trajectory
from ..fitting.result import Fit
from .evidence import half_normals
from .linearised_fit import LinearisedFit, minimum


def log_evidence(scene: Scene, t: Trajectory, fit: Fit) -> float:
    """Log evidence of a model that was fitted by least squares, without a random torque; NaN where
    it was fitted in segments, whose first states are unknowns of their own, and where a shape ran
    to where slopes are too steep for arithmetic (Stribeck's velocity to nothing)."""
    near, n = LinearisedFit.of(fit), scene.n
    if any(r.recording.segment_of is not None for r in near.fitted):
        return math.nan
    found, scale = minimum(near.problem, near.at, most=0), near.problem.scale
    P, S = len(near.at.numbers), np.shape(near.at.states)[1]
    R, states = len(near.fitted), np.asarray(near.problem.states(near.at))
    u = t.prior.regressors(np.asarray(near.problem.numbers(near.at)))
    per_u = t.prior.slopes(u) / np.asarray(scale.numbers)
    width = np.sqrt(scene.noise(t).variance[:S])
    known = np.append(np.zeros(P + 2 * n), np.ones(S - 2 * n))  # to the fit, of internal states
    # All unknowns in standard deviations of their priors: where they are, and the fit's J'J, J'r.
    x, square, slope = u, np.zeros((P + R * S,) * 2), np.zeros(P + R * S)
    fixed, off, g = 0.0, 0.0, scene.grid
    for r, recording in enumerate(scene.recordings):
        each = np.append(per_u, width / np.asarray(scale.states)[r])
        own = np.append(np.zeros(P), np.asarray(near.at.states)[r])
        i = np.r_[0:P, P + r * S : P + (r + 1) * S]
        square[np.ix_(i, i)] += (found.square[r] - np.diag(known)) * np.outer(each, each)
        slope[i] += (found.slope[r] - known * own) * each
        mean = np.append(scene.q[scene.begins[r]], np.zeros(S - n))
        x = np.append(x, (states[r] - mean) / width)
        at, size = g.of(r), len(recording.time)
        predicted = g.of_readings(r, recording.time, found.predicted[r, :size])
        seen, variance = g.seen[at], g.variance[at]
        off += np.sum(np.where(seen, (g.angle[at] - predicted) ** 2 / variance, 0.0))
        fixed += np.sum(np.where(seen, np.log(2 * np.pi * variance), 0.0))
    try:
        factor = cho_factor(square + np.eye(len(square)), lower=True)
    except np.linalg.LinAlgError:
        return math.nan
    step = cho_solve(factor, slope + x)  # from the fit to the posterior mean
    size = 2 * np.log(np.diag(factor[0])).sum()
    log = -0.5 * (off + fixed + x @ x - (slope + x) @ step + size)
    mean, std = np.zeros((1, len(t.u))), np.ones((1, len(t.u)))
    variance = np.diag(cho_solve(factor, np.eye(len(square))))
    mean[0, :P], std[0, :P] = (x - step)[:P], np.sqrt(variance[:P])
    return float(log + half_normals(t.effects, t.prior, Evidences(None, mean, std))[0])
