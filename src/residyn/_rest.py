"""Where an arm that rings would come to rest.

The mean of a ring-down is not its rest: the last swing is cut off anywhere, and an elbow that
swings wide pulls the mean aside. So the law of the motion is learnt, accelerations from angles and
rates to second order, and rest is where it asks for none.
"""

import numpy as np

from ._release import _even, _smooth

_LIVE = 0.05
"""Of the largest pace: slower samples may stick, anywhere."""


def rest_angles(time: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(n,) rad: angles at rest, from a ring-down (N, n) rad at times (N,) s, NaN where lost."""
    _clock, motion = _even(time, angle)
    middle = np.median(motion, axis=0)
    size = np.abs(motion - middle).max(axis=0)
    moving = size > 1e-9
    if not moving.any():
        return middle
    x = (motion - middle)[:, moving] / size[moving]
    # A quarter of the fastest joint's period is all that is smoothed.
    turns = max(int((np.diff(np.sign(column)) != 0).sum()) for column in _calm(x).T)
    q, v, a = _smooth(x, max(1, len(x) // (4 * max(turns, 1))))
    pace = np.sqrt(np.mean(v**2, axis=1))
    live = np.flatnonzero(pace >= _LIVE * pace.max())
    at = _balance(q[live], v[live], a[live])
    rest = middle.copy()
    # A law that is led astray does not put rest where the arm has never been.
    believed = (np.abs(at) < 0.5) & np.isfinite(at)
    rest[moving] += np.where(believed, at, q.mean(axis=0)) * size[moving]
    return rest


def _calm(x: np.ndarray) -> np.ndarray:
    """Sign changes of noise alone do not count: small values take the sign before them."""
    kept = np.where(np.abs(x) > 0.05, x, np.nan)
    for column in kept.T:
        seen = ~np.isnan(column)
        last = np.maximum.accumulate(np.where(seen, np.arange(len(column)), 0))
        column[:] = column[last]
    return np.nan_to_num(kept, nan=1.0)


def _balance(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """The angles at which the law learnt from these samples, (N, n) each, has no acceleration."""
    n = q.shape[1]
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    sign = np.tanh(v / np.maximum(0.05 * np.abs(v).max(axis=0), 1e-300))
    bent = np.stack([q[:, i] * q[:, j] for i, j in pairs], axis=1)
    swung = np.stack([v[:, i] * v[:, j] for i, j in pairs], axis=1)
    causes = np.column_stack([np.ones(len(q)), q, bent, v, swung, sign])
    scale = np.maximum(np.abs(causes).max(axis=0), 1e-300)
    weight, law = np.ones(len(q)), np.zeros((causes.shape[1], n))
    for _ in range(10):  # least absolute deviations: a quick pull is outvoted
        root = np.sqrt(weight)[:, None]
        law = np.linalg.lstsq(causes / scale * root, a * root, rcond=1e-8)[0] / scale[:, None]
        left = np.linalg.norm(a - causes @ law, axis=1)
        weight = 1 / np.maximum(left, np.median(left) + 1e-12)
    at = np.zeros(n)
    for _ in range(20):  # Newton, from the middle
        value = np.concatenate([[1.0], at, [at[i] * at[j] for i, j in pairs]])
        slope = law[1 : n + 1].copy()
        for k, (i, j) in enumerate(pairs):
            slope[i] += law[n + 1 + k] * at[j]
            slope[j] += law[n + 1 + k] * at[i]
        at = at - np.linalg.pinv(slope.T, rcond=1e-3) @ (law[: len(value)].T @ value)
    return at
