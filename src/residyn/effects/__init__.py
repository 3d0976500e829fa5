"""The catalogue of physical effects, and how a user's words become one.

To add an effect: write its class in a file here, and import it below. It is then in `CATALOGUE`,
and the tests of the catalogue apply to it.
"""

import functools
from collections.abc import Iterable
from pathlib import Path

from ..errors import InputError, did_you_mean, quote
from ..physics.effect import AbstractEffect as AbstractEffect
from ..physics.effect import JointEffect as JointEffect
from ..physics.inertia import AbstractInertia
from .air import AirDrag as AirDrag
from .applied import ConstantTorque as ConstantTorque
from .applied import PeriodicDisturbance as PeriodicDisturbance
from .asymmetric_damping import AsymmetricDamping as AsymmetricDamping
from .bearing import BearingDrag as BearingDrag
from .bearing import BearingFriction as BearingFriction
from .bearing import BearingQuadraticDrag as BearingQuadraticDrag
from .cogging import Cogging as Cogging
from .elastic import AsymmetricStiffness as AsymmetricStiffness
from .elastic import CouplingStiffness as CouplingStiffness
from .elastic import CubicStiffness as CubicStiffness
from .elastic import DeadZone as DeadZone
from .elastic import Spring as Spring
from .elastic import StiffnessDrift as StiffnessDrift
from .friction import CoulombFriction as CoulombFriction
from .friction import DahlFriction as DahlFriction
from .friction import LoadFriction as LoadFriction
from .friction import StribeckFriction as StribeckFriction
from .gravity import Gravity as Gravity
from .gravity import Pendulum as Pendulum
from .inertia import InertiaError as InertiaError
from .inertia import PrintedInertiaTorque as PrintedInertiaTorque
from .memory import BrakeSlip as BrakeSlip
from .memory import Hysteresis as Hysteresis
from .memory import Relaxation as Relaxation
from .own import check_instance, checked, installed, read_effects
from .own_numbers import shared
from .sensor import SensorCurve as SensorCurve
from .sensor import SensorDelay as SensorDelay
from .sensor import SensorOffset as SensorOffset
from .sensor import SensorScale as SensorScale
from .viscous import CouplingDamping as CouplingDamping
from .viscous import Damper as Damper
from .viscous import QuadraticDrag as QuadraticDrag
from .wrist import WristFlexibility as WristFlexibility


def _order(kind: type[AbstractEffect]) -> int:
    """The base model, then what else is at a joint, what the sensors do, the whole mechanism."""
    if kind in (Spring, Damper):
        return 0
    return 3 if not issubclass(kind, JointEffect) else 2 if kind.senses else 1


# Every effect that is imported above: to import one is to list it.
CATALOGUE: dict[str, type[AbstractEffect]] = {
    kind.name: kind
    for kind in sorted(
        (k for k in list(vars().values()) if hasattr(k, "equation") and hasattr(k, "name")),
        key=_order,
    )
}


@functools.cache
def adopt_installed() -> None:
    """Add the effects of installed packages to the catalogue, once.

    **Raises:** `InputError` for one that cannot be used.
    """
    for kind in installed():
        adopt(kind, "an installed package")


def catalogue() -> dict[str, type[AbstractEffect]]:
    """Every effect by name: this package's, then those of installed packages and users' files.

    **Raises:** `InputError` for an installed package whose effect cannot be used.
    """
    adopt_installed()
    return CATALOGUE


def adopt(kind: type[AbstractEffect], where: str = "a user's effect") -> None:
    """Add a user's own effect to the catalogue; one of the same file or class is replaced.

    **Raises:** `InputError` if it cannot be used, or its name is taken.
    """
    kind = checked(kind, where)
    there = CATALOGUE.get(kind.name)
    if there is not None and (there.__module__, there.__qualname__) != (
        kind.__module__,
        kind.__qualname__,
    ):
        raise InputError(f'{where}: the name "{kind.name}" is taken; give {kind.__name__} another')
    CATALOGUE[kind.name] = kind


def check_own(effects: Iterable[AbstractEffect], mechanism: AbstractInertia) -> None:
    """Trace the laws of those effects that are not of the catalogue, whose laws have been.

    **Raises:** `InputError`, in one line, for one that cannot be used.
    """
    for effect in effects:
        kind = type(shared(effect))
        if CATALOGUE.get(getattr(kind, "name", "")) is not kind:
            check_instance(effect, mechanism)


def load_effects(path: str | Path) -> tuple[str, ...]:
    """Add the effects that a Python file defines to the catalogue.

    **Returns:** their names.

    **Raises:** `InputError`, in one line, if the file cannot be run or defines none.
    """
    kinds = read_effects(path)
    for kind in kinds:
        adopt(kind, str(path))
    return tuple(kind.name for kind in kinds)


def kind_named(words: str) -> type[AbstractEffect]:
    """The effect's class that `name` or `name:place` asks for, whatever the place.

    **Raises:** `InputError`, in one line, for a name that does not exist.
    """
    name, known = words.partition(":")[0], catalogue()
    if name not in known:
        raise InputError(f'there is no effect "{name}"{_nearest(name, known)}')
    return known[name]


def effects_named(words: str, mechanism: AbstractInertia) -> tuple[AbstractEffect, ...]:
    """The effects that `name` or `name:place` asks for on this mechanism, at their default values.

    A per-joint effect named without a joint is put at every joint.

    **Raises:** `InputError`, in one line, for a name or a place that does not exist here.
    """
    if not isinstance(words, str):
        raise InputError(
            f'{quote(words)} is no effect: give its name, as "coulomb_friction:elbow", or an '
            'instance, as CoulombFriction("elbow")'
        )
    name, colon, place = words.partition(":")
    kind = kind_named(words)
    try:
        places = kind.places(mechanism)
    except ValueError as error:
        raise InputError(str(error)) from None
    if not places:
        if colon:
            raise InputError(f'"{words}": {name} acts on the whole mechanism and takes no joint')
        return (kind(),)
    if not colon:
        return tuple(kind(each) for each in places)  # pyrefly: ignore[bad-argument-count]
    if place not in places:
        raise InputError(
            f'"{words}": {name} goes with {", ".join(places)}{_nearest(place, places)}'
        )
    return (kind(place),)  # pyrefly: ignore[bad-argument-count]


def _nearest(word: str, known) -> str:
    return "; " + (did_you_mean(word, known) or "`residyn effects` lists them")
