"""Errors of the sensor: they change the reading and leave the motion alone."""

from ..physics.effect import JointEffect
from ..physics.motion import Scalar
from ..physics.parameter import ANGLE, DURATION, RATIO, Dimension, param

CURVE = Dimension("1/rad", "1/m", lambda s: 1.0 / s.swing)


class _SensorEffect(JointEffect):
    """Acts on one joint's reading."""

    senses = True

    def joint_torque(self, motion):
        return 0.0

    def joint_reading(self, angle):
        """The reading, given the angle: arrays of any one shape."""
        return angle

    def reading(self, angles, mechanism):
        own = mechanism.joints.index(self.joint)
        return tuple(self.joint_reading(q) if i == own else q for i, q in enumerate(angles))


class SensorOffset(_SensorEffect):
    """The sensor's zero is not the spring's."""

    name = "sensor_offset"
    of_angles = True
    title = "Sensor offset"
    family = "offset"
    equation = "reading = q + o"
    looks_like = "rings about a shifted zero; nothing else changes"
    source = "encoder zeroing error"

    offset: Scalar = param("reading at the true zero", ANGLE)

    def joint_reading(self, angle):
        return angle + self.offset


class SensorScale(_SensorEffect):
    """The sensor reads a share too much."""

    name = "sensor_scale"
    title = "Sensor scale"
    equation = "reading = (1 + e) q"
    looks_like = "one joint's amplitude off against the other's, the same share in every mode"
    source = "gain or gear-ratio error"

    error: Scalar = param("error of the scale, as a share", RATIO)

    def joint_reading(self, angle):
        return angle * (1.0 + self.error)


class SensorCurve(_SensorEffect):
    """The sensor's scale changes along its range."""

    name = "sensor_curve"
    of_angles = True
    title = "Curved sensor"
    equation = "reading = q + b q^2"
    looks_like = "swings wider to one side, at twice the share for twice the swing; a shifted mean"
    source = "nonlinearity of potentiometers and cameras, the first term of its Taylor series"

    curve: Scalar = param("curvature of the reading", CURVE)

    def joint_reading(self, angle):
        return angle + self.curve * angle**2


class SensorDelay(_SensorEffect):
    """The reading is late."""

    name = "sensor_delay"
    title = "Sensor delay"
    equation = "reading(t) = q(t - d)"
    looks_like = "one joint behind the other, by more of a cycle the faster the mode"
    source = "filters and buses: a pure delay to first order"

    delay: Scalar = param("delay of the reading", DURATION, sign="positive")

    def delays(self, mechanism):
        return tuple(self.delay if j == self.joint else 0.0 for j in mechanism.joints)
