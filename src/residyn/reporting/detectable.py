"""The atlas of detectable effects in lines of 80 columns."""

from typing import TYPE_CHECKING

from .diagnosis_text import wrapped
from .numbers import amount, plain
from .words import at_place, lower, share_words, title

if TYPE_CHECKING:
    from ..diagnosis.detectable import Atlas, Detectable


def lines(atlas: "Atlas") -> list[str]:
    """Two lines for each effect: how strong, as a share and as a number; its rival."""
    noise = ", ".join(
        f"{joint} {amount(x, unit, 2)}"
        for joint, x, unit in zip(atlas.joints, atlas.noise, atlas.units, strict=True)
    )
    out = wrapped(
        "",
        f"What {plain(atlas.duration, 3)} s of this motion can show (noise: {noise}). Strengths as "
        "a share of the spring's torque at full swing, or of what else is typical: named in half "
        "of all recordings, and told from the best rival with odds of 20 to 1.",
    )
    out.append(f"{'':<44}{'named':>9}{'told':>9}")
    for e in atlas.effects:
        out += _one(e, atlas.joints)
    return out


def _one(e: "Detectable", joints: tuple[str, ...]) -> list[str]:
    named, told = ("never" if x is None else share_words(x) for x in (e.share, e.told_share))
    out = [f"{at_place(e.effect, joints):<44}{named:>9}{told:>9}"]
    if e.shows is None:
        return out
    unit = "" if e.unit == "1" else f" {e.unit}"
    words = f"{e.number} {plain(e.shows, 2)}{unit}"
    if e.told is not None:
        words += f" and {plain(e.told, 2)}{unit}"
    if e.shape:
        words += " at " + ", ".join(f"{k} {plain(v, 2)}" for k, v in e.shape.items())
    if e.rival is not None:
        rival = at_place(e.rival, joints) if e.rival.partition(":")[2] else title(e.rival)
        words += f"; rival: {lower(rival)}"
    return [*out, *wrapped("    ", words)]
