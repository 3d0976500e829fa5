"""Evolutionary strategies of evosax, run on genes from 0 to 1 in one compiled program.

evosax knows no bounds: what steps over one is reflected back from it. The objective is thus one
periodic function, even about every bound. Strategies that keep a population are told the reflected
individuals; those that keep a distribution, what they drew.
"""

import functools
import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_CHUNK = 25  # generations between two looks at how it goes, at most
_HOPELESS = 1e6  # objective of an individual whose simulation ran away

# evosax's own defaults are made for networks without bounds; these are for genes from 0 to 1. `std`
# falls to `std_end` over the generations, geometrically. Tuned by `benchmarks.genetic tune`.
USUAL: dict[str, dict[str, float]] = {
    "SimpleGA": {"std": 0.1, "std_end": 1e-4, "crossover_rate": 0.5, "elite_ratio": 0.1},
    "CMA_ES": {"std_init": 0.3},
    "DifferentialEvolution": {"elitism": False, "differential_weight": 0.5},
    "PSO": {"inertia_coeff": 0.7, "cognitive_coeff": 1.5, "social_coeff": 1.5},
}
"""Settings of the strategies that were tuned; others of evosax run with its own."""


class MissingExtra(ImportError):
    """A package that only an extra of this one brings is not installed: one line that says so."""


class _Search(NamedTuple):
    """One of evosax's algorithms, and what it is to minimise. evosax compiles anew for every object
    of an algorithm."""

    strategy: Any
    keeps_population: bool
    objective: Callable[[Any, Float[Array, " G"]], Float[Array, ""]]
    one_by_one: bool
    population: int


def evolve(
    objective: Callable[[Any, Float[Array, " G"]], Float[Array, ""]],
    given: Any,
    size: int,
    *,
    strategy: str,
    settings: Mapping[str, float],
    population: int,
    generations: int,
    seed: int,
    one_by_one: bool,
    compiled: Callable[[], None],
    told: Callable[[Sequence[float]], None],
    stop: Callable[[], bool],
) -> tuple[Array, Array]:
    """Minimise `objective(given, genes)` over `size` genes from 0 to 1.

    **Arguments:**

    - `given`: a pytree that the objective needs; its arrays are traced, so that others of the same
      shapes run in the same compiled program. `objective` should be a function of a module.
    - `strategy`, `settings`: a name of `evosax.algorithms`, and what it takes beside `USUAL`.
    - `one_by_one`: one individual after the other instead of side by side.
    - `compiled`: called before the first generation that counts, when both programs have been run.
    - `told`: called now and then with the best objective so far after each generation since.
    - `stop`: asked as often whether to end before all generations are done.

    **Returns:** the best genes (G,), and the best of the first generation.

    **Raises:** `MissingExtra` without evosax; `ValueError` for a strategy or a setting that it does
    not have.
    """
    made, params, keeps = traced_algorithm(
        strategy, population, generations, size, tuple(sorted(settings.items()))
    )
    search = _Search(made, keeps, objective, one_by_one, population)
    begun, first, least = _begin(search, params, given, size, jax.random.key(seed))
    again, fell = begun, least
    for _ in range(2):  # of its own output, whose types JAX may take for others
        again, fell = _go_on(search, params, given, again, jnp.asarray(0))
    jax.block_until_ready(fell)
    compiled()
    begun, first, least = _begin(search, params, given, size, jax.random.key(seed))
    done = 1
    told([float(least)])
    while done < generations and not stop():
        more = min(_CHUNK, generations - done)
        begun, fell = _go_on(search, params, given, begun, jnp.asarray(more))
        told(np.asarray(fell)[:more].tolist())
        done += more
    return fold(begun[1].best_solution), first


def fold(x: Array) -> Array:
    """Genes reflected into 0 to 1."""
    return 1 - jnp.abs(1 - jnp.mod(x, 2))


def values_of(objective: Callable, given: Any, genes: Float[Array, "N G"], one_by_one: bool):
    """(N,) objective of every individual."""

    def one(individual):
        value = objective(given, individual)
        return jnp.where(jnp.isfinite(value), jnp.minimum(value, _HOPELESS), _HOPELESS)

    # Side by side, what dry friction seldom asks for would be computed always.
    return jax.lax.map(one, genes) if one_by_one else jax.vmap(one)(genes)


@eqx.filter_jit
def _begin(search: _Search, params, given, size: int, key):
    """The first generation: where the strategy stands, its best genes and their objective."""
    key, draw, begin = jax.random.split(key, 3)
    if search.keeps_population:
        genes = jax.random.uniform(draw, (search.population, size))
        values = values_of(search.objective, given, genes, search.one_by_one)
        state = search.strategy.init(begin, genes, values, params)
        best = jnp.argmin(values)
        return (key, state), genes[best], values[best]
    state = search.strategy.init(begin, jnp.full(size, 0.5), params)
    (key, state), least = _generation(search, params, given, (key, state))
    return (key, state), fold(state.best_solution), least


@eqx.filter_jit
def _go_on(search: _Search, params, given, begun, count):
    """The next `count` generations, at most a chunk: one program, however many they are."""

    def advance(carry, index):
        return jax.lax.cond(
            index < count,
            lambda carry: _generation(search, params, given, carry),
            lambda carry: (carry, carry[1].best_fitness),
            carry,
        )

    return jax.lax.scan(advance, begun, jnp.arange(_CHUNK))


def _generation(search: _Search, params, given, carry):
    key, state = carry
    key, ask, tell = jax.random.split(key, 3)
    drawn, state = search.strategy.ask(ask, state, params)
    genes = fold(drawn)
    values = values_of(search.objective, given, genes, search.one_by_one)
    known = genes if search.keeps_population else drawn
    state, _ = search.strategy.tell(tell, known, values, state, params)
    return (key, state), state.best_fitness


def evosax_or_missing() -> tuple[dict[str, Any], dict[str, Any]]:
    """All of evosax's algorithms by name, and those that keep a population.

    **Raises:** `MissingExtra` without it.
    """
    try:
        known: dict[str, Any] = importlib.import_module("evosax.algorithms").algorithms
        kept: dict[str, Any] = importlib.import_module(
            "evosax.algorithms.population_based"
        ).population_based_algorithms
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "evosax":
            raise
        raise MissingExtra(
            "the genetic algorithm needs evosax: pip install 'residyn[ga]'"
        ) from None
    return known, kept


@functools.lru_cache(maxsize=64)  # evosax compiles anew for every object
def traced_algorithm(
    name: str, population: int, generations: int, size: int, settings: tuple[tuple[str, float], ...]
) -> tuple[Any, Any, bool]:
    """An algorithm, its parameters, and whether it keeps a population."""
    known, kept = evosax_or_missing()
    if name not in known:
        raise ValueError(f'strategy = "{name}": evosax has {", ".join(sorted(known))}')
    chosen = {**USUAL.get(name, {}), **dict(settings)}
    more = {}
    if "std" in chosen:
        optax = importlib.import_module("optax")
        first, last = chosen.pop("std"), chosen.get("std_end")
        last = first if last is None else last
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
    return strategy, params.replace(**chosen), name in kept
