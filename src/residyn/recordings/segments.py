"""One long recording as many short ones.

What drives a joint that nothing pulls back is integrated twice: an error of a newton becomes metres
in a minute, however right the rest is. Begun afresh every so often, the same recording tells forces
from forces.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .recording import Recording


def segments_of(recording: Recording, seconds: float) -> "tuple[Recording, ...]":
    """The recording cut into segments of about so many seconds, none shorter than half of that.

    Each has more than the two instants that its initial state takes: over a gap in time there is
    no cut.
    """
    count = max(1, round(recording.duration / seconds))
    edges = np.linspace(recording.time[0], recording.time[-1], count + 1)
    cuts = [0]
    for cut in np.searchsorted(recording.time, edges[1:-1]):
        if min(cut - cuts[-1], len(recording.time) - cut) > 2:
            cuts.append(int(cut))
    found = []
    for begin, end in zip(cuts, [*cuts[1:], len(recording.time)], strict=True):
        part = slice(begin, end)
        time = recording.time[part]
        found.append(
            dataclasses.replace(
                recording,
                name=f"{recording.name}, {time[0]:.4g} to {time[-1]:.4g} s",
                time=time,
                angle=recording.angle[part],
                drive=None if recording.drive is None else recording.drive[part],
                warnings=() if found else recording.warnings,
                segment_of=recording,
            )
        )
    return tuple(found)


def by_recording(recordings: "Sequence[Recording]") -> "list[tuple[Recording, list[int]]]":
    """Each recording as it was read, and which of the given ones are its segments."""
    found: dict[int, tuple[Recording, list[int]]] = {}
    for i, r in enumerate(recordings):
        whole = r.segment_of or r
        found.setdefault(id(whole), (whole, []))[1].append(i)
    return list(found.values())
