"""A candidate joined to a model: what it begins from, and whether what came of it could be."""

import math

import numpy as np

from ..effects import AbstractEffect
from ..fitting.base_first import usual
from ..fitting.descent import Descent
from ..model import Model
from .path import one_with, resonant
from .rung import Step, errors_of
from .screen import Screened

_WEAK = 0.3  # of a typical or fitted number, in place of one that physics does not allow
_IMPOSSIBLE = 3.0  # standard errors on the wrong side of zero
_KNOWN = 3.0  # standard errors of a strength that is known
_CYCLES = 2.0  # of an oscillation in the longest recording: fewer could be any slow torque


def silent(effect: AbstractEffect) -> AbstractEffect:
    """The same effect as a fit takes it: at its default values."""
    return type(effect)(effect.place) if effect.place else type(effect)()  # pyright: ignore


def joined(step: Step, screened: Screened) -> np.ndarray:
    """All numbers of a model with a screened effect; what physics keeps positive stays so."""
    own = np.asarray(Model(step.fit.model.mechanism, (screened.effect,)).vector())
    numbers, now = screened.numbers.copy(), np.asarray(step.fit.model.vector())
    for i, n in enumerate(step.fit.model.fitted):
        if n.meaning.sign == "positive" and numbers[i] <= 0.0 < now[i]:
            numbers[i] = _WEAK * now[i]
    return np.concatenate([numbers, own])


def possible(step: Step, model: Model, descent: Descent, alone: Model) -> bool:
    """Whether no number of the effect is on the wrong side of zero, for sure, and no oscillation is
    but a correction of a mode, or too slow to be seen as one, and no memory all that there is to
    it."""
    values, spread = np.asarray(model.vector()), errors_of(descent, 1.0)
    first = len(values) - len(alone.fitted)
    left = math.sqrt(max(1.0, descent.cost / step.readings))
    if _only_remembers(step, values[first:], left * spread[first:], alone):
        return False
    modes = [m.frequency_hz for m in step.fit.modes]
    longest = max(r.recording.duration for r in step.near.fitted)
    (effect,) = alone.effects
    # Beside the simpler law that it extends only the sum of both is known.
    part = any(e.name == effect.extends and e.place == effect.place for e in step.effects)
    for i, n in enumerate(alone.fitted):
        oscillates = n.meaning.field == alone.effects[n.effect].oscillates
        if oscillates:
            frequency = abs(values[first + i])
            if frequency * longest < _CYCLES or one_with(frequency, modes, longest):
                return False
            # Beside a mode it must explain everything: no mimic does.
            if resonant(frequency, modes, longest) and descent.cost > usual(step.readings):
                return False
        if n.meaning.sign == "positive" and n.meaning.silent is not None and not part:
            value, std = values[first + i], spread[first + i]
            if value < 0 and (not np.isfinite(std) or value < -_IMPOSSIBLE * std):
                return False
    return True


def _only_remembers(step: Step, values: np.ndarray, std: np.ndarray, alone: Model) -> bool:
    """Whether an effect does what it does by the memories that many recordings, or stretches of
    one, begin with: each is free, so that together they are any torque that changes from one to the
    next. Then nothing is known of its strength."""
    (effect,) = alone.effects
    if len(step.near.fitted) < 2 or not effect.memory or effect.oscillates is not None:
        return False
    silent_ = [n.meaning.silent for n in alone.fitted]
    return all(
        s is None or not abs(x - s) > _KNOWN * e
        for s, x, e in zip(silent_, values, std, strict=True)
    )
