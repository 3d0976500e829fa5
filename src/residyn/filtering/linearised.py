"""A model along a motion as a linear system: one step from each instant to the next.

The equation of motion is linearised about a given motion at the beginning, middle and end of every
step, and one fourth-order Runge-Kutta step of that affine field gives x+ = A x + B u + T tau + c.
Along the motion a model is data: sums of its effects' torques and slopes (`law`).

Dry friction is linear nowhere, so its direction enters as the expected one over what is known of
the rate, E clip(v / slow + hold, -1, 1): where friction can hold the joint, it takes the torque
that holds it (`hold`), and `slow` is the rate that friction takes away in RAMP steps.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm

from ..physics.model import solve_inertia
from ..physics.motion import split, stack
from ..runtime.export_cache import kept
from .law import RAMP


class Field(NamedTuple):
    """The equation of motion along a motion: K steps of three nodes, M internal states (filled up),
    P regressors (filled up)."""

    f: Any  # (K, 3, X)
    by_x: Any  # (K, 3, X, X)
    by_u: Any  # (K, 3, X, P)
    by_torque: Any  # (K, 3, X, n)
    direction: Any  # (K, 3, n) expected direction of sliding


class Sums(NamedTuple):
    """A model's effects together: torques without dry friction, levels of friction, rates."""

    torque: Any  # (K, 3, n)
    torque_q: Any  # (K, 3, n, n)
    torque_v: Any
    torque_z: Any  # (K, 3, n, M)
    torque_u: Any  # (K, 3, n, P)
    level: Any  # (K, 3, n)
    level_q: Any
    level_v: Any
    level_u: Any
    rate: Any  # (K, 3, M)
    rate_q: Any
    rate_v: Any
    rate_z: Any
    rate_u: Any

    @classmethod
    def zeros(cls, K: int, n: int, M: int, P: int) -> "Sums":
        shapes = (
            *((n,), (n, n), (n, n), (n, M), (n, P)),
            *((n,), (n, n), (n, n), (n, P)),
            *((M,), (M, n), (M, n), (M, M), (M, P)),
        )
        return cls(*(np.zeros((K, 3, *s)) for s in shapes))


def _expected_direction(v, needed, level, spread, slow_time):
    """E clip(v / slow + hold, -1, 1) with v normal of standard deviation `spread`; `needed` is the
    torque that would hold the joint, `slow_time` the ramp's time over its inertia."""
    on = jnp.abs(level) > 0
    safe = jnp.where(on, jnp.abs(level), 1.0)
    ratio = needed / safe
    # More than friction can give: the joint is not held, the less the more is needed.
    ratio = jnp.where(jnp.abs(ratio) <= 1, ratio, 1 / jnp.where(ratio == 0, 1.0, ratio))
    slow = slow_time * (safe + jnp.abs(needed)) + 1e-12
    m, s = v / slow + jnp.where(on, ratio, 0.0), spread / slow + 1e-9

    def beyond(a):  # E max(x - a, 0)
        return (m - a) * norm.cdf((m - a) / s) + s * norm.pdf((m - a) / s)

    return jnp.where(on, -1 + beyond(-1.0) - beyond(1.0), jnp.sign(v))


@kept(like=Field(0, 0, 0, 0, 0))
def field(mechanism, h, q, v, drive, spread, sums: Sums) -> Field:
    """The equation of motion and its slopes at the nodes.

    **Arguments:** `mechanism` with leaves (K, ...); `h` (K,) steps; `q`, `v`, `drive` (K, 3, n);
    `spread` (K, 3, n) standard deviation of what is known of the rates.
    """
    n = q.shape[-1]

    def accelerated(mechanism, q, v, push):
        load = mechanism.inertia_torque(split(q), split(v))
        load = tuple(a - b for a, b in zip(split(push), load, strict=True))
        return stack(solve_inertia(mechanism.mass_matrix(split(q)), load))

    def one(mechanism, h, q, v, drive, spread, s: Sums):
        free = drive - s.torque
        unit = jax.jacfwd(accelerated, argnums=3)(mechanism, q, v, free)  # Z^-1
        light = jnp.diag(unit)
        held = accelerated(mechanism, q, v, free) / light
        args = v, held, s.level, spread, RAMP * h * light
        direction = _expected_direction(*args)
        by_v, by_held, by_level = jax.vmap(jax.grad(_expected_direction, argnums=(0, 1, 2)))(*args)
        friction = s.level * direction
        # Slopes at the torque that acts, friction included.
        total = q, v, free - friction
        a = accelerated(mechanism, *total)
        a_q, a_v = jax.jacfwd(accelerated, argnums=(1, 2))(mechanism, *total)
        free_q, free_v = a_q - unit @ s.torque_q, a_v - unit @ s.torque_v
        free_z, free_u = -unit @ s.torque_z, -unit @ s.torque_u
        hold = s.level * by_held / light
        grow = direction + s.level * by_level  # d friction / d level

        def whole(slope, own=None):
            friction = hold[:, None] * slope
            friction = friction if own is None else friction + grow[:, None] * own
            return slope - unit @ friction

        to_q, to_z = whole(free_q, s.level_q), whole(free_z)
        to_v = whole(free_v, s.level_v) - unit @ jnp.diag(s.level * by_v)
        to_u, to_torque = whole(free_u, s.level_u), whole(unit)
        zero, eye = jnp.zeros((n, n)), jnp.eye(n)
        m, p = s.rate.shape[0], to_u.shape[1]
        f = jnp.concatenate([v, a, s.rate])
        by_x = jnp.concatenate(
            [
                jnp.concatenate([zero, eye, jnp.zeros((n, m))], 1),
                jnp.concatenate([to_q, to_v, to_z], 1),
                jnp.concatenate([s.rate_q, s.rate_v, s.rate_z], 1),
            ]
        )
        by_u = jnp.concatenate([jnp.zeros((n, p)), to_u, s.rate_u])
        by_torque = jnp.concatenate([zero, to_torque, jnp.zeros((m, n))])
        return Field(f, by_x, by_u, by_torque, direction)

    nodes = jax.vmap(one, in_axes=(None, None, 0, 0, 0, 0, 0))
    return jax.vmap(nodes)(mechanism, h, q, v, drive, spread, sums)


class Transition(NamedTuple):
    """x+ = A x + B u + T tau + c."""

    A: Any  # (K, X, X)
    B: Any  # (K, X, P)
    T: Any  # (K, X, n)
    c: Any  # (K, X)


@kept(like=Transition(0, 0, 0, 0))
def transition(h, f, by_x, by_u, by_torque, x) -> Transition:
    """One Runge-Kutta step of the affine field about the motion x (K, 3, X)."""
    X, n = by_x.shape[-1], by_torque.shape[-1]
    const = f - jnp.einsum("kaij,kaj->kai", by_x, x)
    M = jnp.concatenate([by_x, const[..., None], by_torque, by_u], -1)  # of (x, 1, tau, u)
    hh = h[:, None, None]
    eye = jnp.eye(X, M.shape[-1])

    def stage(node, slope, share):  # field at a node after moving along a slope
        return M[:, node] + share * hh * (M[:, node, :, :X] @ slope)

    k1 = M[:, 0]
    k2 = stage(1, k1, 0.5)
    k3 = stage(1, k2, 0.5)
    k4 = stage(2, k3, 1.0)
    phi = eye + hh / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return Transition(phi[..., :X], phi[..., X + 1 + n :], phi[..., X + 1 : X + 1 + n], phi[..., X])


@kept(like=0)
def body_torque(mechanism, changed, q, v, push):
    """(K, 3, n) the torque that a small change of the bodies amounts to: Z' a + f^w', where primes
    are differences between `changed` and `mechanism` (leaves (K, ...))."""

    def asked(mechanism, q, v, a):
        q, v = split(q), split(v)
        load = stack(mechanism.inertia_torque(q, v))
        return stack(tuple(sum(z * x for z, x in zip(row, split(a), strict=True))
                           for row in mechanism.mass_matrix(q))) + load  # fmt: skip

    def one(mechanism, changed, q, v, push):
        inertia = mechanism.mass_matrix(split(q))
        load = mechanism.inertia_torque(split(q), split(v))
        a = stack(
            solve_inertia(inertia, tuple(p - w for p, w in zip(split(push), load, strict=True)))
        )
        return asked(changed, q, v, a) - asked(mechanism, q, v, a)

    return jax.vmap(jax.vmap(one, in_axes=(None, None, 0, 0, 0)))(mechanism, changed, q, v, push)


def nodes(h, path, n: int):
    """Angles, rates and internal states (K, 3, ...) at the beginning, middle and end of each step,
    by Hermite's cubic through the smoothed motion."""
    q, v, z = path[:, :n], path[:, n : 2 * n], path[:, 2 * n :]

    def after(a):
        return np.concatenate([a[1:], a[-1:]])

    q1, v1, z1, hh = after(q), after(v), after(z), h[:, None]
    middle = 0.5 * (q + q1) + hh / 8 * (v - v1)
    rate = np.where(hh > 0, 1.5 * (q1 - q) / np.maximum(hh, 1e-12) - 0.25 * (v + v1), v)

    def three(*x):
        return np.stack(x, axis=1)

    return three(q, middle, q1), three(v, rate, v1), three(z, 0.5 * (z + z1), z1)


def array_leaves(tree):
    """A pytree's arrays as NumPy arrays."""
    return jax.tree.map(np.asarray, eqx.filter(tree, eqx.is_array_like))
