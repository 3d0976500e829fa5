"""The floor: what one arm costs when everything is written by hand and compiled by numba.

RK4 at the sampling interval, the sensitivities to the four numbers and the four initial values
integrated beside it, only J'J and J'r kept, Levenberg-Marquardt on those. One thread. It knows this
one model and nothing else: no other effect, no lost readings, no errors of the numbers.
"""

import numpy as np
from scipy.linalg import eigvalsh

from ._rivals_problem import Answer, Missing, Problem

try:
    from numba import njit
except ImportError as error:
    raise Missing("numba") from error

GROWTH = 3.0
"""By what a stretch is longer than the one before."""
FIRST = 0.6
"""Length of the first stretch, in periods of the slower mode at the start: short enough that no
phase slips by half a cycle in it."""


@njit(fastmath=True)
def stage(q1, q2, v1, v2, s, p, inertia, ds):
    """Accelerations, and of the sensitivities s (4, 8) their second derivatives ds (2, 8)."""
    d, theta2 = inertia[1], inertia[3]
    cross, bend = inertia[2] * np.cos(theta2 + q2), inertia[2] * np.sin(theta2 + q2)
    a, b = inertia[0] + d + 2.0 * cross, d + cross
    scale = 1.0 / (a * d - b * b)
    i11, i12, i22 = d * scale, -b * scale, a * scale
    f1 = bend * v2 * (2.0 * v1 + v2) - p[0] * q1 - p[2] * v1
    f2 = -bend * v1 * v1 - p[1] * q2 - p[3] * v2
    a1, a2 = i11 * f1 + i12 * f2, i12 * f1 + i22 * f2
    # Z da = df - dZ a: both sides' slopes in q2, v1 and v2, then through the inverse inertia.
    q1_1 = -p[0]
    q2_1 = cross * v2 * (2.0 * v1 + v2) + bend * (2.0 * a1 + a2)
    q2_2 = -cross * v1 * v1 - p[1] + bend * a1
    v1_1, v1_2 = 2.0 * bend * v2 - p[2], -2.0 * bend * v1
    v2_1, v2_2 = 2.0 * bend * (v1 + v2), -p[3]
    m11, m12 = i11 * q1_1, i11 * q2_1 + i12 * q2_2
    m13, m14 = i11 * v1_1 + i12 * v1_2, i11 * v2_1 + i12 * v2_2
    m21, m22 = i12 * q1_1, i12 * q2_1 + i22 * q2_2
    m23, m24 = i12 * v1_1 + i22 * v1_2, i12 * v2_1 + i22 * v2_2
    for j in range(8):
        ds[0, j] = m11 * s[0, j] + m12 * s[1, j] + m13 * s[2, j] + m14 * s[3, j]
        ds[1, j] = m21 * s[0, j] + m22 * s[1, j] + m23 * s[2, j] + m24 * s[3, j]
    ds[0, 0] -= i11 * q1
    ds[1, 0] -= i12 * q1
    ds[0, 1] -= i12 * q2
    ds[1, 1] -= i22 * q2
    ds[0, 2] -= i11 * v1
    ds[1, 2] -= i12 * v1
    ds[0, 3] -= i12 * v2
    ds[1, 3] -= i22 * v2
    return a1, a2


@njit(fastmath=True)
def normal(p, state, readings, dt, inertia, square, slope):
    """J'J (8, 8), J'r (8,) and r'r of one recording."""
    q1, q2, v1, v2 = state[0], state[1], state[2], state[3]
    s = np.zeros((4, 8))
    for i in range(4):
        s[i, 4 + i] = 1.0
    mid = np.empty((4, 8))
    k1, k2 = np.empty((2, 8)), np.empty((2, 8))
    k3, k4 = np.empty((2, 8)), np.empty((2, 8))
    square[:] = 0.0
    slope[:] = 0.0
    total, h, sixth = 0.0, dt, dt / 6.0
    for n in range(len(readings)):
        r1, r2 = q1 - readings[n, 0], q2 - readings[n, 1]
        total += r1 * r1 + r2 * r2
        for i in range(8):
            x, y = s[0, i], s[1, i]
            slope[i] += x * r1 + y * r2
            for j in range(8):
                square[i, j] += x * s[0, j] + y * s[1, j]
        a1, a2 = stage(q1, q2, v1, v2, s, p, inertia, k1)
        for j in range(8):
            mid[0, j] = s[0, j] + 0.5 * h * s[2, j]
            mid[1, j] = s[1, j] + 0.5 * h * s[3, j]
            mid[2, j] = s[2, j] + 0.5 * h * k1[0, j]
            mid[3, j] = s[3, j] + 0.5 * h * k1[1, j]
        w1, w2 = v1 + 0.5 * h * a1, v2 + 0.5 * h * a2
        b1, b2 = stage(q1 + 0.5 * h * v1, q2 + 0.5 * h * v2, w1, w2, mid, p, inertia, k2)
        for j in range(8):
            mid[0, j] = s[0, j] + 0.5 * h * s[2, j] + 0.25 * h * h * k1[0, j]
            mid[1, j] = s[1, j] + 0.5 * h * s[3, j] + 0.25 * h * h * k1[1, j]
            mid[2, j] = s[2, j] + 0.5 * h * k2[0, j]
            mid[3, j] = s[3, j] + 0.5 * h * k2[1, j]
        x1, x2 = v1 + 0.5 * h * b1, v2 + 0.5 * h * b2
        c1, c2 = stage(q1 + 0.5 * h * w1, q2 + 0.5 * h * w2, x1, x2, mid, p, inertia, k3)
        for j in range(8):
            mid[0, j] = s[0, j] + h * s[2, j] + 0.5 * h * h * k2[0, j]
            mid[1, j] = s[1, j] + h * s[3, j] + 0.5 * h * h * k2[1, j]
            mid[2, j] = s[2, j] + h * k3[0, j]
            mid[3, j] = s[3, j] + h * k3[1, j]
        y1, y2 = v1 + h * c1, v2 + h * c2
        d1, d2 = stage(q1 + h * x1, q2 + h * x2, y1, y2, mid, p, inertia, k4)
        for j in range(8):
            s[0, j] += h * s[2, j] + h * sixth * (k1[0, j] + k2[0, j] + k3[0, j])
            s[1, j] += h * s[3, j] + h * sixth * (k1[1, j] + k2[1, j] + k3[1, j])
            s[2, j] += sixth * (k1[0, j] + 2.0 * (k2[0, j] + k3[0, j]) + k4[0, j])
            s[3, j] += sixth * (k1[1, j] + 2.0 * (k2[1, j] + k3[1, j]) + k4[1, j])
        q1 += sixth * (v1 + 2.0 * (w1 + x1) + y1)
        q2 += sixth * (v2 + 2.0 * (w2 + x2) + y2)
        v1 += sixth * (a1 + 2.0 * (b1 + c1) + d1)
        v2 += sixth * (a2 + 2.0 * (b2 + c2) + d2)
    return total


@njit(fastmath=True)
def gather(z, readings, count, dt, inertia, square, slope):
    """J'J, J'r and r'r of all recordings' first `count` readings, in logs of the numbers."""
    p = np.exp(z[:4])
    total = 0.0
    square[:] = 0.0
    slope[:] = 0.0
    one, its = np.empty((8, 8)), np.empty(8)
    for r in range(len(readings)):
        first = 4 + 4 * r
        state = z[first : first + 4]
        total += normal(p, state, readings[r, :count], dt, inertia, one, its)
        for i in range(8):
            row, left = (i, p[i]) if i < 4 else (first + i - 4, 1.0)
            slope[row] += left * its[i]
            for j in range(8):
                column, right = (j, p[j]) if j < 4 else (first + j - 4, 1.0)
                square[row, column] += left * right * one[i, j]
    return total


@njit
def descend(z, readings, count, dt, inertia, tolerance, most):
    """Levenberg-Marquardt until a step would lower r'r by less than a share of it; its count."""
    size = len(z)
    square, slope = np.empty((size, size)), np.empty(size)
    square_, slope_ = np.empty((size, size)), np.empty(size)
    total = gather(z, readings, count, dt, inertia, square, slope)
    damping, taken = 1e-3, 1
    while taken < most:
        damped = square.copy()
        for i in range(size):
            damped[i, i] += damping * square[i, i] + 1e-300
        step = np.linalg.solve(damped, -slope)
        for i in range(4):
            step[i] = min(max(step[i], -1.0), 1.0)
        promise = -2.0 * step @ slope - step @ (square @ step)
        new = z + step
        total_ = gather(new, readings, count, dt, inertia, square_, slope_)
        taken += 1
        if total_ < total:
            gain = (total - total_) / max(promise, 1e-300)
            square, square_ = square_, square
            slope, slope_ = slope_, slope
            z, total = new, total_
            damping = max(1e-9, damping * (0.1 if gain > 0.75 else 0.5))
            if promise < tolerance * total:
                break
        elif promise < tolerance * total or damping > 1e12:
            break
        else:
            damping *= 8.0
    return z, total, taken


def stretches(given: Problem) -> list[int]:
    """How many readings are fitted first, next, ..., all of them."""
    shoulder, elbow, s, theta2 = given.inertia
    cross = s * np.cos(theta2)
    mass = np.array([[shoulder + elbow + 2 * cross, elbow + cross], [elbow + cross, elbow]])
    slowest = np.sqrt(np.min(eigvalsh(np.diag(given.start[:2]), mass)))
    count, found = FIRST * 2 * np.pi / slowest / (given.t[1] - given.t[0]), []
    while count < 0.7 * len(given.t):
        found.append(int(count))
        count *= GROWTH
    return [*found, len(given.t)]


def fit(given: Problem, counts: list[int] | None = None) -> Answer:
    """Fit by hand-written code, over growing stretches, or over those given."""
    z = np.concatenate([np.log(given.start), given.states.ravel()])
    dt, evaluations = float(given.t[1] - given.t[0]), 0
    counts = counts or stretches(given)
    for count in counts:
        last = count == counts[-1]
        tolerance, most = (1e-7, 100) if last else (1e-2, 20)
        z, _, taken = descend(z, given.q, count, dt, given.inertia, tolerance, most)
        evaluations += taken * count
    return Answer(np.exp(z[:4]), z[4:].reshape(-1, 4), {"evaluations": evaluations / len(given.t)})


def fit_directly(given: Problem) -> Answer:
    """The same, over all readings from the first step on."""
    return fit(given, [len(given.t)])
