"""The methods that a fit can search by: their names, and what each is given beforehand."""

import difflib
from typing import Any

from .genetic import Genetic
from .minimise import minimiser

LEVENBERG, RANDOM = "levenberg", "random"
GENETIC = {
    "genetic": Genetic(),
    "genetic_release_told": Genetic(initial="readings"),
    "cma_es": Genetic(20, 500, "CMA_ES"),
    "differential_evolution": Genetic(40, 500, "DifferentialEvolution"),
    "particle_swarm": Genetic(40, 500, "PSO"),
}
"""Evolutionary searches, with their settings."""
METHODS = {
    LEVENBERG: "Levenberg-Marquardt",
    RANDOM: "Levenberg-Marquardt, random starts",
    "genetic": "genetic algorithm, 100 x 500",
    "genetic_release_told": "genetic algorithm, 100 x 500, release told",
    "cma_es": "CMA-ES, 20 x 500",
    "differential_evolution": "differential evolution, 40 x 500",
    "particle_swarm": "particle swarm, 40 x 500",
}
"""Names of methods, and what they are called."""
DEFAULT_METHODS = tuple(METHODS)
_WIDE = (
    "bounds a thousandfold wide, from the typical sizes that the readings show; settings of the "
    "strategy tuned on simulated arms"
)
GIVEN = {
    LEVENBERG: "nothing but the readings: it finds its start in closed form, and five others about "
    "it. It minimises squares over the noise, not Eq. 17",
    RANDOM: "the best six of 100 individuals drawn in the genetic algorithm's bounds, which count; "
    "no closed-form start",
    "genetic": f"{_WIDE}; initial states are genes about the first readings",
    "genetic_release_told": f"{_WIDE}; initial states as the first readings say, not searched",
    "cma_es": f"{_WIDE}; initial states are genes about the first readings",
    "differential_evolution": f"{_WIDE}; initial states are genes about the first readings",
    "particle_swarm": f"{_WIDE}; initial states are genes about the first readings",
    "optimistix": "the closed-form start, and gradients in forward mode",
}
"""What each method is given, in words."""


def check_method(given: Any) -> None:
    """**Raises:** `ValueError` for a method that there is not, in one line; `MissingExtra` for one
    whose package is not installed."""
    if not isinstance(given, str) or "." in given:
        minimiser(given)
    elif given not in METHODS:
        close = difflib.get_close_matches(given, METHODS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(METHODS)}"
        raise ValueError(
            f'method = "{given}": there is no such method; {hint} (or a minimiser of optax or '
            "optimistix, such as optimistix.BFGS)"
        )


def title_of(given: Any) -> tuple[str, str, Any]:
    """The name of a method, what it is called, and what to give to `fit`.

    **Raises:** as `check_method`.
    """
    check_method(given)
    if isinstance(given, str) and given in METHODS:
        return given, METHODS[given], given
    name = minimiser(given)[0]
    return name, name, given
