"""Which models are worth their evidence: forward selection and backward elimination.

From the model as it is, all candidates are screened to first order (`columns`); the contenders, and
what no first order can see, are iterated to their own nonlinear evidence beside "nothing more",
from loud random torques to silent ones. The best joins, the motion is smoothed with it, and the
next round begins, until no model beats the one that there is. The models tried, with their
evidences, are all that the rest of the diagnosis needs: it can stop at any time with the best so
far.
"""

import contextlib
import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import softmax

from ..effects import AbstractEffect
from ..effects.own_numbers import shared
from ..filtering.kalman import System
from ..filtering.law import number_slices, numbers_of, state_slices
from ..filtering.linearised import Linear
from ..filtering.trajectory import Scene, Trajectory
from ..fitting import FitError
from ..physics.effect import BASE
from ..physics.parameter import Parameter
from ..runtime.memory import give_back
from ..runtime.parallel import side_by_side
from .columns import (
    Column,
    Columns,
    Screen,
    candidates,
    extended,
    nested,
    of_one_kind,
    spectral_lines,
    strengths,
    without,
)
from .evidence import (
    COMPLETE,
    CONTENDERS,
    EXPLAINS_NOTHING,
    FAINT,
    FALL,
    HOPELESS,
    IN_PLAY,
    INDISTINGUISHABLE,
    INTENSITIES,
    READINGS_LEAD,
    SETTLED,
    STRENGTHS,
    TORQUE_TIMES,
    WIDTH,
    correlation_times,
    information,
    laplace_about,
    log_prior_intensity,
    log_prior_model,
    non_normal_priors,
    occams_window,
    over_intensities,
    prior_of,
    right_signs,
    savage_dickey,
    signed,
    torque_scales,
)
from .simulated import Simulated

_ITERATIONS = 20  # of one model, at the most
_NEAR = 4  # random torques at which a model is judged while it moves
_ROUGH = 1.0  # nats by which kinks make an evidence fall and rise where it is highest
_HALVED = 4  # times that a step is halved, at the most
_HERE = 6  # iterations at one random torque, at the most


@dataclasses.dataclass(frozen=True, eq=False)
class Tried:
    """A model, iterated to its evidence."""

    added: tuple[str, ...]  # labels beyond the base model, in the order in which they joined
    evidences: np.ndarray  # (I,) log evidence at each of `INTENSITIES` of the random torque
    best: Trajectory  # at the likeliest of them
    log_prior: float
    simulated: Simulated | None = dataclasses.field(default=None, kw_only=True)
    """Without a random torque, by exact simulation, where that was done."""

    @property
    def log_evidence(self) -> float:
        """The random torque summed over."""
        return over_intensities(self.evidences)

    @property
    def log_posterior(self) -> float:
        """Not normalised."""
        return self.log_evidence + self.log_prior

    @functools.cached_property
    def weights(self) -> np.ndarray:
        """(I,) posterior of the random torque's intensity, given the model."""
        return softmax(self.evidences + log_prior_intensity(INTENSITIES))

    def needs(self, scene: Scene) -> np.ndarray:
        """(I,) posterior of the random torque that the model needs: of louder ones, too, than it
        was iterated under."""
        known = np.isfinite(self.evidences)
        if known.all():
            return self.weights
        every = np.arange(len(INTENSITIES))
        each = _evidences(scene, self.best, scene.linearised(self.best), every)
        each = np.where(known, self.evidences, each)
        return softmax(each + log_prior_intensity(INTENSITIES))

    @property
    def complete(self) -> float:
        """Probability, given the model, that it needs no random torque that matters."""
        return float(self.weights[self.enough].sum())

    @property
    def nearly_complete(self) -> bool:
        """Whether the filter cannot tell if the model needs a random torque."""
        return self.evidences[-1] > self.evidences.max() - INDISTINGUISHABLE

    @property
    def enough(self) -> np.ndarray:
        """(I,) the intensities with which the model needs no random torque that matters."""
        return COMPLETE if self.best.coloured is None else FAINT

    @property
    def informed(self) -> bool:
        """Whether the readings say anything of the strengths of each effect that was added
        (`information`): else the model has the odds of the prior, which are no finding."""
        t = self.posterior
        each = (_places(t, e, strengths(e)) for e in t.effects if e.label in self.added)
        return all(information(t.covariance[np.ix_(own, own)]) > SETTLED for own in each)

    @property
    def intensity(self) -> float:
        """The likeliest random torque."""
        return INTENSITIES[int(np.argmax(self.weights))]

    @property
    def posterior(self) -> Trajectory:
        """With the posterior of its numbers: as simulated exactly where it needs no random torque
        and that was done; else as smoothed."""
        t, known = self.best, self.simulated
        if known is None or self.intensity > 0:
            return t
        u = np.append(known.u, t.u[len(known.u) :])
        return dataclasses.replace(t, u=u, covariance=known.covariance)

    def starts(self, scene: Scene) -> tuple[Trajectory, ...]:
        """Where fits by least squares begin: without a random torque; and as it is, if it has one,
        for a random torque taken away may lead astray."""
        silent = silenced(scene, self.best, self.intensity)
        return (silent, self.best) if self.intensity > 0 else (silent,)

    def simulated_as(self, found: Simulated) -> "Tried":
        """This model, with its exact simulation without a random torque. Linearised once along the
        motion without one it errs alike under all random torques; not so along another, from which
        the motion without any is far, and what sticks has a motion of its own under each."""
        evidences = self.evidences.copy()
        if self.nearly_complete and not _sticks(self.best):
            evidences += found.log_evidence - evidences[-1]
        evidences[-1] = found.log_evidence
        return dataclasses.replace(self, evidences=evidences, simulated=found)

    def over_torques(self, scene: Scene) -> list[tuple[float, Trajectory]]:
        """The motion under each random torque that counts, with its posterior probability; where
        none can be smoothed (it runs away), the model's own."""
        system = scene.linearised(self.best)
        found = [
            (w, scene.smoothed(self.best, system, x))
            for w, x in zip(self.weights, INTENSITIES, strict=True)
            if w > IN_PLAY
        ]
        kept = [(w, t) for w, t in found if t is not None] or [(1.0, self.best)]
        return [(w / sum(w for w, _ in kept), t) for w, t in kept]


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
    if _sticks(t):
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
    `_evidences`."""
    if scene.coloured is not None:
        return known, np.tile(known, (len(TORQUE_TIMES), 1))
    each = np.full((len(TORQUE_TIMES), len(INTENSITIES)), -np.inf)
    for i, x in enumerate(TORQUE_TIMES):
        other = dataclasses.replace(t, torque_time=x)
        own = known if x == t.torque_time else _evidences(scene, other, linear, levels, at_rest)
        each[i, levels] = own[levels]
    summed = known.copy()
    summed[levels] = np.logaddexp.reduce(each[:, levels], axis=0) - math.log(len(TORQUE_TIMES))
    return summed, each


def _likeliest(evidences: np.ndarray) -> int:
    """The level of the likeliest random torque."""
    return int(np.argmax(evidences + log_prior_intensity(INTENSITIES)))


def _neighbours(level: int) -> np.ndarray:
    """A level and those about it, `_NEAR` in all."""
    first = min(max(level - 1, 0), len(INTENSITIES) - _NEAR)
    return np.arange(first, first + _NEAR)


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
    near = _neighbours(_likeliest(evidences))
    known = _evidences(scene, t, linear, near)
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
        near = _neighbours(level)
        known = _evidences(scene, t, linear, near)
        likeliest = _likeliest(known)
        if likeliest == near[0] > 0:  # it may be a louder one
            known = _evidences(scene, t, linear, every)
            likeliest = _likeliest(known)
        fall = float(evidences.max()) - float(known.max())
        if not fall < SETTLED and back is not None:
            if last or halved == _HALVED or fall < _ROUGH:
                linear, rest = scene.linearised(back), fall < _ROUGH
                known = _evidences(scene, back, linear, every, rest)
                near = _neighbours(_likeliest(known))
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
            known = _evidences(scene, t, linear, every, rest)
            near = _neighbours(_likeliest(known))
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
        found = _evidences(scene, t, step.linear, levels, at_rest=False)
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
        likeliest = _likeliest(known.evidences)
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


def _evidences(
    scene: Scene, t: Trajectory, linear: Linear, levels: np.ndarray, at_rest: bool = True
) -> np.ndarray:
    """(I,) log evidences of a model at some random torques, -inf at others; about its own numbers
    (`laplace_about`) if its iteration has not come to rest."""
    found = np.full(len(INTENSITIES), -np.inf)
    for i in range(0, len(levels), _NEAR):  # one program for few and for all
        some = levels[np.minimum(np.arange(i, i + _NEAR), len(levels) - 1)]
        logs, u, covariance = scene.evidences(t, linear, np.array(INTENSITIES)[some])
        if not at_rest:
            logs, u = laplace_about(logs, u, covariance, t.u), np.tile(t.u, (len(some), 1))
        found[some] = scene.possible(logs + non_normal_priors(t.effects, t.prior, u, covariance))
    return found


def _sticks(t: Trajectory) -> bool:
    """Whether a joint or a brake may stick."""
    return any(e.dry or e.follows for e in t.effects)


def _may_be_complete(model: Tried) -> bool:
    """Whether a model may need no random torque, which an exact simulation tells: a filter's word
    is not enough where something sticks."""
    return model.nearly_complete or _sticks(model.best)


def signs_of(t: Trajectory) -> np.ndarray:
    """(I,) `right_signs` of a smoothed model, for each random torque that it still needs."""
    std = np.sqrt(np.maximum(np.diag(t.covariance), 1e-300))
    return right_signs(t.effects, t.prior, t.u, std, np.array(INTENSITIES))


def silenced(scene: Scene, t: Trajectory, intensity: float) -> Trajectory:
    """A model without a random torque: where a fit by least squares begins. If it runs away on the
    way there, the last motion that did not."""
    first = INTENSITIES.index(intensity)
    for x in (*INTENSITIES[first + 1 :: FALL], 0.0, 0.0):
        moved = scene.smoothed(t, scene.linearised(t), x)
        if moved is None:
            break
        t = moved
    return t


_prepared: set[Any] = set()


def prepare(scene: Scene, base: Sequence[AbstractEffect], wanted: Sequence[AbstractEffect]) -> bool:
    """Compile what a search runs, side by side, by running it once with zeros; once a process.

    **Returns:** whether anything was compiled.
    """
    t = scene.start(base, prior_of(scene, base))
    K, X, n, P = scene.K, t.path.shape[1], scene.n, len(t.u)
    laws, _ = scene.tabulated(t)
    key = laws.names, scene.joints, len(t.first), K, X, P, type(scene.mechanisms[0])
    if key in _prepared:
        return False
    _prepared.add(key)
    shapes = (X, X), (X, P), (X, n), (X,), (n, X), (n, P), (n,), (n, n), (n,)
    system = System(*(np.zeros((K, *shape)) for shape in shapes))
    wide = (n, 3 * K), (n, 3 * K), (X, X, 3 * K), (X, n, 3 * K)
    unused = [np.zeros(0)] * 3
    linear = Linear(system, np.zeros((K, n)), *map(np.zeros, wide), *unused)

    def filters() -> None:
        scene.evidences(t, linear, np.zeros(_NEAR))
        scene.smoothed(t, linear, 0.0)
        Columns(scene, t, wanted, [1.0], linear=linear).gram([0.0])

    # The largest program beside all others.
    side_by_side([functools.partial(scene.linearised, t), filters])
    give_back()
    return True


class OutOfTime(Exception):
    """The search's time is over."""


def tried_alone(
    scene: Scene,
    effects: Sequence[AbstractEffect],
    known: float = -math.inf,
    go_on: Callable[[], None] = lambda: None,
) -> Tried:
    """A model by itself, linearised along the readings at first, and at rest: noise makes of
    readings rates that no model follows. And, where it has effects that are silent there, from the
    springs and dampers alone, which these join one by one as the screen has them: without a
    strength neither shapes nor internal states matter, and no slope leads away. Where it falls
    hopelessly behind a log evidence that is `known`, it is left as far as it has come. `go_on` is
    called before each iteration.

    **Raises:** `FitError` if no motion goes with it.
    """
    plain = [e for e in effects if _begins_at_once(e)]
    silent = [e for e in effects if not _begins_at_once(e)]
    begun = tried_alone(scene, plain, go_on=go_on) if silent else None
    start = scene.start(effects, prior_of(scene, effects))
    starts = [start, dataclasses.replace(start, path=np.zeros_like(start.path))]
    starts = [t for each in starts if (t := _smoothed(scene, each))]
    if begun is not None:
        for effect in silent:
            t, intensity = screening_motion(scene, begun)
            linear = scene.linearised(t)
            lines = spectral_lines(scene, t, linear)
            columns = Columns(scene, t, [shared(effect)], lines, linear=linear)
            (row,) = Screen(columns, screened_at(intensity)).ranked
            begin = scene.consistent(extended(scene, t, row))
            (found,) = settle(scene, [begin], intensity, go_on)
            if found is None:
                break
            begun = Tried((), *found, log_prior=0.0)
        else:
            starts.append(scene.consistent(begun_as(start, begun.best)))
    each = [found for found in settle(scene, starts, INTENSITIES[0], go_on, known) if found]
    if not each:
        raise FitError("no motion of the model goes with the readings")
    best = max((Tried((), *found, log_prior=0.0) for found in each), key=lambda t: t.log_evidence)
    times = torque_scales(scene, best.best)
    if best.log_evidence < known - HOPELESS or times.max() == 1.0:
        return best
    scene.scale_torques(times)
    return tried_alone(scene, effects, known, go_on)


def _begins_at_once(effect: AbstractEffect) -> bool:
    """Whether an effect that is silent has a slope all the same, wherever a motion begins."""
    return effect.name in BASE or effect.senses or not strengths(effect)


def _smoothed(scene: Scene, start: Trajectory) -> Trajectory | None:
    """A start after one step. Of a path that no model was smoothed to, evidence says nothing: about
    rest, that of a linear arm, which may be above all that the true one has."""
    return scene.smoothed(start, scene.linearised(start), INTENSITIES[0])


def begun_as(start: Trajectory, known: Trajectory) -> Trajectory:
    """A model at its start, with the motion, numbers and internal states that another one with the
    same effects has; numbers of a run's own as those that all share."""
    n = known.path.shape[1] - known.first.shape[1]
    t = dataclasses.replace(known, effects=start.effects, prior=start.prior, u=np.array(start.u))
    t = dataclasses.replace(t, path=np.array(start.path), first=np.array(start.first))
    t.path[:, :n] = known.path[:, :n]
    places = zip(t.effects, number_slices(t.effects), state_slices(t.effects), strict=True)
    for effect, own, states in places:
        i = known.labels.index(effect.label)
        fields = [x.field for x in numbers_of(known.effects[i])]
        at = dict(zip(fields, known.u[number_slices(known.effects)[i]], strict=True))
        t.u[own] = [at.get(x.field, at.get(x.field.rpartition("_")[0])) for x in numbers_of(effect)]
        old = state_slices(known.effects)[i]
        t.path[:, n:][:, states] = known.path[:, n:][:, old]
        t.first[:, states] = known.first[:, old]
    return t


def screening_motion(scene: Scene, model: Tried) -> tuple[Trajectory, float]:
    """The motion that candidates are screened along, and its random torque: the likeliest, or one
    that still lets the readings lead."""
    noise = model.best.coloured is not None  # of the readings: the louder, the less they lead
    intensity = model.intensity if noise else max(model.intensity, READINGS_LEAD)
    if intensity == model.intensity:
        return model.best, intensity
    system = scene.linearised(model.best)
    return scene.smoothed(model.best, system, intensity) or model.best, intensity


def screened_at(intensity: float) -> list[float]:
    """Random torques over which a screen sums: the likeliest, one a decade below it, and none."""
    return sorted({intensity, 0.1 * intensity, 0.0}, reverse=True)


class Search:
    """The models tried so far on some recordings."""

    def __init__(
        self,
        scene: Scene,
        base: Sequence[AbstractEffect],
        *,
        deadline: float = math.inf,
        say: Callable[[str], None] = lambda words: None,
    ):
        self.scene, self.say, self.deadline = scene, say, deadline
        self.fixed = scene.fixed = tuple(e.label for e in base)
        self.candidates = candidates(scene, self.fixed)
        self.tried: dict[frozenset[str], Tried] = {}
        self.lines: list[float] = []
        """Frequencies, Hz, in the random torque of the base model."""
        self.passed: dict[frozenset[str], Tried] = {}
        """Models that were not iterated, for to first order they have next to no part: as their
        parents, with the evidence that the first order gives."""
        self.exact: Callable[[Tried], Simulated | None] | None = None
        """A model without a random torque, by exact simulation, if that can be had."""
        self._white: tuple | None = None
        """What was known under white noise, where all models have another noise now."""
        self.curves: list[Any] = []
        """`law.CurveModel`s: models with a law that has no name."""
        self.reassignments: Sequence[Any] = ()
        """`channels.Reassigned`s: the base model with the columns of the readings read otherwise,
        where it does not explain them as they stand."""
        self.stopped: str | None = None
        """Why the search ended early, if it did: "interrupted" or "budget"."""
        self._reduced: set[tuple[Tried, tuple[str, ...]]] = set()
        self._simulated: set[Trajectory] = set()
        self.screens: dict[frozenset[str], Screen] = {}
        """First-order evidence of all candidates beside the models that were extended."""
        say("smoothing the motion with the model")
        self.compiled = prepare(scene, base, self.candidates)
        """Whether programs were compiled for it: none of its kind went before, in this process."""
        alone = tried_alone(scene, base)
        self._keep((), alone.evidences, alone.best)

    def in_time(self) -> None:
        """**Raises:** `OutOfTime` after the deadline."""
        if time.perf_counter() > self.deadline:
            raise OutOfTime

    @property
    def base(self) -> Tried:
        return self.tried[frozenset()]

    @property
    def best(self) -> Tried:
        """The model with the highest posterior."""
        return max(self.tried.values(), key=lambda t: t.log_posterior)

    @property
    def singles(self) -> list[Tried]:
        """The models with one effect, the likeliest first."""
        found = (t for t in self.tried.values() if len(t.added) == 1)
        return sorted(found, key=lambda t: -t.log_posterior)

    def _keep(self, added: Sequence[str], evidences: np.ndarray, best: Trajectory) -> None:
        prior = log_prior_model(len(added), len(self.candidates))
        found = Tried(tuple(added), evidences, best, prior)
        known = self.tried.get(frozenset(added))
        if known is None or found.log_posterior > known.log_posterior:
            self.tried[frozenset(added)] = found

    @property
    def reassigned(self) -> Any:
        """The likeliest other reading of the columns, if it leaves less than an effect might
        explain and is likelier than all models of the columns as they stand; else None."""
        each = [r for r in self.reassignments if r.tried.intensity < WIDTH]
        likeliest = max(each, key=lambda r: r.tried.log_posterior, default=None)
        if likeliest is None or likeliest.tried.log_posterior < self.best.log_posterior:
            return None
        return likeliest

    def run(self, most: int, reassign: Callable[[], Sequence[Any]] = tuple) -> None:
        """Add effects, `most` at most, until no model beats the one that there is, or as long as
        the likeliest explains anything of the motion. Ctrl-C and the deadline end it with what
        there is. `reassign` makes `channels.Reassigned`s."""
        with self.ending():
            if self.base.complete < 0.5:
                self.say("reading the columns otherwise")
                self.reassignments = reassign()
                give_back()
            other = self.reassigned
            if other and (other.tried.complete > 0.5 or self.base.intensity >= WIDTH):
                return  # nothing is left to be explained, or as much as effects are
            self._grow(most)
            if self.best.complete < 0.5:
                self._in_coloured_noise(most)
            self._take_each_away()
            if self.best.intensity >= EXPLAINS_NOTHING:  # then no name says anything
                self.tried, self.passed = {frozenset(): self.base}, {}
        if self.stopped:  # what was tried last has the filter's evidence alone, others an exact one
            self.deadline = math.inf
            with self.ending():
                self._simulate()

    def _in_coloured_noise(self, most: int) -> None:
        """Go on with noise that is not white in the place of a random torque, if the readings are
        surely likelier so, or if no model explains them; as long as that leaves a complete model
        that is surely likelier. If not, all is as before."""
        least = self.best.log_posterior + INDISTINGUISHABLE
        explains = self.best.intensity < EXPLAINS_NOTHING
        self._colour_noise(least if explains else -math.inf)
        if self.scene.coloured is not None:
            self._grow(most)
            self._colour_noise(self.best.log_posterior)  # its time again, with what was found
            if self.best.complete < 0.5 or self.best.log_posterior < least:
                self.whiten_noise()

    def _grow(self, most: int) -> None:
        """Add effects, `most` at most."""
        extended: set[frozenset[str]] = set()
        self.screen(self.base)
        self._simulate()
        while not extended or self.best.intensity < EXPLAINS_NOTHING:
            best = frozenset(self.best.added)
            if best in extended or len(best) >= most:
                # Each effect in turn might have another in its place.
                todo = [
                    (model, x)
                    for model in occams_window(self.tried.values())
                    for x in model.added if frozenset(model.added) - {x} not in extended
                ]  # fmt: skip
                if not todo:
                    return
                rests = [frozenset(model.added) - {x} for model, x in todo]
                self._simplify([
                    (*own, None) for own, rest in zip(todo, rests, strict=True)
                    if rest not in self.tried
                ])  # fmt: skip
                found = [rest for rest in rests if rest in self.tried]
                extended.update(set(rests).difference(found))  # no motion has these
                if not found:
                    continue
                best = found[0]
            self.extend(self.tried[best], most)
            extended.add(best)
            self.reduce()
            self._simulate()

    def _colour_noise(self, least: float) -> None:
        """Give all models noise that is not white in the place of a random torque, if a log
        posterior is then at `least` so high: an Ornstein-Uhlenbeck process, as that torque is, of
        the likeliest correlation time."""
        scene, every = self.scene, np.arange(len(INTENSITIES))
        longest = 1.0 / min(s.frequency for s in scene.scales)
        times = correlation_times(float(np.median(np.diff(scene.recordings[0].time))), longest)
        each = []
        for model in dict.fromkeys([self.base, self.best]):
            # Linearised, a model is the same with noise of any time.
            linear = scene.with_noise(longest).linearised(model.best)
            for own in times.tolist():
                self.in_time()
                known = _evidences(scene.with_noise(own), model.best, linear, every)
                log = over_intensities(known) + model.log_prior - math.log(len(times))
                each.append((log, own, INTENSITIES[_likeliest(known)]))
        _, time_, loudest = max(each)
        if time_ == scene.coloured:
            return
        self.say("weighing noise that is not white")
        models, scene = list(self.tried.values()), scene.with_noise(time_)
        models.sort(key=lambda model: model not in (self.base, self.best))
        some, others = models[:2], models[2:]

        def settled(each: Sequence[Tried]) -> list[tuple[Tried, tuple[np.ndarray, Trajectory]]]:
            found = settle(scene, [m.best for m in each], loudest, self.in_time)
            return [(m, f) for m, f in zip(each, found, strict=True) if f is not None]

        known = settled(some)
        log = max((over_intensities(f[0]) + m.log_prior for m, f in known), default=-math.inf)
        if log < least or not any(model is self.base for model, _ in known):
            return
        known += settled(others) if others else []
        self._white = self._white or (
            self.scene, self.tried, self.passed, self.screens, self.reassignments
        )  # fmt: skip
        self.scene, self.tried, self.passed, self.screens = scene, {}, {}, {}
        self.reassignments = ()
        self._reduced.clear()
        for model, own in known:
            self._keep(model.added, *own)

    @property
    def base_under_torque(self) -> Tried:
        """The base model under a random torque, whatever the noise."""
        return self._white[1][frozenset()] if self._white else self.base

    def whiten_noise(self) -> None:
        """Take back what `_colour_noise` did."""
        if self._white:
            self.scene, self.tried, self.passed, self.screens, self.reassignments = self._white
            self._white = None

    @contextlib.contextmanager
    def ending(self) -> Iterator[None]:
        """What Ctrl-C and the deadline end: `stopped` then says which of them."""
        try:
            yield
        except KeyboardInterrupt:
            self.stopped = "interrupted"
        except OutOfTime:
            self.stopped = "budget"

    def _simulate(self) -> None:
        """The evidence of each model in play that may need no random torque, by exact simulation,
        until no other is in play."""
        while self.exact is not None and self.scene.coloured is None:
            lowest = self.best.log_posterior + math.log(IN_PLAY)
            todo = [
                t
                for t in sorted(self.tried.values(), key=lambda t: len(t.added))
                if t.log_posterior > lowest and t.best not in self._simulated
                if _may_be_complete(t)
            ]
            if not todo:
                return
            self.say("simulating what is in play")
            self._without_torque(todo)

    def _without_torque(self, models: Sequence[Tried]) -> None:
        """Simulate models exactly, each once."""
        self.in_time()
        self._simulated.update(t.best for t in models)
        work = [functools.partial(self.exact, t) for t in models]  # pyrefly: ignore
        for model, found in zip(models, side_by_side(work), strict=True):
            if found is not None:
                self.tried[frozenset(model.added)] = model.simulated_as(found)
        give_back()

    def beside(self, parent: Tried, label: str) -> Tried | None:
        """A model with one more effect, whatever the prior of that; None where it ran away, or has
        that law already. For after a search: its deadline is no more."""
        self.deadline = math.inf
        key = frozenset([*parent.added, label])
        if key not in self.tried:
            trajectory, intensity = screening_motion(self.scene, parent)
            row = next((s for s in self.screen(parent).ranked if s.effect.label == label), None)
            start = row and self._start(parent, trajectory, row)
            (found,) = settle(self.scene, [start], intensity) if start else (None,)
            if found is None:
                return None
            self._keep((*parent.added, label), *found)
        model = self.tried[key]
        known = self.exact is None or model.best in self._simulated
        if not known and self.scene.coloured is None and _may_be_complete(model):
            self._without_torque([model])
        return self.tried[key]

    def screen(self, parent: Tried) -> Screen:
        """The first-order evidence of all candidates beside a model."""
        key = frozenset(parent.added)
        if key not in self.screens:
            self.in_time()
            trajectory, intensity = screening_motion(self.scene, parent)
            self.say(f"screening {len(self.candidates)} candidates")
            # A model with little random torque shows no line in it, however wrong it is: the base
            # model's, which is the loudest, stay.
            linear = self.scene.linearised(trajectory)
            lines = spectral_lines(self.scene, trajectory, linear, self.lines)
            self.lines = self.lines or lines
            effects = [e for e in self.candidates if self._may_join(e, trajectory)]
            columns = Columns(self.scene, trajectory, effects, lines, linear=linear)
            screen = self.screens[key] = Screen(columns, screened_at(intensity))
            little = parent.complete > 0.5 and self.scene.coloured is None
            if not little:  # else the first order is right
                screen.revise(self._sticking(screen, trajectory, linear, intensity))
        return self.screens[key]

    def _sticking(
        self, screen: Screen, trajectory: Trajectory, linear: Linear, intensity: float
    ) -> list[Column]:
        """The candidates in which something sticks, at each of their shapes: dry friction at each
        of `STRENGTHS`, what follows the angle, whose torque is in proportion to its strength, at
        the one that the screen has for that shape.

        When it sticks depends on the numbers, so that one linearisation about no strength says
        little: each point of the grid has its own. About far too small a strength a shape would
        have to move too far.
        """
        scene, first = self.scene, INTENSITIES.index(intensity)
        first = min(max(first - 1, 0), len(INTENSITIES) - _NEAR)
        levels = np.arange(first, first + _NEAR)
        none = over_intensities(_evidences(scene, trajectory, linear, levels))

        def at(row: Column) -> Column:
            self.in_time()
            t = scene.consistent(extended(scene, trajectory, row))
            here = _evidences(scene, t, scene.linearised(t), levels)
            return row._replace(gain=over_intensities(here) - none)

        points = []
        for row in screen.rows:
            # Further strengths are next to silent: of Stribeck's law, Coulomb's is left.
            each = np.eye(len(row.which))[0]
            if row.effect.dry:
                points += [row._replace(regressors=x * each) for x in STRENGTHS]
            elif row.effect.follows:
                points.append(row._replace(regressors=screen.gain([row])[1]))
        return side_by_side([functools.partial(at, point) for point in points])

    def extend(self, parent: Tried, most: int) -> None:
        """Try a model with one more effect, each contender in turn; and, unless one explains the
        readings, with the likeliest pairs: where each alone leaves about as much as before, both
        may leave nothing. Of `most` effects in all."""
        trajectory, intensity = screening_motion(self.scene, parent)
        screen = self.screen(parent)
        prior, worth = self._price(parent, 1)
        chosen, little = screen.ranked[:CONTENDERS], parent.complete > 0.5
        if little:
            # What is left is small, and the first order right: by it most have no part.
            chosen = [s for s in chosen if s.gain > worth]
            for s in (s for s in screen.ranked if s.gain <= worth):
                added = (*parent.added, s.effect.label)
                passed = Tried(added, parent.evidences + s.gain, parent.best, prior)
                self.passed[frozenset(added)] = passed
        # A law that contains another's begins where that one has ended.
        for later in (False, True):
            # Where something sticks, an iteration may end at corners that lie on its way.
            starts = [
                ((s.effect.label,), self._start(parent, trajectory, x))
                for s in chosen if bool(s.effect.extends) is later
                for x in (s, *(s.alike if s.effect.follows else ()))
            ]  # fmt: skip
            self._join(parent, intensity, starts)
        self._simulate()  # the filter may take a model for complete that is not
        if little or self.best.complete <= 0.5:
            pairs = self._pairs(parent, screen, most)
            if little:
                pairs = [own for own in pairs if own[0] > self._price(parent, 2)[1]]
            starts = [self._start_of_two(trajectory, screen, a, b) for _, a, b in pairs]
            self._join(parent, intensity, starts)

    def _pairs(
        self, parent: Tried, screen: Screen, most: int
    ) -> list[tuple[float, Column, Column]]:
        """The likeliest pairs of effects, to first order, that a model may have more: none of which
        one of the two alone is likelier, for the other would follow it; and none with what
        follows the angle, of which one linearisation about no strength says little."""
        if len(parent.added) + 2 > most:
            return []
        more = self._price(parent, 2)[1] - self._price(parent, 1)[1]
        alone = {s.effect.label: screen.gain([s])[0] for s in screen.ranked}
        each = (
            (gain, a, b) for gain, a, b in screen.pairs
            if gain > max(alone[s.effect.label] for s in (a, b)) + more
            and not (a.effect.follows or b.effect.follows)
        )  # fmt: skip
        return list(itertools.islice(each, CONTENDERS))

    def _start_of_two(
        self, t: Trajectory, screen: Screen, *pair: Column
    ) -> tuple[tuple[str, ...], Trajectory]:
        """Where the iteration of a model with two more effects begins, as the screen has them."""
        _, u = screen.gain(pair)
        for s, own in zip(pair, np.split(u, [len(pair[0].which)]), strict=True):
            t = extended(self.scene, t, s._replace(regressors=own))
        return tuple(s.effect.label for s in pair), self.scene.consistent(t)

    def _price(self, parent: Tried, more: int) -> tuple[float, float]:
        """Log prior of a model with some more effects, and what they must raise the log evidence
        by, nats, for it to be in play beside its parent."""
        n, m = len(self.candidates), len(parent.added)
        prior = log_prior_model(m + more, n)
        return prior, log_prior_model(m, n) - prior + math.log(IN_PLAY)

    def _join(
        self,
        parent: Tried,
        intensity: float,
        starts: Sequence[tuple[tuple[str, ...], Trajectory]],
    ) -> None:
        """Iterate a model with some more effects, from where it begins with each of them."""
        if not starts:
            return
        each, begun = zip(*starts, strict=True)
        self.say(f"weighing {len(set(each))} candidates")
        results = settle(self.scene, begun, intensity, self.in_time)
        for labels, found in zip(each, results, strict=True):
            if found is not None:
                self._keep((*parent.added, *labels), *found)

    def _start(self, parent: Tried, trajectory: Trajectory, found: Column) -> Trajectory:
        """Where the iteration of a model with one more effect begins: as the screen has it, or, if
        the model with the law that it contains has ended already, from there."""
        less = self._contained(found.effect)
        ended = less and self.tried.get(frozenset([*parent.added, less.label]))
        if less is None or ended is None:
            return self.scene.consistent(extended(self.scene, trajectory, found))
        return self._instead(ended.best, less, found)  # pyrefly: ignore[missing-attribute]

    def _contained(self, law: AbstractEffect) -> AbstractEffect | None:
        """The candidate that a law is with its further numbers silent."""
        within = (e for e in self.candidates if e.place == law.place and e.name == law.extends)
        return next(within, None)

    def _instead(self, t: Trajectory, old: AbstractEffect, found: Column) -> Trajectory:
        """A model with another law in the place of one of its effects; what both have keeps its
        value."""
        own = number_slices(t.effects)[t.labels.index(old.label)]
        at = {n.field: u for n, u in zip(numbers_of(old), t.u[own], strict=True)}
        values = zip(numbers_of(old), t.numbers[own], strict=True)
        shape = found.shape | {n.field: x for n, x in values if n.silent is None}
        screened = zip(strengths(found.effect), found.regressors, strict=True)
        begun = np.array([at.get(n.field, u) for n, u in screened])
        found = found._replace(shape=shape, regressors=begun)
        rest = without(self.scene, t, old.label)
        return self.scene.consistent(extended(self.scene, rest, found))

    def _may_join(self, effect: AbstractEffect, trajectory: Trajectory) -> bool:
        """Whether an effect is not there, nor a law that it contains or that contains it, nor one
        of its kind that joined the base model."""
        return effect.label not in trajectory.labels and not any(
            nested(effect, present)
            or (present.label not in self.fixed and of_one_kind(effect, present))
            for present in trajectory.effects
        )

    def reduce(self) -> None:
        """Try simpler models from the richer one's motion: those that it says, to first order, to
        be in play, and likelier than the way there has shown."""
        lowest, todo = self.best.log_posterior - INDISTINGUISHABLE, []
        for model in self.tried.values():
            for label in model.added:
                effect = model.best.effects[model.best.labels.index(label)]
                within = self._contained(effect)
                for less in (None, within) if within else (None,):
                    rest = _replaced(model.added, label, less)
                    price = log_prior_model(len(rest), len(self.candidates)) - model.log_prior
                    hoped = model.log_posterior + price - bayes_factor(model.best, effect, less)
                    known = self.tried.get(frozenset(rest))
                    above = known.log_posterior + INDISTINGUISHABLE if known else lowest
                    if rest and hoped > max(lowest, above) and (model, rest) not in self._reduced:
                        todo.append((model, label, less))
        self._simplify(todo)

    def _take_each_away(self) -> None:
        """Try the models in play without each of their effects: whether one is at work shows beside
        the model without it."""

        def left() -> list[tuple[Tried, str, None]]:
            lowest = self.best.log_posterior + math.log(IN_PLAY)
            return [
                (model, x, None)
                for model in self.tried.values() if model.log_posterior > lowest
                for x in model.added
                if frozenset(model.added) - {x} not in self.tried
                and (model, _replaced(model.added, x, None)) not in self._reduced
            ]  # fmt: skip

        while todo := left():
            self._simplify(todo)
            self._simulate()

    def _simplify(self, todo: Sequence[tuple[Tried, str, AbstractEffect | None]]) -> None:
        """Try models without an effect, or with a law that it contains in its place."""
        if not todo:
            return
        self._reduced.update((m, _replaced(m.added, label, less)) for m, label, less in todo)
        self.say("weighing simpler models")
        starts, loudest = [], 0.0
        for model, label, less in todo:
            t, intensity = screening_motion(self.scene, model)
            loudest = max(loudest, intensity)
            if less is None:
                starts.append(without(self.scene, t, label))
                continue
            old, none = t.effects[t.labels.index(label)], np.zeros(len(strengths(less)))
            states = np.zeros((self.scene.K, len(less.memory)))
            starts.append(self._instead(t, old, Column(less, {}, (), states, regressors=none)))
        each = settle(self.scene, starts, loudest, self.in_time)
        for (model, label, less), found in zip(todo, each, strict=True):
            if found is not None:
                self._keep(_replaced(model.added, label, less), *found)


def _replaced(added: Sequence[str], label: str, less: AbstractEffect | None) -> tuple[str, ...]:
    """Labels without one of them, or with another one in its place, which comes last."""
    return (*(x for x in added if x != label), *([less.label] if less else ()))


def bayes_factor(t: Trajectory, effect: AbstractEffect, less: AbstractEffect | None) -> float:
    """Log evidence of a model over that without one of its effects, or with a law that it contains
    in its place, to first order (`savage_dickey`)."""
    kept = [n.field for n in strengths(less)] if less else []
    gone = [n for n in strengths(effect) if n.field not in kept]
    which = _places(t, effect, gone)
    covariance = t.covariance[np.ix_(which, which)]
    return savage_dickey(t.u[which], covariance, [signed(n) for n in gone])


def _places(t: Trajectory, effect: AbstractEffect, numbers: Sequence[Parameter]) -> list[int]:
    """Where some numbers of an effect stand among all of a model."""
    first = number_slices(t.effects)[t.labels.index(effect.label)].start
    return [first + i for i, n in enumerate(numbers_of(effect)) if n in numbers]
