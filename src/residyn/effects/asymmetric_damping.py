"""A damper that differs by the direction of motion, as a check valve's or a worn seal's does."""

import jax.numpy as jnp

from ..physics.effect import JointEffect
from ..physics.motion import Scalar
from ..physics.parameter import DAMPING, param


class AsymmetricDamping(JointEffect):
    """A damper that is stronger one way: c + d where q' > 0, c - d where q' < 0."""

    name = "asymmetric_damping"
    title = "Asymmetric damping"
    family = "damping law"
    equation = "d |q'|"
    looks_like = "rings about a rest that is shifted while the swing is large, and returns with it"
    source = "Wallaschek, Int. J. Non-Linear Mechanics 25, 1990 (shock absorbers)"
    rough = True

    damping: Scalar = param("half the difference of the two directions' damping", DAMPING)

    def joint_torque(self, motion):
        return self.damping * jnp.abs(motion.v)
