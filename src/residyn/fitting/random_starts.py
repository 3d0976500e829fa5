"""Levenberg-Marquardt without the closed-form start: what the start is worth.

A hundred individuals are drawn as the first generation of a genetic algorithm is, and the descents
begin at the best of them.
"""

import time
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect
from ..recordings.experiment import Experiment
from .descent import descend, wild_beside
from .fit import finish
from .genetic import Genetic, Search, search_of
from .history import relative_error
from .result import Fit
from .setup import ready
from .watch import watching

DRAWN = 100


def fit_random(
    experiment: Experiment,
    effects: Sequence[str | AbstractEffect],
    starts: int,
    seed: int = 0,
    progress: Callable[[str], None] = lambda words: None,
) -> Fit:
    """`residyn.fit(..., method="random")`: descents from the best `starts` of a hundred
    individuals. Call it in float64.

    **Raises:** as `residyn.fit`.
    """
    began = time.perf_counter()
    if starts < 1:
        raise ValueError(f"starts = {starts}: at least one start is needed")
    if not experiment.fit_recordings:
        raise ValueError('no recording has role = "fit": there is nothing to fit to')
    here = ready(experiment, experiment.fit_recordings, effects)
    wild = wild_beside(here, [r.angle for r in here.recordings])
    look = search_of(here, wild, Genetic())
    genes = np.random.default_rng(seed).uniform(size=(DRAWN, look.genome.size))
    progress(f"drawing {DRAWN} starts")
    values = np.asarray(_values(look, jnp.asarray(genes)))
    order = np.argsort(values)[:starts]
    if (watch := watching()) is not None:
        watch.add(DRAWN, float(values[order[0]]))
    each = [look.genome.unknowns(jnp.asarray(genes[i]), look.problem) for i in order]
    numbers = np.stack([np.asarray(look.problem.numbers(y)) for y in each])
    progress(f"fitting from {starts} of them")
    begin = here.model.with_vector(jnp.asarray(numbers[0]))
    end = descend(here, begin, numbers, list(wild), progress)
    progress("errors, modes and held-out recordings")
    return finish(experiment, numbers[0], end, began)


@eqx.filter_jit
def _values(look: Search, genes):
    def one(individual):
        value = relative_error(look.problem, look.genome.unknowns(individual, look.problem))
        return jnp.where(jnp.isfinite(value), value, jnp.inf)

    # Abreast, what dry friction seldom asks for would be computed always.
    return jax.lax.map(one, genes) if look.problem.model.dry else jax.vmap(one)(genes)
