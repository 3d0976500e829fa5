"""What is put back from rigid links, and what is said of all repairs.

A lost elbow is where two circles meet, about the shoulder and about the wrist. They meet twice: the
elbow is on the side where it was before and is afterwards, as long as the arm was never straight in
between. Near straight the circles only touch, and noise moves the point far; so an angle is put
back only where it comes out about as sure as a reading.
"""

from collections.abc import Sequence

import numpy as np

from ...errors import quote

_SURE = 1e-3  # error, rad, beyond which an angle is not put back but left lost
_STRAIGHT = 0.1  # sine of a joint's angle below which its side cannot be told
_WORSE = 4.0  # how many times less sure than a reading an angle may be put back
_SIGMAS = 5.0  # standard deviations that an error stays within, over a recording's few lost frames
_TOLD = 4  # how many times or intervals are given one by one


def put_back(flat: np.ndarray, noise: float) -> np.ndarray:
    """Fill in lost inner joints from their neighbours; (N, n + 1) bool, where.

    **Arguments:** `flat` (N, n + 1, 2) m, changed in place; `noise` of one coordinate, m.
    """
    back = np.zeros(flat.shape[:2], dtype=bool)
    seen = ~np.isnan(flat[:, :, 0])
    length = np.nanmedian(np.linalg.norm(np.diff(flat, axis=1), axis=2), axis=0)
    for j in range(1, flat.shape[1] - 1):
        l1, l2 = length[j - 1], length[j]
        reading = 2**0.5 * noise / min(l1, l2)
        inner, outer = flat[:, j] - flat[:, j - 1], flat[:, j + 1] - flat[:, j]
        side = np.sign(inner[:, 0] * outer[:, 1] - inner[:, 1] * outer[:, 0])
        span = flat[:, j + 1] - flat[:, j - 1]
        reach = np.linalg.norm(span, axis=1)
        cosine = (reach**2 - l1**2 - l2**2) / (2 * l1 * l2)
        sine = np.sqrt(np.maximum(1 - cosine**2, 0))  # NaN where a neighbour is lost
        side = _sides(side, sine)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = 2**0.5 * noise * reach / (l1 * l2 * sine)
            # How far along the span the elbow stands, and how far off it.
            along = (reach**2 + l1**2 - l2**2) / (2 * reach)
            off = -side * l1 * l2 * sine / reach
            unit = span / reach[:, None]
            place = along[:, None] * unit + off[:, None] * unit[:, ::-1] * [-1, 1]
        good = (_SIGMAS * np.hypot(error, reading) <= _SURE) & (error <= _WORSE * reading)
        fill = ~seen[:, j] & seen[:, j - 1] & seen[:, j + 1] & (side != 0) & good
        flat[fill, j] = (flat[:, j - 1] + place)[fill]
        back[:, j] = fill
    return back


def _sides(side: np.ndarray, sine: np.ndarray) -> np.ndarray:
    """(N,) 1 or -1 where the joint's side is known, or follows from before and after; else 0."""
    known = np.nan_to_num(side)
    keeps = np.isnan(side) & (sine > _STRAIGHT)  # a sine that is NaN is not

    def carried(known: np.ndarray, keeps: np.ndarray) -> np.ndarray:
        return known[np.maximum.accumulate(np.where(keeps, 0, np.arange(len(known))))]

    ahead, behind = carried(known, keeps), carried(known[::-1], keeps[::-1])[::-1]
    return np.where(ahead * behind < 0, 0, np.sign(ahead + behind))


def sentences(
    names: Sequence[str],
    time: np.ndarray,
    frame: np.ndarray,
    order: np.ndarray,
    lost: np.ndarray,
    rejected: np.ndarray,
    back: np.ndarray,
    still: bool,
) -> list[str]:
    """A sentence for each repair. Arrays are (N, n + 1), per joint; `still`: the base stands."""
    said = _exchanged(names, time, frame, order, lost)
    for j, name in enumerate(names):
        out = np.flatnonzero(rejected[:, j])
        if len(out):
            when = ", ".join(f"{time[i]:.6g}" for i in out[:_TOLD])
            more = f" and {len(out) - _TOLD} more" * (len(out) > _TOLD)
            said.append(
                f"{quote(name)}: {len(out)} reading{'s' * (len(out) > 1)} rejected, since no rigid "
                f"arm has a marker there (at {when} s{more})"
            )
        gone = lost[:, j] & ~rejected[:, j]
        if gone.any():
            longest = max(stop - start for start, stop in _runs(gone))
            said.append(
                f"{quote(name)}: lost in {int(gone.sum())} of {len(time)} frames, at most "
                f"{longest} in a row{_fate(j, lost, back, still)}"
            )
    return said


def _fate(j: int, lost: np.ndarray, back: np.ndarray, still: bool) -> str:
    """What became of a joint's lost and rejected readings."""
    if j == 0:
        return "; its place is known, as it stands still" if still else "; they stay lost"
    filled, gone = int(back[:, j].sum()), int(lost[:, j].sum())
    if not filled:
        return "; they stay lost"
    rest = f", {gone - filled} stay lost" if gone > filled else ""
    return f"; {filled} put back from the markers beside it and the links' lengths{rest}"


def _exchanged(
    names: Sequence[str], time: np.ndarray, frame: np.ndarray, order: np.ndarray, lost: np.ndarray
) -> list[str]:
    """One sentence for each way in which labels were exchanged."""
    said = []
    own = np.arange(order.shape[1])
    for wrong in np.unique(order[(order != own).any(axis=1)], axis=0):
        here = np.all(order == wrong, axis=1)
        moved = [quote(names[j]) for j in own if wrong[j] != j]
        listed = f"{', '.join(moved[:-1])} and {moved[-1]}"
        # From where it was seen to where it was seen last.
        seen = np.any(~lost[:, np.flatnonzero(wrong != own)], axis=1)
        parts = [a + np.flatnonzero(seen[a:b]) for a, b in _runs(here)]
        runs = [(int(at[0]), int(at[-1]) + 1) for at in parts if len(at)]
        if not runs:
            continue
        spans = [
            f"from {time[a]:.6g} to {time[b - 1]:.6g} s (frames {frame[a]} to {frame[b - 1]})"
            if b > a + 1
            else f"at {time[a]:.6g} s (frame {frame[a]})"
            for a, b in runs[:_TOLD]
        ]
        more = f" and {len(runs) - _TOLD} more times" * (len(runs) > _TOLD)
        line = f"{listed} had exchanged labels {', '.join(spans)}{more}: put back"
        if here.all():
            line += "; as that is the whole recording, is markers in the wrong order?"
        elif here.mean() > 0.5:
            line += "; that is most of it, so links that stay rigid were believed, not labels"
        said.append(line)
    return said


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """The intervals, first and one past the last, in which flags are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
