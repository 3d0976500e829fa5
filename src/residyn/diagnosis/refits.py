"""Candidates joined to a model and fitted, each from where the screen says."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import jax
import numpy as np

from .._stretches import in_stretches
from ..effects import AbstractEffect
from ..fitting.descent import Descent
from ..fitting.pipeline import begin_afresh, refit
from ..fitting.result import FitError
from ..model import Model
from ..recording import Experiment
from .path import resonant
from .rung import Refit, Step, errors_of
from .screen import Screened

_HOPELESS = 1.5  # times the best, when it should have settled: not worth the time
_WEAK = 0.3  # of the screened strength, for the second start
_PROMISED = 1.5  # times the screened chi-square: a fit that ends worse starts again
_AGAIN = 3  # fits that start again
_IMPOSSIBLE = 3.0  # standard errors on the wrong side of zero
_FAR = 10.0  # times the noise: no such fit will come down to it
_VALLEYS = 2  # candidates that are fitted stage by stage
_NOISE = 1.1  # times the noise: as good as it gets
_UNUSUAL = 2.0  # standard deviations of chi-square
_CYCLES = 2.0  # of an oscillation in the longest recording: fewer could be any slow torque
_THREADS = 2
_STRETCH = 2.0  # cycles of the slowest mode in a stretch, at least
_JOINED = 3  # stretches make one of the next longer ones


def refits(step: Step, experiment: Experiment, tried: Sequence[Screened]) -> list[Refit]:
    """Fits of some candidates beside a model; those that led nowhere are left out."""
    each: list[Future[Refit | None]] = []

    def one(screened: Screened, before: Sequence[Future[Refit | None]]) -> Refit | None:
        known = [r for r in (f.result() for f in before) if r is not None and r.possible]
        return _refit(step, experiment, screened, min([step.cost, *(r.cost for r in known)]))

    with ThreadPoolExecutor(_THREADS) as pool:  # compiling is most of it, and leaves Python free
        for i, s in enumerate(tried):
            # Of its neighbour, which is fitted beside it, a candidate must know nothing: what it
            # knew would depend on the machine's mood.
            each.append(pool.submit(one, s, each[: max(0, i + 1 - _THREADS)]))
        found = [r for r in (e.result() for e in each) if r is not None]
    return _staged(step, experiment, _again(step, experiment, found))


def _again(step: Step, experiment: Experiment, refits: list[Refit]) -> list[Refit]:
    """Fits that ended far above the best start again where that one has left springs, dampers and
    initial states: a wrong valley of those is the usual reason."""
    best = min((r for r in refits if r.possible), key=lambda r: r.cost, default=None)
    if best is None:
        return refits
    count, size = len(step.fit.numbers), step.near.fitted[0].state.size
    numbers = np.asarray(best.model.vector())[:count]
    states = np.asarray(best.descent.problem.states(best.descent.unknowns))[:, :size]
    found, left = [], _AGAIN
    for r in sorted(refits, key=lambda r: r.screened.chi2):
        if left and r.cost > _PROMISED * best.cost:
            left -= 1
            moved = r.screened._replace(
                numbers=numbers,
                states=np.concatenate([states, r.screened.states[:, size:]], axis=1),
            )
            new = _refit(step, experiment, moved, best.cost, weak=False)
            if new is not None and new.cost < r.cost:
                r = new._replace(screened=r.screened)
        found.append(r)
    return found


def _staged(step: Step, experiment: Experiment, found: list[Refit]) -> list[Refit]:
    """Joints that stick or rattle make many valleys. Where the best fits of such effects end above
    the noise, they start again from what stretches of a few cycles say, in which no phase can slip,
    and from where the screen began and the fit ended with the first cycles fitted first. So does
    whatever the screen puts first, if its fit is nowhere near what was promised, and the first of
    such effects that would have been the best, had it kept its promise."""
    noise = step.readings + _UNUSUAL * math.sqrt(2.0 * step.readings)
    # One of the wrong sign, too: that is a wrong valley's usual mark.
    by_cost = sorted(found, key=lambda r: r.cost)
    promised = sorted(found, key=lambda r: r.screened.chi2)

    def slips(r: Refit) -> bool:
        return (r.effect.dry or r.effect.rough) and r.cost > noise

    def broke(r: Refit, times: float) -> bool:
        return r.cost > times * max(r.screened.chi2, noise)

    again = [r for r in promised[:1] if broke(r, _FAR)]
    rivals = [r for r in promised if slips(r) and broke(r, _PROMISED)]
    again += [r for r in rivals if by_cost and r.screened.chi2 < by_cost[0].cost][:1]
    again += [r for r in by_cost[:_VALLEYS] if slips(r)]
    wild = [r.wild for r in step.near.fitted]
    for r in {r.label: r for r in again}.values():
        alone = Model(step.fit.model.mechanism, (r.effect,))
        ended = np.asarray(r.model.vector()), r.descent.problem.states(r.descent.unknowns)
        begins = [(r.start, r.screened.states), ended]
        for numbers, states in [*_from_stretches(step, experiment, r), *begins]:
            try:
                model, descent = refit(
                    experiment,
                    (*step.effects, silent(r.effect)),
                    np.asarray(numbers)[None],
                    np.asarray(states)[None],
                    wild,
                    staged=True,
                )
            except FitError:
                continue
            if descent.cost < r.cost:
                possible = _possible(step, model, descent, alone)
                new = r._replace(model=model, descent=descent, possible=possible)
                found = [new if x.label == r.label else x for x in found]
                r = new
        if not r.possible or slips(r):
            found = [_afresh(step, experiment, r) if x.label == r.label else x for x in found]
    return found


def _afresh(step: Step, experiment: Experiment, r: Refit) -> Refit:
    """The same candidate from where a fit by name begins, which knows nothing of any screen; or as
    it was, if that is better. One start after the other: that program is compiled already."""
    effects, wild = (*step.effects, silent(r.effect)), [x.wild for x in step.near.fitted]
    alone = Model(step.fit.model.mechanism, (r.effect,))
    numbers, memory = begin_afresh(experiment, effects, wild)
    for i, row in enumerate(numbers):
        own = None if memory is None else memory[i : i + 1]
        try:
            model, descent = refit(experiment, effects, row[None], None, wild, memory=own)
        except FitError:
            continue
        if descent.cost < r.cost:
            possible = _possible(step, model, descent, alone)
            r = r._replace(model=model, descent=descent, start=row, possible=possible)
        if r.cost < _NOISE * step.readings:
            break
    return r


def _from_stretches(step: Step, experiment: Experiment, r: Refit):
    """Where fits of ever longer stretches of the recordings end, each stretch begun afresh:
    (numbers, states), or nothing.

    A few cycles cannot slip, and all of them together know the numbers nearly as well as the whole
    does; from there the next longer ones cannot slip either.
    """
    wholes = [x for x in experiment.recordings if x.role == "fit"]
    if not step.fit.modes:
        return []
    cycles = max(x.duration for x in wholes) * step.fit.modes[0].frequency_hz
    level = int(math.log(max(1.0, cycles / _STRETCH), _JOINED))
    effects = (*step.effects, silent(r.effect))
    numbers, states = np.asarray(r.start)[None], None
    for many in [_JOINED**i for i in range(level, 0, -1)]:
        parts = [in_stretches(x, x.duration / many) for x in wholes]
        wild = []
        for each, whole in zip(parts, step.near.fitted, strict=True):
            edges = np.cumsum([len(p.time) for p in each])[:-1]
            wild += np.split(whole.wild, edges)
        cut = dataclasses.replace(experiment, recordings=tuple(itertools.chain(*parts)))
        try:
            model, descent = refit(cut, effects, numbers, states, wild)
        except FitError:
            return []
        numbers = np.asarray(model.vector())[None]
        # Every third stretch begins where a longer one does.
        states = np.asarray(descent.problem.states(descent.unknowns))[None, ::_JOINED]
    return [] if states is None else [(numbers[0], states[0])]


def _refit(
    step: Step, experiment: Experiment, screened: Screened, least: float, weak: bool = True
) -> Refit | None:
    """Fit a candidate; `least` is the best cost among those that were fitted before."""
    effects = (*step.effects, silent(screened.effect))
    alone = Model(step.fit.model.mechanism, (screened.effect,))
    now = np.asarray(step.fit.model.vector())
    second = np.concatenate([now, np.asarray(alone.vector())])
    for i, n in enumerate(alone.fitted, start=len(now)):
        if n.meaning.silent is not None:
            second[i] = n.meaning.silent + _WEAK * (second[i] - n.meaning.silent)
    states = np.stack([r.state for r in step.near.fitted])
    more = screened.states[:, states.shape[1] :]
    wild = [r.wild for r in step.near.fitted]
    best = None

    def hopeless(cost: float) -> bool:
        return cost > _HOPELESS * max(least, float(step.readings))

    with jax.enable_x64(True):
        # From where the screen says, with the shapes that it likes best; at last from where the
        # model stands. A fit down to the noise needs no other.
        begins = [(_joined(step, x), x.states) for x in (screened, *screened.others)]
        begins += [(second, np.concatenate([states, more], axis=1))]
        for numbers, begin in begins if weak else begins[:1]:
            try:
                model, descent = refit(
                    experiment, effects, numbers[None], begin[None], wild, hopeless
                )
            except FitError:
                continue
            if best is None or descent.cost < best.cost:
                possible = _possible(step, model, descent, alone)
                best = Refit(screened.effect, screened, model, descent, numbers, possible)
            noise = float(step.readings)
            enough = _NOISE * noise
            if not screened.others or screened.chi2 > _FAR * noise:
                enough = _PROMISED * max(screened.chi2, noise)
            if best.cost < enough and not (screened.effect.rough and begin is not begins[-1][1]):
                break
    return best


def _joined(step: Step, screened: Screened) -> np.ndarray:
    """All numbers of a model with a screened effect; what physics keeps positive stays so."""
    own = np.asarray(Model(step.fit.model.mechanism, (screened.effect,)).vector())
    numbers, now = screened.numbers.copy(), np.asarray(step.fit.model.vector())
    for i, n in enumerate(step.fit.model.fitted):
        if n.meaning.sign == "positive" and numbers[i] <= 0.0 < now[i]:
            numbers[i] = _WEAK * now[i]
    return np.concatenate([numbers, own])


def silent(effect: AbstractEffect) -> AbstractEffect:
    """The same effect as a fit takes it: at its default values."""
    return type(effect)(effect.place) if effect.place else type(effect)()  # pyright: ignore


def _possible(step: Step, model: Model, descent: Descent, alone: Model) -> bool:
    """Whether no number of the effect is on the wrong side of zero, for sure, and no oscillation is
    but a correction of a mode, or too slow to be seen as one."""
    values, spread = np.asarray(model.vector()), errors_of(descent, 1.0)
    first = len(values) - len(alone.fitted)
    modes = [m.frequency_hz for m in step.fit.modes]
    longest = max(r.recording.duration for r in step.near.fitted)
    for i, n in enumerate(alone.fitted):
        oscillates = n.meaning.field == alone.effects[n.effect].oscillates
        if oscillates:
            frequency = abs(values[first + i])
            if frequency * longest < _CYCLES or resonant(frequency, modes, longest):
                return False
        if n.meaning.sign == "positive" and n.meaning.silent is not None:
            value, std = values[first + i], spread[first + i]
            if value < 0 and (not np.isfinite(std) or value < -_IMPOSSIBLE * std):
                return False
    return True
