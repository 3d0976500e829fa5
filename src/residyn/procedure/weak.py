"""Eq. 10 and 11 in weak form: inertia and friction of one driven test, without differentiation.

Through a smooth kernel K the measured angle gives K*q, K'*q and K''*q, and the torque K*u: all of
them passed the same filter, so that the equation of motion still holds between them,

    K*u = I K''*q + fc sign(q') + fv K'*q + f0 + (what the braked joint's give asks for).

Both readings have noise. The residual of a row is then a known linear map of white noise: of the
torque through K, of the angle through I K'' + fv K'. Its covariance S depends on the unknowns, and
least squares on S^(-1/2) times the residual is the maximum likelihood of the readings with the true
motion left free: the noise of the acceleration does not pull the inertia down, whatever the kernel.

The paper's own way, ordinary least squares on Eq. 12 and 13, needs rates and accelerations, so the
angle is smoothed, and the torque with it. What noise is left in the acceleration pulls the inertia
down, what motion is smoothed away is lost, and a braked joint that gives is taken for rigid: it is
the start of the weak form, and stands beside.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded
from scipy.optimize import least_squares
from scipy.signal import oaconvolve
from scipy.special import chdtrc

from ..fitting import FitError
from ..fitting.covariance import spread_of
from .driven import DrivenTest, kernel, smoothed

_MOST_ROWS = 500
_PER_REVERSAL = 16  # rows between two reversals, at least, so that few of them see one
_LEAST_ROWS = 12
_ONE_WAY = 0.03
"""A smaller share of rows with the other sign cannot tell dry friction from an offset."""
_BAND = 5  # rows ahead with which one shares readings
_STANDS_OUT = 3.0  # standard errors from zero which an inertia must be
CALIBRATED = 1e-3
"""Probability below which the residual is more than noise, and errors are enlarged."""


def ordinary(test: DrivenTest) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 12 and 13 as they stand: acceleration, sign and rate against torque, by least squares.

    All through one kernel, the narrowest that keeps the noise of the acceleration to a hundredth of
    the acceleration, unless that would smooth away the motion.

    **Returns:** (3,) inertia, Coulomb, viscous; (3,) standard errors.
    """
    dt, noise = test.grid.dt, float(test.recording.noise[test.joint])
    widest = max(2, len(test.rate) // (12 * (test.reversals + 1)))
    knot = 2
    while True:
        pass_ = kernel(knot, dt)
        a = oaconvolve(test.angle, pass_[2], "valid")
        if noise * np.linalg.norm(pass_[2]) < 0.01 * np.std(a) or knot == widest:
            break
        knot = min(math.ceil(1.25 * knot), widest)
    sign = np.sign(smoothed(test.angle, knot, dt)[1])
    columns = [a, oaconvolve(sign, pass_[0], "valid"), oaconvolve(test.angle, pass_[1], "valid")]
    columns = np.stack(columns, axis=1)
    torque = oaconvolve(test.grid.drive[:, test.joint], pass_[0], "valid")
    values, *_ = np.linalg.lstsq(columns, torque, rcond=None)
    # Smoothed rows go together: as many are free as there are kernels beside each other.
    per_free = 1 / float(pass_[0] @ pass_[0])
    left = torque - columns @ values
    variance = float(left @ left) / max(1.0, len(left) / per_free - 3)
    spread = np.linalg.pinv(columns.T @ columns) * variance
    return values, np.sqrt(np.diag(spread))


class Rows(NamedTuple):
    """One driven test through kernels at K places, and how noise enters. The inertias are shoulder,
    elbow and coupling."""

    torque: np.ndarray  # (K,) N m
    # (K, P) of composite inertia, Coulomb, viscous and, if it can be told apart, offset
    columns: np.ndarray
    given: np.ndarray  # (K, 3) of the inertias: what the braked joint's give adds to the torque
    between: np.ndarray  # (K, 3) of the inertias: that between the joints, Z12 of Eq. 2
    covariance: np.ndarray  # (3, 6, K) of noise through K, K', K'': its diagonal and those below


class Solved(NamedTuple):
    """The numbers of one test, (P,): composite inertia, Coulomb, viscous, offset."""

    values: np.ndarray
    std: np.ndarray
    chi2: float  # per degree of freedom: 1 is noise alone
    enlarged: bool  # whether the errors were, since the residual is more than noise


def rows_of(test: DrivenTest, l1: float) -> Rows:
    """Put kernels on a test; `l1` in m.

    **Raises:** `FitError` if too little of the motion is left between its reversals and gaps.
    """
    count, dt = len(test.grid.q), test.grid.dt
    knot = max(1, round(count / max(_MOST_ROWS, _PER_REVERSAL * (test.reversals + 1))))
    half = 3 * knot
    centre = np.arange(half, count - half, knot)
    unclear = np.concatenate([[0], np.cumsum(~test.clear)])
    centre = centre[unclear[centre + half + 1] == unclear[centre - half]]
    if len(centre) < _LEAST_ROWS:
        raise FitError(
            f"{test.name}: too little steady sliding between reversals and lost samples "
            f"({len(centre)} usable stretches of {2 * half * dt:.2g} s, at least {_LEAST_ROWS} are "
            "needed): drive more slowly, sample faster, or record for longer"
        )
    kernels = kernel(knot, dt)
    window = centre[:, None] + np.arange(-half, half + 1)

    def through(derivative: int, column: np.ndarray) -> np.ndarray:
        return column[window] @ kernels[derivative][::-1]  # a convolution runs backwards

    q = test.angle - np.mean(test.angle)
    sign = np.sign(test.rate[centre])
    columns = [through(2, q), sign, through(1, q), np.ones(len(centre))]
    if min(np.mean(sign > 0), np.mean(sign < 0)) < _ONE_WAY:
        columns.pop()
    given, bend = _given(test, l1, knot, through)
    between = np.stack([0 * sign, 0 * sign + 1, l1 * bend[centre]], axis=1)
    ahead = [np.pad(centre[d:], (0, d), constant_values=10**9) for d in range(_BAND + 1)]
    lags = np.minimum(np.stack(ahead) - centre, 2 * half + 1)
    shared = [np.append(np.correlate(k, k, "full"), 0.0)[2 * half :] for k in kernels]
    covariance = np.stack([each[lags] for each in shared])
    torque = through(0, test.grid.drive[:, test.joint])
    return Rows(torque, np.stack(columns, axis=1), given, between, covariance)


def _given(test: DrivenTest, l1: float, knot: int, through) -> tuple[np.ndarray, np.ndarray]:
    """What Eq. 2 and 3 have beyond the composite inertia: the brake gives, the elbow turns.

    Derivatives are moved onto the kernel: of c q'' they leave (c q)'' - 2 (c' q)' + c'' q, where
    only the small c', c'' = d/dt cos(theta2 + q2) need a smoothed rate.
    """
    q, other = test.angle - np.mean(test.angle), test.braked - np.mean(test.braked)
    turn, rate, acceleration = smoothed(test.grid.q[:, 1], knot, test.grid.dt)
    turn = turn + test.recording.theta2
    c, s = np.cos(turn), np.sin(turn)
    slope = -s * rate
    if test.joint == 0:  # momentum of the shoulder, whose angle no energy depends on
        all_ = 2 * q + other
        whole = through(2, c * all_) - through(1, slope * all_)
        coupling = whole - 2 * math.cos(test.theta2) * through(2, q)
    else:
        give = smoothed(other, knot, test.grid.dt)[1]
        bend = -c * rate**2 - s * acceleration
        coupling = through(2, c * other) - 2 * through(1, slope * other)
        coupling = coupling + through(0, bend * other + s * give**2)
    return np.stack([0 * coupling, through(2, other), l1 * coupling], axis=1), c


def solve(test: DrivenTest, rows: Rows, begin: np.ndarray, arm: np.ndarray) -> Solved:
    """Composite inertia and friction of one test, from a start (3,) for its first numbers.

    `arm` is (shoulder, elbow, coupling), good enough for the braked joint's small part.

    **Raises:** `FitError` if the test does not determine its inertia.
    """
    noise, columns = test.recording.noise, rows.columns
    torque = rows.torque - rows.given @ arm
    # An encoder that shows no motion of the braked joint shows no noise either.
    seen = noise[1 - test.joint] if np.ptp(test.braked) else 0.0
    gain = seen * (rows.between @ arm)
    ahead = np.stack([np.append(gain[d:], gain[:d]) for d in range(_BAND + 1)])
    still = test.torque_noise**2 * rows.covariance[0] + gain * ahead * rows.covariance[2]
    moving = noise[test.joint] ** 2 * rows.covariance

    def whitened(values: np.ndarray) -> np.ndarray:
        own = values[0] ** 2 * moving[2] + values[2] ** 2 * moving[1]
        factor = np.asarray(cholesky_banded(still + own, lower=True, check_finite=False))
        residual = torque - columns @ values
        return solve_banded((_BAND, 0), factor, residual, check_finite=False)  # pyrefly: ignore

    sizes = np.linalg.norm(torque) / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    start = np.zeros(columns.shape[1])
    start[: len(begin)] = begin
    try:
        found = least_squares(lambda x: whitened(x * sizes), start / sizes, jac="3-point")
    except ValueError:  # LinAlgError is one
        raise FitError(f"{test.name}: its equations could not be solved") from None
    free = max(1, len(torque) - len(sizes))
    chi2 = 2 * found.cost / free
    inflation, enlarged = _inflation(found.fun, found.jac, chi2, free)
    factor = np.asarray(np.linalg.qr(found.jac, mode="r"))
    spread = spread_of(factor[np.newaxis], sizes, inflation)
    values = found.x * sizes
    if values[0] < -_STANDS_OUT * spread.std[0]:
        raise FitError(
            f"{test.name}: its inertia comes out negative, {values[0]:.3g} kg m^2: "
            f"u{test.joint + 1} must be positive where it turns q{test.joint + 1} up"
        )
    if not np.isfinite(spread.std[0]) or values[0] < _STANDS_OUT * spread.std[0]:
        raise FitError(
            f"{test.name}: the torque of accelerating does not stand out from friction and noise: "
            "drive it faster, or for longer"
        )
    return Solved(values, spread.std, chi2, enlarged)


def _inflation(
    residual: np.ndarray, slopes: np.ndarray, chi2: float, free: int
) -> tuple[float, bool]:
    """By how much the variances of white noise are too small, if the residual shows that they are.

    Rows whose residuals go together hold less than as many free ones: the variance of the score
    then says how much less (Newey and West).
    """
    lags = max(1, round(1.5 * len(residual) ** (1 / 3)))
    whole = float(residual @ residual)
    together = np.array([residual[d:] @ residual[:-d] for d in range(1, lags + 1)]) / whole
    if chdtrc(free, whole) > CALIBRATED and chdtrc(lags, free * together @ together) > CALIBRATED:
        return max(1.0, chi2), False
    # The score of the inertia alone, friction taken out.
    rest, inertia = slopes[:, 1:], slopes[:, 0]
    alone = inertia - rest @ np.linalg.lstsq(rest, inertia, rcond=None)[0]
    score = alone * residual
    total = float(score @ score)
    for d in range(1, lags + 1):
        total += 2 * (1 - d / (lags + 1)) * float(score[d:] @ score[:-d])
    return max(1.0, chi2, total / max(float(alone @ alone), 1e-300)), True
