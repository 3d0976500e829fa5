"""Linear algebra of a fit: initial states eliminated, what is left inverted where it has a rank.

The numbers are shared by all recordings, a recording's initial state is its own. So J'J is block
diagonal with a border: a small block for every recording, and the numbers. Taking each recording's
state out by a small QR (a Schur complement) leaves a few equations in the numbers alone; these are
stacked and solved, and each state follows. As one dense problem, the cost would grow with the third
power of the number of recordings.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, PyTree

from .problem import Unknowns

# Eigenvalue of J'J with unit columns below which a combination has no effect on the prediction: its
# standard error is 1e5 times that of its numbers alone.
BLIND = 1e-10
PART = 1e-3
"""Share of such a combination beyond which a number belongs to it."""


class BorderedSolver(lx.AbstractLinearSolver):
    """Least squares where the unknowns are `Unknowns`, (P,) numbers and (R, s) states, and every
    equation belongs to one recording, (R, ...) of them, or to one unknown alone, `Unknowns` again.

    Its operator maps `Unknowns` to `(rows, Unknowns)`, `rows` any tree of leaves (R, ...): what
    Levenberg-Marquardt asks for, whose second part is the damping. No matrix is formed; P + s
    products with the operator find its blocks.
    """

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]):
        del options
        shape = operator.in_structure()
        zero = Unknowns(*(jnp.zeros(x.shape, x.dtype) for x in shape))
        border = jax.vmap(lambda e: operator.mv(zero._replace(numbers=e)))(
            jnp.eye(zero.numbers.shape[0])
        )
        # A state moves its own recording only: the same one of all recordings is asked for at once.
        blocks = jax.vmap(
            lambda e: operator.mv(zero._replace(states=jnp.broadcast_to(e, zero.states.shape)))
        )(jnp.eye(zero.states.shape[1]))
        # What each unknown's own equation says of it.
        alone = operator.mv(jax.tree.map(jnp.ones_like, zero))[1]
        return _equations(border[0]), _equations(blocks[0]), alone

    def compute(
        self, state, vector: PyTree[Array], options: dict[str, Any]
    ) -> tuple[Unknowns, lx.RESULTS, dict[str, Any]]:
        del options
        border, blocks, alone = state
        right, wanted = vector
        states, numbers = blocks.shape[-1], border.shape[-1]

        def eliminated(border, blocks, right, alone, wanted):
            """One recording: [U, V, w; 0, S, b], triangular, in its state, the numbers and 1."""
            own = jnp.concatenate(
                [jnp.diag(alone), jnp.zeros((states, numbers)), wanted[:, None]], axis=1
            )
            seen = jnp.concatenate([blocks, border, right[:, None]], axis=1)
            return jnp.linalg.qr(jnp.concatenate([seen, own]), mode="r")

        right = _equations(jax.tree.map(lambda x: x[None], right))[..., 0]
        left = jax.vmap(eliminated)(border, blocks, right, alone.states, wanted.states)
        below = left[:, states:, states:].reshape(-1, numbers + 1)
        own = jnp.concatenate([jnp.diag(alone.numbers), wanted.numbers[:, None]], axis=1)
        top = jnp.linalg.qr(jnp.concatenate([below, own]), mode="r")[:numbers]
        found = jax.scipy.linalg.solve_triangular(top[:, :numbers], top[:, numbers])

        def its_state(rows):
            rest = rows[:states, -1] - rows[:states, states : states + numbers] @ found
            return jax.scipy.linalg.solve_triangular(rows[:states, :states], rest)

        return Unknowns(found, jax.vmap(its_state)(left)), lx.RESULTS.successful, {}

    def transpose(self, state, options: dict[str, Any]):
        raise NotImplementedError("a bordered system is not solved the other way round")

    def conj(self, state, options: dict[str, Any]):
        return state, options

    def assume_full_rank(self) -> bool:
        return True


def _equations(columns: PyTree[Array]) -> Array:
    """(R, E, C): all equations of each recording, from C columns, leaves (C, R, ...)."""
    leaves = [x.reshape(*x.shape[:2], -1) for x in jax.tree.leaves(columns)]
    return jnp.moveaxis(jnp.concatenate(leaves, axis=2), 0, 2)


def information(factors: np.ndarray, numbers: int) -> np.ndarray:
    """(P, P) information J'J on the first P of L unknowns, the rest (states) taken out.

    `factors` (R, L, L): each recording's triangular factor of J'J.
    """
    # QR with the states first leaves, below them, the numbers' information alone.
    states_first = np.roll(factors, -numbers, axis=2)
    below = np.asarray(np.linalg.qr(states_first, mode="r"))[:, -numbers:, -numbers:]
    rows = below.reshape(-1, numbers)
    return rows.T @ rows


class Inverse(NamedTuple):
    """The inverse (P, P) of a symmetric matrix where that has a rank, the (B, P) combinations of
    unknowns with unit columns where it has none, and the unknowns' sizes (P,) in which they are."""

    inverse: np.ndarray
    blind: np.ndarray
    size: np.ndarray


def inverse_of(square: np.ndarray) -> Inverse:
    """Pseudo-inverse of J'J, by its eigenvalues with unit columns."""
    diagonal = np.diag(square)
    size = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(square * size * size[:, None])
    seen = values > BLIND
    part = vectors[:, seen] * size[:, None]
    return Inverse((part / values[seen]) @ part.T, vectors[:, ~seen].T, size)


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
