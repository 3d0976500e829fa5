"""The paper's own way through step 1: ordinary least squares on Eq. 12 and 13.

It needs rates and accelerations, so the angle is smoothed, and the torque with it. What noise is
left in the acceleration pulls the inertia down, what motion is smoothed away is lost, and a braked
joint that gives is taken for rigid: this is the start of the weak form (`weak`), and stands beside.
"""

import math

import numpy as np
from scipy.signal import oaconvolve

from .driven import DrivenTest, kernel, smoothed


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
