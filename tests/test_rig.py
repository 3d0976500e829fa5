"""The rig against answers that owe MuJoCo nothing: closed forms, and Eq. 1 in SciPy."""

from __future__ import annotations

import ast
import math
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid
from scipy.linalg import eigh

mujoco = pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.rig import (  # noqa: E402
    HANGING,
    Arm,
    Cart,
    Memory,
    clean_cases,
    friction_cases,
    make_demo,
    paper_twin,
    random_arm,
    random_release,
    simulate,
    tilt,
)

RIG = Path(__file__).parent / "rig"
T20 = np.arange(2001) / 100.0


def matrix(arm: Arm, q2: float) -> np.ndarray:
    reach = arm.l1 * arm.coupling * math.cos(arm.theta2 + q2)
    corner = arm.elbow + reach
    return np.array([[arm.shoulder + arm.elbow + 2 * reach, corner], [corner, arm.elbow]])


def eq1(
    arm: Arm,
    t: np.ndarray,
    start: np.ndarray,
    extra: Callable[[float, np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Eq. 1 with the energy-conserving inertia torque, by DOP853: N x (q1, q2, q1', q2')."""

    def field(now: float, y: np.ndarray) -> list[float]:
        q1, q2, w1, w2 = y.tolist()
        bend = arm.l1 * arm.coupling * math.sin(arm.theta2 + q2)
        r1 = bend * (2 * w1 * w2 + w2 * w2) - arm.stiffness[0] * q1 - arm.damping[0] * w1
        r2 = -bend * w1 * w1 - arm.stiffness[1] * q2 - arm.damping[1] * w2
        if extra:
            more = extra(now, y[:2], y[2:])
            r1, r2 = r1 + more[0], r2 + more[1]
        reach = arm.l1 * arm.coupling * math.cos(arm.theta2 + q2)
        z11, z12, z22 = arm.shoulder + arm.elbow + 2 * reach, arm.elbow + reach, arm.elbow
        det = z11 * z22 - z12 * z12
        return [w1, w2, (z22 * r1 - z12 * r2) / det, (z11 * r2 - z12 * r1) / det]

    state = np.zeros(4)
    state[: len(start)] = start
    kwargs = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
    return solve_ivp(field, (t[0], t[-1]), state, t_eval=t, **kwargs).y.T


def energy(arm: Arm, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    kinetic = [0.5 * w @ matrix(arm, a[1]) @ w for a, w in zip(q, v, strict=True)]
    return np.array(kinetic) + 0.5 * q**2 @ np.array(arm.stiffness)


def test_mass_matrix_is_eq_2() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        arm = random_arm(rng)
        model = mujoco.MjModel.from_xml_string(arm.mjcf())
        data = mujoco.MjData(model)
        data.qpos[:] = rng.uniform(-1.0, 1.0, 2)
        mujoco.mj_forward(model, data)
        columns = []
        for unit in np.eye(2):
            column = np.zeros(2)
            mujoco.mj_mulM(model, data, column, unit)
            columns.append(column)
        np.testing.assert_allclose(columns, matrix(arm, data.qpos[1]), rtol=1e-12)


def test_impossible_inertias_are_refused() -> None:
    with pytest.raises(ValueError, match="no rigid bodies"):
        Arm(l1=0.4, l2=0.4, shoulder=0.3, elbow=0.1, coupling=1.0).bodies()


def test_energy_is_conserved_without_damping() -> None:
    arm = replace(paper_twin(0.7), damping=(0.0, 0.0))
    q, v = simulate(arm, T20, [0.9, -0.8])
    total = energy(arm, q, v)
    assert np.ptp(total) < 1e-7 * total[0]


def test_small_motion_rings_at_the_generalised_eigenvalues() -> None:
    rng = np.random.default_rng(2)
    for _ in range(2):
        arm = replace(random_arm(rng), damping=(0.0, 0.0))
        mass, stiff = matrix(arm, 0.0), np.diag(arm.stiffness)
        squares, shapes = eigh(stiff, mass)
        assert np.sort(np.sqrt(squares)) == pytest.approx(2 * math.pi * arm.modes()[0])
        for square, shape in zip(squares, shapes.T, strict=True):
            q, _ = simulate(arm, T20, 1e-6 * shape)
            pure = 1e-6 * np.cos(math.sqrt(square) * T20)[:, None] * shape
            assert np.max(np.abs(q - pure)) < 1e-5 * 1e-6


def test_free_ringing_solves_eq_1() -> None:
    rng = np.random.default_rng(3)
    for amplitude in (0.2, 0.4, 1.0):
        arm, q0 = random_arm(rng), random_release(rng, (0.5 * amplitude, amplitude))
        q, v = simulate(arm, T20, q0)
        truth = eq1(arm, T20, q0)
        assert np.max(np.abs(q - truth[:, :2])) < 1e-7
        assert np.max(np.abs(v - truth[:, 2:])) < 1e-6


def test_uneven_times_and_a_drive_cost_no_accuracy() -> None:
    rng = np.random.default_rng(4)
    arm = paper_twin(-0.9)
    t = 1.0 + np.cumsum(rng.uniform(0.002, 0.05, 400))
    drive = np.stack([np.sin(3.0 * t), 0.5 * np.cos(5.0 * t)], axis=1)

    def interpolated(now: float, *_: np.ndarray) -> np.ndarray:
        return np.array([np.interp(now, t, u) for u in drive.T])

    q, _ = simulate(arm, t, [0.1, 0.2], drive=drive)
    # From knot to knot, since a solver that steps over the kinks between samples loses its order.
    state, worst = np.array([0.1, 0.2, 0.0, 0.0]), 0.0
    for i in range(1, len(t)):
        state = eq1(arm, t[i - 1 : i + 1], state, interpolated)[-1]
        worst = max(worst, float(np.max(np.abs(q[i] - state[:2]))))
    assert worst < 1e-8


@pytest.mark.parametrize("pull", [HANGING, tilt(0.02, direction=1.1)])
def test_gravity_acts_on_the_absolute_angles(pull: tuple[float, float]) -> None:
    moment = 1.9
    arm = replace(paper_twin(0.4), stiffness=(2.0, 3.0), link1_moment=moment)

    def weight(_: float, q: np.ndarray, __: np.ndarray) -> np.ndarray:
        first, second = q[0], q[0] + arm.theta2 + q[1]
        upper = moment * (pull[1] * math.cos(first) - pull[0] * math.sin(first))
        lower = arm.coupling * (pull[1] * math.cos(second) - pull[0] * math.sin(second))
        return np.array([upper + lower, lower])

    t = np.arange(1001) / 100.0
    q0 = np.array([1.2, -0.7])
    q, _ = simulate(arm, t, q0, gravity=pull)
    assert np.max(np.abs(q - eq1(arm, t, q0, weight)[:, :2])) < 2e-7


def test_hidden_torque_is_felt_inside_the_stages() -> None:
    arm, q0 = paper_twin(0.5), np.array([0.4, -0.5])

    def drag(_: float, __: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.array([-0.3, -0.2]) * v**3

    q, _ = simulate(arm, T20, q0, torque=drag)
    assert np.max(np.abs(q - eq1(arm, T20, q0, drag)[:, :2])) < 1e-7


def test_memory_carries_hysteresis() -> None:
    """A smooth Bouc-Wen loop against the same three equations in SciPy."""
    cart, limit, pull = Cart(mass=2.0, stiffness=20.0, damping=0.05), 0.03, 1.5

    def flow(v: float, z: float) -> float:
        return v - 0.5 * (abs(v) * z * abs(z) + v * z * z) / limit**2

    memory = Memory(
        start=[0.0],
        rate=lambda t, q, v, z: [flow(v[0], z[0])],
        torque=lambda t, q, v, z: [-pull * z[0]],
    )
    q, _ = simulate(cart, T20, 0.2, memory=memory)

    def field(_: float, y: np.ndarray) -> list[float]:
        x, v, z = y
        return [v, (-20.0 * x - 0.05 * v - pull * z) / 2.0, flow(v, z)]

    truth = solve_ivp(field, (0, 20), [0.2, 0, 0], t_eval=T20, rtol=1e-10, atol=1e-12).y[0]
    assert np.max(np.abs(q[:, 0] - truth)) < 1e-6


def test_callbacks_are_taken_back_when_a_torque_fails() -> None:
    def broken(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        raise RuntimeError("hidden torque failed")

    with pytest.raises(RuntimeError, match="hidden torque failed"):
        simulate(paper_twin(), T20[:5], [0.1, 0.1], torque=broken)
    assert mujoco.get_mjcb_passive() is None
    assert mujoco.get_mjcb_act_dyn() is None


def sliding(t: np.ndarray, x: float, omega: float, offset: float) -> np.ndarray:
    """Closed form with dry friction: half cosines about +-offset until a turn falls within it."""
    out, half = np.empty_like(t), math.pi / omega
    begun = 0.0
    for i, now in enumerate(t):
        while now - begun > half and abs(x) > offset:
            x, begun = 2.0 * math.copysign(offset, x) - x, begun + half
        centre = math.copysign(offset, x)
        out[i] = x if abs(x) <= offset else centre + (x - centre) * math.cos(omega * (now - begun))
    return out


@pytest.mark.parametrize("friction", [0.03, 0.31, 1.7])
def test_friction_is_sharp(friction: float) -> None:
    cart = Cart(mass=2.0, stiffness=20.0)
    omega, offset = math.sqrt(10.0), friction / 20.0
    q, v = simulate(cart, T20, 0.3, frictionloss=friction)
    truth = sliding(T20, 0.3, omega, offset)
    assert np.max(np.abs(q[:, 0] - truth)) < 1e-6
    # Each cycle costs 4 F / k of amplitude: read at the exact times of the peaks.
    cycles = int((0.3 - offset) / (4.0 * offset))
    peaks = np.arange(min(cycles, 8) + 1) * 2.0 * math.pi / omega
    if len(peaks) > 1:
        at, _ = simulate(cart, peaks, 0.3, frictionloss=friction)
        assert -np.diff(at[:, 0]) == pytest.approx(4.0 * friction / 20.0, rel=1e-3)
    if friction > 0.1:
        assert abs(q[-1, 0]) == pytest.approx(abs(truth[-1]), abs=1e-5)
        assert abs(q[-1, 0]) > 1e-3
        assert abs(v[-1, 0]) < 1e-7


def test_friction_in_the_arm_takes_torque_times_path() -> None:
    arm = paper_twin(0.3)
    t = np.arange(20001) / 1000.0
    friction = np.array([0.05, 0.1])
    q, v = simulate(arm, t, [0.25, -0.3], frictionloss=friction)
    path = trapezoid(np.abs(v), t, axis=0)
    squares = trapezoid(v**2, t, axis=0)
    total = energy(arm, q, v)
    spent = friction @ path + np.array(arm.damping) @ squares
    assert total[0] - total[-1] == pytest.approx(spent, rel=2e-4)
    assert np.mean(np.abs(v[-2000:, 1]) < 1e-6) > 0.2


def test_random_arms_are_what_they_promise() -> None:
    rng = np.random.default_rng(7)
    for _ in range(50):
        arm = random_arm(rng)
        frequency, ratio = arm.modes()
        assert np.all((frequency >= 0.2) & (frequency <= 5.0))
        assert np.all((ratio >= 0.002) & (ratio <= 0.05))
        assert 0.3 <= arm.shoulder <= 3.0
        assert abs(arm.theta2) <= 2.0
        assert all(x > 0.0 for m, _, i in arm.bodies() for x in (m, i))


def test_cases_repeat_and_carry_their_noise() -> None:
    first, again = (next(clean_cases(np.random.default_rng(8), 1)) for _ in range(2))
    np.testing.assert_array_equal(first.q, again.q)
    assert np.std(first.q - first.truth) == pytest.approx(1e-3, rel=0.1)
    (rough,) = friction_cases(np.random.default_rng(9), 1, amplitude=(0.5, 1.0), noise=0.0)
    assert np.count_nonzero(rough.frictionloss) == 1
    assert np.all(np.abs(rough.q0) >= 0.5)
    np.testing.assert_array_equal(rough.q, rough.truth)


def test_rig_never_imports_what_it_tests() -> None:
    for path in RIG.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] == "residyn" for name in names), path.name


def test_shipped_demo_is_what_the_script_writes() -> None:
    experiment = tomllib.loads((make_demo.HERE / "experiment.toml").read_text(encoding="ascii"))
    arm = paper_twin()
    assert experiment["arm"]["shoulder"] == arm.shoulder
    assert [r["role"] for r in experiment["recordings"]] == ["fit", "check"]
    for entry in experiment["recordings"]:
        path = make_demo.HERE / entry["file"]
        assert path.stat().st_size < 80_000
        shipped = np.loadtxt(path, delimiter=",", skiprows=1)
        t, q = make_demo.recording(*make_demo.RELEASES[entry["file"]])
        # Another MuJoCo may round otherwise, and a reversal can amplify that.
        np.testing.assert_allclose(shipped, np.column_stack([t, q]), atol=1e-5)
