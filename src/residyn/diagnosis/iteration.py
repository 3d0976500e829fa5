"""A model and its motion, iterated until they agree, under every random torque.

A model is linear only along a motion, and its motion is the one smoothed with it: Gauss-Newton's
method for both together. Linearised, it has an evidence under each random torque, and the likeliest
one smooths the next motion. Where a joint or a brake sticks, each random torque has a motion of its
own, and steps are damped.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..filtering.linearised import Linear
from ..filtering.trajectory import Scene, Trajectory
from ..runtime.parallel import side_by_side
from .evidence import (
    FALL,
    HOPELESS,
    INTENSITIES,
    SETTLED,
    TORQUE_TIMES,
    laplace_about,
    log_prior_intensity,
    non_normal_priors,
    over_intensities,
)

_ITERATIONS = 20  # of one model, at the most
NEAR = 4  # random torques at which a model is judged while it moves
_ROUGH = 1.0  # nats by which kinks make an evidence fall and rise where it is highest
_HALVED = 4  # times that a step is halved, at the most
_HERE = 6  # iterations at one random torque, at the most


def settle(
    scene: Scene,
    starts: Sequence[Trajectory],
    loudest: float,
    go_on: Callable[[], None] = lambda: None,
    known: float = -math.inf,
) -> list[tuple[np.ndarray, Trajectory] | None]:
    """Iterate models side by side, each to its likeliest random torque and its own motion under it;
    None for one that ran away, or fell hopelessly behind another, or behind the log evidence
    `known`. `go_on` is called before each iteration.

    Linearised along its motion, a model has an evidence under every random torque; the next motion
    is smoothed under the likeliest one, which falls by a decade an iteration at the most, from
    `loudest`: the readings lead first, the model last. Where a joint or a brake sticks, loud
    torques hide it from the model that has it; there, each is gone through down to none and has
    the evidence of its own motion (graduated optimisation: Blake and Zisserman, Visual
    Reconstruction, 1987). Evidences are sums over the random torque's correlation time.
    """
    first = next(k for k, x in enumerate(INTENSITIES) if x <= loudest)
    each = [_settled(scene, t, first) for t in starts]
    found: list[_State | None] = [None] * len(starts)
    moving = list(range(len(starts)))
    while moving:
        go_on()
        steps = side_by_side([functools.partial(next, each[i]) for i in moving])
        for i, state in zip(moving, steps, strict=True):
            found[i] = state
        best = max([known, *(s.evidences.max() for s in found if s is not None)])
        moving = [i for i in moving if (s := found[i]) and not (s.done or s.hopeless(best))]
    return [(s.evidences, s.trajectory) if s else None for s in found]


class _State(NamedTuple):
    """Where the iteration of a model is."""

    trajectory: Trajectory
    evidences: np.ndarray
    """(I,) of a motion before the last smoothing, -inf where not known."""
    rise: float = math.inf
    """Of the highest of them, nats, in the last iteration."""
    done: bool = False
    likeliest_time: float = 1.0
    """Correlation time of the random torque, where it is done."""

    def hopeless(self, best: float) -> bool:
        """Whether the model is hopelessly behind the best evidence of any, and still would be if
        all iterations to come raised it by as much as the last one. Their steps shrink by half at
        least where they converge at all."""
        return self.evidences.max() < best - HOPELESS - max(0.0, self.rise)


def _settled(scene: Scene, t: Trajectory, level: int) -> Iterator[_State | None]:
    """A model under a random torque from that of index `level` on, of the correlation time that its
    trajectory has; where another one is likelier at its end, iterated once more, under that. Where
    something sticks the time stays: it has its own motion under each torque in any case."""
    if sticks(t):
        yield from _descended(scene, t, level)
        return
    found: _State | None = None
    times: set[float] = set()
    while t.torque_time not in times:
        times.add(t.torque_time)
        state = None
        for state in _iterated(scene, t, level - FALL):
            if state is None or state.done:
                break
            yield state
        if state is None:
            break
        if found is None or over_intensities(state.evidences) > over_intensities(found.evidences):
            found, level = state, int(np.argmax(state.evidences)) + FALL
            t = dataclasses.replace(state.trajectory, torque_time=state.likeliest_time)
            yield state._replace(rise=0.0, done=t.torque_time in times)
    yield found and found._replace(done=True)


def over_torque_times(
    scene: Scene,
    t: Trajectory,
    linear: Linear,
    known: np.ndarray,
    levels: np.ndarray,
    at_rest: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """A model's log evidences `known` (I,) along its motion, at some levels summed over the random
    torque's correlation time; and (T, I) those of each time there. `at_rest` as in
    `evidences_at`."""
    if scene.coloured is not None:
        return known, np.tile(known, (len(TORQUE_TIMES), 1))
    each = np.full((len(TORQUE_TIMES), len(INTENSITIES)), -np.inf)
    for i, x in enumerate(TORQUE_TIMES):
        other = dataclasses.replace(t, torque_time=x)
        own = known if x == t.torque_time else evidences_at(scene, other, linear, levels, at_rest)
        each[i, levels] = own[levels]
    summed = known.copy()
    summed[levels] = np.logaddexp.reduce(each[:, levels], axis=0) - math.log(len(TORQUE_TIMES))
    return summed, each


def likeliest_level(evidences: np.ndarray) -> int:
    """The level of the likeliest random torque."""
    return int(np.argmax(evidences + log_prior_intensity(INTENSITIES)))


def levels_about(level: int) -> np.ndarray:
    """A level and those about it, `NEAR` in all."""
    first = min(max(level - 1, 0), len(INTENSITIES) - NEAR)
    return np.arange(first, first + NEAR)


def _likeliest_time(t: Trajectory, each: np.ndarray) -> float:
    """Of those log evidences (T, I) of each are known; a model's own if they are the same."""
    totals = [over_intensities(x) for x in each]
    best = TORQUE_TIMES[int(np.argmax(totals))]
    own = totals[TORQUE_TIMES.index(t.torque_time)]
    return best if max(totals) > own + SETTLED else t.torque_time


def gain_of_torque_times(
    scene: Scene, t: Trajectory, linear: Linear, evidences: np.ndarray
) -> np.ndarray:
    """(I,) by how much the log `evidences` of a model with a law that is fixed rise where they are
    summed over the random torque's correlation time, near the likeliest torque."""
    near = levels_about(likeliest_level(evidences))
    known = evidences_at(scene, t, linear, near)
    summed, _ = over_torque_times(scene, t, linear, known, near)
    return np.where(np.isfinite(known), summed, 0.0) - np.where(np.isfinite(known), known, 0.0)


def _iterated(scene: Scene, t: Trajectory, level: int) -> Iterator[_State | None]:
    """Gauss-Newton steps of a model: its evidences where it is, near the random torque that it has,
    and where they lead; all evidences where it ends. None where it runs away. The first random
    torque is the one of index `level`, or one louder by `FALL`.

    Evidence falls along the whole of a step where the model bends more than its slopes say: such a
    step is halved (backtracking; Nocedal and Wright, Numerical Optimization, 2006, ch. 3).
    """
    every = np.arange(len(INTENSITIES))
    evidences, rise, back, halved = np.full(len(INTENSITIES), -np.inf), math.inf, None, 0
    for turn in range(_ITERATIONS):
        last, linear = turn == _ITERATIONS - 1, scene.linearised(t)
        near = levels_about(level)
        known = evidences_at(scene, t, linear, near)
        likeliest = likeliest_level(known)
        if likeliest == near[0] > 0:  # it may be a louder one
            known = evidences_at(scene, t, linear, every)
            likeliest = likeliest_level(known)
        fall = float(evidences.max()) - float(known.max())
        if not fall < SETTLED and back is not None:
            if last or halved == _HALVED or fall < _ROUGH:
                linear, rest = scene.linearised(back), fall < _ROUGH
                known = evidences_at(scene, back, linear, every, rest)
                near = levels_about(likeliest_level(known))
                evidences, each = over_torque_times(scene, back, linear, known, near, rest)
                yield _State(t, evidences, rise, True, _likeliest_time(t, each))
            t = dataclasses.replace(t, u=(t.u + back.u) / 2, path=(t.path + back.path) / 2)
            halved += 1
            yield _State(t, evidences, rise)
            continue
        if not np.isfinite(known).any():
            break
        level, before = min(likeliest, max(level, 0) + FALL), level
        rest = bool(level == before and abs(known[level] - evidences[level]) < SETTLED)
        done, time_ = last or rest, t.torque_time
        if done:
            known = evidences_at(scene, t, linear, every, rest)
            near = levels_about(likeliest_level(known))
            known, each = over_torque_times(scene, t, linear, known, near, rest)
            time_ = _likeliest_time(t, each)
        moved = scene.smoothed(t, linear, INTENSITIES[level])
        if moved is None:
            break
        rise = float(known.max()) - float(evidences.max())
        t, back, evidences, halved = moved, t, known, 0
        yield _State(t, evidences, rise, done, time_)
    yield None


class _Step(NamedTuple):
    """A Gauss-Newton step of a model."""

    start: Trajectory
    linear: Linear  # along `start`
    end: Trajectory  # a share of the step on
    off: float
    """Nats by which the density of the numbers at `start` is below that after the whole step."""


def _damped(scene: Scene, t: Trajectory, intensity: float) -> Iterator[_Step]:
    """Gauss-Newton steps of a model in which something sticks, under one random torque.

    Turns on the motion itself, so that whole steps swing about the end. Half steps, and shorter
    ones after each reversal, converge (Kesten, Annals of Mathematical Statistics 29, 1958).
    """
    reversals, before = 0, np.zeros(len(t.u))
    while True:
        linear, share = scene.linearised(t), 1.0 / (2.0 + reversals)
        end = scene.smoothed(t, linear, intensity, share)
        if end is None:
            return
        whole = (end.u - t.u) / share
        slope = np.linalg.solve(end.covariance, whole)
        yield _Step(t, linear, end, 0.5 * float(whole @ slope))
        reversals, before, t = reversals + bool(slope @ before < 0.0), whole, end


def _rested(
    scene: Scene, t: Trajectory, level: int, known: _State, least: float
) -> Generator[_State, None, _Step | None]:
    """Damped steps until the density of the numbers is within `least` nats of its maximum; the one
    that begins closest to it, for where a brake holds or slips they may jump. None where the model
    runs away."""
    best: _Step | None = None
    for here, step in enumerate(_damped(scene, t, INTENSITIES[level]), 1):
        if best is None or step.off < best.off:
            best = step
        if step.off < least or here == _HERE:
            break
        yield known._replace(trajectory=step.end)
    return best


def _descended(scene: Scene, t: Trajectory, level: int) -> Iterator[_State | None]:
    """Steps of a model in which something sticks, under each random torque in turn, then to rest
    under the likeliest one and those next to it. Each has the evidence of its own motion: one under
    a louder torque says of it what is linear only. Loud torques hide what sticks from the evidence,
    so that no model is hopeless before its end."""
    known, lowest = _State(t, np.full(len(INTENSITIES), -np.inf)), len(INTENSITIES) - 1
    best: list[Trajectory | None] = [None] * len(INTENSITIES)  # the motions that these are of
    of_times = np.full((len(TORQUE_TIMES), len(INTENSITIES)), -np.inf)

    def evaluate(step: _Step, levels: np.ndarray) -> np.ndarray:
        t = dataclasses.replace(step.end, u=step.start.u, path=step.start.path)
        found = evidences_at(scene, t, step.linear, levels, at_rest=False)
        found, each = over_torque_times(scene, t, step.linear, found, levels, at_rest=False)
        for i in levels:
            best[i] = t
        known.evidences[levels], of_times[:, levels] = found[levels], each[:, levels]
        return found[levels]

    for at in (*range(level, lowest, FALL), lowest):
        step = yield from _rested(scene, t, at, known, _ROUGH)
        if step is None:
            break
        found = evaluate(step, np.arange(at, min(at + FALL, lowest + 1)))
        if step.off < _ROUGH and not found.max() > known.evidences.max() - HOPELESS:
            break
        t = step.end
    rested: set[int] = set()
    while True:
        likeliest = likeliest_level(known.evidences)
        near = likeliest, likeliest + 1, likeliest - 1
        todo = [(i, t) for i in near if i not in rested and 0 <= i <= lowest and (t := best[i])]
        if not todo:
            break
        at, t = todo[0]
        rested.add(at)
        step = yield from _rested(scene, t, at, known, SETTLED)
        if step is not None:
            evaluate(step, np.array([at]))
            known = known._replace(rise=0.0)
    end = best[likeliest]
    if end is None:
        yield None
        return
    end = dataclasses.replace(end, torque_time=_likeliest_time(end, of_times))
    yield known._replace(trajectory=end, done=True)


def evidences_at(
    scene: Scene, t: Trajectory, linear: Linear, levels: np.ndarray, at_rest: bool = True
) -> np.ndarray:
    """(I,) log evidences of a model at some random torques, -inf at others; about its own numbers
    (`laplace_about`) if its iteration has not come to rest."""
    found = np.full(len(INTENSITIES), -np.inf)
    for i in range(0, len(levels), NEAR):  # one program for few and for all
        some = levels[np.minimum(np.arange(i, i + NEAR), len(levels) - 1)]
        logs, u, covariance = scene.evidences(t, linear, np.array(INTENSITIES)[some])
        if not at_rest:
            logs, u = laplace_about(logs, u, covariance, t.u), np.tile(t.u, (len(some), 1))
        found[some] = scene.possible(logs + non_normal_priors(t.effects, t.prior, u, covariance))
    return found


def sticks(t: Trajectory) -> bool:
    """Whether a joint or a brake may stick."""
    return any(e.dry or e.follows for e in t.effects)
