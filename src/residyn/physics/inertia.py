"""The inertia side of Eq. 1: what the motion of the masses alone asks for.

A body of n coordinates knows its mass matrix `Z(q)` and the torque `f^w(q, v)`, and nothing of
springs or friction.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp

from .motion import Joints, Scalar


class AbstractInertia(eqx.Module):
    """Masses that move along n coordinates: `joints`, `units` and `mass_matrix`."""

    joints: eqx.AbstractVar[tuple[str, ...]]
    units: eqx.AbstractVar[tuple[str, ...] | None]

    @abc.abstractmethod
    def mass_matrix(self, q: Joints) -> tuple[Joints, ...]:
        """Z(q) of Eq. 1, kg m^2 (kg for a sliding joint), as n rows of n scalars."""

    def inertia_torque(self, q: Joints, v: Joints) -> Joints:
        """f^w(q, v) of Eq. 1, N m: dZ/dt v - (1/2) d(v'Z v)/dq, so that energy is conserved."""

        def momentum(q):
            return tuple(_dot(row, v) for row in self.mass_matrix(q))

        q = tuple(jnp.asarray(x, float) for x in q)
        v = tuple(jnp.asarray(x, float) for x in v)
        rate = jax.jvp(momentum, (q,), (v,))[1]
        # Forward mode, so that whoever differentiates the motion may use either mode.
        pull = jax.jacfwd(lambda q: self.kinetic_energy(q, v))(q)
        return tuple(r - p for r, p in zip(rate, pull, strict=True))

    def reach(self) -> tuple[float, ...]:
        """(n,) m, the length of the link that turns with each joint; 1 where it is not known."""
        return (1.0,) * len(self.joints)

    def link_angles(self, q: Joints) -> Joints:
        """Absolute angle of each link, rad: what gravity acts on.

        **Raises:** `ValueError` where the coordinates do not define the links' directions.
        """
        if len(self.joints) == 1:
            return q
        raise ValueError(
            f"{type(self).__name__} of {len(self.joints)} joints does not know its links' absolute "
            "angles, which gravity needs; use [arm], or a mechanism with a link_angles method"
        )

    def kinetic_energy(self, q: Joints, v: Joints) -> Scalar:
        """(1/2) v'Z(q) v, J."""
        return 0.5 * _dot(v, tuple(_dot(row, v) for row in self.mass_matrix(q)))


def _dot(x: Joints, y: Joints) -> Scalar:
    return sum(a * b for a, b in zip(x, y, strict=True))
