"""What step 3 cannot know: drag of the bearings that looks like damping of the joints.

Viscous drag of a bearing on the elbow is exactly a damper at the shoulder. That of one on the wrist
is a damping matrix with off-diagonal terms, which turns with the elbow angle and leaves with the
bearing: recordings at other elbow angles, or without the bearings, tell it from the joints'.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from ..fitting.result import STRONG
from ..reporting.numbers import plain

if TYPE_CHECKING:
    from .unloaded import Unloading

_POOR = 0.05
"""Relative error of a predicted damping ratio beyond which it is said to be poor."""
_SAME = 0.02
"""Elbow angles whose cosines are closer than this are one."""


def doubts_about(found: "Unloading") -> tuple[str, ...]:
    """What a careful person would want to be told about step 3, one line each."""
    return (*_unnamed(found), *_not_told_apart(found), *_checks(found))


def against_growth(found: "Unloading") -> str:
    """What to do about a mode that no arm has."""
    if found.fit.misses:
        size = plain(found.fit.reduced_chi2, 2)
        return (
            f"the fit misses something (chi-square {size} per degree of freedom): name the effect "
            "that it lacks (--with), or let residyn diagnose look for it"
        )
    if found.left_out:
        return what_would_tell(found)
    return "check the inertias, the bearings' masses, and the order and signs of the angles"


def what_would_tell(found: "Unloading") -> str:
    """Which recordings would tell the bearings' drag from the joints' damping."""
    fitted, bearings = found.fit.experiment.fit_recordings, found.fit.experiment.bearings
    bare = not all(r.air_bearings for r in fitted)
    wrist = any(b.joint == "wrist" for b in bearings)
    one_angle = np.ptp([np.cos(r.theta2) for r in fitted if r.air_bearings]) < _SAME
    ways = [] if bare else ["without bearings (air_bearings = false)"]
    if wrist and one_angle:
        ways.append("at another elbow angle (theta2)")
    if not ways:
        return "record for longer, or with less noise"
    advice = f"to tell them apart, record the arm {' or '.join(ways)} too, and fit both"
    if wrist:
        return advice
    return (
        f"{advice} (another elbow angle would not do: drag of a bearing on the elbow is exactly a "
        "damper at the shoulder)"
    )


def _unnamed(found: "Unloading") -> Iterable[str]:
    """No effect of the bearings in the model."""
    fitted = found.fit.experiment.fit_recordings
    if found.left_out:
        return
    if all(r.air_bearings for r in fitted):
        yield (
            "only the bearings' inertia was taken off: drag and friction of theirs, if they have "
            "any, were fitted as damping of the joints and stay, so that the decay without "
            "bearings is predicted too fast; name them (--with bearing_drag, --with "
            "bearing_friction), or let residyn diagnose look for them"
        )
    else:
        yield (
            "the model has no drag or friction of the bearings, so joints are damped alike with "
            "and without them; name them (--with bearing_drag) if that leaves too much"
        )


def _not_told_apart(found: "Unloading") -> Iterable[str]:
    fit, remedy = found.fit, what_would_tell(found)
    own = [i for i, n in enumerate(fit.numbers) if n.name.partition(".")[0] in found.left_out]
    for i in own:
        number = fit.numbers[i]
        if not number.determined:
            yield (
                f"these recordings cannot tell {number.name} from damping of the joints, so the "
                f"decay without bearings is not known; {remedy}"
            )
            continue
        strong = [
            (fit.numbers[j].name, float(r))
            for j, r in enumerate(fit.correlation[i])
            if j not in own and abs(r) > STRONG
        ]
        if strong and number.std > _POOR * abs(number.value):
            names = ", ".join(f"{name} ({r:+.2f})" for name, r in strong)
            yield (
                f"{number.name} is known to {plain(number.percent, 2)} % only, as it is hardly told"
                f" from {names}; {remedy}"
            )
    for pose in found.poses:
        for order, mode in enumerate(pose.without_bearings, 1):
            poor = mode.damping_ratio_std > _POOR * abs(mode.damping_ratio)
            known = np.isfinite(mode.damping_ratio_std) and mode.damping_ratio > 0
            if found.left_out and known and poor:
                size = 100 * mode.damping_ratio_std / abs(mode.damping_ratio)
                yield (
                    f"damping of mode {order} without bearings (theta2 = {pose.theta2:.4g} rad) is "
                    f"known to {plain(size, 2)} % only; {remedy}"
                )
                return


def _checks(found: "Unloading") -> Iterable[str]:
    for check in found.check:
        if check.free is None:
            yield f"{check.name}: no fit of it alone was found, so there is nothing to compare with"
