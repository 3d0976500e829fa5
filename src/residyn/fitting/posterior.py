"""Draws of a fit's numbers, for tools that read posteriors.

Near the minimum chi-square is a parabola, so that with flat priors the posterior is the Gaussian of
the fit's values and covariance (Laplace's approximation). A number whose error is not far below its
size can leave the sign that physics allows; then sample `Embedded.chi2` instead.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import extra


def gaussian(
    numbers: Sequence[Any], covariance: np.ndarray, draws: int, seed: int
) -> dict[str, np.ndarray]:
    """(draws,) of each number that the data determines, by name.

    **Arguments:** `numbers` (P,) and `covariance` (P, P) of a `Fit`.

    **Raises:** `ValueError` if it determines none, or for less than one draw.
    """
    if draws < 1:
        raise ValueError(f"draws = {draws}: at least one is needed")
    known = [i for i, n in enumerate(numbers) if n.determined]
    if not known:
        raise ValueError("the data determines none of the numbers: there is nothing to draw from")
    centre = np.array([numbers[i].value for i in known])
    std = np.array([numbers[i].std for i in known])
    # As correlations: numbers of unlike units differ by many powers of ten.
    correlation = covariance[np.ix_(known, known)] / std / std[:, None]
    random = np.random.default_rng(seed)
    unit = random.multivariate_normal(np.zeros(len(known)), correlation, draws, method="eigh")
    return {
        numbers[i].name: c + s * u for i, c, s, u in zip(known, centre, std, unit.T, strict=True)
    }


def to_arviz(numbers: Sequence[Any], covariance: np.ndarray, draws: int, seed: int) -> Any:
    """See `Fit.to_arviz`."""
    arviz = extra("arviz", "to_arviz needs ArviZ: pip install 'residyn[bayes]'")
    posterior = {name: x[None] for name, x in gaussian(numbers, covariance, draws, seed).items()}
    if int(arviz.__version__.partition(".")[0]) < 1:
        return arviz.from_dict(posterior=posterior)
    return arviz.from_dict({"posterior": posterior})
