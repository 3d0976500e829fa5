"""The methods that a fit can search by: their names, and what each is given beforehand."""

import difflib
from typing import Any, NamedTuple

from .genetic import Genetic
from .minimise import minimiser

LEVENBERG, RANDOM = "levenberg", "random"


class Method(NamedTuple):
    """What a method is called, what it is given beforehand, in words, and the settings of an
    evolutionary search."""

    title: str
    given: str
    how: Genetic | None = None


_WIDE = (
    "bounds a thousandfold wide, from the typical sizes that the readings show; settings of the "
    "strategy tuned on simulated arms; "
)
_TOLD = _WIDE + "initial states as the first readings say, not searched"
_GENES = _WIDE + "initial states are genes about the first readings"
METHODS = {
    LEVENBERG: Method(
        "Levenberg-Marquardt",
        "nothing but the readings: it finds its start in closed form, and five others about it. It "
        "minimises squares over the noise, not Eq. 17",
    ),
    RANDOM: Method(
        "Levenberg-Marquardt, random starts",
        "the best six of 100 individuals drawn in the genetic algorithm's bounds, of which the "
        "simulations count; no closed-form start",
    ),
    "genetic": Method("genetic algorithm, 100 x 500", _GENES, Genetic()),
    "genetic_release_told": Method(
        "genetic algorithm, 100 x 500, release told", _TOLD, Genetic(initial="readings")
    ),
    "cma_es": Method("CMA-ES, 20 x 500", _GENES, Genetic(20, 500, "CMA_ES")),
    "differential_evolution": Method(
        "differential evolution, 40 x 500", _GENES, Genetic(40, 500, "DifferentialEvolution")
    ),
    "particle_swarm": Method("particle swarm, 40 x 500", _GENES, Genetic(40, 500, "PSO")),
}
"""Methods by their names."""
GENETIC = {name: method.how for name, method in METHODS.items() if method.how is not None}
"""Evolutionary searches, with their settings."""
_MINIMISER = "the closed-form start, and gradients in forward mode"


def named(given: Any) -> tuple[str, Method]:
    """The name of a method that is given by its name or, of optax or optimistix, itself; and what
    is said of it.

    **Raises:** `ValueError` for a method that there is not, in one line; `MissingExtra` for one
    whose package is not installed.
    """
    if not isinstance(given, str) or "." in given:
        name = minimiser(given)[0]
        return name, Method(name, _MINIMISER)
    if given not in METHODS:
        close = difflib.get_close_matches(given, METHODS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(METHODS)}"
        raise ValueError(
            f'method = "{given}": there is no such method; {hint} (or a minimiser of optax or '
            "optimistix, such as optimistix.BFGS)"
        )
    return given, METHODS[given]
