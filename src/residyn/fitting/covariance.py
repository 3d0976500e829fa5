"""How well the data determine the numbers: covariance, and what they leave open.

At the best fit the whitened residual's Jacobian J gives the covariance (J'J)^-1 of all unknowns;
its block of the numbers has the initial states' uncertainty in it. Where a combination of numbers
leaves the prediction unchanged, J'J has no inverse: the combination is named and its numbers get no
error, rather than a huge one that looks like a measurement.
"""

from typing import NamedTuple

import numpy as np

# Eigenvalue of J'J with unit columns below which a combination has no effect on the prediction:
# its standard error is 1e5 times that of its numbers alone.
_BLIND = 1e-10
_PART = 1e-3  # share of a blind combination beyond which a number belongs to it


class Spread(NamedTuple):
    """(P, P) covariance (NaN where undetermined), and the groups of numbers left open together."""

    covariance: np.ndarray
    open_groups: tuple[tuple[int, ...], ...]

    @property
    def std(self) -> np.ndarray:
        """(P,) standard errors, inf where undetermined."""
        variance = np.diag(self.covariance)
        return np.sqrt(np.where(np.isfinite(variance), variance, np.inf))


def information(factors: np.ndarray, numbers: int) -> np.ndarray:
    """(P, P) information J'J on the first P of L unknowns, the rest (states) taken out.

    `factors` (R, L, L): each recording's triangular factor of J'J.
    """
    total = np.zeros((numbers, numbers))
    for factor in factors:
        # QR with the states first leaves, below them, the numbers' information alone.
        states_first = np.roll(factor, -numbers, axis=1)
        rest = np.asarray(np.linalg.qr(states_first, mode="r"))[-numbers:, -numbers:]
        total += rest.T @ rest
    return total


def spread_of(factors: np.ndarray, sizes: np.ndarray, inflation: float) -> Spread:
    """Covariance of the numbers, scaled by `sizes` (P,), at the best fit, times `inflation`."""
    square = information(factors, len(sizes))
    diagonal = np.diag(square)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(square / size / size[:, None])
    blind = values < _BLIND
    with np.errstate(divide="ignore"):
        inverse = (vectors * np.where(blind, 0.0, 1.0 / np.where(blind, 1.0, values))) @ vectors.T
    scale = sizes / size
    covariance = inflation * inverse * scale * scale[:, None]
    groups = []
    for vector in vectors[:, blind].T:
        group = tuple(int(i) for i in np.flatnonzero(np.abs(vector) > _PART))
        groups.append(group)
        covariance[list(group), :] = np.nan
        covariance[:, list(group)] = np.nan
    return Spread(covariance, tuple(groups))
