"""From markers at the joints to the joints' angles, and what had to be repaired on the way.

Markers are lost, jump, and exchange their labels. An arm's base stands still and its links are
rigid, so geometry says which marker is which, and which is none of the arm's. Every repair
is a sentence; what cannot be known stays missing (NaN), which a fit does not mind.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError, inside, number, quote
from ..arrays import check_enough
from ..recording import Recording
from ..release import window
from ..rest import estimated_rest
from . import checks, labels, plane, repair, rigid
from .trajectories import Trajectories, read_trajectories

__all__ = ["MotionCapture", "read"]

_TILT = 2e-3  # error of the plane's direction, rad, that is worth a word
_WANDERS = 3e-3  # scatter of the base, of the first link's length, that is no noise: it moves


@dataclass(frozen=True, eq=False)
class MotionCapture:
    """A chain's joint angles from its markers. Make it with `read`."""

    name: str
    """The file's name."""
    markers: tuple[str, ...]
    """From base to tip."""
    time: np.ndarray
    """(N,) s from the file's first frame."""
    angle: np.ndarray
    """(N, n) rad: of link 1 to the table's axis, of each further link to the one before it. NaN
    where it cannot be known."""
    link_lengths: np.ndarray
    """(n,) m, as the markers have them."""
    normal: np.ndarray
    """(3,) unit vector off the table, in the lab's axes; angles grow anticlockwise about it."""
    repairs: tuple[str, ...]
    """What was lost, put back, exchanged or rejected, a sentence each; empty for a clean file."""
    warnings: tuple[str, ...]
    """What does not look like an arm with markers at its joints, a sentence each."""

    def rest(self, start: float | str | None = None, stop: float | None = None) -> np.ndarray:
        """(n,) rad: the angles about which the arm rings, from `start` to `stop`."""
        return self._rest(start, stop)[0]

    def _rest(self, start: float | str | None, stop: float | None) -> tuple[np.ndarray, list[str]]:
        with inside(self.name):
            part = window(self.time, self.angle, start, stop)
            check_enough(self.angle[part], part=start is not None or stop is not None)
            return estimated_rest(self.time[part], self.angle[part])

    def recording(self, **options: Any) -> Recording:
        """The recording, in a model's own coordinates: angles from rest.

        `theta2` is the elbow's angle at rest. If given, the elbow's angle is counted from it; if
        not, from the rest that the ringing itself shows.

        **Arguments:** those of `Recording.from_arrays`, without `time` and `angle`.
        """
        options = {"name": self.name, **options}
        rest, of_rest = self._rest(options.get("start"), options.get("stop"))
        said = [*self.repairs, *self.warnings]
        if self.angle.shape[1] == 2:
            if "theta2" in options:
                theta2 = number("theta2", options["theta2"], "rad")
                if abs(theta2 - rest[1]) > 0.01:
                    said.append(
                        f"theta2 = {theta2:g} rad is given, but by its markers the elbow rests at "
                        f"{rest[1]:.4f} rad; leave theta2 out to take that"
                    )
                rest = np.array([rest[0], theta2])
            else:
                options["theta2"] = float(rest[1])
        turned = ", ".join(f"q{j + 1} from {angle:.4f} rad" for j, angle in enumerate(rest))
        said.append(f"angles are counted from rest, {turned} of its markers")
        return Recording.from_arrays(self.time, self.angle - rest, **options).saying(
            [*said, *of_rest]
        )


def read(
    path: str | os.PathLike[str],
    markers: Sequence[str] | None = None,
    *,
    normal: Sequence[float] | None = None,
    link_lengths: Sequence[float] | None = None,
) -> MotionCapture:
    """Joint angles from a Vicon CSV file or a C3D file of markers at the joints' centres.

    **Arguments:**

    - `markers`: names from base to tip: n + 1 for n joints. They may leave the subject out.
    - `normal`: direction off the table in the lab's axes; if not given, it is fitted.
    - `link_lengths`: m, if known: checked, and used where motion alone cannot tell links apart.

    **Raises:** `InputError`.
    """
    trajectories = read_trajectories(path)
    where = os.fspath(path)
    with inside(where):
        if link_lengths is not None:
            link_lengths = [number("link_lengths", x, "m", above=0) for x in link_lengths]
        names = checks.names_of(markers, trajectories, link_lengths)
        return _solve(where, names, trajectories, normal, link_lengths)


def _solve(
    where: str,
    names: tuple[str, ...],
    file: Trajectories,
    normal: Sequence[float] | None,
    lengths: Sequence[float] | None,
) -> MotionCapture:
    markers = file.of(names)
    if len(markers) < 20:
        raise InputError(f"has {len(markers)} frames; at least 20 are needed")
    for name, column in zip(names, markers.swapaxes(0, 1), strict=True):
        if np.isnan(column).all():
            raise InputError(f"marker {quote(name)} is lost in every frame")
    chain = rigid.find(markers, lengths)
    assigned = labels.assign(markers, chain)
    for _ in range(2):
        chain = rigid.refine(assigned.apply(markers), chain)
        checks.check_believable(names, markers, assigned, chain)
        assigned = labels.assign(markers, chain)
    joints = assigned.apply(markers)
    noise = float(min(chain.sigmas)) / 2**0.5
    given = None if normal is None else checks.direction(normal)
    table = plane.fit(joints, noise) if given is None else plane.frame_of(given)
    warnings = checks.length_warnings(names, chain, lengths)
    warnings += [
        f"{quote(names[j])} changes its label with another marker, and the arm moves too little to "
        "tell which it is: what most frames have was believed"
        + ("" if lengths is not None else "; link_lengths would tell")
        for j in chain.unsure
    ]
    if table.tilt > _TILT:
        warnings.append(
            f"the markers hardly leave one line, so the table's plane is known to "
            f"{np.degrees(table.tilt):.2g} degrees only: give normal, the direction off the table"
        )
    high = table.height(joints)
    off = np.abs(high - np.nanmedian(high, axis=0))
    odd = off > np.maximum(8 * 1.4826 * np.nanmedian(off, axis=0), 0.01 * chain.lengths.mean())
    joints[odd] = np.nan
    rejected = assigned.rejected | odd

    flat = table.flat(joints)
    lost = np.isnan(flat[:, :, 0])
    still = chain.base_sigma <= max(_WANDERS * chain.lengths[0], 4 * noise)
    if still:
        flat[:, 0] = np.nanmedian(flat[:, 0], axis=0)
    else:
        warnings.append(
            f"{quote(names[0])} moves by {1e3 * chain.base_sigma:.2g} mm (standard deviation): the "
            "base of the arm should stand still"
        )
    back = repair.put_back(flat, noise)
    angle = plane.angles(flat)
    repairs = repair.sentences(
        names, file.time, file.frame, assigned.order, lost, rejected, back, still
    )
    for array in (angle, chain.lengths, table.normal):
        array.flags.writeable = False
    return MotionCapture(
        name=where,
        markers=names,
        time=file.time,
        angle=angle,
        link_lengths=chain.lengths,
        normal=table.normal,
        repairs=tuple(repairs),
        warnings=tuple(warnings),
    )
