"""Modes: how the linearised model moves back to its rest.

Around its rest position the model of Eq. 1 is linear, and each mode is a pair of eigenvalues a, b
of its state matrix. With a b = w^2 and a + b = -2 zeta w, `frequency_hz` is w / 2 pi, the natural
frequency, and zeta the damping ratio. A conjugate pair rings, zeta < 1; the peak that one reads off
a record lies lower by sqrt(1 - zeta^2), which is 0.5 % at zeta = 0.1. Two real eigenvalues are an
overdamped mode, zeta > 1. Where one of them grows, w^2 is -a b and zeta = -|a - b| / 2w <= -1.

Which real eigenvalues are a pair, their shapes tell. The velocity that an eigenvalue takes from a
push is a part psi of its left vector, the angles it gives are a part phi of its right one, and
-(a - b)^2 (psi_a . phi_b)(psi_b . phi_a) is 1 for the two of a joint by itself, and for the two of
a mode of coupled joints whose damping is in proportion; it is 0 for two of different modes, and for
an internal state that is only led by the motion, or only acts on it. The closest pairs are taken
first, as many as there are joints: this goes through critical damping without a jump.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..runtime.export_cache import kept
from .model import Model, changed, check_model
from .motion import Motion, split, stack
from .parameter import all_floating

_NEWTON = 12
_RIDGE = 1e-12
_SETTLED = 1e-12  # rad or m, of a step to where a model rests
_ROUNDING = 100  # units in the last place of the largest eigenvalue: what a zero comes out as


class Modes(NamedTuple):
    """n modes, lowest first: one of each joint, and what effects say they add (`own_modes`).

    - `frequency_hz`: the natural frequency, Hz, 0 where nothing pulls back.
    - `damping_ratio`: below 1 the mode rings, from 1 on it creeps back (inf where nothing pulls
      back). Negative, it grows: by ringing above -1, else by moving away.
    """

    frequency_hz: Float[Array | np.ndarray, "*k n"]
    damping_ratio: Float[Array | np.ndarray, "*k n"]


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


def infinite_slopes_of(model: Model) -> tuple[str, ...]:
    """Labels of effects whose torque, or its slope, is not finite at rest: the model has no modes
    (concrete numbers only)."""
    alone = {e.label: changed(model, effects=(e,)) for e in model.effects}
    return tuple(x for x, m in alone.items() if not np.isfinite(at_rest(m)[1]).all())


def not_finite_at_rest(model: Model) -> str:
    """In words, which of a model's effects `infinite_slopes_of` names."""
    labels = ", ".join(infinite_slopes_of(model)) or "some effect"
    return f"at rest the torque of {labels}, or its slope, is not finite"


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
    tiny = here.finfo(square.dtype).tiny
    ridge = _RIDGE * here.trace(square, axis1=-2, axis2=-1) + tiny
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
    """Natural frequencies and damping ratios, (n,) each, differentiable in the model's numbers but
    at exactly critical damping, where eigenvalues have no slopes.

    **Raises:** `TypeError` for what is no model, `ValueError` for a number of one that is not
    finite, or is several.
    """
    check_model(model)
    return _modes(all_floating(model))


@eqx.filter_jit  # else each of its operations is compiled by itself
def _modes(model: Model) -> Modes:
    return modes_of(model, state_matrix(model))


def modes_of(model: Model, matrices: Float[Array | np.ndarray, "*k s s"]) -> Modes:
    """Modes from state matrices of a model; NaN from one that is not finite."""
    # NumPy where nothing is traced: JAX would compile each of these operations by itself.
    here: Any = np if isinstance(matrices, np.ndarray) else jnp
    values, vectors, left = _eigen(here, matrices)
    a, b = _pairs(here, model, values, vectors, left)
    total, product = here.real(a + b), here.real(a * b)
    pulled = product != 0
    w = here.sqrt(here.where(pulled, here.abs(product), 1.0))
    back = here.where(product < 0, here.abs(here.real(a - b)), total)
    free = here.where(total == 0, 0.0, here.where(total < 0, np.inf, -np.inf))
    ratio = here.where(pulled, -back / (2 * w), free)
    frequency = here.where(pulled, w / (2 * np.pi), 0.0)
    good = here.isfinite(matrices).all(axis=(-2, -1))[..., None]
    frequency, ratio = (here.where(good, x, np.nan) for x in (frequency, ratio))
    order = here.argsort(frequency, axis=-1, stable=True)
    return Modes(*(here.take_along_axis(x, order, axis=-1) for x in (frequency, ratio)))


@jax.custom_jvp
def _eigenvalues(matrices):
    return jnp.linalg.eig(matrices)[0] + 0j


@_eigenvalues.defjvp
def _(given, changes):
    """JAX has no derivatives of eigenvectors, so a second derivative is refused, not wrong."""
    (matrices,), (change,) = given, changes
    values, vectors = jnp.linalg.eig(matrices)
    left = jnp.linalg.pinv(vectors, 0.0)  # of vectors that coincide there is no inverse
    return values + 0j, jnp.einsum("...ij,...jk,...ki->...i", left, change + 0j, vectors)


def _eigen(here, matrices):
    """Eigenvalues (..., s), vectors in columns and left ones in rows, of finite matrices; only the
    eigenvalues have derivatives."""
    matrices = here.where(here.isfinite(matrices).all(axis=(-2, -1), keepdims=True), matrices, 0.0)
    fixed = matrices if here is np else jax.lax.stop_gradient(matrices)
    values, vectors = (x + 0j for x in here.linalg.eig(fixed))
    left = here.linalg.pinv(vectors, 0.0)
    if here is jnp:
        values = _eigenvalues(matrices)
    size = here.abs(here.real(values)) + here.abs(here.imag(values))
    least = _ROUNDING * np.finfo(matrices.dtype).eps * size.max(axis=-1, keepdims=True)
    return here.where(size > least, values, 0.0), vectors, left


def _pairs(here, model: Model, values, vectors, left):
    """The two eigenvalues of each mode, (..., n) each."""
    n, s = len(model.mechanism.joints), values.shape[-1]
    fixed = values if here is np else jax.lax.stop_gradient(values)
    a, b = fixed[..., :, None], fixed[..., None, :]
    apart = here.real(-((a - b) ** 2))
    cross = left[..., :, n : 2 * n] @ vectors[..., :n, :]
    close = here.real(-((a - b) ** 2) * cross * here.swapaxes(cross, -1, -2))
    may = (a == here.conj(b)) | ((here.imag(a) == 0) & (here.imag(b) == 0))
    may = may & (np.arange(s)[:, None] < np.arange(s))
    first, second = [], []
    # The effects' own modes are those, of what is left, that ring.
    for score in [close] * n + [apart] * sum(e.own_modes for e in model.effects):
        score = here.where(may, here.nan_to_num(score), -np.inf)
        best = here.argmax(score.reshape(*score.shape[:-2], s * s), axis=-1)[..., None]
        first, second = [*first, best // s], [*second, best % s]
        free = (np.arange(s) != first[-1]) & (np.arange(s) != second[-1])
        may = may & free[..., :, None] & free[..., None, :]
    taken = (here.concatenate(x, axis=-1) for x in (first, second))
    return tuple(here.take_along_axis(values, x, axis=-1) for x in taken)


def _pull(model: Model, q) -> Float[Array, " n"]:
    """The acceleration from rest at `q`."""
    return stack(model.acceleration(_still(q, 0.0 * q, jnp.zeros(len(model.memory)))))


def _still(q, v, z) -> Motion:
    return Motion(0.0, split(q), split(v), (0.0,) * len(q), split(z))
