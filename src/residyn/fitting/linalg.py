"""Linear algebra of a fit: initial states eliminated, what is left inverted where it has a rank.

The numbers are shared by all recordings, a recording's initial state is its own. So J'J is block
diagonal with a border: a small block for every recording, and the numbers. Taking each recording's
state out by a small QR (a Schur complement) leaves a few equations in the numbers alone; these are
stacked and solved, and each state follows. As one dense problem, the cost would grow with the third
power of the number of recordings.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .problem import Unknowns

# Eigenvalue of J'J with unit columns below which a combination has no effect on the prediction that
# another initial state does not undo: its standard error is 1e5 times that of its numbers alone.
BLIND = 1e-10
RIDGE = 1e-14
"""What is added to J'J with unit columns, so that rounding leaves it positive."""
PART = 1e-3
"""Share of such a combination beyond which a number belongs to it."""


def damped_least_squares(
    factor: Float[Array, "R L L"], along: Float[Array, "R L"], damping, like: Unknowns
) -> Unknowns:
    """The step d that minimises |factor d + along|^2 + damping |d|^2, its numbers and states shaped
    as those of `like`."""
    numbers, states = like.numbers.shape[0], like.states.shape[1]
    root = jnp.sqrt(damping)

    def eliminated(factor, along):
        """One recording: [U, V, w; 0, S, b], triangular, in its state, the numbers and 1."""
        seen = [factor[:, numbers:], factor[:, :numbers], -along[:, None]]
        own = [root * jnp.eye(states), jnp.zeros((states, numbers + 1))]
        return jnp.linalg.qr(jnp.block([seen, own]), mode="r")

    left = jax.vmap(eliminated)(factor, along)
    below = left[:, states:, states:].reshape(-1, numbers + 1)
    own = jnp.concatenate([root * jnp.eye(numbers), jnp.zeros((numbers, 1))], axis=1)
    top = jnp.linalg.qr(jnp.concatenate([below, own]), mode="r")[:numbers]
    found = jax.scipy.linalg.solve_triangular(top[:, :numbers], top[:, numbers])

    def its_state(rows):
        rest = rows[:states, -1] - rows[:states, states : states + numbers] @ found
        return jax.scipy.linalg.solve_triangular(rows[:states, :states], rest)

    return Unknowns(found, jax.vmap(its_state)(left))


class Information(NamedTuple):
    """J'J of P numbers (P, P), with the initial states taken out, and its diagonal (P,) with the
    states known."""

    square: np.ndarray
    alone: np.ndarray


def information(factors: np.ndarray, numbers: int) -> Information:
    """What is known of the first P of L unknowns; the rest are states.

    `factors` (R, L, L): each recording's triangular factor of J'J. A number without any effect on
    a recording is a unit vector there, so that the factor can be solved with; it tells nothing.
    """
    unit = np.eye(factors.shape[-1])
    silent = np.all(np.abs(factors - unit) < BLIND, axis=1) & (np.arange(len(unit)) < numbers)
    factors = np.where(silent[:, None], 0.0, factors)
    # QR with the states first leaves, below them, the numbers' information alone.
    states_first = np.roll(factors, -numbers, axis=2)
    below = np.asarray(np.linalg.qr(states_first, mode="r"))[:, -numbers:, -numbers:]
    rows = below.reshape(-1, numbers)
    return Information(rows.T @ rows, np.sum(factors[..., :numbers] ** 2, axis=(0, 1)))


class Spread(NamedTuple):
    """How well P numbers are determined: their covariance (P, P) where data see them, the (B, P)
    combinations that data hardly see, if at all, the numbers' sizes (P,) in which these are, and
    the combinations' own variances (B,)."""

    covariance: np.ndarray
    blind: np.ndarray
    size: np.ndarray
    variance: np.ndarray

    def std_of(self, slopes: np.ndarray) -> np.ndarray:
        """(...) standard errors of quantities with these slopes (..., P) in the numbers; inf where
        one has a part along a combination that data hardly see."""
        scaled = slopes * self.size
        along = scaled @ self.blind.T
        lost = np.linalg.norm(along, axis=-1) > PART * np.linalg.norm(scaled, axis=-1)
        # Of a large error even a small part counts.
        variance = np.einsum("...i,ij,...j->...", slopes, self.covariance, slopes)
        return np.sqrt(np.where(lost, np.inf, variance + along**2 @ self.variance))

    @property
    def std(self) -> np.ndarray:
        """(P,) standard errors of the numbers, inf where undetermined."""
        return self.std_of(np.eye(len(self.size)))

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Which numbers the combinations that data hardly see tie together, and each that is alone
        in one. Of several, any mixture is hardly seen either: what counts is the space they span.
        """
        onto = self.blind.T @ self.blind  # the projection onto that space
        part = np.sqrt(np.diag(onto))
        tied = (np.abs(onto) > PART * part) & (part > PART) & (part[:, None] > PART)
        tied = np.linalg.matrix_power(tied | tied.T, len(tied))  # through other numbers, too
        return tuple(sorted({tuple(np.flatnonzero(row).tolist()) for row in tied if row.any()}))

    def ways(self, group: Sequence[int]) -> int:
        """In how many independent ways the numbers of one of `groups` change and data hardly see
        it."""
        return round(float(np.sum(self.blind[:, list(group)] ** 2)))

    def distance(self, off: np.ndarray, which: Sequence[int]) -> tuple[float, int]:
        """How far off (S,) some numbers are: squared and in standard errors, in the directions in
        which they are determined whatever the other numbers are, and how many directions that
        is."""
        own = list(which)
        _, parts, ways = np.linalg.svd(self.blind[:, own])
        seen = ways[np.sum(parts > PART) :] / self.size[own]
        away, covariance = seen @ off, seen @ self.covariance[np.ix_(own, own)] @ seen.T
        return float(away @ np.linalg.solve(covariance, away)), len(seen)


def inverse_of(known: Information) -> Spread:
    """Pseudo-inverse of J'J, by its eigenvalues with columns that have unit length before the
    states are taken out: of a column that they take up only rounding is left. Along combinations
    that data hardly see the variance is finite where there is no more than rounding."""
    square, diagonal = known
    size = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(square * size * size[:, None])
    seen = values > BLIND
    part = vectors[:, seen] * size[:, None]
    along = 1.0 / np.maximum(values[~seen], RIDGE)
    return Spread((part / values[seen]) @ part.T, vectors[:, ~seen].T, size, along)


def damped_step(square: np.ndarray, slope: np.ndarray, count: int, damping: float) -> Unknowns:
    """The Gauss-Newton step from J'J (R, L, L) and J'r (R, L) of R recordings, in NumPy: `count`
    numbers, shared by all, and each recording's own states, which are eliminated one by one.

    `damping` is added to J'J, relative to its diagonal.
    """
    diagonal = np.einsum("rii->ri", square)
    diagonal = np.where(diagonal > 0, diagonal, 1.0)
    A = square + damping * diagonal[:, :, None] * np.eye(square.shape[-1])
    across = np.concatenate([A[:, count:, :count], slope[:, count:, None]], axis=-1)
    inner = np.linalg.solve(A[:, count:, count:], across)
    taken = A[:, :count, count:] @ inner
    H = (A[:, :count, :count] - taken[..., :count]).sum(axis=0)
    numbers = -np.linalg.solve(H, (slope[:, :count] - taken[..., count]).sum(axis=0))
    return Unknowns(numbers, -inner[..., count] - inner[..., :count] @ numbers)
