"""Noise is what is left of a reading when everything smooth is taken away.

Cut a recording into short blocks and express each in polynomials, degree by degree, orthonormal on
the block's own sample times. Motion is smooth: its share falls faster than exponentially with the
degree and is gone after a few. White noise has the same size in every degree. So beyond the degree
where the spectrum turns flat only noise is left: its level is the sigma of one reading, without any
model of the motion, and a single reading which does not fit is one that stands out of that rest.
"""

import math
from typing import NamedTuple

import numpy as np

from ._arrays import check_noise, check_table
from ._input import InputError

_BLOCK = 32
"""Readings per block: long enough that noise fills most degrees, short against a slow motion."""

_SURE = 5.0
"""Standard deviations from which readings are wild."""

_RUN = 4
"""The most wild readings in a row that are looked for."""

_TINY = 1e-100
"""Motion smaller than this is none."""

_HAIR = 1e-6
"""A ridge for small inverses: a reading that is free already has no room left."""


def estimate_noise(time: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Sigma of one reading, per joint, from what is above the motion's band.

    Never below the rounding of an encoder or a printout (step/sqrt(12)), nor below 1e-9 of the rms
    motion: data without any noise still need a sigma. A joint that never moves shows no noise; it
    gets the largest of the others'.

    **Arguments:** `time` (N,) s; `angle` (N, n) rad or m, NaN where a sample was lost.

    **Returns:** (n,) rad or m, all positive.
    """
    return noise_and_doubts(time, angle)[0]


def noise_and_doubts(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """`estimate_noise`, and in words the joints whose noise could not be seen."""
    time, angle = check_table(time, angle)
    sigma, doubts, still = np.zeros(angle.shape[1]), [], []
    for j, column in enumerate(angle.T):
        seen, y, unit = _scaled(column)
        if len(seen) < 8:
            raise InputError(f"q{j + 1} has fewer than 8 readings: too few to see their noise")
        if not unit:
            still.append(j)
            continue
        good = np.flatnonzero(~_wild(time[seen], y, 0.0))
        good = good if len(good) >= 8 else np.arange(len(y))
        spread = [_blocks(time[seen[part]], y[part]).spread for part in _parts(good)]
        floor = 1e-9 * math.sqrt(float(np.mean(y**2)))
        own = max(float(np.median(spread)), _step(y) / math.sqrt(12))
        sigma[j] = unit * max(own, floor)
        if own < floor:
            doubts.append(
                f"noise of q{j + 1} could not be seen in the data; {sigma[j]:.3g} is taken, 1e-9 "
                "of its rms motion; give noise to say what it is"
            )
    for j in still:
        value = abs(float(angle[np.isfinite(angle[:, j]), j][0]))
        sigma[j] = sigma.max() if len(still) < len(sigma) else 1e-9 * max(value, 1.0)
        doubts.append(
            f"q{j + 1} never moves: all its readings are the same, so their noise cannot be seen; "
            f"{sigma[j]:.3g} is taken; give noise to say what it is"
        )
    return sigma, doubts


def wild_samples(
    time: np.ndarray, angle: np.ndarray, noise: np.ndarray | float | None = None
) -> np.ndarray:
    """Readings that sit far off their neighbours: spikes, or marker swaps of a few samples.

    They are the runs of one to four readings which, let free, explain nearly all that polynomials
    leave of a block. That tells them from a stick or a knock, which is no polynomial either but
    misfits all around.

    **Arguments:** `time` (N,) s; `angle` (N, n) rad or m, NaN where a sample was lost; `noise`, if
    known, the sigma of one reading, (n,) or one number.

    **Returns:** (N, n) bool; False where the sample was lost.
    """
    time, angle = check_table(time, angle)
    flagged = np.zeros(angle.shape, dtype=bool)
    least = np.zeros(angle.shape[1]) if noise is None else check_noise(noise, angle.shape[1])
    for j, column in enumerate(angle.T):
        seen, y, unit = _scaled(column)
        if unit and len(seen) >= 8:
            known = min(float(least[j]), unit) / unit
            flagged[seen[_wild(time[seen], y, known)], j] = True
    return flagged


def _scaled(column: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Where a joint was read, its readings in units of their range, and that; 0 if none."""
    seen = np.flatnonzero(np.isfinite(column))
    values = column[seen]
    unit = float(np.ptp(values)) if len(seen) else 0.0
    if unit < _TINY:
        return seen, np.zeros(len(seen)), 0.0
    return seen, (values - np.median(values)) / unit, unit


class _Blocks(NamedTuple):
    first: np.ndarray
    """(B,) index of each block's first reading; neighbours overlap by half."""
    basis: np.ndarray
    """(B, m, m) orthonormal: column k is a polynomial of degree k, the last quarter is the rest."""
    share: np.ndarray
    """(B, m) what each column holds of the readings."""
    degree: int
    """The first degree that holds nothing but noise."""
    spread: float
    """Robust standard deviation of the shares from there on."""


def _blocks(time: np.ndarray, values: np.ndarray) -> _Blocks:
    """The polynomial spectrum of one joint's readings, scaled."""
    m = int(np.clip(len(time) // 4, 8, _BLOCK))
    first = np.unique(np.append(np.arange(0, len(time) - m, m // 2), len(time) - m))
    span = time[first + m - 1] - time[first]
    first = first[span <= 2 * np.median(span)]  # across a long gap nothing is smooth
    index = first[:, None] + np.arange(m)
    t, y = time[index], values[index]
    x = 2 * (t - t[:, :1]) / (t[:, -1:] - t[:, :1]) - 1
    top = 3 * m // 4  # the highest degrees need no names, and are ill-conditioned
    if np.ptp(x, axis=0).max() < 1e-6 / m:
        x = x[:1]  # evenly sampled: one basis serves all blocks
    basis = np.linalg.qr(np.polynomial.legendre.legvander(x, top - 1), mode="complete")[0]
    basis = np.broadcast_to(basis, (len(first), m, m))
    share = np.einsum("bmk,bm->bk", basis, y - y.mean(axis=1, keepdims=True))
    # An encoder at rest says nothing of the noise, and where the motion ends must be seen where it
    # is at its largest.
    moves = np.ptp(y, axis=1) > 1e-14
    if not moves.any():
        return _Blocks(first, basis, share, 1, 0.0)
    size = np.median(np.abs(y - np.median(y, axis=1, keepdims=True)), axis=1)
    lively = moves & (size >= min(0.3 * size.max(), np.sort(size)[-min(8, len(size))]))
    lively = np.flatnonzero(lively)
    live = share[lively[:: max(1, len(lively) // 1000)]]
    # Down from the top while the next degree is as small as all above it, within its statistics;
    # then up again by two, past motion that was too small to be noticed.
    limit = math.sqrt(1 + 3 * math.sqrt(4 / len(live)))
    degree = top
    while degree > 1 and _spread(live[:, degree - 1]) <= limit * _spread(live[:, degree:]):
        degree -= 1
    degree = min(degree + 2, top)
    return _Blocks(first, basis, share, degree, _spread(share[moves, degree:]))


def _spread(values: np.ndarray) -> float:
    """Standard deviation about zero, blind to a minority of outliers: clipped at three sigma."""
    values = np.abs(values).ravel()
    sigma = 1.4826 * float(np.median(values))
    for _ in range(10):
        # 0.97334: the variance of a normal variable that is kept within three sigma.
        new = math.sqrt(float(np.mean(values[values <= 3 * sigma] ** 2)) / 0.97334)
        if abs(new - sigma) <= 1e-4 * sigma:
            break
        sigma = new
    return sigma


def _step(values: np.ndarray) -> float:
    """The grid that readings lie on (an encoder's step, a printout's last digit); 0 for none."""
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > 1e-10 * np.ptp(values)]  # less is arithmetic's own rounding
    if not len(gaps):
        return 0.0
    least = float(gaps.min())
    # Steps between neighbours only: over the whole range a printout's rounding would add up.
    near = gaps[gaps <= 1.5 * least]
    step = float(near.mean())
    counts = gaps / step
    on_grid = np.mean(np.abs(counts - np.rint(counts)) < 0.1) >= 0.99
    return step if on_grid else 0.0


def _wild(time: np.ndarray, y: np.ndarray, least: float) -> np.ndarray:
    """`wild_samples` of one joint's readings, scaled; `least` is the smallest sigma to believe."""
    flagged = np.zeros(len(y), dtype=bool)
    least = max(least, _step(y) / math.sqrt(12))
    for part in _parts(np.arange(len(y))):
        # A second look without the first one's finds sees what those had hidden.
        for _ in range(2):
            kept = part[~flagged[part]]
            if len(kept) < 8:
                break
            found = _stand_out(_blocks(time[kept], y[kept]), y[kept], least)
            flagged[kept[found]] = True
            if not found.any():
                break
    return flagged


def _parts(index: np.ndarray) -> list[np.ndarray]:
    """`index` in pieces that fit in memory."""
    return np.array_split(index, math.ceil(len(index) / 100_000))


def _stand_out(blocks: _Blocks, values: np.ndarray, least: float) -> np.ndarray:
    """Which of `values` do not fit their block, of sigma `least` or more."""
    found = np.zeros(len(values), dtype=bool)
    m = blocks.basis.shape[1]
    noise = blocks.basis[:, :, blocks.degree :]
    sigma = max(blocks.spread, least, 1e-9 * float(np.std(values)), 1e-14)
    rest = np.einsum("bmk,bk->bm", noise, blocks.share[:, blocks.degree :]) / sigma
    room = np.einsum("bmk,bmk->bm", noise, noise)
    score = np.abs(rest) / np.sqrt(np.maximum(room, 1e-9))
    # Noise with tails heavier than the normal law's is noise still.
    tail = max(1.0, float(np.quantile(score, 0.95)) / 1.96)
    for b in np.flatnonzero(score.max(axis=1) > 3.5 * tail):
        pick = _explain(noise[b] @ noise[b].T, rest[b] / tail)
        index = blocks.first[b] + np.arange(m)
        # A knock may be as sharp as a spike, but is no larger than a part of the acceleration.
        bend = 0.3 * float(np.quantile(np.abs(np.diff(values[index], 2)), 0.75)) / sigma
        # Each reading is judged in the block that has it well inside, if there is one.
        start = 0 if b == 0 else m // 4
        stop = m if b == len(blocks.first) - 1 else m - m // 4
        for i, size in pick.items():
            if start <= i < stop and abs(size) > bend:
                found[index[i]] = True
    return found


def _explain(room: np.ndarray, rest: np.ndarray) -> dict[int, float]:
    """The readings which, let free, explain what is left of a block, and how far off each is.

    Empty when there are none, or when so many would be needed that they are no exception.

    **Arguments:** `room` (m, m) projects on what polynomials leave; `rest` (m,) is that part of the
    readings, in sigmas.
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
    else:
        return {}
    if rest @ rest - left @ left < 0.8 * too_much:
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
