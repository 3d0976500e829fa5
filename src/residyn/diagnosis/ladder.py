"""Up the ladder: the effect that explains most joins the model, everything is fitted again.

The screen says which effects deserve a real fit; the fits, from several starts each, say which of
them it is. A newcomer must be sure, must matter where nothing was fitted too, and may make an
earlier one needless. Thousands of samples make any trifle significant, and the residual of a model
that misses something is not white; so *sure* is judged from how the gain varies from stretch to
stretch of the recording.
"""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np

from ..effects import AbstractEffect
from ..fitting.descent import Descent
from ..fitting.identify import spread_of
from ..fitting.pipeline import finish, refit
from ..fitting.result import Fit, FitError
from ..model import Model
from ..recording import Experiment
from .horizon import HeldOut, held_out
from .linear import Near
from .missing_torque import MissingTorque
from .path import Path
from .screen import Screened, Tried, glance, screen
from .where import Where, where
from .words import SURE

_REFITS = 6  # candidates that are fitted
_CLOSE = 1.25  # a candidate this many times worse than the best, screened, is not fitted
_ROUGHLY = 3.0  # the same where not even the best one comes near the noise
_FEWEST = 3
_DROP = 20.0  # least fall of chi-square, in units of what is left, of one number
_MORE = 3.0  # and of every further one
_SEARCHED = 10.0  # and where a frequency was looked for
_STEADY = 2.5  # standard errors of the gain, as stretches of the recording show it
_MATTERS = 0.05  # share of the error that must go, where what is left is not white
_HELD = 0.02  # and where nothing was fitted
_WORSE = 0.02  # share by which the held-out error may grow where what is left is white
_STRETCHES = 24  # least number of stretches of all recordings
_IMPOSSIBLE = 3.0  # standard errors on the wrong side of zero
_NEAR = 2.0  # times the noise: a fit as good as this knows the motion
_HOPELESS = 1.5  # times the best, when it should have settled: not worth the time
_WEAK = 0.3  # of the screened strength, for the second start
_PROMISED = 1.5  # times the screened chi-square: a fit that ends worse starts again
_GLANCE = 0.6  # of what a newcomer must bring: less, and it is not even screened
_AGAIN = 3  # fits that start again
THREADS = 2


class Refit(NamedTuple):
    """A candidate joined to the model and fitted."""

    effect: AbstractEffect
    screened: Screened
    model: Model
    descent: Descent
    start: np.ndarray
    possible: bool
    """Whether its numbers have the sign that physics allows."""

    @property
    def label(self) -> str:
        """`name` or `name:place`."""
        return self.effect.label

    @property
    def cost(self) -> float:
        """Chi-square with it."""
        return self.descent.cost

    @property
    def numbers(self) -> int:
        """How many numbers it brought."""
        return len(Model(self.model.mechanism, (self.effect,)).fitted)

    @property
    def std(self) -> np.ndarray:
        """(P,) standard errors of all numbers."""
        readings = float(np.sum(np.asarray(self.descent.problem.recorded.weights) > 0))
        return _std(self.descent, max(1.0, self.cost / readings))


class Step(NamedTuple):
    """A model on the ladder, and what was found from it."""

    fit: Fit
    near: Near
    where: Where
    white: float
    held_out: HeldOut | None
    effects: tuple[AbstractEffect, ...]
    slopes: list[np.ndarray]
    alone: float = float("nan")
    tried: Tried | None = None
    screened: tuple[Screened, ...] = ()
    refits: tuple[Refit, ...] = ()

    @property
    def cost(self) -> float:
        """Chi-square of the fit."""
        return cost_of(self.fit)

    @property
    def readings(self) -> int:
        """How many readings were fitted."""
        return sum(int(r.used.sum()) for r in self.near.fitted)


def cost_of(fit: Fit) -> float:
    """Sum of squared whitened residuals of the fitted recordings."""
    return sum(
        float(np.sum((np.where(r.used, r.residual, 0.0) / r.recording.noise) ** 2))
        for r in fit.recordings
        if r.recording.role != "check"
    )


def stand(fit: Fit, effects: Sequence[AbstractEffect]) -> Step:
    """A fitted model as a step of the ladder."""
    near = Near.of(fit)
    _, slopes = near.look(near.at)
    found = where(near, slopes)
    p = [w.p for w in found.white.values() if np.isfinite(w.p)]
    white = float(-np.expm1(len(p) * np.log1p(-min(p)))) if p and min(p) < 1 else 1.0
    return Step(fit, near, found, white, held_out(near), tuple(effects), slopes)


def search(
    step: Step,
    experiment: Experiment,
    missing: Sequence[MissingTorque],
    candidates: Sequence[AbstractEffect],
    say: Callable[[str], None],
) -> Step:
    """Screen all candidates beside a model, and fit those that deserve it."""
    if step.tried is not None:
        drops = glance(step.near, step.slopes, step.tried)
        if not any(
            drops.get(c.label, 0.0) > _GLANCE * worth(c, step) * max(1.0, step.cost / step.readings)
            for c in candidates
            if c.label not in step.fit.model.labels
        ):
            return step
    there = set(step.fit.model.labels)
    some = [c for c in candidates if c.label not in there]
    say(f"screening {len(some)} effects")
    period = 1.0 / step.fit.modes[0].frequency_hz if step.fit.modes else 0.0
    # Near the noise the fit's own motion is the better one to look from: it has no noise in it.
    led = step.cost > _NEAR * step.readings
    paths = [
        Path.of(m, step.near.problem.steps, period, None if led else r.predicted)
        for m, r in zip(missing, step.near.fitted, strict=True)
    ]
    alone, found, kept = screen(step.near, paths, some, led)
    tried = [s for s in found if s.drop > (0.5 if led else 0.8) * worth(s.effect, step)]
    if tried:
        best, noise = tried[0].chi2, float(step.readings)
        enough = (_CLOSE if best < 2 * noise else _ROUGHLY) * max(best, noise)
        tried = [s for i, s in enumerate(tried) if i < _FEWEST or s.chi2 < enough][:_REFITS]
    names = ", ".join(s.effect.label for s in tried)
    say(f"fitting {names}" if names else "nothing worth fitting")
    best = [step.cost]
    with ThreadPoolExecutor(THREADS) as pool:  # compiling is most of it, and leaves Python free
        each = [pool.submit(_refit, step, experiment, s, best) for s in tried]
        refits = [r for r in (e.result() for e in each) if r is not None]
    refits = _again(step, experiment, refits)
    return step._replace(
        alone=alone, screened=tuple(found), refits=tuple(refits), tried=step.tried or kept
    )


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
            new = _refit(step, experiment, moved, [best.cost], weak=False)
            if new is not None and new.cost < r.cost:
                r = new._replace(screened=r.screened)
        found.append(r)
    return found


def worth(effect: AbstractEffect, step: Step) -> float:
    """How far chi-square must fall for an effect, in its own units."""
    count = len(Model(step.fit.model.mechanism, (effect,)).fitted)
    least = _DROP + _MORE * (count - 1) + _SEARCHED * (effect.oscillates is not None)
    return least


def _refit(
    step: Step, experiment: Experiment, screened: Screened, least: list[float], weak: bool = True
) -> Refit | None:
    """Fit a candidate; `least` has the costs of those that were fitted before."""
    effects = (*step.effects, _silent(screened.effect))
    alone = Model(step.fit.model.mechanism, (screened.effect,))
    first = np.concatenate([screened.numbers, np.asarray(alone.vector())])
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
        return cost > _HOPELESS * max(min(least), float(step.readings))

    with jax.enable_x64(True):
        # From where the screen says; if that leads nowhere, from where the model stands.
        begins = [(first, screened.states), (second, np.concatenate([states, more], axis=1))]
        for numbers, begin in begins if weak else begins[:1]:
            try:
                model, descent = refit(
                    experiment, effects, numbers[None], begin[None], wild, hopeless
                )
            except FitError:
                continue
            if best is None or descent.cost < best.cost:
                possible = _possible(model, descent, alone)
                best = Refit(screened.effect, screened, model, descent, numbers, possible)
            if best.cost < _PROMISED * max(screened.chi2, float(step.readings)):
                break
    if best is not None and best.possible:
        least.append(best.cost)
    return best


def _silent(effect: AbstractEffect) -> AbstractEffect:
    """The same effect as a fit takes it: at its default values."""
    return type(effect)(effect.place) if effect.place else type(effect)()  # pyright: ignore


def _std(descent: Descent, inflation: float) -> np.ndarray:
    sizes = np.asarray(descent.problem.scale.numbers)
    return spread_of(np.asarray(descent.compressed.factor), sizes, inflation).std


def _possible(model: Model, descent: Descent, alone: Model) -> bool:
    """Whether no number of the effect is on the wrong side of zero, for sure."""
    values, spread = np.asarray(model.vector()), _std(descent, 1.0)
    first = len(values) - len(alone.fitted)
    for i, n in enumerate(alone.fitted):
        if n.meaning.sign == "positive" and n.meaning.silent is not None:
            value, std = values[first + i], spread[first + i]
            if value < 0 and (not np.isfinite(std) or value < -_IMPOSSIBLE * std):
                return False
    return True


def score(step: Step, refit: Refit) -> float:
    """Chi-square in units of what is left by the best, plus what its numbers cost."""
    return refit.cost / unit(step) + refit.numbers * math.log(step.readings)


def unit(step: Step) -> float:
    """What one reading's square leaves with the best candidate: 1 if that is all there is."""
    least = min((r.cost for r in step.refits), default=step.cost)
    return max(1.0, least / step.readings)


def ranked(step: Step) -> list[Refit]:
    """The fitted candidates that could be, the best first."""
    return sorted((r for r in step.refits if r.possible), key=lambda r: score(step, r))


def accepted(step: Step, chosen: Refit, experiment: Experiment) -> Step | None:
    """The next rung, with the chosen effect; None if that is not sure, or does not matter."""
    before = cost_of(step.fit)
    drop = (before - chosen.cost) / max(1.0, chosen.cost / step.readings)
    if drop < worth(chosen.effect, step) or not steady(step, chosen):
        return None
    began = time.perf_counter()
    fit = finish(
        experiment,
        (*step.effects, _silent(chosen.effect)),
        chosen.model,
        chosen.start,
        chosen.descent,
        began,
    )
    new = stand(fit, (*step.effects, _silent(chosen.effect)))
    return new._replace(tried=step.tried) if matters(step, new) else None


def needless(step: Step, experiment: Experiment, first: int) -> Step:
    """The model less any effect, but the last and the `first` ones, that it no longer needs."""
    fit = step.fit
    for effect in step.effects[first:-1]:
        own = [i for i, n in enumerate(fit.numbers) if n.name.startswith(f"{effect.label}.")]
        square = fit.covariance[np.ix_(own, own)]
        values = np.array([fit.numbers[i].value for i in own])
        if np.isfinite(square).all() and values @ np.linalg.pinv(square) @ values > worth(
            effect, step
        ):
            continue  # so far from silent that no fit without it could do
        left = tuple(e for e in step.effects if e.label != effect.label)
        keep = [i for i in range(len(fit.numbers)) if i not in own]
        sizes = [len(e.memory) for e in fit.model.effects]
        at = fit.model.labels.index(effect.label)
        begin = 2 * len(fit.joints) + sum(sizes[:at])
        states = np.stack([r.state for r in step.near.fitted])
        states = np.delete(states, np.arange(begin, begin + sizes[at]), axis=1)
        numbers = np.asarray(fit.model.vector())[keep]
        try:
            model, descent = refit(
                experiment,
                left,
                numbers[None],
                states[None],
                [r.wild for r in step.near.fitted],
                lambda cost: False,
            )
        except FitError:
            continue
        if (descent.cost - step.cost) / max(1.0, step.cost / step.readings) < worth(effect, step):
            began = time.perf_counter()
            without = stand(finish(experiment, left, model, numbers, descent, began), left)
            return needless(without._replace(tried=step.tried), experiment, first)
    return step


def steady(step: Step, chosen: Refit) -> bool:
    """Whether the gain is more than what stretches of the recording make of it by chance."""
    gains = []
    fitted = chosen.descent.beside([r.recording for r in step.near.fitted])
    period = 1.0 / step.fit.modes[0].frequency_hz if step.fit.modes else 0.0
    for old, new in zip(step.near.fitted, fitted, strict=True):
        use, noise = old.used & new.used, old.recording.noise
        gain = np.where(use, (old.residual / noise) ** 2 - (new.residual / noise) ** 2, 0.0)
        time_ = old.recording.time - old.recording.time[0]
        least = math.ceil(_STRETCHES / len(step.near.fitted))
        count = max(least, int(time_[-1] / period) if period else 0)
        index = np.minimum((time_ / time_[-1] * count).astype(int), count - 1)
        gains += list(np.bincount(index, gain.sum(axis=1), minlength=count))
    total, spread = float(np.sum(gains)), float(np.sqrt(np.sum(np.square(gains))))
    # Squares about zero, not about the mean: a gain that is all in one stretch is one event.
    return total > _STEADY * spread / math.sqrt(2.0)


def matters(old: Step, new: Step) -> bool:
    """Whether the error falls, fitted and held out, by as much as the kind of residual asks."""
    ratio = _size(old.held_out), _size(new.held_out)
    fitted = math.sqrt(cost_of(new.fit) / cost_of(old.fit))
    known = ratio[0] is not None and ratio[1] is not None
    held = ratio[1] / ratio[0] if known else 1.0  # pyright: ignore
    if new.white >= SURE:
        return held < 1.0 + _WORSE
    return fitted < 1.0 - _MATTERS and (not known or held < 1.0 - _HELD)


def _size(held: HeldOut | None) -> float | None:
    if held is None:
        return None
    ratio = held.held_out.ratio
    return float(np.sqrt(np.nanmean(ratio**2)))
