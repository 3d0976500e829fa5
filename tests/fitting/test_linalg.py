"""The step of many recordings is the one that a dense solver takes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from residyn.fitting.linalg import damped_least_squares
from residyn.fitting.problem import Unknowns

DAMPING = 0.09


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def problem_of(recordings: int, numbers: int = 4, states: int = 5):
    """Random triangular factors, the residuals along them, and unknowns of that shape."""
    rng = np.random.default_rng(recordings)
    size = numbers + states
    sizes = 10.0 ** rng.uniform(-3, 3, size)
    factor = np.triu(rng.standard_normal((recordings, size, size))) * sizes
    like = Unknowns(np.zeros(numbers), np.zeros((recordings, states)))
    return factor, rng.standard_normal((recordings, size)), like


def dense(factor, along, like: Unknowns) -> np.ndarray:
    """The same step, all unknowns in one matrix."""
    (recordings, states), numbers = like.states.shape, len(like.numbers)
    count = numbers + recordings * states
    rows = np.zeros((recordings, numbers + states, count))
    for r in range(recordings):
        first = numbers + r * states
        rows[r, :, :numbers] = factor[r, :, :numbers]
        rows[r, :, first : first + states] = factor[r, :, numbers:]
    matrix = np.concatenate([rows.reshape(-1, count), DAMPING**0.5 * np.eye(count)])
    right = np.concatenate([-along.ravel(), np.zeros(count)])
    return np.linalg.lstsq(matrix, right, rcond=None)[0]


@pytest.mark.parametrize("recordings", [1, 2, 7])
def test_same_as_dense(recordings):
    factor, along, like = problem_of(recordings)
    step = damped_least_squares(factor, along, DAMPING, like)
    ours = np.concatenate([step.numbers, np.ravel(step.states)])
    np.testing.assert_allclose(ours, dense(factor, along, like), rtol=1e-8, atol=1e-11)


def test_the_damping_alone_determines_what_the_readings_do_not():
    factor, along, like = problem_of(3)
    factor[:, :, 1] = 0.0
    factor[1, :, 6] = 0.0
    step = damped_least_squares(factor, along, DAMPING, like)
    assert step.numbers[1] == 0.0
    assert step.states[1, 2] == 0.0
    ours = np.concatenate([step.numbers, np.ravel(step.states)])
    np.testing.assert_allclose(ours, dense(factor, along, like), rtol=1e-8, atol=1e-11)


def test_in_proportion_to_the_recordings():
    """Twice the recordings ask for twice the memory, not for four times."""

    def room(recordings):
        factor, along, like = problem_of(recordings)
        program = jax.jit(lambda f, a: damped_least_squares(f, a, DAMPING, like))
        compiled = program.lower(jnp.asarray(factor), jnp.asarray(along)).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    assert room(400) < 2.2 * room(200)
