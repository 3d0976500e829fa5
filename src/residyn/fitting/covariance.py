"""How well the data determine the numbers and the modes: covariance, and what they leave open.

At the best fit the whitened residual's Jacobian J gives the covariance (J'J)^-1 of all unknowns;
its block of the numbers has the initial states' uncertainty in it. Where a combination of numbers
leaves the prediction unchanged, J'J has no inverse: the combination is named and its numbers get no
error, rather than a huge one that looks like a measurement.
"""

from typing import NamedTuple

import numpy as np

from ..physics.modal import at_rest, eigenvalues, state_matrices
from ..physics.modal import modes_of as rings_of
from ..physics.model import Model, changed
from .linalg import PART, information, inverse_of
from .result import Mode, Number


class Spread(NamedTuple):
    """(P, P) covariance (NaN where undetermined), and the groups of numbers left open together."""

    covariance: np.ndarray
    open_groups: tuple[tuple[int, ...], ...]

    @property
    def std(self) -> np.ndarray:
        """(P,) standard errors, inf where undetermined."""
        variance = np.diag(self.covariance)
        return np.sqrt(np.where(np.isfinite(variance), variance, np.inf))


def spread_of(factors: np.ndarray, sizes: np.ndarray, inflation: float) -> Spread:
    """Covariance of the numbers, scaled by `sizes` (P,), at the best fit, times `inflation`."""
    inverse, blind, _ = inverse_of(information(factors, len(sizes)))
    covariance = inflation * inverse * sizes * sizes[:, None]
    groups = [tuple(int(i) for i in np.flatnonzero(np.abs(v) > PART)) for v in blind]
    for group in groups:
        covariance[list(group), :] = np.nan
        covariance[:, list(group)] = np.nan
    return Spread(covariance, tuple(groups))


def numbers_of(model: Model, start: np.ndarray, spread: Spread) -> tuple[Number, ...]:
    """The fitted numbers with their errors."""
    values, units = np.asarray(model.vector()), model.mechanism.units
    return tuple(
        Number(
            name=number.name,
            words=number.meaning.words,
            value=float(values[i]),
            std=float(spread.std[i]),
            start=float(start[i]),
            # A number of no one joint (gravity's moment, say) takes the unit of the first.
            unit=number.meaning.dimension.unit(units[number.joint or 0] if units else None),
            sign=number.meaning.sign,
            determined=bool(np.isfinite(spread.std[i])),
        )
        for i, number in enumerate(model.fitted)
    )


def modes_of(model: Model, covariance: np.ndarray) -> tuple[Mode, ...]:
    """The modes that ring, with errors carried over from the numbers."""
    vector = np.asarray(model.vector())
    steps = np.diag(1e-6 * np.maximum(np.abs(vector), 1e-6))
    beside = np.concatenate([vector[None], vector + steps, vector - steps])
    # All at once: one by one, these small matrices would take as long as the search.
    rings = np.stack(rings_of(eigenvalues(state_matrices(model, beside))))  # (2, 2 P + 1, n)
    best, (up, down) = rings[:, 0], np.split(rings[:, 1:], 2, axis=1)
    slopes = (up - down) / (2 * np.diag(steps)[:, None])
    found = []
    for i, (frequency, damping) in enumerate(best.T):
        if frequency > 0 and abs(damping) < 1 - 1e-9:
            spread = [_carried(slopes[j, :, i], covariance) for j in (0, 1)]
            found.append(Mode(float(frequency), spread[0], float(damping), spread[1]))
    return tuple(found)


def infinite_slopes_of(model: Model) -> tuple[str, ...]:
    """Labels of effects whose torque has an infinite slope at rest: the model has no modes."""
    alone = {e.label: changed(model, effects=(e,)) for e in model.effects}
    return tuple(x for x, m in alone.items() if not np.isfinite(at_rest(m)[1]).all())


def _carried(slope: np.ndarray, covariance: np.ndarray) -> float:
    """Standard error of a quantity with this slope in the numbers."""
    use = slope != 0
    return float(np.sqrt(slope[use] @ covariance[np.ix_(use, use)] @ slope[use]))
