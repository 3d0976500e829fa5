"""The hidden effects' truth against laws written down here a second time, and closed forms.

The laws and the kinematics below share nothing with the rig: plane points are complex numbers, the
arm is Eq. 1 in SciPy.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import ellipk

mujoco = pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.rig import (  # noqa: E402
    NAMES,
    OUTSIDE,
    UNNAMED,
    Arm,
    Hidden,
    HiddenCase,
    hidden_cases,
    paper_twin,
    random_arm,
    random_hidden,
    random_release,
    record,
    simulate,
)
from tests.rig.hidden import prepare, run  # noqa: E402
from tests.test_rig import energy, eq1, matrix  # noqa: E402

Floats = np.ndarray
Law = Callable[[float, Floats, Floats], Floats]
JOINTS = ("shoulder", "elbow")

# One joint that moves, on a base too heavy to: closed forms hold for it.
BASE = Arm(l1=0.4, l2=0.4, shoulder=1e9, elbow=0.5, coupling=0.3, stiffness=(0.0, 8.0))
OMEGA = 4.0


def alone(label: str, values: dict[str, float], q0: float, seconds: float = 10.0) -> HiddenCase:
    rng = np.random.default_rng(0)
    hidden = Hidden(f"{label}:elbow", values)
    return record(rng, BASE, [0.0, q0], [hidden], seconds=seconds, rate=1000.0, noise=0.0)


def periods(case: HiddenCase) -> Floats:
    """Times between falls of the elbow through 0, by its velocity there."""
    (q, v), t = case.motion, case.t
    before = np.flatnonzero((q[:-1, 1] > 0.0) & (q[1:, 1] <= 0.0))
    # Through 0 the acceleration of a symmetric spring is nil: a straight line will do.
    return np.diff(t[before] - q[before, 1] / v[before, 1])


def peaks(case: HiddenCase) -> Floats:
    """Sizes of the elbow's turns, release first."""
    (q, v), x = case.motion, case.motion[0][:, 1]
    turns = np.flatnonzero(v[1:-1, 1] * v[2:, 1] < 0.0) + 1
    rates = v[turns, 1], v[turns + 1, 1]
    share = rates[0] / (rates[0] - rates[1])
    # A parabola through each turn: at its top, half a step's velocity beyond the sample.
    tops = x[turns] + 0.5 * rates[0] * share * (case.t[1] - case.t[0])
    return np.abs(np.concatenate([[q[0, 1]], tops]))


# The laws, once more: torques on the left side of Eq. 1.

SINGLE: dict[str, Callable[[dict[str, float], float, float, float], float]] = {
    "quadratic_drag": lambda n, t, q, v: n["coefficient"] * v * abs(v),
    "cubic_stiffness": lambda n, t, q, v: n["coefficient"] * q**3,
    "asymmetric_stiffness": lambda n, t, q, v: n["stiffness"] * abs(q),
    "asymmetric_damping": lambda n, t, q, v: n["damping"] * abs(v),
    "dead_zone": lambda n, t, q, v: -n["stiffness"] * min(max(q, -n["gap"]), n["gap"]),
    "constant_torque": lambda n, t, q, v: n["torque"],
    "stiffness_drift": lambda n, t, q, v: n["rate"] * t * q,
    "periodic_disturbance": lambda n, t, q, v: (
        n["torque"] * math.sin(2 * math.pi * n["frequency"] * t + n["phase"])
    ),
    "angle_ripple": lambda n, t, q, v: n["torque"] * math.sin(n["waves"] * q + n["phase"]),
    "burst": lambda n, t, q, v: n["torque"] * math.exp(-(((t - n["time"]) / n["width"]) ** 2)),
    "fifth_power_drag": lambda n, t, q, v: n["coefficient"] * v**5,
    "loosening": lambda n, t, q, v: (
        -0.5 * n["stiffness"] * q * (1 + math.tanh((t - n["time"]) / n["width"]))
    ),
    "magnet": lambda n, t, q, v: (
        n["torque"]
        * (q - n["angle"])
        / n["width"]
        * math.exp(-(((q - n["angle"]) / n["width"]) ** 2))
    ),
}


def points(arm: Arm, q: Floats, places: tuple[str, ...]) -> list[tuple[complex, complex]]:
    """Of every bearing, how its place moves with each joint."""
    link1 = 1j * arm.l1 * np.exp(1j * q[0])
    link2 = 1j * arm.l2 * np.exp(1j * (q[0] + arm.theta2 + q[1]))
    return [(link1, 0j) if p == "elbow" else (link1 + link2, link2) for p in places]


def at_bearings(
    arm: Arm, places: tuple[str, ...], force: Callable[[float], float]
) -> Callable[[float, Floats, Floats], Floats]:
    def law(_: float, q: Floats, v: Floats) -> Floats:
        out = np.zeros(2)
        for first, second in points(arm, q, places):
            u = first * v[0] + second * v[1]
            pull = force(abs(u)) * u / abs(u) if u else 0.0
            out += [(np.conj(first) * pull).real, (np.conj(second) * pull).real]
        return out

    return law


def gravity_law(arm: Arm, n: dict[str, float]) -> Law:
    def law(_: float, q: Floats, __: Floats) -> Floats:
        one, two = q[0], q[0] + arm.theta2 + q[1]
        upper = n["moment1"] * math.sin(one) + n["lateral1"] * math.cos(one)
        lower = n["moment2"] * math.sin(two) + n["lateral2"] * math.cos(two)
        return np.array([upper + lower, lower])

    return law


def law_of(case: HiddenCase, hidden: Hidden) -> Law:
    name, _, place = hidden.label.partition(":")
    n, arm = dict(hidden.values), case.arm
    if name in SINGLE:
        j, single = JOINTS.index(place), SINGLE[name]
        unit = np.eye(2)[j]
        return lambda t, q, v: unit * single(n, t, q[j], v[j])
    if name == "coupling_stiffness":
        return lambda t, q, v: n["stiffness"] * q[::-1]
    if name == "coupling_damping":
        return lambda t, q, v: n["damping"] * v[::-1]
    if name == "gravity":
        return gravity_law(arm, n)
    if name == "bearing_drag":
        return at_bearings(arm, case.bearings, lambda u: n["coefficient"] * u)
    if name == "bearing_quadratic_drag":
        return at_bearings(arm, case.bearings, lambda u: n["coefficient"] * u * u)
    assert name == "bearing_friction"
    return at_bearings(arm, case.bearings, lambda u: n["force"])


PLAIN = [x for x in (*NAMES, *OUTSIDE) if x.partition(":")[0] in SINGLE]
PLAIN += ["coupling_stiffness", "coupling_damping", "gravity"]
PLAIN += ["bearing_drag", "bearing_quadratic_drag"]


def check_against_the_law(case: HiddenCase, tolerance: float = 1e-6) -> None:
    """The motion solves Eq. 1 with the laws' torques, and the torque reported is theirs."""
    laws = [law_of(case, h) for h in case.hidden if not h.label.startswith("sensor")]

    def torque(t: float, q: Floats, v: Floats) -> Floats:
        return -sum(law(t, q, v) for law in laws)

    q, v = case.motion
    truth = eq1(case.arm, case.t, case.q0, torque)
    assert np.max(np.abs(q - truth[:, :2])) < tolerance * np.max(np.abs(q))
    assert case.torque is not None
    said = np.array([-torque(*row) for row in zip(case.t, q, v, strict=True)])
    assert np.max(np.abs(said)) > 0.0
    assert np.max(np.abs(case.torque - said)) < 1e-7 * np.max(np.abs(said))


@pytest.mark.parametrize("label", PLAIN)
def test_torques_follow_their_laws(label: str) -> None:
    rng = np.random.default_rng([1, len(label)])
    check_against_the_law(next(hidden_cases(rng, label, 1, seconds=4.0, strength=0.05)))


def test_effects_add_up() -> None:
    rng = np.random.default_rng(2)
    labels = ["cubic_stiffness:elbow", "dead_zone:elbow", "bearing_drag", "sensor_scale:elbow"]
    labels += ["asymmetric_stiffness:elbow", "gravity", "coupling_stiffness"]
    (case,) = hidden_cases(rng, labels, 1, seconds=4.0, strength=0.05, noise_share=0.0)
    check_against_the_law(case)
    scale = 1.0 + case.numbers["sensor_scale:elbow.error"]
    np.testing.assert_allclose(case.q, case.motion[0] * [1.0, scale], atol=1e-15)


# Dry friction and memories: pieces of smooth motion, joined where SciPy finds the end of one.


def field(arm: Arm, law: Law) -> Callable[[float, Floats], Floats]:
    def rates(t: float, y: Floats) -> Floats:
        q, v = y[:2], y[2:4]
        bend = arm.l1 * arm.coupling * math.sin(arm.theta2 + q[1])
        inertial = bend * np.array([-2 * v[0] * v[1] - v[1] ** 2, v[0] ** 2])
        load = inertial + np.array(arm.stiffness) * q + np.array(arm.damping) * v + law(t, q, v)
        return np.concatenate([v, np.linalg.solve(matrix(arm, q[1]), -load)])

    return rates


def joined(case: HiddenCase, j: int, mode: float, pieces: Callable) -> tuple[Floats, Floats]:
    """Angles and the torque at joint j; `pieces(mode, y)` gives law, guard (ends at 0), next."""
    now, y, t = 0.0, np.array([*case.q0, 0.0, 0.0]), case.t
    q, torque = np.empty((len(t), 2)), np.empty(len(t))
    while True:
        law, guard, following = pieces(mode, y)

        def end(t: float, y: Floats, guard: Callable = guard) -> float:
            return guard(y)

        end.terminal, end.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
        unit = np.eye(2)[j]
        flow = field(case.arm, lambda t, q, v, law=law, unit=unit: unit * law(q[j], v[j]))
        kwargs = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13, "events": end}
        done = solve_ivp(flow, (now, t[-1]), y, dense_output=True, **kwargs)
        inside = (t >= now) & (t <= done.t[-1])
        states = done.sol(t[inside])
        q[inside] = states[:2].T
        torque[inside] = [law(*pair) for pair in zip(states[j], states[2 + j], strict=True)]
        if done.status == 0:
            return q, torque
        now, y = done.t[-1], done.y[:, -1]
        mode = following(y)


@pytest.mark.parametrize("label", ["coulomb_friction:elbow", "stribeck_friction:shoulder"])
def test_dry_friction_between_its_jumps(label: str) -> None:
    rng = np.random.default_rng(3)
    (case,) = hidden_cases(rng, label, 1, seconds=4.0, strength=0.01)
    j, n = JOINTS.index(label.partition(":")[2]), dict(case.hidden[0].values)

    def friction(v: float) -> float:
        return n["torque"] + n.get("excess", 0.0) * math.exp(-((v / n.get("velocity", 1.0)) ** 2))

    def pieces(sign: float, _: Floats) -> tuple:
        return lambda q, v: sign * friction(v), lambda y: sign * y[2 + j], lambda y: -sign

    # It sets off against the spring; and with so little friction it never sticks here.
    first = float(np.sign(case.motion[1][1, j]))
    q, torque = joined(case, j, first, pieces)
    assert np.max(np.abs(case.motion[0] - q)) < 1e-6 * np.max(np.abs(q))
    said = case.torque
    assert said is not None
    assert np.max(np.abs(said[1:, 1 - j])) < 1e-9
    assert np.max(np.abs(said[1:, j] - torque[1:])) < 1e-5 * friction(0.0)


def test_brake_slips_as_a_play_operator() -> None:
    rng = np.random.default_rng(4)
    (case,) = hidden_cases(rng, "brake_slip:elbow", 1, seconds=4.0)
    k, width = case.hidden[0].values["stiffness"], case.hidden[0].values["angle"]
    assert k == case.arm.stiffness[1]
    slip = [float(np.clip(0.0, case.q0[1] - width, case.q0[1] + width))]

    def pieces(sliding: float, y: Floats) -> tuple:
        if sliding:
            law = lambda q, v: -k * (q - sliding * width)  # noqa: E731

            def stop(y: Floats) -> float:
                slip[0] = float(y[1] - sliding * width)
                return 0.0

            return law, lambda y: sliding * y[3], stop
        held = slip[0]
        side = lambda y: float(np.sign(y[1] - held))  # noqa: E731
        return lambda q, v: -k * held, lambda y: width - abs(y[1] - held), side

    q, torque = joined(case, 1, 0.0, pieces)
    assert abs(slip[0]) > 0.0
    assert np.max(np.abs(case.motion[0] - q)) < 1e-6 * np.max(np.abs(q))
    assert case.torque is not None
    assert np.max(np.abs(case.torque[:, 1] - torque)) < 1e-5 * np.max(np.abs(torque))


def test_brake_slip_agrees_with_plastic_springs() -> None:
    """MuJoCo has such springs itself, but follows them to first order in its step only."""
    if not hasattr(mujoco.MjModel, "jnt_springyield"):
        pytest.skip("this MuJoCo has no plastic springs")
    case = alone("brake_slip", {"stiffness": 8.0, "angle": 0.12}, 0.3, seconds=2.0)
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><compiler angle="radian"/><option integrator="RK4"/>
        <worldbody><body><joint type="hinge" axis="0 0 1" stiffness="8" springyield="0.12"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 0.5"/></body></worldbody></mujoco>"""
    )
    ends = []
    for steps in (50_000, 100_000):
        data = mujoco.MjData(model)
        model.opt.timestep = 2.0 / steps
        data.qpos[0] = 0.3
        mujoco.mj_step(model, data, steps)
        ends.append(float(data.qpos[0]))
    assert case.motion[0][-1, 1] == pytest.approx(2 * ends[1] - ends[0], abs=1e-7)


@pytest.mark.parametrize("start", [None, 0.0])
def test_hysteresis_is_bouc_and_wen_s(start: float | None) -> None:
    rng = np.random.default_rng(5)
    arm, q0 = random_arm(rng), random_release(rng)
    n = dict(random_hidden(rng, "hysteresis:shoulder", arm, q0, 0.08).values)
    level, y0 = n["torque"], n["angle"]
    values = n if start is None else n | {"start": start}
    case = record(rng, arm, q0, [Hidden("hysteresis:shoulder", values)], seconds=4.0)
    pulled = math.copysign(1.0 - math.exp(-abs(q0[0]) / y0), q0[0])

    def flow(t: float, y: Floats) -> Floats:
        z = y[4]
        rate = y[2] / y0 * (1 - abs(z) * (0.5 * np.sign(y[2] * z) + 0.5))
        return np.append(field(arm, lambda t, q, v: np.array([level * z, 0.0]))(t, y), rate)

    begin = [*q0, 0.0, 0.0, pulled if start is None else start]
    kwargs = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-11, "max_step": 0.01}
    truth = solve_ivp(flow, (0, 4), begin, t_eval=case.t, **kwargs).y.T
    assert np.max(np.abs(case.motion[0] - truth[:, :2])) < 2e-6 * np.max(np.abs(q0))
    assert case.torque is not None
    assert np.max(np.abs(case.torque[:, 0] - level * truth[:, 4])) < 1e-4 * level


# Closed forms.


def test_dry_friction_takes_the_same_from_every_turn() -> None:
    case = alone("coulomb_friction", {"torque": 0.1}, 0.307)
    assert -np.diff(peaks(case)[:8]) == pytest.approx(2 * 0.1 / 8.0, rel=1e-4)
    assert case.torque is not None
    # At last it sticks, off centre, and friction bears the spring.
    assert np.max(np.abs(case.motion[1][-100:, 1])) < 1e-8
    assert case.torque[-1, 1] == pytest.approx(-8.0 * case.motion[0][-1, 1], rel=1e-6)


def test_static_friction_holds_up_to_its_height() -> None:
    values = {"torque": 0.2, "excess": 0.6, "velocity": 0.002}
    held = alone("stribeck_friction", values, 0.0999, seconds=2.0)
    assert np.ptp(held.motion[0][:, 1]) < 1e-7
    freed = alone("stribeck_friction", values, 0.1001, seconds=4.0)
    assert np.ptp(freed.motion[0][:, 1]) > 0.1


def test_quadratic_drag_s_turns() -> None:
    case = alone("quadratic_drag", {"coefficient": 0.4}, 0.5)
    bend = 2 * 0.4 / 0.5
    expected = [0.5]
    for _ in range(8):
        left = (1 + bend * expected[-1]) * math.exp(-bend * expected[-1])
        gap = lambda a, left=left: (1 - bend * a) * math.exp(bend * a) - left  # noqa: E731
        expected.append(brentq(gap, 0.0, expected[-1], xtol=1e-14))
    assert peaks(case)[:9] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("coefficient", [15.0, -15.0])
def test_cubic_spring_has_duffing_s_period(coefficient: float) -> None:
    case = alone("cubic_stiffness", {"coefficient": coefficient}, 0.4)
    a, b = 8.0 / 0.5, coefficient / 0.5 * 0.4**2
    period = 4 * ellipk(b / (2 * (a + b))) / math.sqrt(a + b)
    assert periods(case) == pytest.approx(period, rel=1e-6)


def test_two_springs_by_turns() -> None:
    case = alone("asymmetric_stiffness", {"stiffness": -3.0}, 0.3)
    period = math.pi * (math.sqrt(0.5 / 5.0) + math.sqrt(0.5 / 11.0))
    assert periods(case) == pytest.approx(period, rel=1e-6)


def test_backlash_coasts_through_its_gap() -> None:
    case = alone("dead_zone", {"stiffness": 8.0, "gap": 0.1}, 0.3)
    period = 2 * math.pi / OMEGA + 4 * 0.1 / (OMEGA * 0.2)
    assert periods(case) == pytest.approx(period, rel=1e-6)


def test_forced_ringing() -> None:
    values = {"torque": 0.3, "frequency": 1.1, "phase": 0.7}
    case = alone("periodic_disturbance", values, 0.2)
    pulse, t = 2 * math.pi * 1.1, case.t
    size = -0.3 / (8.0 - 0.5 * pulse**2)
    forced = size * np.sin(pulse * t + 0.7)
    cosine, sine = 0.2 - size * math.sin(0.7), -size * pulse * math.cos(0.7) / OMEGA
    free = cosine * np.cos(OMEGA * t) + sine * np.sin(OMEGA * t)
    assert np.max(np.abs(case.motion[0][:, 1] - free - forced)) < 1e-7


# Bearings' friction, the wrist, inertias, sensors.


def test_wrist_bearing_s_friction_turns_in_the_plane() -> None:
    rng = np.random.default_rng(6)
    arm = replace(paper_twin(1.1), stiffness=(16.0, 9.0))
    case = record(
        rng, arm, [0.3, -0.2], [Hidden("bearing_friction", {"force": 0.3})], bearings=("wrist",)
    )
    still = 1 + int(np.argmax(np.all(case.motion[1][1:] == 0.0, axis=1)))
    assert still > 1
    slip = law_of(case, case.hidden[0])
    cut = case.t < 5.0
    truth = eq1(arm, case.t[cut], case.q0, lambda t, q, v: -slip(t, q, v))
    assert np.max(np.abs(case.motion[0][cut] - truth[:, :2])) < 3e-6
    # Once stopped it stays, and the force that holds it is within the friction.
    assert np.ptp(case.motion[0][still:], axis=0) == pytest.approx([0.0, 0.0], abs=0.0)
    assert case.torque is not None
    ((first, second),) = points(arm, case.motion[0][-1], ("wrist",))
    jacobian = np.array([[first.real, first.imag], [second.real, second.imag]])
    assert np.linalg.norm(np.linalg.solve(jacobian, case.torque[-1])) <= 0.3
    assert case.torque[-1] == pytest.approx(-np.array(arm.stiffness) * case.motion[0][-1])


def test_friction_holds_the_links_while_the_hand_rings_on() -> None:
    arm, t = paper_twin(1.1), np.arange(1001) / 100.0
    hand = {"inertia": 0.03, "frequency": 2.0, "damping_ratio": 0.001}
    hidden = [Hidden("bearing_friction", {"force": 1.5}), Hidden("wrist_flexibility", hand)]
    made = run(prepare(arm, [0.3, -0.2], hidden, ("elbow", "wrist")), t)
    last = slice(-300, None)
    assert np.max(np.abs(made.v[last, :2])) < 1e-8
    assert np.max(np.ptp(made.q[last, :2], axis=0)) < 1e-8
    # On the held arm it rings as it would on a bench.
    state = np.array([[0.0, 1.0], [-((4 * math.pi) ** 2), -2 * 0.001 * 4 * math.pi]])
    free = np.array([made.q[-300, 2], made.v[-300, 2]])
    assert np.abs(free[1]) > 0.1
    after = expm(state * (t[-1] - t[-300])) @ free
    assert [made.q[-1, 2], made.v[-1, 2]] == pytest.approx(after, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("name", ["bearing_drag", "bearing_quadratic_drag", "bearing_friction"])
def test_bearings_take_force_times_slip(name: str) -> None:
    rng = np.random.default_rng(7)
    arm, q0 = random_arm(rng), random_release(rng)
    hidden = random_hidden(rng, name, arm, q0, 0.03)
    case = record(rng, arm, q0, [hidden], seconds=5.0, rate=1000.0)
    (q, v), (size,) = case.motion, hidden.values.values()
    power = {"bearing_drag": 2, "bearing_quadratic_drag": 3, "bearing_friction": 1}[name]
    slips = np.zeros(len(q))
    for i in range(len(q)):
        for one, two in points(arm, q[i], case.bearings):
            slips[i] += abs(one * v[i, 0] + two * v[i, 1]) ** power
    spent = size * slips + v**2 @ np.array(arm.damping)
    spent = cumulative_trapezoid(spent, case.t, initial=0.0)
    total = energy(arm, q, v)
    assert np.max(np.abs(total[0] - total - spent)) < 1e-5 * total[0]
    assert spent[-1] > 0.1 * total[0]


@pytest.mark.parametrize(("mass", "offset"), [(None, 0.0), (0.4, 0.15)])
def test_wrist_rings_as_three_joints(mass: float | None, offset: float) -> None:
    arm = paper_twin(0.8)
    values = {"inertia": 0.05, "frequency": 2.4, "damping_ratio": 0.03}
    more = {} if mass is None else {"mass": mass, "offset": offset}
    q0 = 1e-6 * np.array([0.7, -1.0])
    hidden = Hidden("wrist_flexibility", values | more)
    case = record(np.random.default_rng(8), arm, q0, [hidden], seconds=10.0, noise=0.0)
    tie = 0.05 + (mass or 0.0) * offset * arm.l2
    outer = tie + (mass or 0.0) * offset * arm.l1 * math.cos(0.8)
    mass3 = np.block(
        [[matrix(arm, 0.0), np.array([[outer], [tie]])], [np.array([[outer, tie, 0.05]])]]
    )
    pulse = 2 * math.pi * 2.4
    stiff = np.diag([*arm.stiffness, 0.05 * pulse**2])
    damp = np.diag([*arm.damping, 2 * 0.03 * 0.05 * pulse])
    state = np.block(
        [[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(mass3, np.hstack([stiff, damp]))]]
    )
    leap = expm(state * case.t[1])
    y = np.array([*q0, 0, 0, 0, 0])
    for i in range(len(case.t)):
        assert np.max(np.abs(case.motion[0][i] - y[:2])) < 1e-6 * 1e-6
        y = leap @ y
    check_equation(case, 1e-4)


def check_equation(case: HiddenCase, tolerance: float) -> None:
    """Z q'' + f + k q + c q' + torque = 0 with the accelerations of a spline through q'."""
    q, v = case.motion
    a = CubicSpline(case.t, v).derivative()(case.t)
    assert case.torque is not None
    rest = [
        field(case.arm, lambda t, q, v, x=x: x)(0.0, np.concatenate([q, v]))[2:] - a
        for q, v, a, x in zip(q, v, a, case.torque, strict=True)
    ]
    scale = np.max(np.abs(a))
    assert np.max(np.abs(rest[3:-3])) < tolerance * scale


def test_a_stiff_wrist_is_the_arm_that_is_given() -> None:
    rng = np.random.default_rng(9)
    arm = replace(paper_twin(0.8), link1_moment=1.5)
    hand = {"inertia": 0.05, "frequency": 80.0, "damping_ratio": 0.3, "mass": 0.4, "offset": 0.15}
    tilted = random_hidden(rng, "gravity", arm, [0.2, 0.3], 0.05)
    wrist = Hidden("wrist_flexibility", hand)
    both, one = (
        record(rng, arm, [0.2, 0.3], hidden, seconds=1.5, noise=0.0)
        for hidden in ([wrist, tilted], [tilted])
    )
    assert np.max(np.abs(both.motion[0] - one.motion[0])) < 2e-3 * 0.3


@pytest.mark.parametrize("part", ["shoulder", "elbow", "coupling"])
def test_inertia_errors_are_in_the_true_arm(part: str) -> None:
    rng = np.random.default_rng(10)
    (case,) = hidden_cases(rng, f"inertia_error:{part}", 1, seconds=4.0, rate=500.0)
    share = case.numbers[f"inertia_error:{part}.share"]
    assert 0.01 <= abs(share) <= 0.05
    true = replace(case.arm, **{part: getattr(case.arm, part) * (1 + share)})
    assert np.max(np.abs(case.motion[0] - eq1(true, case.t, case.q0)[:, :2])) < 1e-7
    check_equation(case, 1e-4)


def test_sensors_err_and_the_motion_does_not() -> None:
    rng = np.random.default_rng(11)
    arm, q0 = random_arm(rng), random_release(rng)
    hidden = [
        Hidden("sensor_offset:shoulder", {"offset": 0.02}),
        Hidden("sensor_scale:shoulder", {"error": -0.03}),
        Hidden("sensor_delay:elbow", {"delay": 0.0137}),
    ]
    case = record(rng, arm, q0, hidden, seconds=4.0, noise=0.0)
    assert case.torque is None
    np.testing.assert_array_equal(case.q, case.truth)
    # The release comes before the first sample, so that the late joint is read from it on.
    begun = simulate(arm, np.concatenate([[0.0], case.t + 0.0137]), q0)[0][1:]
    assert np.max(np.abs(case.motion[0] - begun)) < 1e-8
    assert np.max(np.abs(case.truth[:, 1] - simulate(arm, case.t, q0)[0][:, 1])) < 1e-8
    assert case.truth[0, 1] == q0[1]
    assert case.truth[:, 0] == pytest.approx(0.97 * case.motion[0][:, 0] + 0.02, abs=1e-15)


def test_time_counts_from_the_first_sample() -> None:
    rng = np.random.default_rng(12)
    arm, q0 = random_arm(rng), random_release(rng)
    hidden = [
        Hidden("sensor_delay:shoulder", {"delay": 0.05}),
        random_hidden(rng, "stiffness_drift:elbow", arm, q0, 0.1),
        random_hidden(rng, "burst:shoulder", arm, q0, 0.1, seconds=4.0),
    ]
    case = record(rng, arm, q0, hidden, seconds=4.0, noise=0.0)
    assert case.torque is not None
    for i in (0, 50, 200):
        state = case.t[i], case.motion[0][i], case.motion[1][i]
        said = law_of(case, hidden[1])(*state) + law_of(case, hidden[2])(*state)
        assert case.torque[i] == pytest.approx(said, abs=1e-9)


# What is drawn.


@pytest.mark.parametrize("label", [*NAMES, *OUTSIDE])
def test_silent_without_strength(label: str) -> None:
    rng = np.random.default_rng(13)
    (case,) = hidden_cases(rng, label, 1, strength=0.0, seconds=2.0, noise_share=0.0)
    clean = simulate(case.arm, case.t, case.q0)[0]
    assert np.max(np.abs(case.q - clean)) < 1e-7
    if case.torque is not None:
        assert np.max(np.abs(case.torque)) < 1e-9


@pytest.mark.parametrize("label", [*NAMES, *OUTSIDE])
def test_draws_are_arms_that_could_be(label: str) -> None:
    rng = np.random.default_rng(14)
    for _ in range(10):
        arm, q0 = random_arm(rng), random_release(rng)
        n = random_hidden(rng, label, arm, q0).values
        assert all(math.isfinite(x) and x != 0.0 for x in n.values())
        name, _, place = label.partition(":")
        j = int(place == "elbow")
        if name == "coupling_damping":
            assert n["damping"] ** 2 < math.prod(arm.damping)
        if name == "asymmetric_damping":
            assert abs(n["damping"]) < arm.damping[j]
        if name == "dead_zone":
            assert 0.0 < n["stiffness"] <= arm.stiffness[j]
        if name == "wrist_flexibility":
            replace(arm, elbow=arm.elbow - n["inertia"]).bodies()
        if name == "inertia_error":
            replace(arm, **{place: getattr(arm, place) * (1 + n["share"])}).bodies()


def test_cases_repeat_and_know_their_noise() -> None:
    labels = ["coulomb_friction:elbow", "sensor_offset:elbow"]
    first, again = (
        next(hidden_cases(np.random.default_rng(15), labels, 1, seconds=3.0)) for _ in range(2)
    )
    np.testing.assert_array_equal(first.q, again.q)
    assert [h.label for h in first.hidden] == labels
    assert "sensor_offset:elbow.offset" in first.numbers
    spread = np.sqrt(np.mean(np.var(first.motion[0], axis=0)))
    assert first.noise == pytest.approx(0.0025 * spread)
    assert np.std(first.q - first.truth) == pytest.approx(first.noise, rel=0.1)


def test_unknown_and_repeated_effects_are_refused() -> None:
    arm, rng = paper_twin(), np.random.default_rng(16)
    with pytest.raises(ValueError, match="knows no effect"):
        record(rng, arm, 0.1, [Hidden("gremlin:elbow", {})])
    twice = [Hidden("constant_torque:elbow", {"torque": 0.1})] * 2
    with pytest.raises(ValueError, match="hidden twice"):
        record(rng, arm, 0.1, twice)


@pytest.mark.parametrize("name", UNNAMED)
def test_a_law_of_no_catalogue_is_the_torque_that_the_arm_lacks(name):
    """By MuJoCo's inverse dynamics along the motion, which know nothing of the law."""
    rng = np.random.default_rng(3)
    (case,) = hidden_cases(rng, f"{name}:elbow", 1, strength=0.05, seconds=4.0)
    law, numbers = UNNAMED[name], case.hidden[0].values
    (q, v), found = case.motion, case.torque
    x = {"angle": q[:, 1], "rate": v[:, 1], "time": case.t}[law.variable]
    expected = np.array([law.value(dict(numbers), float(y)) for y in x])
    if law.factor == "direction":
        expected *= np.sign(v[:, 1])
    size = np.abs(expected).max()
    moving = slice(5, None)  # a release from rest: dry friction has no direction yet
    assert np.abs(found[moving, 1] - expected[moving]).max() < 5e-3 * size
    assert np.abs(found[:, 0]).max() < 5e-3 * size
