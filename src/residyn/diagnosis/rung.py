"""A model on the ladder: its fit, what was seen of it, and the candidates that were tried."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..effects import AbstractEffect
from ..fitting.descent import Descent
from ..fitting.identify import information, spread_of
from ..fitting.result import Fit
from ..model import Model
from .elimination import inverse_of
from .horizon import HeldOut, held_out
from .linear import Near, marginal
from .screen import Screened, Tried, left_over
from .unnamed import Unnamed
from .where import Where, where

_DROP = 20.0  # least fall of chi-square, in units of what is left, of one number
_MORE = 3.0  # and of every further one
_SEARCHED = 10.0  # and where a frequency was looked for


class Refit(NamedTuple):
    """A candidate joined to the model and fitted."""

    effect: AbstractEffect
    screened: Screened
    model: Model
    descent: Descent
    start: np.ndarray
    possible: bool
    """Whether its numbers have the sign that physics allows."""
    by_name: bool = False
    """Whether it was fitted from where a fit by name begins, too."""

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
        return numbers_of(self.effect, self.model, len(self.descent.wild))

    @property
    def std(self) -> np.ndarray:
        """(P,) standard errors of all numbers."""
        readings = float(np.sum(np.asarray(self.descent.problem.recorded.weights) > 0))
        return errors_of(self.descent, max(1.0, self.cost / readings))

    def price(self, readings: int) -> float:
        """What its numbers cost, in units of chi-square."""
        scale = max(1.0, self.cost / readings)
        own = np.arange(len(Model(self.model.mechanism, (self.effect,)).fitted))
        square = information(np.asarray(self.descent.compressed.factor), len(self.start))
        known = certainty(square / scale, len(self.start) - len(own) + own)
        return numbers_price(known, self.numbers, readings)


class Step(NamedTuple):
    """A model on the ladder, and what was found from it."""

    fit: Fit
    near: Near
    where: Where
    held_out: HeldOut | None
    effects: tuple[AbstractEffect, ...]
    slopes: list[np.ndarray]
    alone: float = float("nan")
    tried: Tried | None = None
    """What the first rung's screen keeps."""
    seen: Tried | None = None
    """And what this one's does."""
    screened: tuple[Screened, ...] = ()
    refits: tuple[Refit, ...] = ()
    unnamed: Unnamed | None = None

    def seen_with(self, tried: Tried) -> "Step":
        """The same, looked at with torques of any shape, too."""
        return self._replace(tried=tried, unnamed=left_over(self.near, self.slopes, tried))

    @property
    def white(self) -> float:
        """Probability that what is left is noise: the least of all tests, corrected for their
        number."""
        p = [w.p for w in self.where.white.values() if np.isfinite(w.p)]
        spectra = _least(min(p), len(p)) if p else 1.0
        return spectra if self.unnamed is None else _least(min(spectra, self.unnamed.p), 2)

    @property
    def cost(self) -> float:
        """Chi-square of the fit."""
        return cost_of(self.fit)

    @property
    def readings(self) -> int:
        """How many readings were fitted."""
        return self.near.readings

    def price(self, effect: AbstractEffect) -> float:
        """What the numbers of an effect of its model cost, in units of chi-square."""
        near, scale = self.near, max(1.0, self.cost / self.readings)
        square, _, _ = marginal(self.slopes, near.weights(), near.numbers, near.memories())
        index = self.fit.model.labels.index(effect.label)
        own = np.flatnonzero([n.effect == index for n in self.fit.model.fitted])
        count = numbers_of(effect, self.fit.model, len(near.fitted))
        return numbers_price(certainty(square / scale, own), count, self.readings)


def cost_of(fit: Fit) -> float:
    """Sum of squared whitened residuals of the fitted recordings."""
    return sum(
        float(np.sum((np.where(r.used, r.residual, 0.0) / r.recording.noise) ** 2))
        for r in fit.recordings
        if r.recording.role != "check"
    )


def stand(fit: Fit, effects: Sequence[AbstractEffect], tried: Tried | None = None) -> Step:
    """A fitted model as a step of the ladder; `tried` is from the first one's screen."""
    near = Near.of(fit)
    _, slopes = near.look(near.at)
    found = where(near, slopes)
    step = Step(fit, near, found, held_out(near), tuple(effects), slopes)
    return step if tried is None else step.seen_with(tried)


def _least(p: float, count: int) -> float:
    """Probability that the least of so many independent ones is as small as this."""
    return float(-np.expm1(count * np.log1p(-p))) if p < 1 else 1.0


def worth(effect: AbstractEffect, step: Step) -> float:
    """How far chi-square must fall for an effect, in its own units."""
    count = numbers_of(effect, step.fit.model, len(step.near.fitted))
    least = _DROP + _MORE * (count - 1) + _SEARCHED * (effect.oscillates is not None)
    return least


def numbers_of(effect: AbstractEffect, model: Model, recordings: int) -> int:
    """How many numbers an effect brings to a model; an oscillation has a phase of its own in every
    recording, of which the first is part of the search."""
    phases = recordings - 1 if effect.oscillates else 0
    return len(Model(model.mechanism, (effect,)).fitted) + phases


def extends(one: Refit, other: Refit) -> bool:
    """Whether an effect is another one's law with more to it, at the same place."""
    return one.effect.extends == other.effect.name and one.effect.place == other.effect.place


def errors_of(descent: Descent, inflation: float) -> np.ndarray:
    """(P,) standard errors of the numbers where a descent ended, squared times `inflation`."""
    sizes = np.asarray(descent.problem.scale.numbers)
    return spread_of(np.asarray(descent.compressed.factor), sizes, inflation).std


def certainty(square: np.ndarray, own: np.ndarray) -> np.ndarray:
    """(K,) of some numbers, along the directions in which they are known apart: by how many of
    their standard errors their size goes, squared; `square` (P, P) is the information of all."""
    rest = np.setdiff1d(np.arange(len(square)), own)
    # What the other numbers could do as well is not known of these.
    cross = square[np.ix_(rest, own)]
    alone = square[np.ix_(own, own)] - cross.T @ inverse_of(square[np.ix_(rest, rest)]) @ cross
    return np.maximum(0.0, np.linalg.eigvalsh(alone))


def numbers_price(known: np.ndarray, count: int, readings: int) -> float:
    """What `count` numbers cost, of which some are `known` so well: the logarithm of the number of
    readings each, or less, for to fit one of many values costs more than to fit almost any
    (Laplace's approximation of the evidence, with a number's size as its range beforehand)."""
    most = math.log(readings)
    return float(np.sum(np.minimum(most, np.log1p(known)))) + (count - len(known)) * most
