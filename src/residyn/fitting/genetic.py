"""The paper's step 2: a genetic algorithm on the objective of Eq. 17.

Kept beside Levenberg-Marquardt as the paper's own method and as a second opinion: it follows no
gradient and needs no start, only bounds. It ends near the minimum and not in it, so the errors of
its numbers, which come from the Jacobian at its best point as those of any fit do, describe what
the recordings say and not how far the search fell short; that is told apart, by the step that least
squares would still take.
"""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..effects import AbstractEffect
from ..physics.model import Number as Fitted
from ..physics.parameter import RATIO, STIFFNESS, Dimension
from ..recordings.experiment import Experiment
from .conclusion import Found, searched
from .evolution import evolve, values_of
from .history import History, Part, Watch, relative_error, watching
from .initial_guess import first_guess, resolving
from .multistart import DEFAULT_STARTS, outliers_among
from .problem import Problem, Ready, Unknowns, ready
from .result import Fit

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

_DRAWN = 100  # individuals, of which the best ones are random starts
_LAST, _FALL = 0.1, 0.01  # settled: the last tenth of the generations gained less than 1 %


@dataclasses.dataclass(frozen=True)
class Genetic:
    """How to search; the defaults are the paper's 100 individuals and 500 generations.

    - `strategy`: a name of `evosax.algorithms`: SimpleGA (selection of the best, uniform crossover,
      normal mutation that shrinks), CMA_ES, DifferentialEvolution, PSO, ...; the paper's kind is
      the default, CMA_ES with 20 individuals gets furthest.
    - `settings`: what that strategy takes, beside the defaults in `fitting.evolution.USUAL`.
    - `bounds`: (low, high) of a number by its name, in its own unit; without, from the typical
      sizes that the recordings show. Of one sign and a factor of ten apart, they are searched
      logarithmically.
    - `initial`: "genes" lets each recording's initial state be genes, too, about its first
      readings; "readings" keeps what the first readings say, as the paper keeps its known release,
      which leaves their noise in the numbers.
    """

    population: int = 100
    generations: int = 500
    strategy: str = "SimpleGA"
    settings: Mapping[str, float] = dataclasses.field(default_factory=dict)
    seed: int = 0
    bounds: Mapping[str, tuple[float, float]] | None = None
    initial: str = GENES

    def __post_init__(self):
        if self.population < 4:
            raise ValueError(f"population = {self.population}: at least 4 individuals are needed")
        if self.generations < 1:
            raise ValueError(f"generations = {self.generations}: at least one is needed")
        if self.initial not in (GENES, READINGS):
            raise ValueError(f'initial = "{self.initial}": must be "{GENES}" or "{READINGS}"')


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


class Search(NamedTuple):
    """What a genetic algorithm looks at: a problem, and what its genes mean there."""

    problem: Problem
    genome: Genome


def fit_genetic(
    experiment: Experiment,
    effects: Sequence[str | AbstractEffect] = (),
    how: Genetic | None = None,
    progress: Callable[[str], None] = lambda words: None,
) -> Fit:
    """`residyn.fit(..., method="genetic")`: the same `Fit`, with its `history`.

    Readings far off their neighbours are set aside beforehand, none afterwards. Call it in float64.

    **Raises:** `MissingExtra` without evosax; `FitError` if no individual moves like an arm;
    `ValueError` as `fit`, and for bounds or settings that do not go.
    """
    began, how = time.perf_counter(), how or Genetic()
    here = ready(experiment, experiment.fit_recordings, effects)
    outliers = outliers_among(here)
    found = run(search_of(here, outliers, how), how, progress)
    progress("errors, modes and held-out recordings")
    words = (
        f"{found.steps} generations of {how.population} individuals ({how.strategy}); "
        f"objective of Eq. 17: {found.history.objective[-1]:.4g}, "
        + ("settled" if found.settled else "still falling")
    )
    return searched(experiment, here, outliers, found, words, began)


def search_of(here: Ready, outliers: Sequence[np.ndarray], how: Genetic) -> Search:
    """The search of an experiment: the model, the step and the readings that
    Levenberg-Marquardt would have, so that both simulate alike; but not its start."""
    begin = resolving(here, first_guess(here, outliers, DEFAULT_STARTS)[0])
    bounds = box(here.model.fitted, here.typical(), how.bounds)
    problem, states = here.problem(begin, outliers)
    noise, scale = np.max([r.noise for r in here.recordings], axis=0), problem.scale.states[0]
    share = _SHARE_OF_STATE + _SIGMAS * noise / scale[: len(noise)]
    memory = np.full(len(scale) - 2 * len(noise), _MEMORY)
    reach = np.concatenate([share, share, memory]) * scale
    return Search(problem, Genome(bounds, states, reach, how.initial == GENES))


def drawn(here: Ready, outliers: list[np.ndarray], starts: int, seed: int) -> np.ndarray:
    """(S, P) numbers of the best of a hundred individuals, drawn as the first generation is: starts
    that know nothing of the closed form, which shows what that is worth."""
    look = search_of(here, outliers, Genetic())
    genes = jnp.asarray(np.random.default_rng(seed).uniform(size=(_DRAWN, look.genome.size)))
    values = np.asarray(_drawn_values(look, genes))
    order = np.argsort(values)[:starts]
    if (watch := watching()) is not None:
        watch.add(_DRAWN, float(values[order[0]]))
    return np.stack(
        [np.asarray(look.genome.box.at(genes[i, : len(look.genome.box.low)])) for i in order]
    )


@eqx.filter_jit
def _drawn_values(look: Search, genes):
    return values_of(objective_of, look, genes, look.problem.model.dry)


def run(look: Search, how: Genetic, progress: Callable[[str], None] = lambda words: None) -> Found:
    """Search."""
    watch, done = watching() or Watch(), 0

    def told(fell: Sequence[float]) -> None:
        nonlocal done
        done += len(fell)
        words = f"generation {done} of {how.generations}, objective {fell[-1]:.4g}"
        progress(Part(words, done / how.generations))
        watch.add(how.population, *fell)

    progress(Part("the first generation", 0.0))
    best, first = evolve(
        objective_of,
        look,
        look.genome.size,
        strategy=how.strategy,
        settings=how.settings,
        population=how.population,
        generations=how.generations,
        seed=how.seed,
        one_by_one=look.problem.model.dry,
        compiled=watch.restart,
        told=told,
        stop=watch.over,
    )
    y, bounds, history = look.genome.unknowns(best, look.problem), look.genome.box, watch.history
    return Found(
        np.asarray(look.problem.numbers(y)),
        np.asarray(look.problem.states(y)),
        np.asarray(bounds.at(first[: len(bounds.low)])),
        history,
        done,
        done > 1 and _settled(history),
    )


def objective_of(look: Search, genes: Any):
    return relative_error(look.problem, look.genome.unknowns(genes, look.problem))


def _settled(history: History) -> bool:
    last = history.objective[-max(2, round(_LAST * len(history.objective))) :]
    return float(last[0] - last[-1]) < _FALL * float(last[0])
