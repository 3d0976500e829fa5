"""The equation of motion as the integrator sees it: model, drive torque, direction of sliding."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics.model import Model
from ..physics.motion import Joints, Motion, Scalar, split
from ..physics.parameter import floating


class Drive(eqx.Module):
    """External torque on a uniform grid, joined by straight lines.

    `values` (M, n) in N m (or N) at `start + spacing * arange(M)`; constant beyond the ends.
    """

    start: Float[Array, ""] = eqx.field(converter=floating)
    spacing: Float[Array, ""] = eqx.field(converter=floating)
    values: Float[Array, "M n"] = eqx.field(converter=floating)

    def __call__(self, t: Scalar) -> Joints:
        """Torque on each joint at an instant."""
        last = self.values.shape[0] - 1
        place = jnp.clip((t - self.start) / self.spacing, 0.0, last)
        index = jnp.clip(jnp.floor(place).astype(int), 0, last - 1)
        part = place - index
        values = jnp.asarray(self.values)
        return split((1.0 - part) * values[index] + part * values[index + 1])

    def during(self, index) -> "Drive":
        """The torque during one integration step."""
        return self


class Piecewise(eqx.Module):
    """External torque that is a straight line within each of M integration steps.

    `left` and `right` (M, n) in N m (or N): its values at the ends of the steps, where it may jump.
    """

    start: Float[Array, ""] = eqx.field(converter=floating)
    spacing: Float[Array, ""] = eqx.field(converter=floating)
    left: Float[Array, "M n"] = eqx.field(converter=floating)
    right: Float[Array, "M n"] = eqx.field(converter=floating)

    def during(self, index) -> Drive:
        """The torque during one integration step."""
        values = jnp.stack([jnp.asarray(side)[index] for side in (self.left, self.right)])
        return Drive(self.start + index * self.spacing, self.spacing, values)


class Args(NamedTuple):
    model: Model
    drive: Drive | None


@eqx.filter_jit  # traced once for all stages of all steps: tracing is most of a first fit's cost
def rates(args: Args, motion: Motion, held: Joints | None = None) -> tuple[Joints, Joints]:
    """(q'', z'): accelerations, and the rates of the internal states."""
    drive = None if args.drive is None else args.drive(motion.t)
    return args.model.acceleration(motion, drive, held), args.model.memory_rate(motion)


def acceleration(args: Args, motion: Motion, held: Joints | None = None) -> Joints:
    """q'' alone."""
    return rates(args, motion, held)[0]


def signs(v: Joints) -> Joints:
    return tuple(jnp.sign(x) for x in v)
