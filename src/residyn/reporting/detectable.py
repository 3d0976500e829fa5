"""The atlas of detectable effects in lines of 80 columns."""

from ..diagnosis.detectable import Atlas, Detectable
from .layout import Table, filled, printed
from .names import at_place, force, lower, title
from .numbers import amount, plain, share

_VALUES = 52  # columns of an effect's numbers


def text(atlas: Atlas) -> str:
    """For each effect: how strong, as a share and as a number; its rival."""
    noise = ", ".join(
        f"{joint} {amount(x, unit, 2)}"
        for joint, x, unit in zip(atlas.joints, atlas.noise, atlas.units, strict=True)
    )
    head = filled(
        f"What {plain(atlas.duration, 3)} s of this motion can show (noise: {noise}). Strengths as "
        f"a share of the spring's {force(atlas.units)} at full swing, or of what else is typical: "
        "named in half of all recordings, and told from the best rival with odds of 20 to 1."
    )
    rows = []
    for e in atlas.effects:
        shares = ("never" if x is None else share(x) for x in (e.share, e.told_share))
        rows.append(["\n".join(_one(e, atlas.joints)), *shares])
    return "\n".join([*head, *printed(Table(["", "named", "told"], rows), indent=0)])


def _one(e: Detectable, joints: tuple[str, ...]) -> list[str]:
    name = at_place(e.effect, joints, comma=True)
    if e.shows is None:
        return [name]
    words = f"{e.number} {_short(e.shows, e.unit)}"
    if e.told is not None:
        words += f" and {_short(e.told, e.unit)}"
    if e.shape:
        shape = (f"{k} {_short(v, e.shape_units[k])}" for k, v in e.shape.items())
        words += f" at {', '.join(shape)}"
    if e.rival is not None:
        placed = e.rival.partition(":")[2]
        rival = at_place(e.rival, joints, comma=True) if placed else title(e.rival)
        words += f"; rival: {lower(rival)}"
    return [name, *filled(words, "    ", width=_VALUES)]


def _short(value: float, unit: str) -> str:
    return f"{plain(value, 2)}{'' if unit == '1' else f' {unit}'}"
