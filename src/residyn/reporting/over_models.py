"""What is said of step 3 over all models in play: their probabilities, bands, and what to do."""

from ..effects import BearingDrag
from ..procedure.over_models import OverModels, Spread
from .layout import Table, filled, printed
from .names import named, upper
from .numbers import percent, plain, with_error
from .plan import recipe

_NAMES = {"frequency_hz": ("frequency", "Hz", 1.0), "damping_ratio": ("damping ratio", "%", 100.0)}
"""In words, the unit in which each is told, and its number in that unit."""


def text(found: OverModels) -> str:
    out = ["[[In orbit, over all models]]", *printed(models_table(found))]
    out += filled(drag_words(found), "    ")
    for theta2, table in modes_tables(found):
        out += [f"[[Modes over all models]]  elbow at {theta2} rad", *printed(table)]
    return "\n".join([*out, *filled(narrowing_words(found), "    ")])


def models_table(found: OverModels) -> Table:
    rows = [[named(m.added, found.joints), percent(m.probability)] for m in found.models]
    return Table(["model", "probability"], rows)


def drag_words(found: OverModels) -> str:
    """What was taken to be known of such damping beforehand; empty if drag is in no model."""
    if not any(BearingDrag.name in m.added for m in found.models):
        return ""
    return (
        "Before the recordings, damping of the whole arm (drag of the bearings, quadratic drag, "
        "drag in air, damping between the joints; each as likely) was as likely as not beside each "
        "model: dampers of the joints do much the same, and stay without bearings."
    )


def modes_tables(found: OverModels) -> list[tuple[str, Table]]:
    """Of each elbow angle, the modes without bearings, and what their uncertainty comes from."""
    tables = []
    for theta2, modes in found.poses:
        rows = []
        for i, mode in enumerate(modes, 1):
            for key, (words, unit, factor) in _NAMES.items():
                x: Spread = getattr(mode, key)
                low, high = (with_error(factor * v, factor * x.std)[0] for v in (x.low, x.high))
                shares = (x.from_name, x.from_numbers, x.from_inertias)
                rows.append([f"{i} {words}", f"{low} to {high} {unit}", *map(percent, shares)])
            if mode.rings < 0.995:
                rows.append([f"{i} rings with", percent(mode.rings), "", "", ""])
        head = ["mode", "95 % band", "from name", "numbers", "inertias"]
        tables.append((plain(theta2, 4), Table(head, rows)))
    return tables


def narrowing_words(found: OverModels) -> str:
    """What is known worst of the lowest mode, and the test that would narrow it most; empty if none
    was sought."""
    test = found.next_test
    if test is None or test.band is None or found.narrows is None:
        return ""
    spread: Spread = getattr(found.poses[0][1][0], found.narrows)
    what, unit, factor = _NAMES[found.narrows]
    now, then = (f"+/- {plain(factor * x, 2)} {unit}" for x in (1.96 * spread.std, test.band))
    return (
        f"The {what} of mode 1 is what is known worst: {now} (95 %). {upper(recipe(test))}: that "
        f"is expected to narrow it to {then}."
    )
