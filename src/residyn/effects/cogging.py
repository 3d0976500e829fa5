"""A torque that is periodic in the angle: of a motor's magnets, of a gear's teeth."""

import jax.numpy as jnp

from ..physics.effect import JointEffect
from ..physics.motion import Scalar
from ..physics.parameter import ANGLE, TORQUE, param


class Cogging(JointEffect):
    """A cos + sin pair of one period of the angle, so that no phase is special."""

    name = "cogging"
    title = "Cogging"
    family = "spring shape"
    equation = "S sin(2 pi q/p) + C (cos(2 pi q/p) - 1)"
    looks_like = "frequency wavers as the swing dies away; late swings favour some angles"
    source = "Hanselman, Brushless Permanent-Magnet Motor Design, 1994 (cogging torque)"

    sine: Scalar = param("torque in the sine of the angle", TORQUE)
    cosine: Scalar = param("torque in its cosine", TORQUE)
    period: Scalar = param(
        "angle after which it repeats",
        ANGLE,
        sign="positive",
        silent=None,
        default=0.1,
        grid=(0.3, 0.6, 1.2, 2.4),
    )

    def joint_torque(self, motion):
        # About the rest, where it is taken to vanish: its constant part is a constant torque.
        phase = 2 * jnp.pi * motion.q / self.period
        return self.sine * jnp.sin(phase) + self.cosine * (jnp.cos(phase) - 1.0)
