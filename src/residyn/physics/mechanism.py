"""Mechanisms: bodies without forces, to which effects are added.

`mechanism + effect` is a `Model`. The arm of the paper is `PlanarArm`; anything whose mass matrix
does not depend on the positions is a `ConstantInertia`.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from ..errors import quote
from .effect import AbstractEffect
from .inertia import AbstractInertia
from .model import Model
from .parameter import floating

_REAL = 100.0  # times rounding: a smaller inertia of some motion, in those of the joints, is none


class AbstractMechanism(AbstractInertia):
    """A mechanism of n coordinates. To write one: give `joints`, `units` and `mass_matrix`.

    `inertia_torque` then follows from the mass matrix by automatic differentiation (Lagrange), and
    so conserves energy; a closed form, where you have one, is only faster.
    """

    def __add__(self, effect: AbstractEffect) -> Model:
        """`mechanism + effect`: a Model."""
        return Model(self) + effect


class PlanarArm(AbstractMechanism):
    """Two links in a plane: the arm of the paper, Eq. 2.

    **Arguments:**

    - `link_lengths`: l1, l2 in m.
    - `shoulder`: I1 + m2 l1^2, kg m^2; I1 is of link 1 about the shoulder joint.
    - `elbow`: I2 about the elbow joint, kg m^2.
    - `coupling`: m2 rho2, kg m; rho2 is from the elbow joint to link 2's centre of mass.
    - `theta2`: elbow angle at rest, rad; 0 is the arm stretched out.
    - `bearings`: how many air bearings ride on the elbow and how many on the wrist (the end of
      link 2). Their mass is in the inertias already; this says where they slide.
    - `load`: what presses a load-dependent friction, N.
    - `run`: which run of the rig this is, for numbers that one run has for itself: 1, 2, ...; 0
      for those that share all numbers.

    **Raises:** `ValueError` for other than two lengths, and for inertias that no arm has; traced
    numbers are not looked at.
    """

    link_lengths: Float[Array, " 2"]
    shoulder: Float[Array, ""]
    elbow: Float[Array, ""]
    coupling: Float[Array, ""]
    theta2: Float[Array, ""]
    bearings: Float[Array, " 2"]
    load: Float[Array, ""]
    run: Float[Array, ""]
    joints: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] | None = eqx.field(static=True)

    def __init__(
        self,
        link_lengths: ArrayLike | Sequence[float],
        shoulder: ArrayLike,
        elbow: ArrayLike,
        coupling: ArrayLike,
        theta2: ArrayLike = 0.0,
        bearings: ArrayLike | Sequence[float] = (0.0, 0.0),
        load: ArrayLike = 0.0,
        run: ArrayLike = 0.0,
    ):
        self.link_lengths = floating(link_lengths)
        if self.link_lengths.shape != (2,):
            raise ValueError(f"link_lengths = {link_lengths}: must be two numbers, l1 and l2 (m)")
        self.shoulder = floating(shoulder)
        self.elbow = floating(elbow)
        self.coupling = floating(coupling)
        self.theta2 = floating(theta2)
        self.bearings = floating(bearings)
        self.load, self.run = floating(load), floating(run)
        self.joints, self.units = ("shoulder", "elbow"), ("rad", "rad")
        known = (self.shoulder, self.elbow, self.coupling, self.theta2, self.link_lengths)
        if any(isinstance(x, Tracer) for x in known):
            return
        finite = all(np.isfinite(x).all() for x in known)
        if not finite or not np.all(real_arm(self.link_lengths[0], *known[:3])):
            raise ValueError(
                f"shoulder = {quote(shoulder)}, elbow = {quote(elbow)}, coupling = "
                f"{quote(coupling)}, theta2 = {quote(theta2)}, link_lengths = "
                f"{quote(link_lengths)}: must be finite, and shoulder*elbow above (l1*coupling)^2, "
                "both positive, or some motion would have no inertia"
            )

    def mass_matrix(self, q):
        """Eq. 2."""
        cross = self.link_lengths[0] * self.coupling * jnp.cos(self.theta2 + q[1])
        off = self.elbow + cross
        return (self.shoulder + off + cross, off), (off, self.elbow)

    def inertia_torque(self, q, v):
        """The energy-conserving form of Eq. 3, with q2' the elbow's own rate.

        Eq. 3 as printed has the opposite sign and reads q2' as link 2's absolute rate; it is kept
        as the effect `printed_inertia_torque`.
        """
        s = self.link_lengths[0] * self.coupling * jnp.sin(self.theta2 + q[1])
        return -s * (2.0 * v[0] * v[1] + v[1] * v[1]), s * v[0] * v[0]

    def reach(self):
        """l1, l2."""
        return tuple(self.link_lengths.tolist())

    def link_angles(self, q):
        """q1 and q1 + theta2 + q2."""
        return q[0], q[0] + self.theta2 + q[1]


def real_arm(l1: Any, shoulder: Any, elbow: Any, coupling: Any) -> Any:
    """Whether Eq. 2's mass matrix of such an arm is positive definite, whatever its elbow's angle;
    of arrays, of each."""
    cross = l1 * coupling
    return (shoulder > 0) & (elbow > 0) & (shoulder * elbow > cross * cross)


def arm_of(mechanism: AbstractInertia, name: str) -> PlanarArm:
    """The mechanism, which an effect of this name takes for the arm.

    **Raises:** `ValueError` if it is something else.
    """
    if not isinstance(mechanism, PlanarArm):
        raise ValueError(f"{name} is about the arm of Eq. 2; this experiment has no [arm]")
    return mechanism


class ArmEffect(AbstractEffect):
    """An effect of the whole arm of Eq. 2, and of no other mechanism."""

    @classmethod
    def places(cls, mechanism):
        arm_of(mechanism, cls.name)
        return ()


class ConstantInertia(AbstractMechanism):
    """Any number of joints with a mass matrix that does not depend on their positions.

    **Arguments:**

    - `matrix`: kg m^2, or kg for sliding joints; (n, n), symmetric, positive definite.
    - `joints`: one name per coordinate, no two alike; "q1", "q2", ... if not given.
    - `units`: "rad" or "m" per joint, or None if not known.
    - `load`, `run`: as of a `PlanarArm`.

    **Raises:** `ValueError` for what is none of this; the values of a traced matrix are not looked
    at.
    """

    matrix: Float[Array, "n n"] = eqx.field(converter=floating)
    load: Float[Array, ""]
    run: Float[Array, ""]
    joints: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] | None = eqx.field(static=True)

    def __init__(self, matrix, joints=None, units=None, load=0.0, run=0.0):
        matrix = floating(matrix)
        self.matrix = matrix if matrix.ndim > 1 else matrix.reshape(1, -1)
        self.load, self.run = floating(load), floating(run)
        n = self.matrix.shape[-1]
        self.joints = tuple(joints) if joints is not None else tuple(f"q{i + 1}" for i in range(n))
        self.units = tuple(units) if units is not None else None
        if self.matrix.shape[-2:] != (n, n) or len(self.joints) != n:
            raise ValueError(
                f"matrix has shape {self.matrix.shape}: it must be square, "
                f"one row per joint ({', '.join(self.joints)})"
            )
        if len(set(self.joints)) < n:
            raise ValueError(f"joints are {', '.join(self.joints)}: no two may be alike")
        if self.units is not None and (len(self.units) != n or {*self.units} - {"rad", "m"}):
            raise ValueError(f'units = {self.units}: must be "rad" or "m" for each of {n} joints')
        if isinstance(self.matrix, Tracer):
            return
        known = np.asarray(self.matrix)
        turned, eps = np.swapaxes(known, -1, -2), np.finfo(known.dtype).eps
        rounding = n * eps * np.abs(known).max(initial=0.0)
        if not (np.abs(known - turned) <= rounding).all() or not np.isfinite(known).all():
            raise ValueError(f"matrix = {quote(known.tolist())}: must be finite and symmetric")
        # Kilograms stand beside kilogram square metres: measure each joint by its own inertia.
        own = np.diagonal(known, axis1=-2, axis2=-1)
        size = np.sqrt(np.where(own > 0, own, 1.0))
        scaled = known / size[..., None] / size[..., None, :]
        if not (np.linalg.eigvalsh(scaled) > _REAL * eps).all():
            raise ValueError(f"matrix = {quote(known.tolist())}: must be positive definite")

    def mass_matrix(self, q):
        """The constant matrix."""
        n = len(self.joints)
        return tuple(tuple(self.matrix[i, j] for j in range(n)) for i in range(n))

    def inertia_torque(self, q, v):
        """Zero: the mass matrix does not change with the motion."""
        return (0.0,) * len(self.joints)
