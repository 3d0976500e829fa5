"""The paper's rig on its air bearings and off them, with what the bearings do beside carrying.

Off the bearings the arm is lighter by Eq. 5, here written out from where each bearing rides, and
free of their drag and friction. Everything else (springs, joint dampers) is the same arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .arm import Arm, paper_twin
from .hidden import Hidden, HiddenCase, record

MASS, INERTIA = 1.9635, 0.00245437
"""Of each bearing, kg and kg m^2: the paper's Table 1."""


def off_bearings(arm: Arm, places: Sequence[str] = ("elbow", "wrist")) -> Arm:
    """The arm without a bearing of Table 1 at each of `places`."""
    shoulder, elbow, coupling = arm.shoulder, arm.elbow, arm.coupling
    for place in places:
        # Where it rides on link 2, and so how it swings with it; all of them turn with link 2.
        reach = {"elbow": 0.0, "wrist": arm.l2}[place]
        shoulder -= MASS * arm.l1**2
        elbow -= INERTIA + MASS * reach**2
        coupling -= MASS * reach
    return replace(arm, shoulder=shoulder, elbow=elbow, coupling=coupling)


@dataclass(frozen=True)
class Release:
    """One recording of the rig: its elbow angle, how it is let go, and whether on bearings."""

    theta2: float
    q0: tuple[float, float] = (0.25, -0.3)
    bearings: bool = True


def releases(
    wanted: Sequence[Release],
    *,
    rig: Arm | None = None,
    drag: float = 0.0,
    friction: float = 0.0,
    places: Sequence[str] = ("elbow", "wrist"),
    seed: int = 0,
    noise: float = 1e-3,
    seconds: float = 20.0,
) -> list[HiddenCase]:
    """Recordings at 100 Hz of the paper's rig (or another `rig`, its bearings on), whose every
    bearing has a `drag` (N s/m) and a `friction` (N)."""
    hidden = []
    if drag:
        hidden.append(Hidden("bearing_drag", {"coefficient": drag}))
    if friction:
        hidden.append(Hidden("bearing_friction", {"force": friction}))
    found = []
    for i, each in enumerate(wanted):
        arm = replace(rig or paper_twin(), theta2=each.theta2)
        found.append(
            record(
                np.random.default_rng([seed, i]),
                arm if each.bearings else off_bearings(arm, places),
                each.q0,
                hidden if each.bearings else [],
                noise=noise,
                seconds=seconds,
                bearings=places if each.bearings else (),
            )
        )
    return found
