"""Step 3 over all models in play, in lines of 80 columns."""

import math
from typing import TYPE_CHECKING

from .diagnosis_text import wrapped
from .numbers import plain, with_error
from .plan import motion_words, named, setting_words
from .words import percent

if TYPE_CHECKING:
    from ..procedure.over_models import OverModels, Spread

_NAMES = {"frequency_hz": ("frequency", "Hz"), "damping_ratio": ("damping ratio", "")}


def over_lines(found: "OverModels", joints: tuple[str, ...]) -> list[str]:
    """Models, modes without bearings with their bands, and the test that would narrow them."""
    out = ["[[In orbit, over all models]]"]
    for m in found.models:
        name = named(m.added, joints)
        words = name if len(name) <= 68 else f"{name[:65]}..."
        out.append(f"    {percent(m.probability):>6}  {words}")
    for theta2, modes in found.poses:
        out.append(
            f"    elbow at {plain(theta2, 4)} rad{'95 % band':>31}"
            f"{'from name':>11}{'numbers':>9}{'inertias':>9}"
        )
        for i, mode in enumerate(modes, 1):
            for key, (words, unit) in _NAMES.items():
                head = f"{i}" if key == "frequency_hz" else ""
                out.append(_row(head, words, unit, getattr(mode, key)))
            if mode.rings < 0.995:
                out.append(f"       rings with {percent(mode.rings)}")
    test = found.next_test
    if test is not None and test.band is not None and found.narrows is not None:
        spread: Spread = getattr(found.poses[0][1][0], found.narrows)
        what, unit = _NAMES[found.narrows]
        setting = setting_words(test)
        out += wrapped(
            "    ",
            f"The {what} of mode 1 is what is known worst: +/- {plain(1.96 * spread.std, 2)} {unit}"
            f" (95 %). {motion_words(test).capitalize()}{f' ({setting})' if setting else ''}, and "
            f"record {plain(test.duration, 2)} s: that is expected to narrow it to +/- "
            f"{plain(test.band, 2)} {unit}".rstrip()
            + ".",
        )
    return out


def _row(head: str, words: str, unit: str, x: "Spread") -> str:
    low, high = (with_error(v, x.std)[0] if math.isfinite(v) else "?" for v in (x.low, x.high))
    shares = "".join(
        f"{percent(share):>{width}}"
        for share, width in ((x.from_name, 11), (x.from_numbers, 9), (x.from_inertias, 9))
    )
    band = f"{low} to {high} {unit}".rstrip()
    return f"    {head:<2} {words:<14}{band:>30}{shares}"
