"""What the page says of where a fit fails, and of the torque that it lacks."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import plot
from ..diagnosis import Comparison, Missing
from ..recording import Experiment
from ._picture import picture


def failing(compared: Comparison, drawn: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """All that the template says of where a fit fails; `drawn` are its missing torques."""
    ahead = compared.horizon
    return {
        "explained": compared.explained,
        "words": compared.words,
        "where": picture(
            "Bars: the residual in times the noise, by time, by amplitude and by frequency",
            plot.where(compared),
            plot.where(compared, narrow=True),
        ),
        "horizon": None
        if ahead is None
        else picture(
            "The prediction's error in times the noise against time ahead",
            plot.horizon(compared),
            plot.horizon(compared, narrow=True),
        ),
        "torques": drawn,
    }


def torques(experiment: Experiment, missing: Sequence[Missing]) -> list[dict[str, Any]]:
    """The missing torque of each recording and joint."""
    return [
        torque(experiment, found, joint)
        for found in missing
        for joint in range(len(experiment.joints))
    ]


def clearest(
    experiment: Experiment, pairs: Sequence[tuple[Missing, int]], most: int
) -> tuple[list[dict[str, Any]], int]:
    """Of missing torques, each of a recording and a joint, those that stand out of their bands:
    the clearest first, at most so many; and how many more there are."""
    seen = sorted(
        ((found, joint) for found, joint in pairs if found.stands_out(joint)),
        key=lambda pair: -_clarity(*pair),
    )
    return [torque(experiment, *pair) for pair in seen[:most]], max(0, len(seen) - most)


def _clarity(found: Missing, joint: int) -> float:
    """The torque in times what is not known of it."""
    torque, std = found.torque.torque[:, joint], found.torque.std[:, joint]
    return float(np.sqrt(np.mean(torque**2) / np.mean(std**2)))


def torque(experiment: Experiment, found: Missing, joint: int) -> dict[str, Any]:
    """The missing torque of one recording at one joint: a picture and its words."""
    name, unit = experiment.joints[joint], experiment.units
    words = {
        "name": name,
        "unit": unit[joint] if unit else None,
        "curves": found.curves_at(joint),
        "link_angle": None if found.link_angle is None else found.link_angle[:, joint],
    }
    return {
        "words": found.words(joint),
        "picture": picture(
            f"Missing torque at the {name} in {found.recording}",
            plot.missing_torque(found.torque, joint, **words),
            plot.missing_torque(found.torque, joint, **words, narrow=True),
        ),
    }
