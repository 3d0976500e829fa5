"""Effects, places and models in words. `coulomb_friction:elbow` is an identifier, for files and
command lines; people read "Coulomb friction at the elbow", in tables "Coulomb friction, elbow"."""

import re
from collections.abc import Sequence

from ..effects import catalogue
from ..fitting.result import Fit
from ..physics.effect import BASE
from .numbers import change, glued, times

PLAIN = "springs and dampers"
HELD_OUT = "held out"
"""Recordings, or parts of them, that the numbers were not fitted to."""
STOPPED = {"interrupted": "was stopped by Ctrl-C", "budget": "ended when its budget was spent"}
"""How a search ended early, by `Budget.stopped`."""
SURE = 0.9
"""Probability from which a sentence says "is"."""
_PERSONS = ("Bouc-Wen", "Coulomb", "Dahl", "Stribeck")
_UNCOUNTED = (
    "cogging", "damping", "drag", "drift", "friction", "gravity", "hysteresis", "stiffness",
)  # fmt: skip
"""What names are of that go without an article: "dry friction", "stiffness between joints"."""
_FURTHER = re.compile(r" (?:\(|as |at |between |in |of )")
"""Where what a name is of ends: "drag of the air bearings", "dead zone (backlash)"."""


def listed(words: Sequence[str]) -> str:
    """ "a, b and c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def upper(words: str) -> str:
    """The same with a capital first letter."""
    return words[:1].upper() + words[1:]


def lower(words: str) -> str:
    """The same with a small first letter, unless it begins with a person's name."""
    return words if words.split(" ", 1)[0] in _PERSONS else words[:1].lower() + words[1:]


def counted(words: str) -> bool:
    """Whether a name is of one thing ("damping law") and not of a quantity ("dry friction")."""
    last = _FURTHER.split(words)[0].rpartition(" ")[2].lower()
    return last not in _UNCOUNTED and not last.endswith("s")


def an(words: str) -> str:
    """A name as it stands in a sentence: "a damping law", "an offset", "dry friction"."""
    words = lower(words)
    article = "an" if words[:1].lower() in "aeiou" else "a"
    return f"{article} {words}" if counted(words) else words


def unbroken(words: str) -> str:
    """For a page: numbers stay with their signs and units."""
    return glued(words).replace("+/-", "±").replace("^2", "²").replace("^3", "³")


def modal(probability: float) -> str:
    """ "is", "is probably" or "may be", as the probability allows."""
    return "is" if probability >= SURE else "is probably" if probability >= 0.5 else "may be"


def title(label: str) -> str:
    """What an effect is called in words: "Coulomb friction" of `coulomb_friction:elbow`."""
    name = label.partition(":")[0]
    kind = catalogue().get(name)
    return upper(name.replace("_", " ")) if kind is None else kind.titled()


def placed(words: str, place: str | None, joints: Sequence[str], comma: bool = False) -> str:
    """Words with a place: "gravity", "dry friction at the elbow" (or "dry friction, elbow"); where
    there is but one joint, without it."""
    if place is None or (place in joints and len(joints) == 1):
        return words
    if comma:
        return f"{words}, {place}"
    return f"{words} at {the(place)}" if place in joints else f"{words} ({place})"


def the(joint: str) -> str:
    """ "the elbow"; a name with a number goes without: "joint1"."""
    return joint if joint[-1:].isdigit() else f"the {joint}"


def at(joint: str, joints: Sequence[str]) -> str:
    """ " at the elbow"; nothing where there is but one joint."""
    return placed("", joint, joints)


def at_place(label: str, joints: Sequence[str], comma: bool = False) -> str:
    """ "Coulomb friction at the elbow", or "Coulomb friction, elbow"."""
    return placed(title(label), label.partition(":")[2] or None, joints, comma)


def named(labels: Sequence[str], joints: Sequence[str]) -> str:
    """ "Coulomb friction at the elbow and gravity"; without any, "springs and dampers alone"."""
    return listed([lower(at_place(x, joints)) for x in labels]) if labels else f"{PLAIN} alone"


def spoken(labels: Sequence[str], joints: Sequence[str]) -> str:
    """The same in a sentence: "Coulomb friction at the elbow and a constant torque"."""
    return listed([an(at_place(x, joints)) for x in labels]) if labels else named(labels, joints)


def force(units: Sequence[str | None] | None) -> str:
    """What acts at joints that are read in "rad" or "m", or what is itself in "N m" or "N": a
    torque, or a force where all of them slide."""
    return "force" if units and {"m", "N"}.issuperset(units) else "torque"


def position(units: Sequence[str | None] | None) -> str:
    """What is read of joints in "rad" or "m": an angle, or a position where all of them slide."""
    return "position" if units and {"m"}.issuperset(units) else "angle"


def base_name(fit: Fit, comma: bool = False) -> str:
    """ "springs and dampers", and what else is in the model."""
    usual = {f"{kind}:{joint}" for kind in BASE for joint in fit.joints}
    more = [lower(at_place(x, fit.joints, comma)) for x in fit.model.labels if x not in usual]
    return " + ".join([PLAIN, *more])


def error_change(
    before: tuple[float, float | None], after: tuple[float, float | None], more: str = ""
) -> str:
    """How an error goes, fitted and held out: "falls from 46 to 15 times the noise (held out: from
    50 to 16)", with a third digit where only that differs; `more` is said behind."""
    (first, held), (last, ahead) = before, after
    words = f"{change(first, last, times(first) == times(last))} times the noise"
    if held is None or ahead is None:
        return words
    beside = change(held, ahead)
    beside = f": {beside.removeprefix('falls ')}" if ahead < held else f": it {beside}"
    return f"{words} ({HELD_OUT}{beside}{more})"


def own_name(number: str) -> str:
    """`coulomb_friction:elbow.torque` is "torque"."""
    return number.partition(".")[2]


def when_held_out(what: str) -> str:
    """Which readings were held out, of a `HeldOut.what`."""
    if what == "check recordings":
        return "whole recordings"
    return "the last third, predicted from a fit of the first two"
