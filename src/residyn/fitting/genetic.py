"""The paper's step 2: a genetic algorithm on the objective of Eq. 17.

Kept beside Levenberg-Marquardt as the paper's own method and as a second opinion: it follows no
gradient and needs no start, only bounds. It ends near the minimum and not in it, so the errors of
its numbers, which come from the Jacobian at its best point as those of any fit do, describe what
the recordings say and not how far the search fell short; that is told apart, by the step that least
squares would still take.
"""

import dataclasses
import functools
import importlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..effects import AbstractEffect
from ..errors import extra
from ..physics.model import Number as Fitted
from ..physics.parameter import RATIO, STIFFNESS, Dimension
from ..recordings.experiment import Experiment
from .conclusion import Found, searched
from .history import History, Part, Watch, relative_error, watching
from .initial_guess import resolving
from .multistart import DEFAULT_STARTS, Beginning, beginning
from .problem import Problem, Unknowns
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

_CHUNK = 25  # generations between two looks at how it goes, at most
_HOPELESS = 1e6  # objective of an individual whose simulation ran away
_DRAWN = 100  # individuals, of which the best ones are random starts
_LAST, _FALL = 0.1, 0.01  # settled: the last tenth of the generations gained less than 1 %


@dataclasses.dataclass(frozen=True)
class Genetic:
    """How to search; the defaults are the paper's 100 individuals and 500 generations.

    - `strategy`: a name of `evosax.algorithms`: SimpleGA (selection of the best, uniform crossover,
      normal mutation that shrinks), CMA_ES, DifferentialEvolution, PSO, ...; the paper's kind is
      the default, CMA_ES with 20 individuals gets furthest.
    - `settings`: what that strategy takes, beside the defaults in `fitting.genetic.USUAL`.
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
    bounds: Mapping[str, tuple[float, float]] | None,
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


class Search(NamedTuple):
    """What a genetic algorithm looks at: a problem, and what the G genes of one individual mean
    there: first the P numbers, then any initial states.

    `states` (R, s) are those that the first readings give, in their own units, and `reach` (s,) how
    far a gene may move them, if they are `free`.
    """

    problem: Problem
    box: Box
    states: np.ndarray
    reach: np.ndarray
    free: bool

    @property
    def size(self) -> int:
        """G."""
        return len(self.box.low) + self.free * self.states.size

    def numbers(self, genes: Float[Array, " G"]) -> Float[Array, " P"]:
        """The individual's numbers, in their own units."""
        return self.box.at(genes[: len(self.box.low)])

    def unknowns(self, genes: Float[Array, " G"]) -> Unknowns:
        """The individual as unknowns of the problem, scaled."""
        states = jnp.asarray(self.states)
        if self.free:
            moves = 2 * genes[len(self.box.low) :].reshape(states.shape) - 1
            states = states + moves * self.reach
        return self.problem.scaled(self.numbers(genes), states)


def fit_genetic(
    experiment: Experiment,
    effects: Sequence[str | AbstractEffect],
    how: Genetic,
    progress: Callable[[str], None],
) -> Fit:
    """`residyn.fit(..., method="genetic")`: the same `Fit`, with its `history`.

    Readings far off their neighbours are set aside beforehand, none afterwards. Call it in float64.

    **Raises:** `MissingExtra` without evosax; `FitError` if no individual moves like an arm;
    `ValueError` as `fit`, and for bounds or settings that do not go.
    """
    began = time.perf_counter()
    begin = beginning(experiment, effects, DEFAULT_STARTS)
    found = run(search_of(begin, how), how, progress)
    progress("errors, modes and held-out recordings")
    words = (
        f"{found.steps} generations of {how.population} individuals ({how.strategy}); "
        f"objective of Eq. 17: {found.history.objective[-1]:.4g}, "
        + ("settled" if found.settled else "still falling")
    )
    return searched(begin.experiment, begin.here, found, words, began)


def search_of(begin: Beginning, how: Genetic) -> Search:
    """The search of an experiment: the model, the step and the readings that
    Levenberg-Marquardt would have, so that both simulate alike; but not its start."""
    here = begin.here
    bounds = box(here.model.fitted, here.typical(), how.bounds)
    problem, states = here.problem(resolving(here, begin.numbers), here.outliers)
    noise, scale = np.max([r.noise for r in here.recordings], axis=0), problem.scale.states[0]
    share = _SHARE_OF_STATE + _SIGMAS * noise / scale[: len(noise)]
    memory = np.full(len(scale) - 2 * len(noise), _MEMORY)
    reach = np.concatenate([share, share, memory]) * scale
    return Search(problem, bounds, states, reach, how.initial == GENES)


def drawn(begin: Beginning, starts: int, seed: int) -> np.ndarray:
    """(S, P) numbers of the best of a hundred individuals, drawn as the first generation is: starts
    that know nothing of the closed form, which shows what that is worth."""
    look = search_of(begin, Genetic())
    genes = jnp.asarray(np.random.default_rng(seed).uniform(size=(_DRAWN, look.size)))
    values = np.asarray(_values(look, genes))
    order = np.argsort(values)[:starts]
    if (watch := watching()) is not None:
        watch.add(_DRAWN, float(values[order[0]]))
    return np.stack([np.asarray(look.numbers(genes[i])) for i in order])


# -- strategies of evosax --------------------------------------------------------------------

# evosax knows no bounds: what steps over one is reflected back from it. The objective is thus one
# periodic function, even about every bound. Strategies that keep a population are told the
# reflected individuals; those that keep a distribution, what they drew.

# evosax's own defaults are made for networks without bounds; these are for genes from 0 to 1. `std`
# falls to `std_end` over the generations, geometrically. Tuned by `benchmarks.genetic tune`.
USUAL: dict[str, dict[str, float]] = {
    "SimpleGA": {"std": 0.1, "std_end": 1e-4, "crossover_rate": 0.5, "elite_ratio": 0.1},
    "CMA_ES": {"std_init": 0.3},
    "DifferentialEvolution": {"elitism": False, "differential_weight": 0.5},
    "PSO": {"inertia_coeff": 0.7, "cognitive_coeff": 1.5, "social_coeff": 1.5},
}
"""Settings of the strategies that were tuned; others of evosax run with its own."""


class Strategy(NamedTuple):
    """One of evosax's algorithms, its parameters, and whether it keeps a population."""

    algorithm: Any
    params: Any
    keeps_population: bool


def fold(x: Array) -> Array:
    """Genes reflected into 0 to 1."""
    return 1 - jnp.abs(1 - jnp.mod(x, 2))


def evosax_or_missing() -> tuple[dict[str, Any], dict[str, Any]]:
    """All of evosax's algorithms by name, and those that keep a population.

    **Raises:** `MissingExtra` without it.
    """
    needed = "the genetic algorithm needs evosax: pip install 'residyn[ga]'"
    known = extra("evosax.algorithms", needed).algorithms
    kept = extra("evosax.algorithms.population_based", needed).population_based_algorithms
    return known, kept


@functools.lru_cache(maxsize=64)  # evosax compiles anew for every object
def traced_algorithm(
    name: str, population: int, generations: int, size: int, settings: tuple[tuple[str, float], ...]
) -> Strategy:
    """A strategy for so many genes.

    **Raises:** `MissingExtra` without evosax; `ValueError` for a strategy or a setting that it does
    not have.
    """
    known, kept = evosax_or_missing()
    if name not in known:
        raise ValueError(f'strategy = "{name}": evosax has {", ".join(sorted(known))}')
    chosen = {**USUAL.get(name, {}), **dict(settings)}
    more = {}
    if "std" in chosen:
        optax = importlib.import_module("optax")
        first = chosen.pop("std")
        last = chosen.get("std_end", first)
        more["std_schedule"] = optax.exponential_decay(first, max(1, generations - 1), last / first)
    chosen.pop("std_end", None)
    strategy = known[name](population_size=population, solution=jnp.zeros(size), **more)
    strategy.elite_ratio = chosen.pop("elite_ratio", strategy.elite_ratio)
    params = strategy.default_params
    unknown = [key for key in chosen if not hasattr(params, key)]
    if unknown:
        raise ValueError(f"{unknown[0]} is no setting of {name}")
    if "differential_weight" in chosen:  # drawn between two bounds, unless they are the same
        weight = chosen["differential_weight"]
        bounds = {"differential_weight_min": weight, "differential_weight_max": weight}
        chosen = {**{k: v for k, v in bounds.items() if hasattr(params, k)}, **chosen}
    return Strategy(strategy, params.replace(**chosen), name in kept)


# -- generations -----------------------------------------------------------------------------


def run(look: Search, how: Genetic, progress: Callable[[str], None] = lambda words: None) -> Found:
    watch, key = watching() or Watch(), jax.random.key(how.seed)
    settings = tuple(sorted(how.settings.items()))
    strategy = traced_algorithm(how.strategy, how.population, how.generations, look.size, settings)
    given = strategy, look
    progress(Part("the first generation", 0.0))
    begun, first, least = _begin(*given, key)
    for _ in range(2):  # compiles; of its own output, whose types JAX may take for others
        begun, _ = _go_on(*given, begun, jnp.asarray(0))
    jax.block_until_ready(begun)
    watch.restart()
    begun, first, least = _begin(*given, key)
    done, fell = 1, [float(least)]
    while True:
        words = f"generation {done} of {how.generations}, objective {fell[-1]:.4g}"
        progress(Part(words, done / how.generations))
        watch.add(how.population, *fell)
        if done == how.generations or watch.over():
            break
        more = min(_CHUNK, how.generations - done)
        begun, fell = _go_on(*given, begun, jnp.asarray(more))
        fell, done = np.asarray(fell)[:more].tolist(), done + more
    y, history = look.unknowns(fold(begun[1].best_solution)), watch.history
    return Found(
        np.asarray(look.problem.numbers(y)),
        np.asarray(look.problem.states(y)),
        np.asarray(look.numbers(first)),
        history,
        done,
        done > 1 and _settled(history),
    )


def objective_of(look: Search, genes: Any):
    """Eq. 17 of one individual."""
    return relative_error(look.problem, look.unknowns(genes))


@eqx.filter_jit
def _values(look: Search, genes: Float[Array, "N G"]) -> Float[Array, " N"]:
    def one(individual):
        value = objective_of(look, individual)
        return jnp.where(jnp.isfinite(value), jnp.minimum(value, _HOPELESS), _HOPELESS)

    # Side by side, what dry friction seldom asks for would be computed always.
    return jax.lax.map(one, genes) if look.problem.model.dry else jax.vmap(one)(genes)


@eqx.filter_jit
def _begin(strategy: Strategy, look: Search, key):
    """The first generation: where the strategy stands, its best genes and their objective."""
    key, draw, begin = jax.random.split(key, 3)
    if strategy.keeps_population:
        genes = jax.random.uniform(draw, (strategy.algorithm.population_size, look.size))
        values = _values(look, genes)
        state = strategy.algorithm.init(begin, genes, values, strategy.params)
        best = jnp.argmin(values)
        return (key, state), genes[best], values[best]
    state = strategy.algorithm.init(begin, jnp.full(look.size, 0.5), strategy.params)
    (key, state), least = _generation(strategy, look, (key, state))
    return (key, state), fold(state.best_solution), least


@eqx.filter_jit
def _go_on(strategy: Strategy, look: Search, begun, count):
    """The next `count` generations, at most a chunk: one program, however many they are."""

    def advance(carry, index):
        return jax.lax.cond(
            index < count,
            lambda carry: _generation(strategy, look, carry),
            lambda carry: (carry, carry[1].best_fitness),
            carry,
        )

    return jax.lax.scan(advance, begun, jnp.arange(_CHUNK))


def _generation(strategy: Strategy, look: Search, carry):
    key, state = carry
    key, ask, tell = jax.random.split(key, 3)
    drawn, state = strategy.algorithm.ask(ask, state, strategy.params)
    genes = fold(drawn)
    values = _values(look, genes)
    known = genes if strategy.keeps_population else drawn
    state, _ = strategy.algorithm.tell(tell, known, values, state, strategy.params)
    return (key, state), state.best_fitness


def _settled(history: History) -> bool:
    last = history.objective[-max(2, round(_LAST * len(history.objective))) :]
    return float(last[0] - last[-1]) < _FALL * float(last[0])
