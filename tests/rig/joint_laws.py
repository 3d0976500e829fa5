"""What each hidden effect at a joint is: MuJoCo's physics where it has it, else a law.

The signs and the names of the numbers are those of the catalogue: every torque is on the left side
of Z q'' + f + sum of torques = drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from .bench import Bench, Cell
from .loaded import Tendon
from .stepping import until

FAR = 1e6
"""An angle (rad) that no joint reaches."""
SMOOTH = 0.1
"""How much of a law's own scale (angle, rate or phase per radian) one step may cover."""

Values = Mapping[str, float]
JointEffect = Callable[[Bench, int, Values], None]


def _only(joint: int) -> tuple[float, float]:
    return (0.0, 1.0) if joint else (1.0, 0.0)


def _coulomb_friction(bench: Bench, joint: int, values: Values) -> None:
    bench.friction[joint] += values["torque"]


def _stribeck_friction(bench: Bench, joint: int, values: Values) -> None:
    """MuJoCo's dry friction at its height at rest, less a smooth help that grows with the rate."""
    excess, velocity = values["excess"], values["velocity"]
    bench.friction[joint] += values["torque"] + excess

    def help_along(_: float, __: float, v: float) -> float:
        return math.copysign(1.0, v) * excess * math.expm1(-((v / velocity) ** 2))

    def limit(_: float, v: float, a: float) -> float:
        near = abs(v) < 5.0 * velocity and a
        return SMOOTH * (velocity + abs(v)) / abs(a) if near else math.inf

    bench.joint_law(joint, help_along)
    bench.joint_limit(joint, limit)


def _quadratic_drag(bench: Bench, joint: int, values: Values) -> None:
    bench.dampers[joint][1] += values["coefficient"]


def _cubic_stiffness(bench: Bench, joint: int, values: Values) -> None:
    bench.springs[joint][2] += values["coefficient"]


def _asymmetric_stiffness(bench: Bench, joint: int, values: Values) -> None:
    """The spring is weaker by |s|, and a second one of 2 |s| acts on one side only."""
    stiffness = values["stiffness"]
    bench.springs[joint][0] -= abs(stiffness)
    slack = (-FAR, 0.0) if stiffness > 0.0 else (0.0, FAR)
    bench.tendons.append(Tendon(_only(joint), 2.0 * abs(stiffness), slack=slack))
    bench.joint_limit(joint, until)


def _asymmetric_damping(bench: Bench, joint: int, values: Values) -> None:
    damping = values["damping"]
    bench.joint_law(joint, lambda t, q, v: damping * abs(v))
    bench.joint_limit(joint, lambda q, v, a: until(v, a))


def _dead_zone(bench: Bench, joint: int, values: Values) -> None:
    """Part of the spring is moved to a tendon that is slack within the gap."""
    stiffness, gap = values["stiffness"], values["gap"]
    bench.springs[joint][0] -= stiffness
    bench.tendons.append(Tendon(_only(joint), stiffness, slack=(-gap, gap)))
    bench.joint_limit(joint, lambda q, v, a: min(until(q - gap, v, a), until(q + gap, v, a)))


def _hysteresis(bench: Bench, joint: int, values: Values) -> None:
    """Bouc-Wen with n = 1. It begins where a slow pull from 0 to the release has left it."""
    level, angle = values["torque"], values["angle"]
    q0 = float(bench.q0[joint])
    pulled = math.copysign(-math.expm1(-abs(q0) / angle), q0)

    def rate(_: float, v: float, z: float) -> float:
        return v / angle * (1.0 - (abs(z) if v * z > 0.0 else 0.0))

    def limit(_: float, v: float, a: float, __: float) -> float:
        return min(until(v, a), SMOOTH * angle / abs(v) if v else math.inf)

    bench.cells.append(
        Cell(joint, values.get("start", pulled), lambda q, v, z: level * z, rate, limit=limit)
    )


def _brake_slip(bench: Bench, joint: int, values: Values) -> None:
    """The play operator: exact at any step's end, however the angle went, if it did not turn."""
    stiffness, angle = values["stiffness"], values["angle"]

    def slip(q: float, s: float) -> float:
        return min(max(s, q - angle), q + angle)

    def limit(q: float, v: float, a: float, s: float) -> float:
        return min(until(v, a), until(q - s - angle, v, a), until(q - s + angle, v, a))

    bench.cells.append(
        Cell(
            joint,
            slip(float(bench.q0[joint]), values.get("start", 0.0)),
            lambda q, v, s: -stiffness * slip(q, s),
            settle=slip,
            limit=limit,
        )
    )


def _constant_torque(bench: Bench, joint: int, values: Values) -> None:
    torque = values["torque"]
    bench.joint_law(joint, lambda t, q, v: torque)


def _stiffness_drift(bench: Bench, joint: int, values: Values) -> None:
    rate = values["rate"]
    bench.joint_law(joint, lambda t, q, v: rate * t * q)


def _periodic_disturbance(bench: Bench, joint: int, values: Values) -> None:
    torque, phase = values["torque"], values.get("phase", 0.0)
    pulse = 2.0 * math.pi * values["frequency"]
    bench.joint_law(joint, lambda t, q, v: torque * math.sin(pulse * t + phase))
    bench.joint_limit(joint, lambda q, v, a: SMOOTH / pulse)


def _sensor_offset(bench: Bench, joint: int, values: Values) -> None:
    bench.offset[joint] += values["offset"]


def _sensor_scale(bench: Bench, joint: int, values: Values) -> None:
    bench.scale[joint] *= 1.0 + values["error"]


def _sensor_delay(bench: Bench, joint: int, values: Values) -> None:
    bench.delay[joint] += values["delay"]


def _angle_ripple(bench: Bench, joint: int, values: Values) -> None:
    torque, waves, phase = values["torque"], values["waves"], values.get("phase", 0.0)

    def limit(_: float, v: float, a: float) -> float:
        pace = waves * abs(v) + math.sqrt(waves * abs(a))
        return 2.0 * SMOOTH / pace if pace else math.inf

    bench.joint_law(joint, lambda t, q, v: torque * math.sin(waves * q + phase))
    bench.joint_limit(joint, limit)


def _burst(bench: Bench, joint: int, values: Values) -> None:
    torque, time, width = values["torque"], values["time"], values["width"]
    bench.joint_law(joint, lambda t, q, v: torque * math.exp(-(((t - time) / width) ** 2)))
    bench.joint_limit(joint, lambda q, v, a: SMOOTH * width)


def _fifth_power_drag(bench: Bench, joint: int, values: Values) -> None:
    coefficient = values["coefficient"]
    bench.joint_law(joint, lambda t, q, v: coefficient * v**5)


def _magnet(bench: Bench, joint: int, values: Values) -> None:
    """A well: it pulls towards its angle for a positive torque."""
    torque, angle, width = values["torque"], values["angle"], values["width"]

    def pull(_: float, q: float, __: float) -> float:
        x = (q - angle) / width
        return torque * x * math.exp(-x * x)

    def limit(q: float, v: float, a: float) -> float:
        reach = max(abs(q - angle) - 4.0 * width, width)
        return SMOOTH * reach / (abs(v) + math.sqrt(abs(a) * width) + 1e-9)

    bench.joint_law(joint, pull)
    bench.joint_limit(joint, limit)


def _loosening(bench: Bench, joint: int, values: Values) -> None:
    """Within a moment the spring loses some of its stiffness, for good."""
    stiffness, time, width = values["stiffness"], values["time"], values["width"]
    bench.joint_law(
        joint, lambda t, q, v: -0.5 * stiffness * q * (1 + math.tanh((t - time) / width))
    )
    bench.joint_limit(joint, lambda q, v, a: SMOOTH * width)


IN_CATALOGUE: dict[str, JointEffect] = {
    "coulomb_friction": _coulomb_friction,
    "stribeck_friction": _stribeck_friction,
    "quadratic_drag": _quadratic_drag,
    "cubic_stiffness": _cubic_stiffness,
    "asymmetric_stiffness": _asymmetric_stiffness,
    "asymmetric_damping": _asymmetric_damping,
    "dead_zone": _dead_zone,
    "hysteresis": _hysteresis,
    "brake_slip": _brake_slip,
    "constant_torque": _constant_torque,
    "stiffness_drift": _stiffness_drift,
    "periodic_disturbance": _periodic_disturbance,
    "sensor_offset": _sensor_offset,
    "sensor_scale": _sensor_scale,
    "sensor_delay": _sensor_delay,
}
OUTSIDE_CATALOGUE: dict[str, JointEffect] = {
    "angle_ripple": _angle_ripple,
    "burst": _burst,
    "fifth_power_drag": _fifth_power_drag,
    "magnet": _magnet,
    "loosening": _loosening,
}
