"""How large a random hidden effect is: enough to matter, not so much that nothing else does.

Sizes are in shares of the joint's spring torque at its largest swing, or of that swing; both are
those of the bare arm, linear and undamped, from the same release.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .arm import Arm, G
from .cases import log_uniform
from .loaded import first_moment
from .scene import Scene, Values, swings
from .unnamed import UNNAMED

SHARE = (0.005, 0.1)
MOST = 0.9
"""Of what the dampers or inertias of the arm can bear."""


def _stribeck_friction(s: Scene) -> Values:
    excess = s.between(0.3, 1.5)
    whole = 1.0 + excess
    velocity = s.spread(0.02, 0.3) * s.rate
    return {"torque": s.torque / whole, "excess": s.torque * excess / whole, "velocity": velocity}


def _asymmetric_damping(s: Scene) -> Values:
    most = MOST * s.arm.damping[s.joint]
    return {"damping": s.sign() * min(s.torque / s.rate, most)}


def _dead_zone(s: Scene) -> Values:
    """Half of them the whole spring's, unless a share is asked for: then of that share of it."""
    gap = s.between(0.1, 0.5)
    whole = not s.given and s.rng.random() < 0.5
    return {
        "stiffness": s.stiffness * (1.0 if whole else min(s.share / gap, 1.0)),
        "gap": gap * s.angle,
    }


def _hysteresis(s: Scene) -> Values:
    return {"torque": s.torque, "angle": s.between(0.1, 0.6) * s.angle}


def _brake_slip(s: Scene) -> Values:
    """The whole spring yields; a share that is asked for is what the largest swing lacks."""
    held = 1.0 - s.share if s.given else s.between(0.1, 0.6)
    return {"stiffness": s.stiffness, "angle": held * s.angle if s.share > 0.0 else 10.0 * s.angle}


def _periodic_disturbance(s: Scene) -> Values:
    """Not so near a mode that the answer, undamped, would be more than half the swing."""
    low, high = s.arm.modes()[0].tolist()
    force = np.eye(2)[s.joint] * s.torque
    while True:
        frequency = s.spread(0.3 * low, 3.0 * high)
        square = (2.0 * math.pi * frequency) ** 2
        answer = np.linalg.solve(np.diag(s.arm.stiffness) - square * s.arm.mass_matrix(), force)
        if np.all(np.abs(answer) < max(0.5, 2.0 * s.share) * s.swing):
            break
    return {"torque": s.torque, "frequency": frequency, "phase": s.between(0.0, 2.0 * math.pi)}


def _angle_ripple(s: Scene) -> Values:
    waves = s.between(8.0, 16.0) / s.angle
    return {"torque": s.torque, "waves": waves, "phase": s.between(0.0, 2.0 * math.pi)}


def _burst(s: Scene) -> Values:
    time = s.between(0.1, 0.6) * s.seconds
    return {"torque": s.sign() * s.torque, "time": time, "width": s.between(0.1, 0.5)}


def _magnet(s: Scene) -> Values:
    height = math.sqrt(0.5) * math.exp(-0.5)
    angle, width = s.between(-0.6, 0.6) * s.angle, s.between(0.08, 0.25) * s.angle
    return {"torque": s.torque / height, "angle": angle, "width": width}


def _loosening(s: Scene) -> Values:
    time = s.between(0.1, 0.6) * s.seconds
    return {"stiffness": s.torque / s.angle, "time": time, "width": s.between(0.1, 0.5)}


def _coupling_stiffness(s: Scene) -> Values:
    return {"stiffness": s.sign() * min(s.share, MOST) * math.sqrt(math.prod(s.arm.stiffness))}


def _coupling_damping(s: Scene) -> Values:
    size = s.share * math.sqrt(math.prod(s.arm.stiffness) * math.prod(s.swing / s.speed))
    return {"damping": s.sign() * min(size, MOST * math.sqrt(math.prod(s.arm.damping)))}


def gravity_values(arm: Arm, tilt: float, direction: float) -> Values:
    """A tilted table's numbers, as angles (rad) and as the catalogue's four pulls (N m)."""
    pull = G * math.sin(tilt)
    along, across = pull * math.cos(direction), -pull * math.sin(direction)
    first, second = first_moment(arm), arm.coupling
    return {
        "tilt": tilt,
        "direction": direction,
        "moment1": first * along,
        "moment2": second * along,
        "lateral1": first * across,
        "lateral2": second * across,
    }


def _gravity(s: Scene) -> Values:
    spring = s.arm.stiffness * s.swing
    torques = np.array([first_moment(s.arm) + s.arm.coupling, s.arm.coupling]) * G
    tilt = s.share / float(np.max(torques / spring))
    if not s.given:
        tilt = min(max(tilt, 2e-3), 0.06)
    return gravity_values(s.arm, tilt, s.between(-math.pi, math.pi))


def _at_bearings(s: Scene, power: int) -> float:
    """The force coefficient whose torque is the share of the shoulder's, or of the elbow's."""
    arm, bearings = s.arm, s.bearings
    reach = math.hypot(arm.l1 + arm.l2 * math.cos(arm.theta2), arm.l2 * math.sin(arm.theta2))
    levers = np.array([arm.l1 if b == "elbow" else reach for b in bearings])
    force = np.sum(levers * (levers * s.speed[0]) ** power)
    return s.share * arm.stiffness[0] * float(s.swing[0]) / float(force)


def _wrist_flexibility(s: Scene) -> Values:
    """Above both modes, or between them where there is room."""
    arm = s.arm
    low, high = arm.modes()[0].tolist()
    room = MOST * (arm.elbow - (arm.l1 * arm.coupling) ** 2 / arm.shoulder)
    share = s.share if s.given else s.spread(0.02, 0.15)
    between = high > 1.8 * low and s.rng.random() < 0.4
    frequency = s.spread(1.3 * low, high / 1.3) if between else s.spread(2.0, 4.0) * high
    return {
        "inertia": min(share * arm.elbow, room),
        "frequency": frequency,
        "damping_ratio": s.spread(0.005, 0.05),
    }


def _inertia_error(s: Scene, part: str) -> Values:
    """Whichever way leaves bodies that could exist."""
    arm, share = s.arm, s.sign() * (s.share if s.given else s.spread(0.01, 0.05))
    room = arm.shoulder * arm.elbow / (arm.l1 * arm.coupling) ** 2
    tight = (1.0 + share) ** -2 if part == "coupling" else 1.0 + share
    return {"share": -share if room * tight < 1.05 else share}


JOINT: dict[str, Callable[[Scene], Values]] = {
    "coulomb_friction": lambda s: {"torque": s.torque},
    "stribeck_friction": _stribeck_friction,
    "quadratic_drag": lambda s: {"coefficient": s.torque / s.rate**2},
    "cubic_stiffness": lambda s: {"coefficient": s.sign() * s.torque / s.angle**3},
    "asymmetric_stiffness": lambda s: {"stiffness": s.sign() * s.torque / s.angle},
    "asymmetric_damping": _asymmetric_damping,
    "dead_zone": _dead_zone,
    "hysteresis": _hysteresis,
    "brake_slip": _brake_slip,
    "constant_torque": lambda s: {"torque": s.sign() * s.torque},
    "stiffness_drift": lambda s: {"rate": s.sign() * s.torque / (s.angle * s.seconds)},
    "periodic_disturbance": _periodic_disturbance,
    "sensor_offset": lambda s: {"offset": s.sign() * s.share * s.angle},
    "sensor_scale": lambda s: {"error": s.sign() * s.share},
    "sensor_delay": lambda s: {"delay": s.share * s.angle / s.rate},
    "angle_ripple": _angle_ripple,
    "burst": _burst,
    "fifth_power_drag": lambda s: {"coefficient": s.torque / s.rate**5},
    "magnet": _magnet,
    "loosening": _loosening,
}
ARM: dict[str, Callable[[Scene], Values]] = {
    "coupling_stiffness": _coupling_stiffness,
    "coupling_damping": _coupling_damping,
    "gravity": _gravity,
    "bearing_drag": lambda s: {"coefficient": _at_bearings(s, 1)},
    "bearing_quadratic_drag": lambda s: {"coefficient": _at_bearings(s, 2)},
    "bearing_friction": lambda s: {"force": _at_bearings(s, 0)},
    "wrist_flexibility": _wrist_flexibility,
}


def draw(
    rng: np.random.Generator,
    label: str,
    arm: Arm,
    q0: ArrayLike,
    strength: float | None,
    bearings: tuple[str, ...],
    seconds: float,
) -> Values:
    """The numbers of one effect."""
    share = log_uniform(rng, *SHARE) if strength is None else strength
    start = np.broadcast_to(np.asarray(q0, dtype=float), (2,))
    name, _, place = label.partition(":")
    joint = 1 if place == "elbow" else 0
    scene = Scene(
        rng, arm, *swings(arm, start), share, strength is not None, bearings, seconds, joint
    )
    if name == "inertia_error":
        return _inertia_error(scene, place)
    if name in UNNAMED:
        return UNNAMED[name].draw(scene)
    return ARM[name](scene) if name in ARM else JOINT[name](scene)
