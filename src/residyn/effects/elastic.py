"""Joint flexibility: the spring of Eq. 4."""

from ..motion import Scalar
from ..parameter import STIFFNESS, param
from .base import JointEffect


class Spring(JointEffect):
    """Equivalent stiffness of a braked joint, Eq. 4 (Eq. 24: gearbox and brake in series)."""

    name = "spring"
    equation = "k q"
    looks_like = "the ringing itself: sets the frequencies"
    source = "paper, Eq. 4 and 24"

    stiffness: Scalar = param("joint stiffness", STIFFNESS, sign="positive")

    def joint_torque(self, motion):
        return self.stiffness * motion.q
