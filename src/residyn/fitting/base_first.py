"""A second chance for a fit by name: springs and dampers alone first, then the effect.

In much noise, or where an effect rattles or oscillates, a closed-form start may lie so far off that
all of its neighbours end in wrong valleys, some of them above what springs and dampers alone leave.
Those are found more surely; and from where they end, a little of the effect leads on.
"""

import contextlib
import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .beginnings import frequency_of, lines
from .descent import Descent, descend
from .multistart import beginning, resolving
from .result import FitError
from .setup import Ready
from .smoothing import uniform

_STRENGTHS = 0.01, 0.3, 1.0  # of an effect's typical one
_LINES = 2  # of the residual's spectrum
_TURNS = 0.0, 0.5 * math.pi  # of an oscillation's phase
_WEAK = 0.05  # of an oscillation's typical strength
_UNUSUAL = 2.0  # standard deviations of chi-square


class _Row(NamedTuple):
    """Where a descent begins."""

    numbers: np.ndarray  # (P,), of which those of springs and dampers are known better
    memory: np.ndarray | None = None  # (1, R, m)
    states: np.ndarray | None = None  # (R, s), where no phase can slip: all readings count at once


def led_astray(descent: Descent) -> bool:
    """Whether starts ended in different places, and the best of them above the noise."""
    return descent.agreeing < descent.starts and above_noise(descent)


def lonely(descent: Descent) -> bool:
    """Whether no other start ended where the best one did, above the noise."""
    return descent.agreeing == 1 < descent.starts and above_noise(descent)


def above_noise(descent: Descent) -> bool:
    """Whether chi-square is more than noise often makes it."""
    return descent.cost > usual(int(np.count_nonzero(descent.problem.recorded.weights)))


def usual(readings: int) -> float:
    """Chi-square that the noise of so many readings does not often exceed."""
    return readings + _UNUSUAL * math.sqrt(2.0 * readings)


def from_the_base(
    here: Ready,
    bare: Ready,
    found: np.ndarray,
    memory: np.ndarray | None,
    wild: list[np.ndarray],
) -> Descent | None:
    """The fit of `here` from where that of `bare`, springs and dampers alone, ends, with effects
    hardly there, weak, as is typical, and as in the starts (S, P) in closed form and their internal
    states (S, R, m); None where that leads nowhere."""
    numbers, states = beginning(bare, wild, len(found))
    try:
        begin = resolving(bare, numbers)
        base = descend(bare, begin, numbers, wild, lambda words: None, states)
    except FitError:
        return None
    own = base.problem.numbers(base.unknowns)
    rows: list[_Row] = [_Row(_of_typical(here, share)) for share in _STRENGTHS]
    rows += _ringing(here, base)
    remembered = [None] * len(found) if memory is None else memory[:, None]
    rows += [_Row(*pair) for pair in zip(found, remembered, strict=True)]
    # Each by itself: of several, those that are behind after the first cycles would be left.
    ends = []
    for row in rows:
        numbers = np.concatenate([own, row.numbers[len(own) :]])
        begin = here.model.with_vector(jnp.asarray(numbers))
        near = None if row.states is None else row.states[None]
        with contextlib.suppress(FitError):
            end = descend(
                here, begin, numbers[None], wild, lambda words: None, row.memory, near=near
            )
            ends.append(end)
            if not above_noise(end):
                break
    if not ends:
        return None
    best = min(ends, key=lambda d: d.cost)
    steps = base.steps + sum(d.steps for d in ends)
    return best._replace(starts=len(found) + len(ends), steps=steps)


def _ringing(here: Ready, base: Descent) -> list[_Row]:
    """Where a weak oscillation begins with a frequency at which the residual rings, once it is a
    little of what the base fit has left; nothing without an oscillation."""
    model, rows = here.model, []
    memory = [m.effect for m in model.memory]
    known = np.asarray(base.problem.states(base.unknowns))
    for i, effect in enumerate(model.effects):
        if effect.oscillates is None:
            continue
        fits = base.beside(here.recordings)
        left = [dataclasses.replace(f.recording, angle=f.residual) for f in fits]
        grids = [uniform(r, w) for r, w in zip(left, base.wild, strict=True)]
        shortest = min(len(g.q) for g in grids)
        each = np.stack([g.q[:shortest] for g in grids])  # (R, G, n)
        spacing = np.array([g.dt for g in grids])
        for frequency, phases in lines(np.moveaxis(each, -1, 0), spacing)[:_LINES]:
            for turn in _TURNS:  # how late an angle answers a torque depends on the modes
                numbers = _of_typical(here, _WEAK)
                numbers[frequency_of(model, i)] = frequency
                states = np.zeros((len(grids), len(memory)))
                states[:, memory.index(i)] = phases + turn
                rows.append(_Row(numbers, states=np.concatenate([known, states], axis=1)))
    return rows


def _of_typical(here: Ready, share: float) -> np.ndarray:
    """Typical numbers, of strengths a share."""
    silent = [n.meaning.silent for n in here.model.fitted]
    pairs = zip(silent, here.typical(), strict=True)
    return np.array([x if s is None else s + share * (x - s) for s, x in pairs])
