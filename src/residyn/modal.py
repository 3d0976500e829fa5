"""Modes: how the linearised model rings.

Around its rest position the model of Eq. 1 is linear, and its state matrix has one pair of complex
eigenvalues per mode: s = -zeta w +- i w sqrt(1 - zeta^2). `frequency_hz` is w / 2 pi, the natural
frequency, which damping does not move; the peak that one reads off a record lies lower by
sqrt(1 - zeta^2), which is 0.5 % at zeta = 0.1.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from .model import Model
from .motion import Motion, split, stack


class Modes(NamedTuple):
    """n modes, lowest first. A mode that does not ring has `damping_ratio` 1."""

    frequency_hz: Float[Array | np.ndarray, " n"]
    damping_ratio: Float[Array | np.ndarray, " n"]


def equilibrium(model: Model) -> Float[Array, " n"]:
    """Where the model rests, rad or m: near 0, less where gravity or a constant torque pulls."""

    def push(q):
        return stack(model.acceleration(_at_rest(q, 0.0 * q, jnp.zeros(len(model.memory)))))

    def step(q, _):
        slope = jax.jacfwd(push)(q)
        # A joint without stiffness rests anywhere: the small ridge leaves it where it is.
        square = slope.T @ slope
        ridge = (1e-12 * jnp.trace(square) + 1e-300) * jnp.eye(len(q))
        return q - jnp.linalg.solve(square + ridge, slope.T @ push(q)), None

    start = jnp.zeros(len(model.mechanism.joints))
    return jax.lax.scan(step, start, None, length=12)[0]


def state_matrix(model: Model, q: Float[Array, " n"] | None = None) -> Float[Array, "s s"]:
    """d(q', q'', z')/d(q, q', z) of the model at rest in `q`, s = 2n and as many as it has internal
    states; dry friction, which has no slope, is off."""
    q = equilibrium(model) if q is None else q
    n, still = q.shape[0], jnp.zeros(len(model.memory))

    def slopes(y):
        motion = _at_rest(y[:n], y[n : 2 * n], y[2 * n :])
        return jnp.concatenate(
            [y[n : 2 * n], stack(model.acceleration(motion)), _array(model.memory_rate(motion))]
        )

    return jax.jacfwd(slopes)(jnp.concatenate([q, jnp.zeros(n), still]))


def modes(model: Model) -> Modes:
    """Natural frequencies and damping ratios, differentiable in the model's numbers."""
    return modes_of(jnp.linalg.eigvals(state_matrix(model)))


def modes_of(values: Complex[Array | np.ndarray, " 2n"]) -> Modes:
    """Modes from the eigenvalues of a state matrix."""
    # NumPy where nothing is traced: JAX would compile each of these operations by itself.
    concrete = isinstance(values, np.ndarray)
    here = np if concrete else jnp
    sort = partial(np.argsort, kind="stable") if concrete else jnp.argsort
    size = here.abs(values)
    # One of each conjugate pair: the upper half plane first, real values by size after it.
    order = -here.sign(here.imag(values)) - 1e-9 * size / here.max(size)
    keep = sort(order)[: len(values) // 2]
    keep = keep[sort(size[keep])]
    safe = here.where(size > 0, size, 1.0)
    return Modes((size / (2 * np.pi))[keep], (-here.real(values) / safe)[keep])


def _at_rest(q, v, z) -> Motion:
    return Motion(0.0, split(q), split(v), (0.0,) * len(q), split(z))


def _array(x) -> Float[Array, " m"]:
    return stack(x) if x else jnp.zeros(0)
