"""An effect as data along a motion: its torque, and how that changes with everything.

An effect of the catalogue, or a user's own, is a function of the motion and of its numbers. Along a
given motion only its values and slopes there matter to a filter. One small program for each kind of
effect evaluates them at all instants at once; what a model consists of is data from here on.

Dry friction jumps with the direction of sliding. It is split into the torque without it and the
*level* L of friction at each joint: torque = torque + L direction, -1 <= direction <= 1.
"""

import dataclasses
from typing import Any, NamedTuple, TypeGuard, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect, JointEffect
from ..physics.inertia import AbstractInertia
from ..physics.motion import JointMotion, Motion, split, stack
from ..physics.parameter import Parameter, parameters_of
from ..runtime.export_cache import kept

_Effect = TypeVar("_Effect", bound=AbstractEffect)

RAMP = 0.4
"""Half-width of dry friction's ramp in steps: the Runge-Kutta step is stable above 1 / 2.78."""


class Slopes(NamedTuple):
    """A vector of r entries at K instants, and its derivatives."""

    value: Any  # (K, r)
    by_q: Any  # (K, r, n)
    by_v: Any  # (K, r, n)
    by_z: Any  # (K, r, m) the effect's own m internal states
    by_number: Any  # (K, r, p) the effect's own p numbers


class Law(NamedTuple):
    """An effect along a motion."""

    torque: Slopes
    """N m (or N), positive where it resists; of dry friction, without the level."""
    level: Slopes | None
    """Level of dry friction, N m; None where there is none."""
    rate: Slopes | None
    """r = m: d/dt of the internal states; None where there are none."""
    joint: int | None
    """The joint that all this is about, r = n = 1 then; None: the whole mechanism, r = n."""

    def whole(self, x: np.ndarray, n: int) -> np.ndarray:
        """(K, n) of (K, r): what is not of the effect's joint is 0."""
        if self.joint is None:
            return x
        out = np.zeros((len(x), n))
        out[:, self.joint] = x[:, 0]
        return out


_NONE = Slopes(0, 0, 0, 0, 0)


def numbers_of(effect: AbstractEffect) -> list[Parameter]:
    """The p numbers of an effect that a fit moves."""
    return [each for each in parameters_of(effect) if each.fitted]


def with_numbers(effect: _Effect, values) -> _Effect:
    """The effect with its p fitted numbers replaced."""
    fields = [each.field for each in numbers_of(effect)]
    return dataclasses.replace(effect, **dict(zip(fields, split(values), strict=True)))


def of_one_joint(effect: AbstractEffect) -> TypeGuard[JointEffect]:
    """Whether the effect's torque and states depend on the motion of its own joint alone."""
    kind = type(effect)
    return (
        isinstance(effect, JointEffect)
        and kind.torque is JointEffect.torque
        and kind.rate is JointEffect.rate
        and kind.jumps is JointEffect.jumps
    )


def changes_bodies(effect: AbstractEffect) -> bool:
    """Whether the effect is an error of the inertias."""
    return type(effect).bodies is not AbstractEffect.bodies


def law(
    effect: AbstractEffect,
    numbers: np.ndarray,
    mechanism: AbstractInertia,
    t: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    z: np.ndarray,
    step: np.ndarray,
    spread: np.ndarray,
) -> Law:
    """The law of an effect with some numbers (p,) at K instants.

    **Arguments:** `mechanism` with every leaf (K, ...); `t` (K,) s; `q`, `v` (K, n); `z` (K, m) its
    own internal states; `step` (K,) s and `spread` (K, n) the standard deviation of what is known
    of the rates, over which the friction of a point is smoothed.
    """
    joint = None
    if of_one_joint(effect):
        joint = mechanism.joints.index(effect.joint)
        alone = dataclasses.replace(effect, joint="")  # one program for all joints
        found = _joint_law(alone, numbers, t, q[:, joint], v[:, joint], z)
    else:
        found = _whole_law(effect, numbers, mechanism, t, q, v, z, step, spread)
    r = q.shape[1] if joint is None else 1
    value, by_q, by_v, by_z, by_u = (np.asarray(x) for x in found)
    if joint is not None:
        by_q, by_v = by_q[..., None], by_v[..., None]
    torque, level, rate = (
        Slopes(value[:, rows], by_q[:, rows], by_v[:, rows], by_z[:, rows], by_u[:, rows])
        for rows in (slice(0, r), slice(r, 2 * r), slice(2 * r, None))
    )
    return Law(torque, level if effect.dry else None, rate if effect.memory else None, joint)


@kept(like=_NONE)
def _joint_law(effect: JointEffect, numbers, t, q, v, z):
    """Torque, level and rates of the internal states, stacked, of an effect at one joint."""

    def at(q, v, z, u, t):
        own = with_numbers(effect, u)
        motion = JointMotion(t, q, v, jnp.sign(v), split(z), q)
        if effect.dry:
            up, down = (
                jnp.asarray(own.joint_torque(motion._replace(direction=s)), float)
                for s in (1.0, -1.0)
            )
            parts = [0.5 * (up + down), 0.5 * (up - down)]
        else:
            parts = [own.joint_torque(motion), 0.0]
        return stack((*parts, *(own.joint_rate(motion) if effect.memory else ())))

    def one(q, v, z, t):
        args = q, v, z, jnp.asarray(numbers), t
        return Slopes(at(*args), *jax.jacfwd(at, argnums=(0, 1, 2, 3))(*args))

    return jax.vmap(one)(q, v, z, t)


@kept(like=_NONE)
def _whole_law(effect, numbers, mechanism, t, q, v, z, step, spread):
    """The same of an effect of the whole mechanism."""

    def at(q, v, z, u, t, step, spread, mechanism):
        own = with_numbers(effect, u)
        direction = tuple(0.0 if effect.dry else jnp.sign(x) for x in v)
        motion = Motion(t, split(q), split(v), direction, split(z), None, 1.0)
        if effect.grips:
            # A point's direction is smoothed over the ramp's time, and over what is not known of
            # its velocity (1.5 standard deviations, as a normal velocity's mean direction is).
            own_now = jax.lax.stop_gradient(own)
            lost = own_now.lost_speed(motion, mechanism) + 1e-12
            unsure = own_now.speed_spread(split(spread), mechanism)
            motion = motion._replace(grain=2 * RAMP * step + 1.5 * unsure / lost)
        torque = own.torque(motion, mechanism)
        level = (0.0,) * len(torque)
        if effect.dry:
            level = tuple(0.0 if x is None else x for x in own.jumps(motion, mechanism))
        rate = own.rate(motion, mechanism) if effect.memory else ()
        return stack((*torque, *level, *rate))

    def one(q, v, z, t, step, spread, mechanism):
        args = q, v, z, jnp.asarray(numbers), t, step, spread, mechanism
        return Slopes(at(*args), *jax.jacfwd(at, argnums=(0, 1, 2, 3))(*args))

    return jax.vmap(one)(q, v, z, t, step, spread, mechanism)


class Followed(NamedTuple):
    """Internal states after a step, for effects whose memory jumps along with the motion."""

    value: Any  # (K, m)
    by_z: Any  # (K, m, m)
    by_q: Any  # (K, m, n)
    by_number: Any  # (K, m, p)


@kept(like=Followed(0, 0, 0, 0))
def followed(effect, numbers, mechanism, t, q, v, z) -> Followed:
    """`effect.follow` at K steps that began with states `z` (K, m) and ended in `q`, `v` (K, n)."""

    def at(z, q, u, t, v, mechanism):
        motion = Motion.at(t, q, v, z)._replace(turn=split(q))
        return stack(with_numbers(effect, u).follow(motion, mechanism))

    def one(z, q, t, v, mechanism):
        args = z, q, jnp.asarray(numbers), t, v, mechanism
        return Followed(at(*args), *jax.jacfwd(at, argnums=(0, 1, 2))(*args))

    return jax.vmap(one)(z, q, t, v, mechanism)


class Reading(NamedTuple):
    """What sensors say of n angles."""

    value: Any  # (K, n)
    by_angle: Any  # (K, n, n)
    by_number: Any  # (K, n, p)
    delay: Any  # (n,) s
    delay_by_number: Any  # (n, p)


@kept(like=Reading(0, 0, 0, 0, 0))
def reading(effect, numbers, mechanism, angle) -> Reading:
    """An effect of the sensors at K instants: `angle` (K, n)."""
    numbers = jnp.asarray(numbers)

    def at(angle, u):
        return stack(with_numbers(effect, u).reading(split(angle), mechanism))

    def late(u):
        return stack(with_numbers(effect, u).delays(mechanism))

    value = jax.vmap(lambda a: at(a, numbers))(angle)
    slopes = jax.vmap(lambda a: jax.jacfwd(at, argnums=(0, 1))(a, numbers))
    by_angle, by_number = slopes(angle)
    return Reading(value, by_angle, by_number, late(numbers), jax.jacfwd(late)(numbers))


@kept(like=0)
def states_along(effect, numbers, mechanism, q, v, t, h, z0):
    """Internal states (K, 3, m) of an effect along a motion, at the nodes of each step.

    **Arguments:** `q`, `v` (K, 3, n), `t` (K, 3), `h` (K,) steps; `z0` (K, m): where not NaN, the
    states begin anew there.
    """
    own = with_numbers(effect, jnp.asarray(numbers))

    def step(z, at):
        q, v, t, h, anew, mechanism = at
        z = jnp.where(jnp.isnan(anew), z, anew)
        if effect.follows:
            move = lambda z, i: stack(  # noqa: E731
                own.follow(Motion.at(t[i], q[i], v[i], z)._replace(turn=split(q[i])), mechanism)
            )
            end = move(move(z, 1), 2)
            return end, jnp.stack([z, z, z])

        def rate(z, i, j):
            middle = lambda x: 0.5 * (x[i] + x[j])  # noqa: E731
            return stack(own.rate(Motion.at(middle(t), middle(q), middle(v), z), mechanism))

        def half(z, i):
            return z + h / 2 * rate(z + h / 4 * rate(z, i, i), i, i + 1)

        middle = half(z, 0)
        end = half(middle, 1)
        return end, jnp.stack([z, middle, end])

    return jax.lax.scan(step, z0[0], (q, v, t, h, z0, mechanism))[1]


def first_states(effect: AbstractEffect, mechanism: AbstractInertia, q0, v0) -> np.ndarray:
    """(m,) internal states at a first instant of which nothing else is known."""
    begun = effect.begin(Motion.at(0.0, tuple(map(float, q0)), tuple(map(float, v0))), mechanism)
    return np.array([float(z) for z in begun])


def along_instants(mechanisms, run: np.ndarray):
    """Mechanisms, one for each recording, as one whose leaves are (K, ...)."""
    return jax.tree.map(
        lambda *leaves: np.stack([np.asarray(x, float) for x in leaves])[run],
        *[eqx.filter(m, eqx.is_array_like) for m in mechanisms],
    )
