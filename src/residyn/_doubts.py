"""What is doubtful in the recordings of an experiment taken together, a line each."""

from typing import TYPE_CHECKING

import numpy as np

from ._stretches import wholes

if TYPE_CHECKING:
    from .recording import Experiment


def in_degrees(experiment: "Experiment") -> list[str]:
    """Doubts about the unit of angles: no braked joint turns by five radians."""
    doubts = []
    for recording, _ in wholes(experiment.recordings):
        sizes = np.nanquantile(np.abs(recording.angle), 0.99, axis=0)
        units = experiment.units or ("",) * len(sizes)
        large = [
            f"q{j + 1} reaches {size:.3g}"
            for j, (size, unit) in enumerate(zip(sizes, units, strict=True))
            if unit == "rad" and size > 5
        ]
        if abs(recording.theta2) > 2 * np.pi:
            large.append(f"theta2 = {recording.theta2:g}")
        doubts += [f"{recording.name}: {x}: in degrees? it must be in rad" for x in large]
    return doubts


def not_held_out(experiment: "Experiment") -> list[str]:
    """A check on readings that were fitted is none."""
    doubts = []
    for check, _ in wholes(experiment.check_recordings):
        for fit, _ in wholes(experiment.fit_recordings):
            _, i, j = np.intersect1d(check.time, fit.time, return_indices=True)
            same = np.array_equal(check.angle[i], fit.angle[j], equal_nan=True)
            if check.name == fit.name and len(i) and same:
                doubts.append(
                    f'{check.name}: {len(i)} of its samples have role = "check" and are fitted too'
                )
    return doubts
