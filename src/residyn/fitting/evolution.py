"""Evolutionary strategies of evosax, run on genes from 0 to 1 in one compiled program.

evosax knows no bounds: what steps over one is reflected back from it. The objective is thus one
periodic function, even about every bound. Strategies that keep a population are told the reflected
individuals; those that keep a distribution, what they drew.
"""

import functools
import importlib
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from ..errors import extra

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
    return Strategy(strategy, params.replace(**chosen), name in kept)
