"""Step 3 on MuJoCo twins of the paper's rig: recordings, experiments, and the truth in orbit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import residyn
from residyn.fitting import Mode
from residyn.recordings.experiment import Experiment
from residyn.recordings.recording import Recording
from residyn.recordings.tables import ArmTable, Bearing
from tests.rig import driven
from tests.rig.arm import Arm, paper_twin
from tests.rig.hidden import BEARINGS, HiddenCase
from tests.rig.unloaded import INERTIA, MASS, Release, off_bearings, releases

ON = tuple(Bearing(place, MASS, INERTIA) for place in BEARINGS)
DRAG, FRICTION = 0.3, 0.02
"""N s/m and N: of each bearing, where there is any."""
ANGLES = (0.3, 1.5)
"""Elbow angles at rest of the recordings with hidden drag, rad."""


def table_of(arm: Arm) -> ArmTable:
    """The `[arm]` as it is."""
    return ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)


def clean(seed: int, arm: Arm, table: ArmTable) -> Experiment:
    """One release on the bearings, to be fitted, and one off them; the elbow straight."""
    wanted = [Release(0.0), Release(0.0, (0.3, 0.1), bearings=False)]
    return Experiment(table, _recordings(wanted, releases(wanted, rig=arm, seed=seed)), ON)


def dragged(seed: int = 0) -> Experiment:
    """Two elbow angles on bearings with drag and friction, to be fitted, and both off them."""
    wanted = [Release(a) for a in ANGLES] + [Release(a, (0.2, 0.3), bearings=False) for a in ANGLES]
    cases = releases(wanted, drag=DRAG, friction=FRICTION, seed=seed)
    return Experiment(table_of(paper_twin()), _recordings(wanted, cases), ON)


def _recordings(wanted: Sequence[Release], cases: Sequence[HiddenCase]) -> tuple[Recording, ...]:
    return tuple(
        Recording.from_arrays(
            case.t,
            case.q,
            noise=case.noise,
            theta2=each.theta2,
            role="fit" if each.bearings else "check",
            name=f"{'on bearings' if each.bearings else 'bare'}, elbow at {each.theta2:g} rad",
            air_bearings=each.bearings,
        )
        for each, case in zip(wanted, cases, strict=True)
    )


def fitted_only(experiment: Experiment) -> Experiment:
    """The experiment without what is held out."""
    return replace(experiment, recordings=experiment.fit_recordings)


def rig() -> Arm:
    """The paper's simulated rig: Table 2's inertias, stiffness of Eq. 24, damping 0.1 N m s/rad."""
    return replace(driven.table_2_arm(), stiffness=(50 / 3, 50 / 3), damping=(0.1, 0.1))


def errors_in_orbit(mode: Mode, arm: Arm) -> tuple[float, float]:
    """Of the lowest mode's frequency and decay rate, as shares; `arm` has its bearings on."""
    frequency, damping = (float(x[0]) for x in off_bearings(arm).modes())
    rate = 2 * math.pi * mode.frequency_hz * mode.damping_ratio
    return mode.frequency_hz / frequency - 1, rate / (2 * math.pi * frequency * damping) - 1


def values(found: residyn.Unloading) -> dict[str, float]:
    """The fitted numbers by name."""
    return {n.name: n.value for n in found.fit.numbers}
