"""What the page says of where a fit fails, and of the torque that it lacks."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..diagnosis import Comparison, Missing
from ..recordings.experiment import Experiment
from . import figures as plot
from .numbers import plain
from .picture import picture
from .words import at_place, lower


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
    """Of missing torques, each of a recording and a joint, those that are larger than what is not
    known of them: the clearest first, at most so many; and how many more there are."""
    seen = sorted(
        ((found, joint) for found, joint in pairs if found.significant(joint)),
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
        "words": torque_words(found, joint),
        "picture": picture(
            f"Missing torque at the {name} in {found.recording}",
            plot.missing_torque(found.torque, joint, **words),
            plot.missing_torque(found.torque, joint, **words, narrow=True),
        ),
    }


def torque_words(found: Missing, joint: int) -> str:
    """What to say beside the picture of a missing torque at one joint."""
    name, unit = found.joints[joint], found.units[joint]
    size = f"{plain(float(found.torque.rms[joint]))} {unit}"
    share = float(found.torque.share_of_spring[joint])
    words = f"{found.recording}, {name}: {size} rms is missing"
    words += f", {plain(100 * share, 2)} % of the spring's torque. " if share == share else ". "
    if not found.significant(joint):
        return words + "It is smaller than its own band: nothing is seen to be missing here."
    drawn = found.curves_at(joint)
    if not drawn:
        return words.strip()
    first, *others = drawn
    words += (
        f"Blue: {lower(at_place(first.effect, found.joints))}, "
        f"{plain(100 * first.share, 3)} % of its square. Against angle, rate and amplitude it is "
        "shown less the change of springs and dampers that goes with the blue line."
    )
    if others:
        other = lower(at_place(others[0].effect, found.joints))
        words += f" Next: {other}, {plain(100 * others[0].share, 3)} %."
    return words
