"""When does the hand let go? When the joints begin to obey one law.

A braked arm in free motion has accelerations that follow from its angles and velocities alone, by
springs, dampers and friction whatever their sizes. A hand adds a force of its own. So learn the law
from the ring-down, linear in angle, velocity and the sign of velocity, and walk back from the end
to where the accelerations stop keeping to it.

Angles, velocities and accelerations come from one smoothing of the recording followed by central
differences. Smoothing and differences commute with a linear law, so they blur the instant a little
but do not bend the law.
"""

import math

import numpy as np

from ._input import InputError
from ._noise import wild_samples


def release_time(time: np.ndarray, angle: np.ndarray) -> float:
    """The time of a sample from which the motion is free and rings down.

    At an excursion's peak, or as soon after it as no force but the arm's own is left.

    **Arguments:** `time` (N,) s, increasing; `angle` (N, n) rad or m, NaN where a sample was lost.
    """
    time = np.asarray(time, dtype=float)
    angle = np.asarray(angle, dtype=float)
    angle = angle[:, None] if angle.ndim == 1 else angle
    if len(time) < 20 or (np.isfinite(angle).sum(axis=0) < 20).any():
        raise InputError('start = "release": too few readings to find where the free decay begins')
    clock, motion = _even(time, angle)
    motion = motion - np.median(motion[-max(len(motion) // 4, 1) :], axis=0)
    size = np.abs(motion).max(axis=0)
    if not size.any():
        raise InputError('start = "release": the joints never move; give start in seconds')
    motion = motion[:, size > 0] / size[size > 0]
    excursion = np.sqrt(np.mean(motion**2, axis=1))
    peak = int(excursion.argmax())
    # The joint that leads is back at rest a quarter of its period after it lets go, and in another
    # half period it comes back: by then no hand is on it.
    lead = int(np.abs(motion[peak]).argmax())
    side = motion[:, lead] * np.sign(motion[peak, lead])
    left = np.flatnonzero(side[peak:] <= 0)
    if not len(left):
        raise InputError(
            'start = "release": nothing rings down after the largest excursion '
            f"(at {clock[peak]:.6g} s); give start in seconds"
        )
    left = peak + int(left[0])
    held = peak + int(np.flatnonzero(side[peak:left] >= 0.98 * side[peak])[-1])
    back = np.flatnonzero(side[left:] > 0)
    back = left + int(back[0]) if len(back) else len(side)
    free = _last_breach(_breach(motion, max(1, (left - held) // 4)), left - held)
    if free > back:
        free = held  # the law itself is wrong, as in a large swing under gravity
    elif free < peak:
        # Thrown rather than let go: the decay begins where the throw ends.
        ahead = excursion[free:]
        falls = np.flatnonzero(np.diff(ahead) < 0)
        free += int(falls[0]) if len(falls) else 0
    return float(time[np.searchsorted(time, clock[free] - 1e-9 * (clock[1] - clock[0]))])


def _even(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The recording at equal steps, lost and wild readings filled in."""
    step = float(np.median(np.diff(time)))
    clock = time[0] + step * np.arange(math.floor((time[-1] - time[0]) / step + 1e-6) + 1)
    good = np.isfinite(angle) & ~wild_samples(time, angle)
    columns = [np.interp(clock, time[g], a[g]) for g, a in zip(good.T, angle.T, strict=True)]
    return clock, np.stack(columns, axis=1)


def _breach(motion: np.ndarray, w: int) -> np.ndarray:
    """How far each sample of `motion` (N, n) breaks the law of the ring-down; below 1, it keeps it.

    Smoothing and differences reach `w` samples.
    """
    pad = np.concatenate([np.repeat(motion[:1], 2 * w, 0), motion, np.repeat(motion[-1:], 2 * w, 0)])
    total = np.cumsum(np.concatenate([np.zeros_like(pad[:1]), pad]), axis=0)
    smooth = (total[w:] - total[:-w]) / w
    at = 2 * w - w // 2 + np.arange(len(motion))
    q, ahead, behind = smooth[at], smooth[at + w], smooth[at - w]
    v, a = ahead - behind, ahead - 2 * q + behind
    speed = np.sqrt(np.mean(v**2, axis=1))
    # A hand that holds still or pulls slowly has many samples but no speed; a quick pull is
    # outvoted in least absolute deviations.
    live = speed >= LIVE * speed.max()
    breach = np.zeros(len(q))
    for j in range(motion.shape[1]):
        sign = np.tanh(v[:, j] / (0.05 * np.abs(v[:, j]).max() + 1e-300))
        causes = np.column_stack([q, v, sign, np.ones(len(q))])
        weight, wrong, usual = np.ones((len(q), 1)), np.zeros(len(q)), 0.0
        for _ in range(15):
            law = np.linalg.lstsq((causes * weight)[live], a[live, j] * weight[live, 0], rcond=None)[0]
            wrong = np.abs(a[:, j] - causes @ law)
            usual = 1.4826 * float(np.median(wrong[live]))
            weight = 1 / np.sqrt(np.maximum(wrong, usual + 1e-12))[:, None]
        limit = max(SD * usual, ACC * float(np.abs(a[live, j]).max()), 1e-12)
        breach = np.maximum(breach, wrong / limit)
    return breach


def _last_breach(breach: np.ndarray, quarter: int) -> int:
    """The first sample after which the law is never broken again for most of a quarter period."""
    broken = np.concatenate([[0], np.cumsum(breach >= 1)])
    half = max(1, quarter // 2)
    low = np.maximum(np.arange(len(breach)) - half, 0)
    high = np.minimum(np.arange(len(breach)) + half + 1, len(breach))
    most = np.flatnonzero(broken[high] - broken[low] > 0.5 * (high - low))
    if not len(most):
        return 0
    free = int(most[-1])
    while free < len(breach) - 1 and breach[free] >= 1:
        free += 1
    return free
ACC=.05
SD=5
LIVE=.2
