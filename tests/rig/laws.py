"""Hidden effects by their label, and what those are that concern the whole arm."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from .arm import tilt
from .bearing import Plane
from .bench import Bench
from .joint_laws import IN_CATALOGUE, OUTSIDE_CATALOGUE, Values
from .loaded import Hand, Tendon
from .unnamed import UNNAMED, put_unnamed

JOINTS = ("shoulder", "elbow")

ArmEffect = Callable[[Bench, Values], None]


def _tie(first: float, second: float, mixed: float) -> tuple[float, float]:
    """a, b with a b = mixed, a^2 <= first and b^2 <= second: a tendon that takes no more."""
    a = math.sqrt(abs(mixed) * math.sqrt(first / second))
    return a, mixed / a


def _coupling_stiffness(bench: Bench, values: Values) -> None:
    """A tendon's spring; what it adds to each joint's own stiffness is taken off the hinge's."""
    if mixed := values["stiffness"]:
        arms = _tie(*bench.given.stiffness, mixed)
        bench.tendons.append(Tendon(arms, stiffness=1.0))
        for spring, arm in zip(bench.springs, arms, strict=True):
            spring[0] -= arm**2


def _coupling_damping(bench: Bench, values: Values) -> None:
    if mixed := values["damping"]:
        arms = _tie(*bench.given.damping, mixed)
        bench.tendons.append(Tendon(arms, damping=1.0))
        for damper, arm in zip(bench.dampers, arms, strict=True):
            damper[0] -= arm**2


def _gravity(bench: Bench, values: Values) -> None:
    pull = tilt(values["tilt"], values.get("direction", 0.0))
    bench.gravity = (bench.gravity[0] + pull[0], bench.gravity[1] + pull[1])


def _bearing_drag(bench: Bench, values: Values, power: int = 1) -> None:
    plane, places, size = Plane(bench.given), bench.bearings, values["coefficient"]
    bench.laws.append(lambda t, q, v: plane.drag(q, v, places, power, size))


def _bearing_quadratic_drag(bench: Bench, values: Values) -> None:
    _bearing_drag(bench, values, 2)


def _bearing_friction(bench: Bench, values: Values) -> None:
    """At the elbow it is exactly dry friction of the shoulder."""
    bench.friction[0] += values["force"] * bench.given.l1 * list(bench.bearings).count("elbow")
    bench.wrist_friction += values["force"] * list(bench.bearings).count("wrist")


def _wrist_flexibility(bench: Bench, values: Values) -> None:
    inertia = values["inertia"]
    if inertia > 0.0:
        pulse = 2.0 * math.pi * values["frequency"]
        # With its centre on the axis the hand's mass changes nothing, if link 2 lacks as much.
        light = 0.01 * bench.given.bodies()[1][0]
        bench.hand = Hand(
            inertia,
            inertia * pulse**2,
            2.0 * values["damping_ratio"] * inertia * pulse,
            values.get("mass", light),
            values.get("offset", 0.0),
        )


def _inertia_error(bench: Bench, part: str, values: Values) -> None:
    size = getattr(bench.true, part) * (1.0 + values["share"])
    bench.true = replace(bench.true, **{part: size})


ARM_EFFECTS: dict[str, ArmEffect] = {
    "coupling_stiffness": _coupling_stiffness,
    "coupling_damping": _coupling_damping,
    "gravity": _gravity,
    "bearing_drag": _bearing_drag,
    "bearing_quadratic_drag": _bearing_quadratic_drag,
    "bearing_friction": _bearing_friction,
    "wrist_flexibility": _wrist_flexibility,
}
INERTIAS = ("shoulder", "elbow", "coupling")

NAMES = (
    *(f"{name}:{joint}" for name in IN_CATALOGUE for joint in JOINTS),
    *ARM_EFFECTS,
    *(f"inertia_error:{part}" for part in INERTIAS),
)
"""Labels of the catalogue's effects on a two-joint arm."""
OUTSIDE = tuple(f"{name}:{joint}" for name in OUTSIDE_CATALOGUE for joint in JOINTS)
"""Labels of effects that no catalogue has."""


def put(bench: Bench, label: str, values: Values) -> None:
    """Put one hidden effect on the bench."""
    name, _, place = label.partition(":")
    if name in UNNAMED:
        put_unnamed(bench, name, JOINTS.index(place), dict(values))
        return
    if label not in (*NAMES, *OUTSIDE):
        raise ValueError(f'the rig knows no effect "{label}"')
    if name == "inertia_error":
        _inertia_error(bench, place, values)
    elif name in ARM_EFFECTS:
        ARM_EFFECTS[name](bench, values)
    else:
        (IN_CATALOGUE | OUTSIDE_CATALOGUE)[name](bench, JOINTS.index(place), values)
