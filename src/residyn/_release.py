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
    # From half its excursion to rest is a third of a quarter period.
    quarter = 3 * (left - peak - int(np.flatnonzero(side[peak:left] >= 0.5 * side[peak])[-1]))
    back = np.flatnonzero(side[left:] > 0)
    back = left + int(back[0]) if len(back) else len(side)
    free = _last_breach(_breach(motion, excursion, quarter)[: back + 1], quarter)
    if True:
        # Thrown rather than let go, it rises still: the decay begins where the throw ends.
        speed = np.sqrt(
            np.mean(np.gradient(_smooth(motion, max(1, quarter // 4))[0], axis=0) ** 2, axis=1)
        )
        falls = np.flatnonzero(np.diff(excursion[free:]) < 0)
        if speed[free] > TH * speed.max() and len(falls):
            free += int(falls[0])
    return float(time[np.searchsorted(time, clock[free] - 1e-9 * (clock[1] - clock[0]))])


def _even(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The recording at equal steps, lost and wild readings filled in."""
    step = float(np.median(np.diff(time)))
    clock = time[0] + step * np.arange(math.floor((time[-1] - time[0]) / step + 1e-6) + 1)
    good = np.isfinite(angle) & ~wild_samples(time, angle)
    columns = [np.interp(clock, time[g], a[g]) for g, a in zip(good.T, angle.T, strict=True)]
    return clock, np.stack(columns, axis=1)


def _breach(motion: np.ndarray, excursion: np.ndarray, quarter: int) -> np.ndarray:
    """How far each sample of `motion` (N, n) breaks the law of the ring-down; below 1, it keeps it.

    `quarter` is a quarter period in samples.
    """
    breach = np.zeros(len(motion))
    for part in (4, 2, 1):
        w = max(1, quarter // part)
        q, v, a = _smooth(motion, w)
        speed = np.sqrt(np.mean(v**2, axis=1))
        # A hand that holds still or pulls slowly has many samples but no speed; a quick pull is
        # outvoted in least absolute deviations.
        live = speed >= LIVE * speed.max()
        wrong, usual = _misfit(q, v, a, live)
        most = np.quantile(wrong[live], 0.9, axis=0)
        size = np.sqrt(np.mean(a[live] ** 2, axis=0))
        limit = np.maximum(np.maximum(SD * usual, Q9 * most), ACC * np.abs(a[live]).max(axis=0))
        breach = (wrong / np.maximum(limit, 1e-12)).max(axis=1)
        # A hand that holds still is one whatever the law says.
        breach[(speed < HS * speed.max()) & (excursion > HE * excursion.max())] = np.inf
        if (usual <= NZ * size).all():
            break
    return breach


def _smooth(motion: np.ndarray, w: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, velocity and acceleration (both per step), (N, n) each, over `w` samples each way."""
    pad = np.concatenate(
        [np.repeat(motion[:1], 2 * w, 0), motion, np.repeat(motion[-1:], 2 * w, 0)]
    )
    total = np.cumsum(np.concatenate([np.zeros_like(pad[:1]), pad]), axis=0)
    smooth = (total[w:] - total[:-w]) / w
    at = 2 * w - w // 2 + np.arange(len(motion))
    q, ahead, behind = smooth[at], smooth[at + w], smooth[at - w]
    return q, ahead - behind, ahead - 2 * q + behind


def _misfit(
    q: np.ndarray, v: np.ndarray, a: np.ndarray, live: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the law, learnt where `live`, leaves of the accelerations: (N, n) and usual size (n,)."""
    wrong = np.empty_like(a)
    for j in range(a.shape[1]):
        sign = np.tanh(v[:, j] / (0.05 * np.abs(v[:, j]).max() + 1e-300))
        causes = np.column_stack([q, v, sign, np.ones(len(q))])
        weight = np.ones((len(q), 1))
        for _ in range(15):
            law = np.linalg.lstsq(
                (causes * weight)[live], (a[:, j] * weight[:, 0])[live], rcond=None
            )
            wrong[:, j] = np.abs(a[:, j] - causes @ law[0])
            floor = np.median(wrong[live, j]) + 1e-12
            weight = 1 / np.sqrt(np.maximum(wrong[:, j], floor))[:, None]
    return wrong, 1.4826 * np.median(wrong[live], axis=0)


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


ACC = 0.05
LIVE = 0.2
SD = 4
Q9 = 1.5
HS = 0.1
HE = 0.3
NZ = 0.1
TH = 0.3
