"""The missing torque of a fitted model: of each recording, with the curves that belong over it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .._stretches import wholes
from .._units import plain
from ..effects import AbstractEffect
from ..fitting.problem import posed
from ..fitting.result import Fit
from ..fitting.setup import mechanism_of
from .curves import Curve, curves
from .missing_torque import MissingTorque, missing_torque

_WORTH = 0.1  # share of what is missing from which a curve is worth drawing
_CLEAR = 1.0  # times its own standard deviation, from which a missing torque is one


class Missing(NamedTuple):
    """What is missing in one recording."""

    recording: str
    units: tuple[str, ...]
    """Of the torque, per joint."""
    joints: tuple[str, ...]
    torque: MissingTorque
    link_angle: np.ndarray | None
    """(N, n) absolute angles of the links, rad; None where the joints do not tell them."""
    curves: tuple[Curve, ...]
    """What effects would draw, the one that explains most first."""

    def stands_out(self, joint: int) -> bool:
        """Whether the torque at a joint is larger than what is not known of it."""
        size = np.sqrt(np.mean(self.torque.torque[:, joint] ** 2))
        return bool(size > _CLEAR * np.sqrt(np.mean(self.torque.std[:, joint] ** 2)))

    def curves_at(self, joint: int) -> tuple[Curve, ...]:
        """The curves worth drawing at a joint."""
        if not self.stands_out(joint):
            return ()
        return tuple(c for c in self.curves if c.share > _WORTH and np.any(c.torque[:, joint]))[:2]

    def words(self, joint: int) -> str:
        """What to say beside the picture of a joint."""
        name, unit = self.joints[joint], self.units[joint]
        size = f"{plain(float(self.torque.rms[joint]))} {unit}"
        share = float(self.torque.share_of_spring[joint])
        words = f"{self.recording}, {name}: {size} rms is missing"
        words += f", {plain(100 * share, 2)} % of the spring's torque. " if share == share else ". "
        if not self.stands_out(joint):
            return words + "It does not stand out of its band: nothing is seen to be missing here."
        drawn = self.curves_at(joint)
        if not drawn:
            return words + "No effect of the catalogue draws it."
        words += (
            f"Blue: what {drawn[0].effect} would draw, {plain(100 * drawn[0].share, 3)} % of it. "
            "Against angle, rate and amplitude it is shown less the change of springs and dampers "
            "that goes with the blue line. "
        )
        if len(drawn) > 1:
            share = plain(100 * drawn[1].share, 3)
            words += f"Next best: {drawn[1].effect}, {share} %. "
        return words + "A curve that fits is a hint, not a verdict."


def missing_of(fit: Fit, effects: Sequence[AbstractEffect] | None = None) -> tuple[Missing, ...]:
    """The missing torque of every fitted recording of a fit, with the curves of some effects; None:
    of the whole catalogue."""
    found = []
    for beside in fit.whole:
        if beside.recording.role == "check":
            continue
        model = posed(fit.model, mechanism_of(fit.experiment, beside.recording))
        torque = missing_torque(model, beside.recording, wild=beside.wild, state=beside.state)
        try:
            links = np.stack(model.mechanism.link_angles(tuple(torque.angle.T)), axis=1)
        except ValueError:
            links = None
        kinds = fit.experiment.units or ("rad",) * len(fit.joints)
        units = tuple("N" if kind == "m" else "N m" for kind in kinds)
        bare = Missing(beside.recording.name, units, fit.joints, torque, links, ())
        if any(bare.stands_out(joint) for joint in range(len(fit.joints))):
            bare = bare._replace(curves=tuple(curves(model, torque, effects)))
        found.append(bare)
    return tuple(found)


def along_each(fit: Fit, found: Sequence[Missing]) -> list[MissingTorque]:
    """The missing torque along each fitted recording, stretches by themselves."""
    fitted = [r.recording for r in fit.recordings if r.recording.role != "check"]
    parts: list[MissingTorque | None] = [None] * len(fitted)
    for (_, which), missing in zip(wholes(fitted), found, strict=True):
        first = 0
        for i in which:
            last = first + len(fitted[i].time)
            parts[i] = missing.torque.between(first, last)
            first = last
    return [p for p in parts if p is not None]


def with_curves(
    fit: Fit, found: Sequence[Missing], effects: Sequence[AbstractEffect]
) -> tuple[Missing, ...]:
    """The same, with the curves of these effects instead."""
    fitted = [r.recording for r in fit.whole if r.recording.role != "check"]
    return tuple(
        m._replace(
            curves=tuple(
                curves(posed(fit.model, mechanism_of(fit.experiment, recording)), m.torque, effects)
            )
        )
        for m, recording in zip(found, fitted, strict=True)
    )


def summary(found: tuple[Missing, ...]) -> dict[str, Any] | None:
    """Per joint the rms over all recordings, N m or N, and its share of the spring torque's."""
    if not found:
        return None
    joints = {}
    for j, joint in enumerate(found[0].joints):
        rms = float(np.sqrt(np.mean([m.torque.rms[j] ** 2 for m in found])))
        share = float(np.sqrt(np.mean([m.torque.share_of_spring[j] ** 2 for m in found])))
        joints[joint] = {"rms": rms, "share_of_spring": share, "unit": found[0].units[j]}
    return joints
