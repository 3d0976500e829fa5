"""The catalogue of physical effects, and how a user's words become one.

To add an effect: write its class in a file here and its name in `CATALOGUE`. The catalogue's tests
then apply to it.
"""

import difflib

from ..mechanism import AbstractMechanism
from .base import AbstractEffect as AbstractEffect
from .base import JointEffect as JointEffect
from .elastic import Spring as Spring
from .friction import CoulombFriction as CoulombFriction
from .gravity import Gravity as Gravity
from .inertia import InertiaError as InertiaError
from .inertia import PrintedInertiaTorque as PrintedInertiaTorque
from .viscous import Damper as Damper

CATALOGUE: dict[str, type[AbstractEffect]] = {
    effect.name: effect
    for effect in (
        Spring,
        Damper,
        CoulombFriction,
        Gravity,
        PrintedInertiaTorque,
        InertiaError,
    )
}


def effects_named(words: str, mechanism: AbstractMechanism) -> tuple[AbstractEffect, ...]:
    """The effects that `name` or `name:place` asks for on this mechanism, at their default values.

    A per-joint effect named without a joint is put at every joint.

    **Raises:** `ValueError`, in one line, for a name or a place that does not exist here.
    """
    name, colon, place = words.partition(":")
    if name not in CATALOGUE:
        raise ValueError(f'there is no effect "{name}"{_nearest(name, CATALOGUE)}')
    kind = CATALOGUE[name]
    places = kind.places(mechanism)
    if not places:
        if colon:
            raise ValueError(f'"{words}": {name} acts on the whole mechanism and takes no joint')
        return (kind(),)
    if not colon:
        return tuple(kind(each) for each in places)  # pyright: ignore[reportCallIssue]
    if place not in places:
        raise ValueError(
            f'"{words}": {name} goes with {", ".join(places)}{_nearest(place, places)}'
        )
    return (kind(place),)  # pyright: ignore[reportCallIssue]


def _nearest(word: str, known) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f'; did you mean "{close[0]}"?' if close else "; `residyn effects` lists them"
