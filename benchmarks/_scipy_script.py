"""What `benchmarks.process` times beside the command: a script as people write it.

    python benchmarks/_scipy_script.py release.csv theta2 I1+m2*l1^2 I2 m2*l1*rho2 k1 k2 c1 c2

SciPy's `least_squares` on `solve_ivp` with DOP853, from given start values: the fastest combination
of `_rivals_scipy`. It stands alone, Eq. 1 included: what it imports is timed with it.
"""

import math
import sys

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

data = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1)
theta2, shoulder, d, s, *start = map(float, sys.argv[2:])
t, q = data[:, 0], data[:, 1:]


def rates(t, y, k1, k2, c1, c2):
    q1, q2, v1, v2 = y
    cross, bend = s * math.cos(theta2 + q2), s * math.sin(theta2 + q2)
    a, b = shoulder + d + 2 * cross, d + cross
    f1 = bend * (2 * v1 * v2 + v2 * v2) - k1 * q1 - c1 * v1
    f2 = -bend * v1 * v1 - k2 * q2 - c2 * v2
    det = a * d - b * b
    return v1, v2, (d * f1 - b * f2) / det, (a * f2 - b * f1) / det


scale = np.array([*start, 0.1, 0.1, 0.5, 0.5])


def residual(z, stop):
    y, now = z * scale, t[t <= t[0] + stop]
    out = solve_ivp(
        rates, (now[0], now[-1]), y[4:], "DOP853", now, args=tuple(y[:4]), rtol=1e-7, atol=1e-9
    )
    if out.y.shape[1] < len(now):
        return np.full(q[: len(now)].size, 1e3)
    return ((out.y[:2].T - q[: len(now)]) / 1e-3).ravel()


z = np.array([*start, *q[0], 0.0, 0.0]) / scale
for stop in (1.0, 4.0, np.inf):  # from 40 % off, all readings at once end in a wrong valley
    z = least_squares(residual, z, args=(stop,), method="lm", diff_step=1e-5, xtol=1e-8).x
print(*(z * scale)[:4])
