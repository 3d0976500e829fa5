"""From markers at the joints to the joints' angles, and what had to be repaired on the way.

Markers are lost, jump, and exchange their labels. An arm's base stands still and its links are
rigid, so geometry says which marker is which, and which is none of the arm's. Every repair
is a sentence; what cannot be known stays missing (NaN), which a fit does not mind.
"""

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError, entries, inside, number, quote
from ..arrays import check_enough
from ..recording import Recording
from ..release import window
from ..rest import estimated_rest
from . import labels, plane, repair, rigid
from .trajectories import Trajectories, listed, read_trajectories

__all__ = ["MotionCapture", "read"]

_LOOSE = 0.01  # relative scatter or error of a link's length that is worth a word
_ELASTIC, _REFUSED = 0.1, 0.25  # scatter of a link's length, share of readings rejected: no arm's
_OTHER = 0.2  # relative error of a link's length with which it must be another link
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
        known = [f"q{j + 1}" for j in range(self.angle.shape[1])]  # in rad, as they are computed
        options = {"name": self.name, "stated": known, **options}
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
        found = Recording.from_arrays(self.time, self.angle - rest, **options)
        return dataclasses.replace(found, rest_estimated=True).saying([*said, *of_rest])


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
        names = _names_of(markers, trajectories, link_lengths)
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
        _check_believable(names, markers, assigned, chain)
        assigned = labels.assign(markers, chain)
    joints = assigned.apply(markers)
    noise = float(min(chain.sigmas)) / 2**0.5
    table = plane.fit(joints, noise) if normal is None else plane.frame_of(_direction(normal))
    warnings = _length_warnings(names, chain, lengths)
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


def _names_of(markers: Any, file: Trajectories, lengths: Sequence[float] | None) -> tuple[str, ...]:
    """The names of the markers from base to tip, if they are such."""
    example = '["Shoulder", "Elbow", "Wrist"]'
    right = f"from base to tip, as {example}; the file has {listed(file.names)}"
    if markers is None:
        raise InputError(f"markers is missing: name them {right}")
    markers = entries("markers", markers, f"a list of names, {right}")
    if not all(isinstance(name, str) for name in markers):
        raise InputError(f"markers = {quote(markers)}: must be names, {right}")
    if len(set(markers)) < len(markers):
        raise InputError(f"markers = {quote(markers)}: names must differ, {right}")
    joints = len(markers) - 1
    if joints < 1 or (lengths is not None and joints != len(lengths)):
        need = "at least 2" if lengths is None else f"{len(lengths) + 1}, one more than links"
        raise InputError(f"markers has {len(markers)} names: must have {need}, {right}")
    if joints > 7:
        raise InputError(f"markers has {len(markers)} names: chains of up to 7 links are read")
    return tuple(markers)


def _check_believable(
    names: tuple[str, ...], markers: np.ndarray, assigned: labels.Labels, chain: rigid.Rigid
) -> None:
    """Markers of which many fit no rigid arm are not an arm's."""
    seen = int((~np.isnan(markers[:, :, 0])).sum())
    wrong = int(assigned.rejected.sum())
    why = ""
    if wrong > _REFUSED * seen:
        why = f"{wrong} of {seen} readings fit none"
    loose = chain.sigmas / chain.lengths
    if not loose.max() < _ELASTIC:
        j = int(loose.argmax())
        why = f"from {quote(names[j])} to {quote(names[j + 1])} the distance changes"
    if why:
        raise InputError(
            f"markers {', '.join(map(quote, names))} are no chain of rigid links from a joint that "
            f"stands still: {why}; must be one marker at each joint's centre, from base to tip"
        )


def _direction(normal: Any) -> np.ndarray:
    """`normal`, (3,), if it is a direction."""
    values = entries("normal", normal, "three numbers, as [0, 0, 1]", 3)
    found = np.array([number("normal", value, "of any unit") for value in values])
    if not np.linalg.norm(found) > 0:
        raise InputError(f"normal = {quote(normal)}: must point somewhere, as [0, 0, 1]")
    return found


def _length_warnings(
    names: tuple[str, ...], chain: rigid.Rigid, known: Sequence[float] | None
) -> list[str]:
    """Links that are not rigid, or not as long as they should be.

    **Raises:** `InputError` where the difference is so large that it must be another link.
    """
    warnings = []
    for i, (length, sigma) in enumerate(zip(chain.lengths, chain.sigmas, strict=True)):
        link = f"link {i + 1}, {quote(names[i])} to {quote(names[i + 1])},"
        if sigma > _LOOSE * length:
            warnings.append(
                f"{link} changes its length of {length:.4g} m by {1e3 * sigma:.2g} mm (standard "
                "deviation): are the markers at the joints' centres?"
            )
        if known is None:
            continue
        off = length / known[i] - 1
        if abs(off) > _OTHER:
            raise InputError(
                f"{link} is {length:.4g} m long by its markers, but link_lengths has "
                f"{known[i]:g} m: is that another marker, or another unit?"
            )
        if abs(off) > _LOOSE:
            warnings.append(
                f"{link} is {length:.4g} m long by its markers, {100 * off:+.2g} % from the "
                f"{known[i]:g} m of link_lengths"
            )
    return warnings
