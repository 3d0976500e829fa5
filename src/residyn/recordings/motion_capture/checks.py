"""Whether markers, and what is asked of them, can be an arm's.

What cannot be is refused with a line that says what would be right; what is merely odd is a
warning, one sentence each.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import InputError, entries, number, quote
from .labels import Labels
from .rigid import Rigid
from .trajectories import Trajectories, listed

_LOOSE = 0.01  # relative scatter or error of a link's length that is worth a word
_ELASTIC, _REFUSED = 0.1, 0.25  # scatter of a link's length, share of readings rejected: no arm's
_OTHER = 0.2  # relative error of a link's length with which it must be another link


def names_of(markers: Any, file: Trajectories, lengths: Sequence[float] | None) -> tuple[str, ...]:
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


def check_believable(
    names: tuple[str, ...], markers: np.ndarray, labels: Labels, rigid: Rigid
) -> None:
    """Markers of which many fit no rigid arm are not an arm's."""
    seen = int((~np.isnan(markers[:, :, 0])).sum())
    wrong = int(labels.rejected.sum())
    why = ""
    if wrong > _REFUSED * seen:
        why = f"{wrong} of {seen} readings fit none"
    loose = rigid.sigmas / rigid.lengths
    if not loose.max() < _ELASTIC:
        j = int(loose.argmax())
        why = f"from {quote(names[j])} to {quote(names[j + 1])} the distance changes"
    if why:
        raise InputError(
            f"markers {', '.join(map(quote, names))} are no chain of rigid links from a joint that "
            f"stands still: {why}; must be one marker at each joint's centre, from base to tip"
        )


def direction(normal: Any) -> np.ndarray:
    """`normal`, (3,), if it is a direction."""
    values = entries("normal", normal, "three numbers, as [0, 0, 1]", 3)
    found = np.array([number("normal", value, "of any unit") for value in values])
    if not np.linalg.norm(found) > 0:
        raise InputError(f"normal = {quote(normal)}: must point somewhere, as [0, 0, 1]")
    return found


def length_warnings(
    names: tuple[str, ...], rigid: Rigid, known: Sequence[float] | None
) -> list[str]:
    """Links that are not rigid, or not as long as they should be.

    **Raises:** `InputError` where the difference is so large that it must be another link.
    """
    warnings = []
    for i, (length, sigma) in enumerate(zip(rigid.lengths, rigid.sigmas, strict=True)):
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
