"""Modes: how the linearised model rings.

Around its rest position the model of Eq. 1 is linear, and its state matrix has one pair of complex
eigenvalues per mode: s = -zeta w +- i w sqrt(1 - zeta^2). `frequency_hz` is w / 2 pi, the natural
frequency, which damping does not move; the peak that one reads off a record lies lower by
sqrt(1 - zeta^2), which is 0.5 % at zeta = 0.1.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..runtime.export_cache import kept
from .model import Model
from .motion import Motion, split, stack
from .parameter import all_floating

_NEWTON = 12
_RIDGE = 1e-12
_SETTLED = 1e-12  # rad or m, of a step to where a model rests


class Modes(NamedTuple):
    """n modes, lowest first. A mode that does not ring has `damping_ratio` 1."""

    frequency_hz: Float[Array | np.ndarray, " n"]
    damping_ratio: Float[Array | np.ndarray, " n"]


def equilibrium(model: Model) -> Float[Array, " n"]:
    """Where the model rests, rad or m: near 0, less where gravity or a constant torque pulls."""
    n = len(model.mechanism.joints)

    def step(q, _):
        return q - _past_rest(jnp, jax.jacfwd(partial(_pull, model))(q), _pull(model, q)), None

    return jax.lax.scan(step, jnp.zeros(n), None, length=_NEWTON)[0]


def state_matrix(model: Model, q: Float[Array, " n"] | None = None) -> Float[Array, "s s"]:
    """d(q', q'', z')/d(q, q', z) of the model at rest in `q`, s = 2n and as many as it has internal
    states; dry friction, which has no slope, is off."""
    q = equilibrium(model) if q is None else q
    n = q.shape[0]

    def slopes(y):
        motion = _still(y[:n], y[n : 2 * n], y[2 * n :])
        return stack((*motion.v, *model.acceleration(motion), *model.memory_rate(motion)))

    return jax.jacfwd(slopes)(jnp.concatenate([q, jnp.zeros(n + len(model.memory))]))


def fastest(model: Model) -> float:
    """Largest angular frequency of the linearised model, rad/s (concrete numbers only)."""
    return float(paces(model, np.asarray(model.vector())[None]).max())


def ringing(model: Model) -> float:
    """Largest angular frequency of a mode of the linearised model that rings, rad/s, 0 if none does
    (concrete numbers only). What only fades, however fast, is left out: a solver that chooses its
    steps follows it where it must."""
    values = np.linalg.eigvals(_finite(at_rest(model)[1]))
    rings = np.abs(np.imag(values)) > 1e-9 * np.abs(values)
    return float(np.abs(values[rings]).max(initial=0.0))


def paces(model: Model, numbers: Float[np.ndarray, "K P"]) -> Float[np.ndarray, "K s"]:
    """Sizes of the state matrix' eigenvalues with each row of concrete numbers, smallest first,
    rad/s, or those without effects that have corners, where these are larger: outside of its gap a
    joint with backlash has all of its spring. Infinite where the matrix is not finite."""
    found = _eigenvalue_sizes(model, numbers)
    rough = [model.effects[n.effect].rough and n.meaning.silent is not None for n in model.fitted]
    if any(rough):
        silent = [n.meaning.silent for n in model.fitted]
        without = np.where(rough, np.array(silent, float), numbers)
        found = np.maximum(found, _eigenvalue_sizes(model, without))
    return found


def _eigenvalue_sizes(model: Model, numbers: np.ndarray) -> np.ndarray:
    room, found = 2 * numbers.shape[1] + 1, []  # rows that are compiled for anyway
    for first in range(0, len(numbers), room):
        some = numbers[first : first + room]
        filled = np.concatenate([some, np.tile(some[-1:], (room - len(some), 1))])
        sizes = np.abs(eigenvalues(state_matrices(model, filled)[: len(some)]))
        found.append(np.sort(np.nan_to_num(sizes, nan=np.inf)))
    return np.concatenate(found)


def eigenvalues(matrices: Float[np.ndarray, "*k s s"]) -> Complex[np.ndarray, "*k s"]:
    """Of state matrices; NaN where one is not finite, as at rest of a torque with an infinite
    slope: it has no modes."""
    good = np.asarray(np.isfinite(matrices).all(axis=(-2, -1), keepdims=True))
    return np.where(good[..., 0], np.linalg.eigvals(np.where(good, matrices, 0.0)), np.nan)


def at_rest(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """`equilibrium` (n,) and `state_matrix` (s, s) of concrete numbers, by the program that a fit
    needs anyway."""
    vector = np.asarray(model.vector())
    q, matrices = _at_rest_with(model, np.tile(vector, (2 * len(vector) + 1, 1)))
    return q[0], matrices[0]


def state_matrices(model: Model, numbers: Float[np.ndarray, "K P"]) -> Float[np.ndarray, "K s s"]:
    """`state_matrix` with each row of concrete numbers. Compiled for each K: 2 P + 1 serves for a
    central difference in all numbers."""
    return _at_rest_with(model, numbers)[1]


def _at_rest_with(model: Model, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the model rests (K, n), and its state matrix there."""
    # Newton's steps of `equilibrium`, outside of the compiled program, which is small then; most
    # models rest at 0, and take none.
    n = len(model.mechanism.joints)

    def seen(q) -> tuple[np.ndarray, np.ndarray]:
        pull, matrices = _linearised(model, numbers, q)
        return _finite(pull), np.asarray(matrices)

    q = np.zeros((len(numbers), n))
    pull, matrices = seen(q)
    for _ in range(_NEWTON):
        step = _past_rest(np, _finite(matrices[:, n : 2 * n, :n]), pull)
        if np.all(np.abs(step) <= _SETTLED):
            break
        q = q - step
        pull, matrices = seen(q)
    return q, matrices


def _past_rest(here, slope, pull):
    """How far (..., n) from rest a model is, by Newton, where it is pulled with `pull` (..., n),
    which has this `slope` (..., n, n); `here` is NumPy or JAX."""
    turned = here.swapaxes(slope, -1, -2)
    square = turned @ slope
    # A joint without stiffness rests anywhere: the small ridge leaves it where it is.
    ridge = _RIDGE * here.trace(square, axis1=-2, axis2=-1) + 1e-300
    square = square + ridge[..., None, None] * here.eye(slope.shape[-1])
    return here.linalg.solve(square, turned @ pull[..., None])[..., 0]


def _finite(x) -> np.ndarray:
    return np.nan_to_num(np.asarray(x), nan=0.0, posinf=0.0, neginf=0.0)


@kept(like=(0, 0))
def _linearised(model: Model, numbers, q):
    """What pulls at rest in each row of `q`, and the state matrix there."""

    # One after the other: such small arrays compile longer than they run.
    def one(row):
        here = model.with_vector(row[0])
        return _pull(here, row[1]), state_matrix(here, row[1])

    return jax.lax.map(one, (numbers, q))


def modes(model: Model) -> Modes:
    """Natural frequencies and damping ratios, differentiable in the model's numbers."""
    return _modes(all_floating(model))


@eqx.filter_jit  # else each of its operations is compiled by itself
def _modes(model: Model) -> Modes:
    return modes_of(jnp.linalg.eigvals(state_matrix(model)))


def modes_of(values: Complex[Array | np.ndarray, "*k 2n"]) -> Modes:
    """Modes from the eigenvalues of a state matrix, or of several."""
    # NumPy where nothing is traced: JAX would compile each of these operations by itself.
    here = np if isinstance(values, np.ndarray) else jnp
    sort, along = partial(here.argsort, stable=True), partial(here.take_along_axis, axis=-1)
    size = here.abs(values)
    # One of each conjugate pair: the upper half plane first, real values by size after it.
    order = -here.sign(here.imag(values)) - 1e-9 * size / here.max(size, axis=-1, keepdims=True)
    keep = sort(order)[..., : values.shape[-1] // 2]
    keep = along(keep, sort(along(size, keep)))
    safe = here.where(size > 0, size, 1.0)
    return Modes(along(size / (2 * np.pi), keep), along(-here.real(values) / safe, keep))


def _pull(model: Model, q) -> Float[Array, " n"]:
    """The acceleration from rest at `q`."""
    return stack(model.acceleration(_still(q, 0.0 * q, jnp.zeros(len(model.memory)))))


def _still(q, v, z) -> Motion:
    return Motion(0.0, split(q), split(v), (0.0,) * len(q), split(z))
