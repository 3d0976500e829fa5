"""The step of many recordings is the one that a dense solver takes."""

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from residyn.fitting.linalg import BorderedSolver
from residyn.fitting.problem import Unknowns


@pytest.fixture(autouse=True)
def _wide():
    with jax.enable_x64(True):
        yield


def problem_of(recordings: int, numbers: int = 4, states: int = 5, equations: int = 12):
    """A random operator of the arrowhead's kind, and a right-hand side."""
    rng = np.random.default_rng(recordings)
    border = rng.standard_normal((recordings, equations, numbers))
    blocks = rng.standard_normal((recordings, equations, states)) * 10.0 ** rng.uniform(
        -3, 3, states
    )

    def mv(y: Unknowns):
        rows = jnp.einsum("rei,i->re", border, y.numbers) + jnp.einsum(
            "res,rs->re", blocks, y.states
        )
        # Two leaves of rows, one of them a single equation, as the fit has them.
        return (rows[:, 1:], rows[:, 0]), jax.tree.map(lambda x: 0.3 * x, y)

    like = Unknowns(jnp.zeros(numbers), jnp.zeros((recordings, states)))
    operator = lx.FunctionLinearOperator(mv, jax.eval_shape(lambda: like))
    right = jax.tree.map(lambda x: jnp.asarray(rng.standard_normal(x.shape)), mv(like))
    return operator, right


@pytest.mark.parametrize("recordings", [1, 2, 7])
def test_same_as_dense(recordings):
    operator, right = problem_of(recordings)
    ours, theirs = (
        lx.linear_solve(operator, right, solver).value for solver in (BorderedSolver(), lx.QR())
    )
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_more_unknowns_than_equations_of_a_recording():
    """The damping alone determines what the readings do not."""
    operator, right = problem_of(3, numbers=6, states=9, equations=8)
    ours, theirs = (
        lx.linear_solve(operator, right, solver).value for solver in (BorderedSolver(), lx.QR())
    )
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-10)


def test_in_proportion_to_the_recordings():
    """Twice the recordings ask for twice the memory, not for four times."""

    def room(recordings):
        operator, right = problem_of(recordings)
        program = jax.jit(lambda x: lx.linear_solve(operator, x, BorderedSolver()).value)
        return program.lower(right).compile().memory_analysis().temp_size_in_bytes

    assert room(400) < 2.2 * room(200)
