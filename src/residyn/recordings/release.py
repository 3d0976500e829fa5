"""When does the hand let go? When the joints begin to obey one law.

A braked arm in free motion has accelerations that follow from its angles and velocities alone, by
springs, dampers and friction whatever their sizes. A hand adds a force of its own. So learn the law
from the ring-down, linear in angle, velocity and the sign of velocity, and find the last instant,
before the swing that follows the largest excursion is over, at which the accelerations break it.
Where several joints move, the inertia of one depends on the angles of others. To second order that
adds products of two angles and of two velocities: a tenth of the acceleration of an arm let go with
its elbow bent, which without them would be a hand's.

Angles, velocities and accelerations come from one smoothing of the recording followed by central
differences. Smoothing and differences commute with a linear law: they blur the instant a little,
towards a later one, but do not bend the law. They bend its products, the less the shorter they are.
"""

from typing import Any

import numpy as np

from ..errors import InputError, number, quote
from .arrays import LEAST, check_enough, check_table
from .resampling import evenly_sampled, moving_means


def window(time: np.ndarray, angle: np.ndarray, start: Any, stop: Any) -> slice:
    """The samples from `start` to `stop`, in s or None; `start` may be "release"."""
    if len(time) < LEAST:
        check_enough(angle, part=False)
    step = float(np.median(np.diff(time)))
    # A stop of 20 s belongs to 2000 samples at 100 Hz, the last of which is at 19.99 s.
    room, hair = 2 * step, 1e-6 * step
    within = f"must be within the recording, {time[0]:g} to {time[-1]:g} s on its own clock"
    high = len(time)
    if stop is not None:
        stop = number("stop", stop, "s")
        if not time[0] <= stop <= time[-1] + room:
            raise InputError(f"stop = {stop:g} s: {within}")
        high = int(np.searchsorted(time, stop + hair, side="right"))
    if isinstance(start, str):
        if start != "release":
            raise InputError(f'start = {quote(start)}: must be a number (s) or "release"')
        check_enough(angle[:high], part=True)
        start = release_time(time[:high], angle[:high])
    elif start is not None:
        start = number("start", start, "s")
        if not time[0] - room <= start <= time[-1]:
            raise InputError(f"start = {start:g} s: {within}")
        if stop is not None and start >= stop:
            raise InputError(f"start = {start:g} s: must be before stop = {stop:g} s")
    return slice(0 if start is None else int(np.searchsorted(time, start - hair)), high)


def release_time(time: np.ndarray, angle: np.ndarray) -> float:
    """The time of a sample from which the motion is free and rings down.

    It is the largest excursion, or as soon after it as no force but the arm's own is left; where
    several joints are let go from rest, their release.

    **Arguments:** `time` (N,) s, increasing; `angle` (N, n) rad or m, NaN where one is missing.
    """
    time, angle = check_table(time, angle)
    check_enough(angle, part=False)
    clock, motion = evenly_sampled(time, angle)
    motion = motion - np.median(motion[-(len(motion) // 4) :], axis=0)
    size = np.abs(motion).max(axis=0)
    if size.max() < 1e-100:
        raise InputError('start = "release": the joints never move; give start in seconds')
    motion = motion[:, size > 1e-100] / size[size > 1e-100]
    excursion = np.sqrt(np.mean(motion**2, axis=1))
    peak = int(excursion.argmax())

    # The joint that leads returns to rest, swings through and comes back: then no hand is on it.
    lead = int(np.abs(motion[peak]).argmax())
    side = motion[:, lead] * np.sign(motion[peak, lead])
    rest = np.flatnonzero(side[peak:] <= 0)
    if not len(rest):
        raise InputError(
            'start = "release": nothing rings down after the largest excursion '
            f"(at {clock[peak]:.6g} s); give start in seconds"
        )
    rest = peak + int(rest[0])
    back = np.flatnonzero(side[rest:] > 0)
    back = rest + int(back[0]) if len(back) else len(side) - 1

    # From half the excursion to rest takes a third of a quarter period, however long it was held.
    quarter = 3 * (rest - peak - int(np.flatnonzero(side[peak:rest] >= 0.5 * side[peak])[-1]))
    broken = _broken(motion, excursion, quarter)[: back + 1]
    free = _after_last(broken, quarter)

    # Thrown rather than let go, it is moving and still rises: wait for the end of the rise.
    place, speed, _ = _smooth(motion, max(1, quarter // 4))
    pace = np.sqrt(np.mean(speed**2, axis=1))
    falls = np.flatnonzero(np.diff(np.sum(place[free:] ** 2, axis=1)) < 0)
    if pace[free] > 0.1 * pace.max() and len(falls):
        free += int(falls[0])
    return float(time[np.searchsorted(time, clock[free] - 1e-6 * (clock[1] - clock[0]))])


def _broken(motion: np.ndarray, excursion: np.ndarray, quarter: int) -> np.ndarray:
    """Which samples of `motion` (N, n) break the law of the ring-down."""
    broken = np.zeros(len(motion), dtype=bool)
    # As little smoothing as the noise allows, and half of that where it bends products.
    for part in (4, 2, 1) if motion.shape[1] == 1 else (8, 4, 2, 1):
        q, v, a = _smooth(motion, max(1, quarter // part))
        pace = np.sqrt(np.mean(v**2, axis=1))
        # A hand that holds still or pulls slowly has many samples but no speed: do not learn there.
        live = np.flatnonzero(pace >= 0.2 * pace.max())
        live = live[:: max(1, len(live) // 5000)]
        wrong = _misfit(q, v, a, live)
        usual = 1.4826 * np.median(wrong[live], axis=0)
        bent = np.quantile(wrong[live], 0.9, axis=0)  # of a law that is a little wrong
        limit = np.max([3.5 * usual, 1.5 * bent, 0.05 * np.abs(a[live]).max(axis=0)], axis=0)
        held = (pace < 0.2 * pace.max()) & (excursion > 0.3 * excursion.max())
        broken = (wrong > limit + 1e-12).any(axis=1) | held
        if (usual <= 0.3 * np.sqrt(np.mean(a[live] ** 2, axis=0))).all():
            break
    return broken


def _smooth(motion: np.ndarray, w: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, velocity and acceleration, (N, n) each, by mean and differences over `w` samples."""
    pad = np.pad(motion, ((2 * w, 2 * w), (0, 0)), mode="edge")
    mean = moving_means(pad, w)
    at = 2 * w - w // 2 + np.arange(len(motion))
    q, ahead, behind = mean[at], mean[at + w], mean[at - w]
    return q, ahead - behind, ahead - 2 * q + behind


def _misfit(q: np.ndarray, v: np.ndarray, a: np.ndarray, live: np.ndarray) -> np.ndarray:
    """What the law, learnt from the samples `live`, leaves of the accelerations: (N, n)."""
    wrong = np.empty_like(a)
    one, other = np.triu_indices(q.shape[1] if q.shape[1] > 1 else 0)
    products = np.hstack([q[:, one] * q[:, other], v[:, one] * v[:, other]])
    for j in range(a.shape[1]):
        sign = np.tanh(v[:, j] / max(0.05 * np.abs(v[:, j]).max(), 1e-300))
        causes = np.column_stack([q, v, sign, np.ones(len(q)), products])
        weight, law = np.ones(len(live)), np.zeros(causes.shape[1])
        for _ in range(15):  # least absolute deviations: a quick pull is outvoted
            matrix, right = causes[live] * weight[:, None], a[live, j] * weight
            law = np.linalg.lstsq(matrix, right, rcond=None)[0]
            left = np.abs(a[live, j] - causes[live] @ law)
            weight = 1 / np.sqrt(np.maximum(left, np.median(left) + 1e-12))
        wrong[:, j] = np.abs(a[:, j] - causes @ law)
    return wrong


def _after_last(broken: np.ndarray, quarter: int) -> int:
    """The first sample after the last part that is broken for most of a quarter period."""
    n, half = len(broken), max(1, quarter // 2)
    count = np.concatenate([[0], np.cumsum(broken)])
    low, high = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half + 1, n)
    mostly = np.flatnonzero(count[high] - count[low] > 0.5 * (high - low))
    if not len(mostly):
        return 0
    mended = np.flatnonzero(~broken[mostly[-1] :])
    return int(mostly[-1] + mended[0]) if len(mended) else n - 1
