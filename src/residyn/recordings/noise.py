"""Noise is what is left of a reading when everything smooth is taken away.

Beyond the degree where a recording's polynomial spectrum turns flat there is nothing but noise, and
its level there is the sigma of one reading.
"""

import math

import numpy as np

from ..errors import InputError
from .arrays import check_table
from .outliers import outliers_of
from .polynomial_spectrum import blocks, grid_step, parts, scaled


def estimate_noise(time: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Sigma of one reading, per joint, from what is above the motion's band.

    Never below the rounding of an encoder or a printout (step/sqrt(12)), nor below 1e-5 of the rms
    motion, ten times what the steps of a diagnosis' filter err by: data without any noise still
    need a sigma. A joint that never moves shows no noise; it gets the largest of the others'.

    **Arguments:** `time` (N,) s; `angle` (N, n) rad or m, NaN where one is missing.

    **Returns:** (n,) rad or m, all positive.
    """
    return noise_and_warnings(time, angle)[0]


def noise_and_warnings(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """`estimate_noise`, and in words the joints whose noise could not be seen."""
    time, angle = check_table(time, angle)
    sigma, warnings, still = np.zeros(angle.shape[1]), [], []
    for j, column in enumerate(angle.T):
        seen, y, unit = scaled(column)
        if len(seen) < 8:
            raise InputError(f"q{j + 1} has fewer than 8 readings: too few to see their noise")
        if not unit:
            still.append(j)
            continue
        good = np.flatnonzero(~outliers_of(time[seen], y, 0.0))
        good = good if len(good) >= 8 else np.arange(len(y))
        spread = [blocks(time[seen[part]], y[part]).spread for part in parts(good)]
        rms = math.sqrt(float(np.mean(y**2)))
        own = max(float(np.median(spread)), grid_step(y) / math.sqrt(12))
        sigma[j] = unit * max(own, 1e-5 * rms)
        if own < 1e-9 * rms:  # digits of float64, no noise of a sensor
            warnings.append(
                f"noise of q{j + 1} could not be seen in the data; {sigma[j]:.3g} is taken, 1e-5 "
                "of its rms motion; give noise to say what it is"
            )
    for j in still:
        value = abs(float(angle[np.isfinite(angle[:, j]), j][0]))
        sigma[j] = sigma.max() if len(still) < len(sigma) else 1e-9 * max(value, 1.0)
        warnings.append(
            f"q{j + 1} never moves: all its readings are the same, so their noise cannot be seen; "
            f"{sigma[j]:.3g} is taken; give noise to say what it is"
        )
    return sigma, warnings
