"""Loss in proportion to the rate: the damper of Eq. 4."""

from ..motion import Scalar
from ..parameter import DAMPING, param
from .base import JointEffect


class Damper(JointEffect):
    """Equivalent viscous damping of a braked joint, Eq. 4."""

    name = "damper"
    equation = "c q'"
    looks_like = "amplitude falls by the same share every cycle"
    source = "paper, Eq. 4"
    dissipates = True

    damping: Scalar = param("joint damping", DAMPING, sign="positive")

    def joint_torque(self, motion):
        return self.damping * motion.v
