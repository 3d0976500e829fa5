"""SciPy and lmfit on solve_ivp: what most people would write first.

Both integrate Eq. 1 in Python; neither has derivatives, so each Jacobian is nine simulations of
each recording. Unknowns are scaled to order one.
"""

import time

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from ._rivals_problem import Answer, Missing, Problem, TooSlow, rates

RTOL, ATOL = 1e-7, 1e-9
FAR = 1e3
"""The residual (sigma) where a simulation breaks off."""
DIFFERENCE = 1e-5
"""Relative step of finite differences: well above the integrator's own error."""


def residuals(given: Problem):
    """The whitened residual at (numbers / start, states), and the scales of both."""
    scale = np.concatenate([given.start, np.tile([0.1, 0.1, 0.5, 0.5], len(given.q))])
    inertia, ends = given.inertia.tolist(), (given.t[0], given.t[-1])
    began = time.perf_counter()

    def residual(z: np.ndarray) -> np.ndarray:
        if time.perf_counter() - began > given.limit:
            raise TooSlow
        y = z * scale
        parts = []
        for q, state in zip(given.q, y[4:].reshape(-1, 4), strict=True):
            args = (inertia, *y[:4].tolist())
            out = solve_ivp(rates, ends, state, "DOP853", given.t, args=args, rtol=RTOL, atol=ATOL)
            full = out.y.shape[1] == len(given.t)
            parts.append(
                ((out.y[:2].T - q) / given.noise).ravel() if full else np.full(q.size, FAR)
            )
        return np.concatenate(parts)

    first = np.concatenate([given.start, given.states.ravel()]) / scale
    return residual, first, scale


def answer(z: np.ndarray, scale: np.ndarray) -> Answer:
    """Scaled unknowns as an answer."""
    y = z * scale
    return Answer(y[:4], y[4:].reshape(-1, 4))


def fit_scipy(given: Problem) -> Answer:
    """`scipy.optimize.least_squares` with method "lm".

    Tried beside it, on the reference problem: within bounds ("trf") it takes longer, and without
    `x_scale="jac"` it seldom ends within a minute; RK45 takes twice as long as DOP853; LSODA is too
    uneven for differences and ends elsewhere.
    """
    residual, first, scale = residuals(given)
    out = least_squares(residual, first, method="lm", diff_step=DIFFERENCE, xtol=1e-8)
    return answer(out.x, scale)


def fit_lmfit(given: Problem) -> Answer:
    """`lmfit.Minimizer`, leastsq (MINPACK)."""
    try:
        import lmfit
    except ImportError as error:
        raise Missing("lmfit") from error
    residual, first, scale = residuals(given)
    parameters = lmfit.Parameters()
    for i, value in enumerate(first):
        parameters.add(f"x{i}", value=value, min=0.0 if i < 4 else -np.inf)  # k, c positive

    def of(found) -> np.ndarray:
        return residual(np.array([found[f"x{i}"].value for i in range(len(first))]))

    out = lmfit.Minimizer(of, parameters, calc_covar=False).leastsq(epsfcn=DIFFERENCE**2)
    return answer(np.array([out.params[f"x{i}"].value for i in range(len(first))]), scale)
