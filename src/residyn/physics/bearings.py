"""Air bearings: putting them on and taking them off (Eq. 5).

A bearing carries the arm's weight and adds its own mass where it rides. In orbit it is not there,
so the last of the paper's steps subtracts exactly what was added.
"""

from collections.abc import Iterable
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .mechanism import PlanarArm
from .parameter import floating


class AirBearing(eqx.Module):
    """One bearing: `mass` in kg, `inertia` about its own centre in kg m^2.

    `joint` is the point it carries: "elbow" (it rides on the elbow joint) or "wrist" (the end of
    link 2). Both turn with link 2, as Eq. 5 has it.
    """

    joint: Literal["elbow", "wrist"] = eqx.field(static=True)
    mass: Float[Array, ""] = eqx.field(converter=floating)
    inertia: Float[Array, ""] = eqx.field(converter=floating)

    def __check_init__(self):
        if self.joint not in ("elbow", "wrist"):
            raise ValueError(f'joint = "{self.joint}": an air bearing rides on "elbow" or "wrist"')


def with_bearings(arm: PlanarArm, bearings: Iterable[AirBearing]) -> PlanarArm:
    """The arm with the bearings put on (Eq. 5)."""
    return _carry(arm, bearings, +1.0)


def without_bearings(arm: PlanarArm, bearings: Iterable[AirBearing]) -> PlanarArm:
    """The arm with the bearings taken off (Eq. 5, 18-20)."""
    return _carry(arm, bearings, -1.0)


def _carry(arm: PlanarArm, bearings: Iterable[AirBearing], sign: float) -> PlanarArm:
    l1, l2 = arm.link_lengths[0], arm.link_lengths[1]
    shoulder, elbow, coupling = arm.shoulder, arm.elbow, arm.coupling
    count = arm.bearings
    for bearing in bearings:
        # Distance of the bearing from the elbow, along link 2.
        reach = l2 if bearing.joint == "wrist" else 0.0 * l2
        shoulder = shoulder + sign * bearing.mass * l1**2
        elbow = elbow + sign * (bearing.inertia + bearing.mass * reach**2)
        coupling = coupling + sign * bearing.mass * reach
        count = count + sign * np.eye(2)[0 if bearing.joint == "elbow" else 1]
    return eqx.tree_at(
        lambda a: (a.shoulder, a.elbow, a.coupling, a.bearings),
        arm,
        (shoulder, elbow, coupling, count),
    )
