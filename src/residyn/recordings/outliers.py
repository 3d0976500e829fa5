"""An outlier is a reading that its neighbours contradict, and that is the only thing wrong there.

Polynomials that follow the motion through a short block leave its noise. A spike, or a marker that
was mistaken for another for a few samples, is left there too, and once those few readings are let
free nothing strange remains. A stick or a knock is no polynomial either, but misfits all around:
freeing a few readings does not mend it. Nor is a motion that is livelier here than elsewhere, as
just after a release: it is in the next few degrees, where a spike is in all of them alike.
"""

import math

import numpy as np

from .arrays import check_noise, check_table
from .polynomial_spectrum import Blocks, blocks, grid_step, parts, scaled

_SURE = 5.0  # standard deviations from which a reading is an outlier
_SMOOTH = 3  # readings for each degree of a polynomial that a few outliers do not move
_HUBER = 2.0  # median deviations, 1.35 sigma: of normal errors 95 % efficient (Huber 1981)
_MODIFIED = 20  # steps to it
_FAR = 15.0  # sigma: less far off, a reading may be of noise with heavy tails, as encoders have
_RUN = 4  # the most outliers in a row that are looked for
_HAIR = 1e-6  # a ridge for small inverses: a reading that is free already has no room left


def outlier_mask(
    time: np.ndarray, angle: np.ndarray, noise: np.ndarray | float | None = None
) -> np.ndarray:
    """Readings that sit far off their neighbours: spikes, or marker swaps of a few samples.

    They are runs of one to four readings. A single one is seen from about 8 sigma; a run needs
    more the longer it is and the faster the motion, 15 sigma as a rule.

    **Arguments:** `time` (N,) s; `angle` (N, n) rad or m, NaN where one is missing; `noise`, if
    known, the sigma of one reading, (n,) or one number.

    **Returns:** (N, n) bool; False where the sample is missing.
    """
    time, angle = check_table(time, angle)
    flagged = np.zeros(angle.shape, dtype=bool)
    least = np.zeros(angle.shape[1]) if noise is None else check_noise(noise, angle.shape[1])
    for j, column in enumerate(angle.T):
        seen, y, unit = scaled(column)
        if unit and len(seen) >= 8:
            known = min(float(least[j]), unit) / unit
            flagged[seen[outliers_of(time[seen], y, known)], j] = True
    return flagged


def outliers_of(time: np.ndarray, y: np.ndarray, least: float) -> np.ndarray:
    """`outlier_mask` of one joint's readings, scaled; `least` is the smallest sigma to believe."""
    flagged = np.zeros(len(y), dtype=bool)
    least = max(least, grid_step(y) / math.sqrt(12))
    for part in parts(np.arange(len(y))):
        # A second look without the first one's finds sees what those had hidden.
        for _ in range(2):
            kept = part[~flagged[part]]
            if len(kept) < 8:
                break
            found = _stand_out(time[kept], y[kept], least)
            flagged[kept[found]] = True
            if not found.any():
                break
    return flagged


def _stand_out(time: np.ndarray, values: np.ndarray, least: float) -> np.ndarray:
    """Which of `values` do not fit their block, of sigma `least` or more."""
    found = np.zeros(len(values), dtype=bool)
    cut = blocks(time, values)
    m = cut.basis.shape[1]
    # One outlier is in all degrees of its block, and most blocks may have one: what is noise is
    # seen without those that are far off their neighbours.
    near = ~_far_off(cut, values)
    usual = blocks(time[near], values[near]) if 4 * m <= near.sum() < len(near) else cut
    cut = cut._replace(degree=usual.degree, spread=usual.spread)
    sigma = max(cut.spread, least, 1e-9 * float(np.std(values)), 1e-14)
    # Noise with tails heavier than the normal law's is noise still.
    tail = max(1.0, float(np.quantile(_left(usual, sigma)[1], 0.95)) / 1.96)
    noise = cut.basis[:, :, cut.degree :]
    rest, score = _left(cut, sigma)
    for b in np.flatnonzero(score.max(axis=1) > 3.5 * tail):
        own = noise[b % len(noise)]
        pick = _explain(own @ own.T, rest[b] / tail, cut.share[b, cut.degree :] / sigma / tail)
        index = cut.first[b] + np.arange(m)
        # A knock may be as sharp as a spike, but is no larger than a part of the acceleration.
        bend = 0.3 * float(np.quantile(np.abs(np.diff(values[index], 2)), 0.75)) / sigma
        # Each reading is judged in the block that has it well inside, if there is one.
        start = 0 if b == 0 else m // 4
        stop = m if b == len(cut.first) - 1 else m - m // 4
        for i, size in pick.items():
            if start <= i < stop and abs(size) > bend:
                found[index[i]] = True
    return found


def _left(cut: Blocks, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """(B, m) what polynomials leave of each block, in sigmas, and the size of that in standard
    deviations of what they leave of noise."""
    noise = cut.basis[:, :, cut.degree :]
    rest = (noise @ cut.share[:, cut.degree :, None])[..., 0] / sigma
    return rest, np.abs(rest) / np.sqrt(np.maximum(np.sum(noise**2, axis=-1), 1e-9))


def _far_off(cut: Blocks, values: np.ndarray) -> np.ndarray:
    """(N,) which of `values` are far off the smooth polynomial of their block that a few outliers
    move by next to nothing (Huber's estimate, by modified residuals: Huber, Robust Statistics,
    1981, ch. 7)."""
    m = cut.basis.shape[1]
    smooth = cut.basis[:, :, : m // _SMOOTH]
    y = values[cut.first[:, None] + np.arange(m)]
    left = y - (smooth @ (np.swapaxes(smooth, 1, 2) @ y[:, :, None]))[..., 0]
    far = np.zeros(len(values), bool)
    usual = np.median(np.abs(left))
    if np.abs(left).max() <= _SURE * 1.4826 * usual:
        return far
    for _ in range(_MODIFIED):
        size = np.abs(left)
        usual = np.maximum(np.median(size, axis=1, keepdims=True), np.median(size))
        part = np.clip(left, -_HUBER * usual, _HUBER * usual)[:, :, None]
        left = left - (smooth @ (np.swapaxes(smooth, 1, 2) @ part))[..., 0]
    inside = np.zeros(left.shape, bool)
    inside[:, m // 4 : m - m // 4] = inside[0, : m // 4] = inside[-1, m - m // 4 :] = True
    block, place = np.nonzero(inside & (np.abs(left) > _FAR * 1.4826 * usual))
    far[cut.first[block] + place] = True
    return far


def _explain(room: np.ndarray, rest: np.ndarray, degrees: np.ndarray) -> dict[int, float]:
    """The readings which, let free, explain what is left of a block, and how far off each is. Empty
    when so many would be needed that they are no exception, or when as many further degrees explain
    as much.

    **Arguments:** `room` (m, m) projects on what polynomials leave; `rest` (m,) is that part of the
    readings, in sigmas; `degrees`, what each further degree holds of it.
    """
    too_much = float(rest @ rest - np.trace(room))
    picked: list[int] = []
    size, left, free = np.zeros(0), rest, room
    for _ in range(_RUN):
        run = _best_run(free, left)
        if run is None:
            break
        picked += [i for i in run if i not in picked]
        inner = room[np.ix_(picked, picked)] + _HAIR * np.eye(len(picked))
        across = np.linalg.solve(inner, room[picked])
        size = np.linalg.solve(inner, rest[picked])
        left, free = rest - across.T @ rest[picked], room - room[:, picked] @ across
        left[picked] = free[picked] = free[:, picked] = 0.0  # what the ridge leaves of a large one
    else:
        return {}
    explained, livelier = rest @ rest - left @ left, degrees[: len(picked)]
    if explained < max(0.8 * too_much, float(livelier @ livelier)):
        return {}
    return dict(zip(picked, size.tolist(), strict=True))


def _best_run(room: np.ndarray, rest: np.ndarray) -> list[int] | None:
    """The run of up to four readings that explains most, if it is surely more than noise."""
    best, run = _SURE**2, None
    for length in range(1, _RUN + 1):
        at = np.arange(len(rest) - length + 1)[:, None] + np.arange(length)
        inner = room[at[:, :, None], at[:, None, :]] + _HAIR * np.eye(length)
        size = np.linalg.solve(inner, rest[at][:, :, None])[:, :, 0]
        # Each further reading must earn its place: by three standard deviations.
        gain = np.einsum("il,il->i", rest[at], size) - 9 * (length - 1)
        if gain.max() > best:
            best, run = float(gain.max()), at[int(gain.argmax())].tolist()
    return run
