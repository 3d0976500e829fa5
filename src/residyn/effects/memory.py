"""Torques that remember: what they are depends on how the joint came to its angle.

Against the angle such a torque draws a loop instead of a line. That of dry friction inside has the
same shape however slowly one goes round it: Bouc and Wen's law has an internal state with a rate of
its own; a brake that slips follows the angle instead, at a distance that its holding torque allows.
A spring that relaxes draws a line when it is slow or fast, and a loop between.
"""

import jax.numpy as jnp

from ..physics.effect import JointEffect
from ..physics.motion import Scalar
from ..physics.parameter import ANGLE, DURATION, RATIO, STIFFNESS, TORQUE, Memory, param


class Hysteresis(JointEffect):
    """Bouc-Wen hysteresis: elastic for small reversals, yielding at a torque Q for large ones.

    y z' = q' (1 - |z|^n) while z grows towards the direction of q', y z' = q' on the way back
    (Bouc-Wen with beta = gamma = 1/2); z runs between -1 and 1.
    """

    name = "hysteresis"
    title = "Hysteresis"
    family = "elastoplastic law"
    equation = "Q z, y z' = q' (1 - |z|^n (1 + sign(q' z)) / 2)"
    looks_like = "damping and stiffness both fall as the swing grows; a loop against the angle"
    source = "Bouc 1967; Wen, J. Eng. Mech. 102, 1976"
    rough = True
    memory = (Memory("z", RATIO),)

    level: Scalar = param("torque at which it yields", TORQUE, sign="positive", name="torque")
    angle: Scalar = param(
        "deflection at which it yields",
        ANGLE,
        sign="positive",
        silent=None,
        default=0.05,
        grid=(0.25, 0.6, 1.5),
    )
    sharpness: Scalar = param(
        "n, sharpness of the yielding",
        RATIO,
        sign="positive",
        silent=None,
        default=1.0,
        grid=(1.0,),
    )

    def begin(self, motion, mechanism):
        # Where a slow pull from rest to the first angle leaves it (exactly so for n = 1).
        q = motion.q[mechanism.joints.index(self.joint)]
        return (-jnp.sign(q) * jnp.expm1(-jnp.abs(q / self.angle)),)

    def joint_torque(self, motion):
        return self.level * motion.memory[0]

    def joint_rate(self, motion):
        (z,) = motion.memory
        # How far it is loaded in the direction of the motion; never 0, for the power's slope.
        loaded = jnp.maximum(jnp.where(motion.v >= 0, z, -z), 1e-9)
        # Beyond 1 only too long a step leads; the power is bounded there, or a large n diverges.
        power = jnp.exp(jnp.minimum(jnp.abs(self.sharpness) * jnp.log(loaded), 1.0))
        return (motion.v / jnp.abs(self.angle) * (1.0 - power),)


class BrakeSlip(JointEffect):
    """The joint's spring in series with a brake that slips at a holding torque T.

    Beside the spring k q this is -s x, with x the angle by which the brake has slipped: x stays
    while |q - x| < a and follows beyond (the play operator). With s = k the whole spring sits on
    the brake, and T = k a.
    """

    name = "brake_slip"
    title = "Slipping brake"
    family = "elastoplastic law"
    equation = "-s x, x the slip: |q - x| <= a"
    looks_like = "the first large swings lose much and shift the rest; later ones ring on, cleanly"
    source = "elastoplastic (Jenkin) element: Iwan, J. Appl. Mech. 33, 1966"
    rough = True
    follows = True
    # One that slips at the release only has moved the rest, and no more.
    memory = (Memory("slip", ANGLE),)

    stiffness: Scalar = param(
        "stiffness that sits on the brake", STIFFNESS, sign="positive", as_spring=True
    )
    angle: Scalar = param(
        "deflection at which the brake slips",
        ANGLE,
        sign="positive",
        silent=None,
        default=0.1,
        grid=(0.5, 1.0, 1.7, 2.8),
    )

    def begin(self, motion, mechanism):
        q = motion.q[mechanism.joints.index(self.joint)]
        return (self._led(0.0, q),)

    def _led(self, slip, q):
        """The slip after the joint has gone to an angle."""
        return jnp.clip(slip, q - jnp.abs(self.angle), q + jnp.abs(self.angle))

    def _slip(self, motion):
        # First as far as the joint went before it turned round, then to where it is now.
        return self._led(self._led(motion.memory[0], motion.turn), motion.q)

    def joint_torque(self, motion):
        return -self.stiffness * self._slip(motion)

    def joint_follow(self, motion):
        return (self._slip(motion),)


class Relaxation(JointEffect):
    """A Maxwell element: a spring in series with a damper, which relaxes in the time tau.

    Beside the joint's own spring it makes the standard linear solid: stiffer when fast than when
    slow, and most damped at 1/tau. x is what the damper has given way.
    """

    name = "relaxation"
    title = "Relaxing spring"
    family = "viscoelastic law"
    equation = "s (q - x), tau x' = q - x"
    looks_like = "modes of different frequency are damped, and stiffened, as no one damper does"
    source = "Maxwell 1867; Zener, Elasticity and Anelasticity of Metals, 1948"
    of_frequency = True
    memory = (Memory("x", ANGLE),)

    stiffness: Scalar = param("stiffness that relaxes", STIFFNESS, sign="positive")
    time: Scalar = param(
        "time in which it relaxes",
        DURATION,
        sign="positive",
        silent=None,
        default=1.0,
        grid=(0.3, 1.0, 3.0, 10.0),
    )

    def begin(self, motion, mechanism):
        # Where a slow pull from rest to the first angle leaves it.
        return (motion.q[mechanism.joints.index(self.joint)],)

    def joint_torque(self, motion):
        return self.stiffness * (motion.q - motion.memory[0])

    def joint_rate(self, motion):
        return ((motion.q - motion.memory[0]) / jnp.abs(self.time),)
