"""Which marker is at which joint: a motion capture system sometimes exchanges labels.

Each way to give the labels to the joints is a state, and the recording a path through states. A
frame speaks for a state if the base is where it stands and links are as long as they are; frames
in a row speak for keeping it, unless markers would have to leap. The best path (Viterbi) is found
for all frames together, so that a frame in which markers are lost, or in which two states fit
alike, is decided by those around it. A marker that fits in no state is none of the arm's: it is
rejected.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from .rigid import Rigid

_REJECT = 36.0  # what it costs to reject a marker: with what the others lose, it takes eight sigma
_AGREE = 16.0  # what it is worth, when a marker must be rejected, that another then agrees
_NOISE = 16.0  # a misfit below this is none: to miss a marker must not be better than to see it
_SWITCH = 20.0  # what it costs to change the state
_LEAP = 40.0  # what a leap of one marker costs at most
_ODD = 0.01  # what a frame costs whose labels are wrong: what nothing can tell, labels do
_FAR_OFF = 1e6  # misfits are cut off here, which only keeps numbers finite


@dataclass(frozen=True, eq=False)
class Labels:
    """Which label is at which joint."""

    order: np.ndarray  # (N, n + 1) int: the label at each joint
    rejected: np.ndarray  # (N, n + 1) bool: the marker at this joint is none of the arm's

    def apply(self, markers: np.ndarray) -> np.ndarray:
        """Markers (N, n + 1, 3) at their joints, NaN where rejected."""
        joints = np.take_along_axis(markers, self.order[:, :, None], axis=1)
        return np.where(self.rejected[:, :, None], np.nan, joints)


def assign(markers: np.ndarray, rigid: Rigid) -> Labels:
    """The most plausible labels of `markers` (N, n + 1, 3) m, for a chain of these constants."""
    orders = _orders(markers.shape[1])
    cost, without = _frames(markers, rigid, orders)
    cost = cost + _ODD * (orders != np.arange(markers.shape[1])).any(axis=1)
    path = _path(cost, orders, _leaps(markers, rigid))
    found = Labels(orders[path], without[np.arange(len(path)), path])
    joints = found.apply(markers)
    seen = ~np.isnan(markers[np.arange(len(path))[:, None], found.order, 0])
    return Labels(found.order, seen & (found.rejected | _alone(joints, rigid)))


def _alone(joints: np.ndarray, rigid: Rigid) -> np.ndarray:
    """(N, n + 1) bool: markers that no link vouches for and that leap from where others did."""
    seen = ~np.isnan(joints[:, :, 0])
    vouched = np.zeros_like(seen)
    vouched[:, 0] = seen[:, 0]  # the base has its place
    both = seen[:, 1:] & seen[:, :-1]
    vouched[:, 1:] |= both
    vouched[:, :-1] |= both
    alone = np.zeros_like(seen)
    for j, (place, sure) in enumerate(zip(joints.swapaxes(0, 1), vouched.T, strict=True)):
        at, odd = np.flatnonzero(sure), np.flatnonzero(seen[:, j] & ~sure)
        if len(at) < 2:
            alone[odd, j] = True
            continue
        usual = np.quantile(np.linalg.norm(np.diff(place[at], axis=0), axis=1) / np.diff(at), 0.99)
        after = np.searchsorted(at, odd).clip(1, len(at) - 1)
        before, after = at[after - 1], at[after]
        nearest = np.where(odd - before <= after - odd, before, after)
        room = 2 * usual * np.abs(nearest - odd) + 6 * rigid.base_sigma
        alone[odd, j] = np.linalg.norm(place[odd] - place[nearest], axis=1) > room
    return alone


def _orders(markers: int) -> np.ndarray:
    """The ways to give labels to joints, the labels' own first; of long chains, single swaps."""
    orders = np.array(list(itertools.permutations(range(markers))))
    moved = (orders != np.arange(markers)).sum(axis=1)
    return orders if markers <= 4 else orders[moved <= 2]


def _frames(markers: np.ndarray, rigid: Rigid, orders: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What each frame costs in each state, (N, states), and which joints' markers are rejected, as
    that is cheapest, (N, states, n + 1) bool."""
    frames, joints = markers.shape[:2]
    # The misfits of every label at the base, and of every two labels at the ends of each link.
    base = ((markers - rigid.base) ** 2).sum(axis=2) / rigid.base_sigma**2
    apart = np.linalg.norm(markers[:, :, None] - markers[:, None], axis=3)
    cost = np.full((frames, len(orders)), np.inf)
    best = np.full((frames, len(orders)), np.inf)
    chosen = np.zeros((frames, len(orders)), dtype=int)
    sets = np.array(sorted(itertools.product([False, True], repeat=joints), key=sum))
    # Rejecting more than three of a long chain leaves nothing to believe.
    sets = sets[sets.sum(axis=1) <= 3]
    for s, order in enumerate(orders):
        links = (apart[:, order[:-1], order[1:]] - rigid.lengths) / rigid.sigmas
        misfit = np.column_stack([base[:, order[0]], links**2])
        # One that cannot be had (NaN) says nothing, neither for nor against.
        wrong = np.nan_to_num(np.clip(misfit - _NOISE, 0, _FAR_OFF))
        here = ~np.isnan(markers[:, order, 0])
        for r, out in enumerate(sets):
            kept = ~out & ~np.append(False, out[:-1])
            total = _REJECT * (here & out).sum(axis=1) + wrong[:, kept].sum(axis=1)
            # Which marker to reject is a matter of how many others then agree; which state is
            # right is not, or a marker that is lost would be replaced by any other.
            score = total - _AGREE * (~np.isnan(misfit[:, kept])).sum(axis=1)
            better = score < best[:, s] - 1e-9
            best[better, s], cost[better, s] = score[better], total[better]
            chosen[better, s] = r
    return cost, sets[chosen]


def _leaps(markers: np.ndarray, rigid: Rigid) -> np.ndarray:
    """(N, n + 1, n + 1): what it costs to go on from label j's last place to label i's new one."""
    frames, joints = markers.shape[:2]
    t = np.arange(frames)[:, None]
    seen = np.where(np.isnan(markers[:-1, :, 0]), -1, t[:-1])
    before = np.vstack([np.full(joints, -1), np.maximum.accumulate(seen)])  # seen last; -1: never
    last = np.take_along_axis(markers, before.clip(0)[..., None], axis=0)
    last[before < 0] = np.nan
    gap = t - before
    moved = np.linalg.norm(markers - last, axis=2) / gap
    usual = np.nanquantile(moved, 0.99) if np.isfinite(moved).any() else 0.0
    scale = (2 * usual + 6 * rigid.base_sigma) * gap
    far = np.linalg.norm(markers[:, :, None] - last[:, None], axis=3) / scale[:, None]
    return np.nan_to_num(np.minimum(far**2, _LEAP), nan=0.0)


def _path(cost: np.ndarray, orders: np.ndarray, leaps: np.ndarray) -> np.ndarray:
    """The cheapest sequence of states, (N,)."""
    states = len(orders)
    switch = _SWITCH * (1 - np.eye(states))
    came = np.zeros(cost.shape, dtype=int)
    total = cost[0]
    new, old = orders[:, None, :], orders[None, :, :]
    for t in range(1, len(cost)):
        step = switch + leaps[t][new, old].sum(axis=2) + total
        came[t] = step.argmin(axis=1)
        total = step[np.arange(states), came[t]] + cost[t]
    path = np.empty(len(cost), dtype=int)
    path[-1] = total.argmin()
    for t in range(len(cost) - 1, 0, -1):
        path[t - 1] = came[t, path[t]]
    return path
