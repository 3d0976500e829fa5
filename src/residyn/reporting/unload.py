"""Step 3 as one page: how the arm rings on its bearings and without them, then the fit."""

import os
from typing import Any

import numpy as np

from ..fitting import Mode
from ..procedure import Unloading
from ..procedure.carried import NAMES, inertias
from ..procedure.decay import decay_of, decay_words
from ..procedure.ringdown import RingDown
from ..procedure.unloaded_words import check_lines, exact_words
from . import figures as plot
from .fit import chapter
from .numbers import amount, plain, with_error
from .picture import picture
from .template import filled, written
from .words import unbroken


def write_unload(path: str | os.PathLike[str], found: Unloading, title: str) -> None:
    """Write step 3 as one self-contained page.

    **Raises:** `InputError` if the file cannot be written.
    """
    written(path, render_unload(found, title))


def render_unload(found: Unloading, title: str) -> str:
    """The page as text."""
    sides = found.ring_downs()
    return filled(
        "unload.html.j2",
        title=title,
        found=found,
        verdict=unbroken(_verdict(found)),
        ring_down=picture(
            "Angles after the same release, on the bearings and without them, against time",
            plot.ring_down(found, sides),
            plot.ring_down(found, sides, narrow=True),
        ),
        band=unbroken(_band(found, sides)),
        poses=[{"theta2": plain(p.theta2, 4), "rows": _rows(p)} for p in found.poses],
        exact=exact_words(found),
        inertias=_inertias(found),
        bearings=found.fit.experiment.bearings,
        checks=[" ".join(" ".join(check_lines(c, found)).split()) for c in found.check],
        c=chapter(f"The fit behind it: {title}", found.fit),
        number=1,
        chapters=[{"failing": None}],
        comparison=True,
        diagnosis=None,
    )


def _verdict(found: Unloading) -> str:
    """The lowest mode without bearings, or what is not physical."""
    if not found.physical:
        return f"{found.unphysical[0][0].upper()}{found.unphysical[0][1:]}."
    if not found.without_bearings:
        return "Without its bearings the arm does not ring."
    on = found.with_bearings[0] if found.with_bearings else None
    mode = found.without_bearings[0]
    before = "" if on is None else f" (on them: {_frequency(on)}, {_after(on)})"
    return (
        f"Without its bearings the arm rings at {_frequency(mode)}, and its lowest mode falls to "
        f"1/e {decay_words(mode)}{before}."
    )


def _frequency(mode: Mode) -> str:
    value, std = with_error(mode.frequency_hz, mode.frequency_hz_std)
    return f"{value} +/- {std} Hz"


def _after(mode: Mode) -> str:
    found = decay_of(mode)
    return "growing" if found is None else f"{plain(found.value, 3)} s"


def _band(found: Unloading, sides: tuple[RingDown, RingDown]) -> str:
    """How wide the bands are."""
    words = []
    for side, where in zip(sides, ("on the bearings", "without them"), strict=True):
        if side.low is None or side.high is None:
            words.append(f"{where} there is none, as the recordings leave a number open")
            continue
        width = float(np.max(side.high - side.low))
        units = found.fit.experiment.units
        unit = units[0] if units else None
        size = amount(width, unit, 2) if np.isfinite(width) else "without bound"
        words.append(f"{where} it is at most {size} wide")
    lacks = ", and this one does lack something" if found.fit.misses else ""
    return (
        f"The band holds the motion with 95 % if the model lacks nothing{lacks}: "
        f"{', '.join(words)}. "
        "It is not drawn where it is thinner than the line."
    )


def _rows(pose: Any) -> list[dict[str, str]]:
    rows = []
    sides = pose.with_bearings, pose.without_bearings
    for i in range(max(map(len, sides))):
        on, off = (side[i] if i < len(side) else None for side in sides)
        for words, told in (
            ("frequency", _frequency),
            ("damping ratio", _damping),
            ("falls to 1/e", decay_words),
        ):
            both = ("does not ring" if m is None else unbroken(told(m)) for m in (on, off))
            on_words, off_words = both
            rows.append({"mode": f"{i + 1}", "words": words, "on": on_words, "off": off_words})
    for leaves, key in ((pose.leaves_with, "on"), (pose.leaves_without, "off")):
        if leaves:
            row = {"mode": "", "words": "from its rest", "on": "", "off": ""}
            rows.append({**row, key: "moves away: not physical"})
    return rows


def _damping(mode: Mode) -> str:
    value, std = with_error(100 * mode.damping_ratio, 100 * mode.damping_ratio_std)
    return f"{value} +/- {std} %"


def _inertias(found: Unloading) -> list[tuple[str, str, str, str]]:
    was, now = (np.asarray(inertias(m.mechanism)) for m in (found.model, found.unloaded))
    return [
        (name, unit, plain(float(a), 5), plain(float(b), 5))
        for name, unit, a, b in zip(NAMES, ("kg m²", "kg m²", "kg m"), was, now, strict=True)
    ]
