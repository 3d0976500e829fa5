"""Which starts are tried, and with whose step all of them are integrated.

A kernel of the closed-form start that is too wide has lost the fast mode, and its numbers are those
of a slow arm. Noise and a rest that has moved can make several such candidates look the surest
ones. So of candidates that are alike one is tried before all others, and the fastest mode, which
sets the integration step and how far the first readings are looked at, is not that of the surest
candidate but of what most of them can live with.
"""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ..physics.modal import paces
from ..physics.model import Model
from .initial_guess import closed_form, perturbed
from .problem import posed
from .setup import Ready

_LOOKED = 24  # candidates, the best ones, that are looked at
_ALIKE = 0.2  # share by which shapes of one kind differ at most
_PACE = 0.7  # and the logarithms of its modes' frequencies
_ABSURD = 1e12  # rad/s
_SLOWER = 0.75  # share of the starts that are no faster than the one that sets the step


def beginning(
    here: Ready, wild: Sequence[np.ndarray], starts: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """Where the starts begin, the best one first: numbers (S, P), internal states (S, R, m)."""
    found = closed_form(here.posed(), here.recordings, wild, here.typical())
    some = _various(here, found.numbers)[:starts] if starts > 1 else [0][: len(found.numbers)]
    candidates = found.numbers[some] if some else here.typical()[None]
    candidates = _turned(here.model, candidates)
    more = starts - len(candidates)
    numbers = np.vstack([candidates, perturbed(candidates[0], more)])
    memory = found.memory[[*some, *some[:1] * more]] if some else None
    return numbers, memory


def _various(here: Ready, candidates: np.ndarray) -> list[int]:
    """Indices of candidates (C, P), best first, those last that hardly differ from a better one: of
    kernels that have all lost the fast mode, one is tried before any that has not."""
    if not len(candidates):
        return []
    shapes = [n.meaning.silent is None for n in here.model.fitted]
    seen = np.log(_paces(here, candidates[:_LOOKED]))
    kinds, alike = [], []
    for i, pace in enumerate(seen):
        own = candidates[i][shapes]
        near = any(
            np.all(np.abs(pace - seen[k]) <= _PACE)
            and np.all(np.abs(own - candidates[k][shapes]) <= _ALIKE * np.abs(own))
            for k in kinds
        )
        (alike if near else kinds).append(i)
    return [*kinds, *alike, *range(len(seen), len(candidates))]


def _paces(here: Ready, numbers: np.ndarray) -> np.ndarray:
    """(S, s) how fast a model's modes are with numbers (S, P), slowest first, rad/s, none slower
    than a cycle in the longest recording."""
    least = 2 * math.pi / max(r.duration for r in here.recordings)
    return np.clip(paces(posed(here.model, here.mechanisms[0]), numbers), least, _ABSURD)


def resolving(here: Ready, numbers: np.ndarray) -> Model:
    """The start of numbers (S, P) by whose fastest mode all of them are integrated: no slower than
    that of three in four.

    A start from a wide kernel may have lost the fast mode. It costs nothing but itself, unless the
    others are integrated with its step, and begin from where it would.
    """
    if len(numbers) > 1:
        fast = _paces(here, numbers[:_LOOKED])[:, -1]
        order = np.argsort(np.where(fast < _ABSURD, fast, 0.0), kind="stable")
        numbers = numbers[order[math.ceil(_SLOWER * (len(order) - 1)) :]]
    return here.model.with_vector(jnp.asarray(numbers[0]))


def _turned(model: Model, numbers: np.ndarray) -> np.ndarray:
    """Starts (S, P) of which no effect's number has a sign that physics does not allow: an inertia
    below zero, however small, runs away. Springs and dampers stay: gravity may hold a joint."""
    base = ("spring", "damper")
    positive = [
        n.meaning.sign == "positive" and model.effects[n.effect].name not in base
        for n in model.fitted
    ]
    return np.where(positive, np.abs(numbers), numbers)
