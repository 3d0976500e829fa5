"""How well the data determine the numbers and the modes: covariance, and what they leave open.

At the best fit the whitened residual's Jacobian J gives the covariance (J'J)^-1 of all unknowns;
its block of the numbers has the initial states' uncertainty in it. Where a combination of numbers
leaves the prediction unchanged, J'J has no inverse: the combination is named and its numbers get no
error, rather than a huge one that looks like a measurement. What does not change along it, as a
frequency that two stiffnesses only set together, has its error all the same.
"""

import numpy as np

from ..physics.effect import unit_of
from ..physics.modal import modes_of as rings_of
from ..physics.modal import state_matrices
from ..physics.model import Model
from .linalg import Spread, information, inverse_of
from .result import Mode, Number


def spread_of(factors: np.ndarray, sizes: np.ndarray, inflation: float) -> Spread:
    """How well the numbers, scaled by `sizes` (P,), are determined at the best fit; `inflation` of
    the variances."""
    covariance, blind, size, variance = inverse_of(information(factors, len(sizes)))
    covariance = inflation * covariance * sizes * sizes[:, None]
    return Spread(covariance, blind, size * sizes, inflation * variance)


def numbers_of(model: Model, start: np.ndarray, spread: Spread) -> tuple[Number, ...]:
    """The fitted numbers with their errors."""
    values, std = np.asarray(model.vector()), spread.std
    return tuple(
        Number(
            name=number.name,
            words=number.meaning.words,
            value=float(values[i]),
            std=float(std[i]),
            start=float(start[i]),
            unit=unit_of(model.labels[number.effect], number.meaning, model.mechanism),
            sign=number.meaning.sign,
            determined=bool(np.isfinite(std[i])),
            acts=number.acts,
        )
        for i, number in enumerate(model.fitted)
    )


def modes_of(model: Model, spread: Spread) -> tuple[Mode, ...]:
    """The modes that ring, with errors carried over from the numbers."""
    vector = np.asarray(model.vector())
    steps = np.diag(1e-6 * np.maximum(np.abs(vector), 1e-6))
    beside = np.concatenate([vector[None], vector + steps, vector - steps])
    # All at once: one by one, these small matrices would take as long as the search.
    rings = np.stack(rings_of(model, state_matrices(model, beside)))  # (2, 2 P + 1, n)
    best, (up, down) = rings[:, 0], np.split(rings[:, 1:], 2, axis=1)
    slopes = (up - down) / (2 * np.diag(steps)[:, None])
    std = spread.std_of(slopes.swapaxes(1, 2))  # (2, n)
    return tuple(
        Mode(float(frequency), float(std[0, i]), float(damping), float(std[1, i]))
        for i, (frequency, damping) in enumerate(best.T)
        if frequency > 0 and abs(damping) < 1 - 1e-9
    )
