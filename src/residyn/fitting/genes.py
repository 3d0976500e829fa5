"""From genes to unknowns: a box of numbers, and what a search may do about initial states.

An evolutionary search knows nothing of size or sign, so all its genes run from 0 to 1. A number
that physics keeps positive, and of which only the order of magnitude is known beforehand, is spread
over its bounds logarithmically; one that may have either sign, linearly.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.model import Number as Fitted
from ..physics.parameter import RATIO, STIFFNESS, Dimension
from .problem import Problem, Unknowns

# Bounds in typical sizes (`Ready.typical`). Among 80 random arms the springs were 0.03 to 15 times
# their typical size and the dampers 2e-4 to 0.13 times.
_STIFF = (0.02, 20.0)
_WEAK = (1e-4, 1.0)
_EITHER_SIGN = 1.0
_SHARE = 0.3  # of a number without dimension, about its silent value
_GRID = 3.0  # times, beyond the ends of a shape's grid
_LOGARITHMIC = 10.0  # bounds of one sign that are this many times apart are spread so

# How far an initial state may lie from what the first readings say: a share of the joint's typical
# angle and rate, and as many sigma. Internal states may be anything of their typical size.
_SHARE_OF_STATE = 0.1
_SIGMAS = 2.0
_MEMORY = 2.0

READINGS, GENES = "readings", "genes"


class Box(NamedTuple):
    """Bounds of P numbers, (P,) each, and which of them are searched logarithmically."""

    low: np.ndarray
    high: np.ndarray
    logarithmic: np.ndarray

    def at(self, genes: Float[Array, " P"]) -> Float[Array, " P"]:
        """The numbers, in their own units, at genes from 0 to 1."""
        straight = self.low + genes * (self.high - self.low)
        low, high = (jnp.where(self.logarithmic, x, 1.0) for x in (self.low, self.high))
        curved = jnp.exp(jnp.log(low) + genes * jnp.log(high / low))
        found = jnp.where(self.logarithmic, curved, straight)
        return jnp.clip(found, self.low, self.high)  # rounding must not lead out of the box


def box(
    numbers: Sequence[Fitted],
    typical: np.ndarray,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> Box:
    """The bounds of a search: those given by name, the others from typical sizes (P,).

    **Raises:** `ValueError` for a name that the model does not have, and for bounds that are not
    two finite numbers, the lower one first.
    """
    given = dict(bounds or {})
    low, high = np.empty(len(numbers)), np.empty(len(numbers))
    for i, (number, size) in enumerate(zip(numbers, typical, strict=True)):
        low[i], high[i] = given.pop(number.name, None) or _usual(number, float(size))
        if not (np.isfinite([low[i], high[i]]).all() and low[i] < high[i]):
            raise ValueError(
                f"bounds of {number.name}: ({low[i]:g}, {high[i]:g}) must be two finite numbers, "
                "the lower one first"
            )
    if given:
        known = ", ".join(n.name for n in numbers)
        raise ValueError(
            f"bounds of {next(iter(given))}: there is no such number; there are {known}"
        )
    return Box(low, high, (low > 0) & (high > _LOGARITHMIC * low))


def _usual(number: Fitted, size: float) -> tuple[float, float]:
    meaning = number.meaning
    if meaning.silent is None:
        grid = meaning.grid or (1.0,)
        return min(grid) * size / _GRID, max(grid) * size * _GRID
    if meaning.sign == "positive":
        low, high = _STIFF if _is(meaning.dimension, STIFFNESS) else _WEAK
        return low * size, high * size
    reach = _SHARE if _is(meaning.dimension, RATIO) else _EITHER_SIGN
    return meaning.silent - reach * size, meaning.silent + reach * size


def _is(one: Dimension, other: Dimension) -> bool:
    return (one.rotary, one.sliding) == (other.rotary, other.sliding)


class Genome(NamedTuple):
    """What the G genes of one individual mean: first the P numbers, then any initial states.

    `states` (R, s) are those that the first readings give, in their own units, and `reach` (s,) how
    far a gene may move them, if they are `free`.
    """

    box: Box
    states: np.ndarray
    reach: np.ndarray
    free: bool

    @property
    def size(self) -> int:
        """G."""
        return len(self.box.low) + self.free * self.states.size

    def unknowns(self, genes: Float[Array, " G"], problem: Problem) -> Unknowns:
        """The individual as unknowns of a problem, scaled."""
        count = len(self.box.low)
        states = jnp.asarray(self.states)
        if self.free:
            states = states + (2 * genes[count:].reshape(states.shape) - 1) * self.reach
        return problem.scaled(self.box.at(genes[:count]), states)


def genome(
    problem: Problem, bounds: Box, states: np.ndarray, noise: np.ndarray, initial: str
) -> Genome:
    """The genome of a problem whose first readings, of these sigmas (n,), give the initial states
    (R, s).

    `initial` is "readings" (these states are kept, as the paper keeps its known release) or "genes"
    (each is a gene, too, about the reading).

    **Raises:** `ValueError` for any other `initial`.
    """
    if initial not in (READINGS, GENES):
        raise ValueError(f'initial = "{initial}": must be "{GENES}" or "{READINGS}"')
    scale = np.asarray(problem.scale.states)[0]
    share = _SHARE_OF_STATE + _SIGMAS * noise / scale[: len(noise)]
    memory = np.full(len(scale) - 2 * len(noise), _MEMORY)
    reach = np.concatenate([share, share, memory]) * scale
    return Genome(bounds, states, reach, initial == GENES)
