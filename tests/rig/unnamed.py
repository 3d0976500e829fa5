"""Laws that no catalogue has: torques of one joint that depend on its angle, its rate or time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from .bench import Bench
from .scene import Scene, Values
from .stepping import Now

STEP = 1e-3
"""The longest step (s): no law here changes noticeably within it."""


class Unnamed(NamedTuple):
    """A law factor f(variable): where it belongs, and how large a random one is."""

    variable: str
    """"angle", "rate" or "time"."""
    factor: str
    """"direction" (of sliding), or none."""
    families: frozenset[str]
    """What kind of terms a formula of it has."""
    numbers: int
    """How many there are to estimate."""
    draw: Callable[[Scene], Values]
    value: Callable[[Values, float], float]
    """f in N m, positive where it resists, at its numbers and the variable."""


def _exponential_stop(n: Values, q: float) -> float:
    return n["side"] * n["torque"] * math.exp((n["side"] * q - n["angle"]) / n["width"])


def _two_cogs(n: Values, q: float) -> float:
    first = n["torque"] * math.sin(n["waves"] * q + n["phase"])
    return first + n["second"] * math.sin(n["ratio"] * n["waves"] * q + n["shift"])


def _soft_magnet(n: Values, q: float) -> float:
    x = (q - n["angle"]) / n["width"]
    return n["torque"] * x * math.exp(-x * x)


def _draw_stop(s: Scene) -> Values:
    angle = s.angle
    width = s.between(0.1, 0.25) * angle
    return {"torque": s.torque, "side": s.sign(), "angle": angle, "width": width}


def _draw_cogs(s: Scene) -> Values:
    turn = 2.0 * math.pi
    each = {"torque": s.between(0.5, 1.0) * s.torque, "second": s.between(0.5, 1.0) * s.torque}
    waves = {"waves": s.between(5.0, 9.0) / s.angle, "ratio": s.between(1.5, 2.5)}
    return each | waves | {"phase": s.between(0.0, turn), "shift": s.between(0.0, turn)}


def _draw_magnet(s: Scene) -> Values:
    height = math.sqrt(0.5) * math.exp(-0.5)
    angle, width = s.between(-0.6, 0.6) * s.angle, s.between(0.15, 0.35) * s.angle
    return {"torque": s.torque / height, "angle": angle, "width": width}


def _one_way(n: Values, v: float) -> float:
    return n["side"] * n["coefficient"] * max(n["side"] * v, 0.0) ** 2


_POWER = frozenset({"power"})
UNNAMED: dict[str, Unnamed] = {
    "three_halves_drag": Unnamed(
        "rate", "", _POWER, 1,
        lambda s: {"coefficient": s.torque / s.rate**1.5},
        lambda n, v: n["coefficient"] * math.copysign(abs(v) ** 1.5, v),
    ),
    "quintic_drag": Unnamed(
        "rate", "", _POWER, 1,
        lambda s: {"coefficient": s.torque / s.rate**5},
        lambda n, v: n["coefficient"] * v**5,
    ),
    "quintic_stiffness": Unnamed(
        "angle", "", _POWER, 1,
        lambda s: {"coefficient": s.sign() * s.torque / s.angle**5},
        lambda n, q: n["coefficient"] * q**5,
    ),
    "exponential_stop": Unnamed(
        "angle", "", frozenset({"exponential"}), 2, _draw_stop, _exponential_stop
    ),
    "two_cogs": Unnamed("angle", "", frozenset({"sine"}), 6, _draw_cogs, _two_cogs),
    "soft_magnet": Unnamed("angle", "", frozenset({"well"}), 3, _draw_magnet, _soft_magnet),
    "fading_friction": Unnamed(
        "time", "direction", frozenset({"exponential"}), 2,
        lambda s: {"torque": s.torque, "decay": s.between(0.1, 0.3) * s.seconds},
        lambda n, t: n["torque"] * math.exp(-t / n["decay"]),
    ),
    "one_way_drag": Unnamed(
        "rate", "", _POWER, 1,
        lambda s: {"coefficient": s.torque / s.rate**2, "side": s.sign()}, _one_way,
    ),
}  # fmt: skip
"""By name."""


def put_unnamed(bench: Bench, name: str, joint: int, values: Values) -> None:
    """Put one law on the bench: dry friction by MuJoCo's own, its level set anew before each step;
    the others as torques."""
    law = UNNAMED[name]
    if law.factor == "direction":

        def fade(now: Now) -> float:
            now.model.dof_frictionloss[joint] = law.value(values, now.t)
            return STEP

        bench.friction[joint] += law.value(values, 0.0)
        bench.limits.append(fade)
        return
    if law.variable == "angle":
        bench.joint_law(joint, lambda t, q, v: law.value(values, q))
    else:
        bench.joint_law(joint, lambda t, q, v: law.value(values, v))
    bench.joint_limit(joint, lambda q, v, a: STEP)
