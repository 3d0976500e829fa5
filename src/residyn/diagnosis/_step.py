"""Eq. 1 over one short time, as a Kalman filter wants it: one flat state in, one flat state out.

The flat state is (q, v, z): angles, rates and the model's internal states. The torque that is
looked for enters from outside, positive where it resists. Classical Runge-Kutta is enough between
neighbouring readings, and every stage is smooth: where the model has dry friction, its direction is
not the sharp sign of the rate (of which a filter would see no slope) but a ramp, as wide as what
one step takes off the rate, that ends where friction can hold the joint.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model import Model, solve_inertia
from ..motion import Joints, Motion, Scalar, split, stack

Ends = tuple[Float[Array, " n"], Float[Array, " n"]]
"""A torque at both ends of a step, N m (or N), a straight line between them."""


# Runge and Kutta's stages: where in the step, and how much each counts.
_STAGES = (np.array([0.0, 0.5, 0.5, 1.0]), np.array([1.0, 2.0, 2.0, 1.0]) / 6.0)


def size(model: Model) -> int:
    """Length of the flat state."""
    return 2 * len(model.mechanism.joints) + len(model.memory)


def reading(model: Model, x: Float[Array, " d"]) -> Float[Array, " n"]:
    """What the sensors say in a state, rad or m; a delay counts to first order."""
    n = len(model.mechanism.joints)
    late = jnp.stack([jnp.asarray(delay, float) for delay in model.delays])
    return model.reading(x[:n] - late * x[n : 2 * n])


def advance(
    model: Model, t: Scalar, h: Scalar, x: Float[Array, " d"], torque: Ends, drive: Ends
) -> Float[Array, " d"]:
    """The flat state a time `h` (s) later; no time changes nothing."""
    push = jnp.stack([drive[i] - torque[i] for i in range(2)])

    def stage(carry, at):
        slope, total = carry
        share, weight = at
        now = (1.0 - share) * push[0] + share * push[1]
        slope = stack(_rates(model, t + share * h, split(x + share * h * slope), split(now), h))
        return (slope, total + weight * slope), None

    # A loop, not four calls: written out, this is most of what compiling a filter takes.
    (_, total), _ = jax.lax.scan(stage, (0.0 * x, 0.0 * x), _STAGES)
    x1 = split(x + h * total)
    if model.follows:
        n = len(model.mechanism.joints)
        x1 = (*x1[: 2 * n], *model.memory_follow(_motion(t + h, x1, n)))
    return stack(x1)


def _motion(t: Scalar, x: Joints, n: int) -> Motion:
    return Motion.at(t, x[:n], x[n : 2 * n], x[2 * n :])


def _rates(model: Model, t: Scalar, x: Joints, push: Joints, h: Scalar) -> Joints:
    """dx/dt under an outer torque `push`."""
    n = len(model.mechanism.joints)
    motion = _motion(t, x, n)._replace(grain=h)
    if model.dry:
        motion = motion._replace(direction=_direction(model, motion, push, h))
    return (*motion.v, *model.acceleration(motion, push), *model.memory_rate(motion))


def _direction(model: Model, motion: Motion, push: Joints, h: Scalar) -> Joints:
    """Direction of sliding, without a jump.

    Near rest, friction takes the torque that would otherwise set the joint going, and what brings
    the rate to zero in a step or two; but no more than it has.
    """
    n = len(motion.v)
    none = motion._replace(direction=(0.0,) * n)
    free = model.acceleration(none, push)
    found = []
    for j, level in enumerate(_levels(model, motion)):
        unit = tuple(1.0 if i == j else 0.0 for i in range(n))
        light = solve_inertia(model.bodies.mass_matrix(motion.q), unit)[j]
        needed = free[j] / light  # to keep the rate as it is
        safe = jnp.where(level > 0, level, 1.0)
        ratio = needed / safe
        # A joint that turns round under more than friction is not being held.
        hold = jnp.where(jnp.abs(ratio) <= 1, ratio, 1 / jnp.where(ratio == 0, 1.0, ratio))
        slow = _RAMP * h * light * (safe + jnp.abs(needed)) + 1e-30
        ramp = jnp.clip(motion.v[j] / slow + hold, -1.0, 1.0)
        found.append(jnp.where(level > 0, ramp, jnp.sign(motion.v[j])))
    return tuple(found)


_RAMP = 1.0
# Half-width of the ramp in steps: narrower is stiff for Runge-Kutta, wider blurs the reversal.


def _levels(model: Model, motion: Motion) -> list[Scalar]:
    """Half the jump of each joint's torque where its direction flips, N m."""
    total: list[Scalar] = [jnp.zeros(()) for _ in motion.v]
    for effect, own in model.each(motion):
        if effect.dry:
            for j, more in enumerate(effect.jumps(own, model.bodies)):
                total[j] = total[j] if more is None else total[j] + more
    return total
