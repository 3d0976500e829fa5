"""Up the ladder: the effect that explains most joins the model, everything is fitted again.

The screen says which effects deserve a real fit; the fits, from several starts each, say which of
them it is. A newcomer must be sure, must matter where nothing was fitted too, and may make an
earlier one needless. Thousands of samples make any trifle significant, and the residual of a model
that misses something is not white; so *sure* is judged from how the gain varies from stretch to
stretch of the recording.
"""

import math
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from ..effects import CATALOGUE, AbstractEffect
from ..fitting.pipeline import finish, refit
from ..fitting.result import Fit, FitError
from ..parameter import parameters_of
from ..recording import Experiment
from .horizon import HeldOut
from .joined import silent
from .refits import refits
from .rung import Refit, Step, cost_of, extends, stand, worth
from .screen import pair
from .valleys import afresh, near_noise
from .words import SURE

MATTERS = 0.1
"""Share of the error that must go, where what is left is not white."""
MORE_THAN_NOISE = 1.2
"""Chi-square a reading."""
_STEADY = 2.5  # standard errors of the gain, as stretches of the recording show it
_HELD = 0.05  # and where nothing was fitted
_TOGETHER = 0.5  # what two effects leave over the noise, screened, over the best one's
_PROMISES = 0.2  # share of the error over the noise that must go for an effect to wait for another
_WORSE = 0.02  # share by which the held-out error may grow where what is left is white
_NEARLY_ALL = 0.01  # of what was over the noise, left
_MOST = 0.25  # the same: as good as a tenth of the error, however near the noise that was
_TWINS = 0.01  # of chi-square
_SELDOM = 0.01  # probability
_STRETCHES = 24  # least number of stretches of all recordings


def score(step: Step, refit: Refit) -> float:
    """What is left by a candidate, plus what its numbers cost: the logarithm of the number of
    readings each, or, for what a law has more than another one that was fitted, what noise alone
    seldom gains with it."""
    cost, plain = refit.numbers * math.log(step.readings), simpler(step, refit)
    if plain is not None and _lawful(refit):
        more = refit.numbers - plain.numbers
        seldom = float(chdtri(more, _SELDOM))
        cost = min(cost, plain.numbers * math.log(step.readings) + seldom)
    return left_by(step, refit) + cost


def _lawful(refit: Refit) -> bool:
    """Whether no strength has the wrong sign, however surely."""
    own = refit.model.effects[-1]
    signs = {p.field: p.sign for p in parameters_of(own) if p.silent is not None}
    return all(getattr(own, field) >= 0.0 for field, sign in signs.items() if sign == "positive")


def left_by(step: Step, refit: Refit) -> float:
    """Chi-square in units of what is left by the best.

    Where even the best leaves more than noise, a law with more to it than another one bends to
    that, too: what it brings beyond the other one counts only if it matters.
    """
    cost, plain = refit.cost, simpler(step, refit)
    matters = plain is None or cost < (1.0 - MATTERS) ** 2 * plain.cost
    if plain is not None and unit(step) > MORE_THAN_NOISE and not matters:
        cost = max(cost, plain.cost)
    return cost / unit(step)


def simpler(step: Step, refit: Refit) -> Refit | None:
    """The fit of the law that a candidate extends, if that could be."""
    return next((r for r in step.refits if r.possible and extends(refit, r)), None)


def unit(step: Step) -> float:
    """What one reading's square leaves with the best candidate: 1 if that is all there is."""
    least = min((r.cost for r in step.refits), default=step.cost)
    return max(1.0, least / step.readings)


def ranked(step: Step) -> list[Refit]:
    """The fitted candidates that could be, the best first. Twins, which nothing but rounding tells
    apart, come in the catalogue's order: on every machine the same one is named."""
    scores = {id(r): score(step, r) for r in step.refits if r.possible}
    best = min(scores.values(), default=0.0)
    order = list(CATALOGUE)

    def place(r: Refit) -> tuple[float, int]:
        own, name = scores[id(r)], r.effect.name
        twin = own - best < _TWINS
        return (best, order.index(name) if name in order else len(order)) if twin else (own, 0)

    return sorted((r for r in step.refits if r.possible), key=place)


class Accepted(NamedTuple):
    """A next rung."""

    step: Step
    firm: bool
    """Whether it stands by itself; else it is to be judged by what the next rung makes of it."""


def accepted(step: Step, chosen: Refit, experiment: Experiment, stands: Step) -> Accepted | None:
    """The next rung, with the chosen effect; None if that is not sure, or does not matter.

    `stands` is the rung that it must be better than: the last one that stood by itself. Where two
    effects are missing, the one that joins first may predict no better until the other one has
    joined: if the fitted readings say that it explains much, it may wait for that.
    """
    before = cost_of(step.fit)
    drop = (before - chosen.cost) / max(1.0, chosen.cost / step.readings)
    if drop < worth(chosen.effect, step):
        return None
    new = _with(step, chosen, experiment)
    if new.white < SURE and near_noise(step, chosen):
        better = afresh(step, experiment, chosen)
        if better is not chosen:
            chosen, new = better, _with(step, better, experiment)
    # Where only noise is left, chi-square can be believed; else the gain must be steady.
    if new.white < SURE and not steady(step, chosen):
        return None
    if matters(stands, new):
        return Accepted(new, True)
    # A model whose prediction could not even be had promises nothing.
    left, had = (over_noise(cost, step) for cost in (cost_of(new.fit), before))
    promises = new.held_out is not None and left < (1.0 - _PROMISES) ** 2 * had
    return Accepted(new, False) if stands is step and promises else None


def _with(step: Step, chosen: Refit, experiment: Experiment) -> Step:
    """The step with one of its candidates in the model."""
    began = time.perf_counter()
    fit = finish(experiment, chosen.model, chosen.start, chosen.descent, began)
    return stand(fit, (*step.effects, silent(chosen.effect)), step.tried)


def over_noise(chi2: float, step: Step) -> float:
    """What is left beyond noise: by that two effects share what one alone can do of it, however
    little of the whole that is."""
    return max(0.0, chi2 - step.readings)


def with_another(step: Step, experiment: Experiment) -> Accepted | None:
    """The next rung, to wait for the one after it, where no effect alone explains anything, and two
    together do: a driven joint without a spring drifts away as long as any constant is missing."""
    if step.seen is None or step.white >= SURE or not step.screened:
        return None
    found = pair(step.near, step.seen, {s.effect.label for s in step.screened})
    best = over_noise(step.screened[0].chi2, step)
    if found is None or over_noise(found[2], step) > _TOGETHER * best:
        return None
    chosen = next((r for r in step.refits if r.label == found[0]), None)
    if chosen is None:
        screened = next(s for s in step.screened if s.effect.label == found[0])
        chosen = next(iter(refits(step, experiment, [screened])), None)
    if chosen is None or not chosen.possible or chosen.cost > step.cost:
        return None
    return Accepted(_with(step, chosen, experiment), False)


def needless(step: Step, experiment: Experiment, first: int) -> Step:
    """The model less any effect, but the last and the `first` ones, that it no longer needs."""
    fit = step.fit
    for effect in step.effects[first:-1]:
        own = [i for i, n in enumerate(fit.numbers) if n.name.startswith(f"{effect.label}.")]
        if _loud(fit, own) > worth(effect, step):
            continue  # so far from silent that no fit without it could do
        left = tuple(e for e in step.effects if e.label != effect.label)
        keep = [i for i in range(len(fit.numbers)) if i not in own]
        sizes = [len(e.memory) for e in fit.model.effects]
        at = fit.model.labels.index(effect.label)
        begin = 2 * len(fit.joints) + sum(sizes[:at])
        states = np.stack([r.state for r in step.near.fitted])
        states = np.delete(states, np.arange(begin, begin + sizes[at]), axis=1)
        numbers = _handed_on(fit, effect)[keep]
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
            without = stand(finish(experiment, model, numbers, descent, began), left, step.tried)
            return needless(without, experiment, first)
    return step


def _handed_on(fit: Fit, effect: AbstractEffect) -> np.ndarray:
    """(P,) numbers, those of an effect added to its own ones in a law that extends it."""
    numbers = np.array(fit.model.vector())
    place = {n.name: i for i, n in enumerate(fit.numbers)}
    for rich in fit.model.effects:
        if rich.extends == effect.name and rich.place == effect.place:
            for name, i in place.items():
                label, _, field = name.rpartition(".")
                if label == effect.label and f"{rich.label}.{field}" in place:
                    numbers[place[f"{rich.label}.{field}"]] += numbers[i]
    return numbers


def _loud(fit: Fit, own: Sequence[int]) -> float:
    """How far an effect's strengths are from silent, in squared standard errors; 0 if nobody knows.
    A shape is never silent: a gap's width says nothing of whether there is one."""
    meanings = [n.meaning for n in fit.model.fitted]
    strengths = [i for i in own if meanings[i].silent is not None]
    square = fit.covariance[np.ix_(strengths, strengths)]
    if not strengths or not np.isfinite(square).all():
        return 0.0
    far = np.array([fit.numbers[i].value - float(meanings[i].silent or 0.0) for i in strengths])
    return float(far @ np.linalg.pinv(square) @ far)


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
    left = over_noise(cost_of(new.fit), new) / max(over_noise(old.cost, old), 1e-300)
    if not known:
        # What it is about may be too plain to be doubted for a prediction that none made.
        return left < _NEARLY_ALL
    return (fitted < 1.0 - MATTERS and held < 1.0 - _HELD) or (left < _MOST and held < 1.0)


def _size(held: HeldOut | None) -> float | None:
    if held is None:
        return None
    ratio = held.held_out.ratio
    return float(np.sqrt(np.nanmean(ratio**2)))
