"""Arms whose motion is known to 1e-12, for whatever integrates them: tests and benchmarks.

Smooth ones are integrated by diffrax's Dopri8 at rtol = 1e-12. With dry friction no solver of
ordinary differential equations will do, since the torque jumps where a joint reverses: between two
such instants the motion is smooth, so SciPy's DOP853 (of the same order) goes from one to the next.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import residyn
from residyn.physics.parameter import QUADRATIC, RATIO, Memory, param
from residyn.recordings.tables import ArmTable, InertiaTable
from tests import rig

MATRIX, JOINTS, UNITS = [[1.0, 0.3], [0.3, 0.5]], ("base", "tip"), ("rad", "rad")
NOISE = 1e-3
EXACT = residyn.Integrator("Dopri8", rtol=1e-12, atol=1e-14)
IMPLICIT = residyn.Integrator("Kvaerno5", rtol=1e-6, atol=1e-8)


class LaggingDrag(residyn.JointEffect):
    """Quadratic drag that follows the motion with a lag of 0.1 ms."""

    name = "lagging_drag"
    title = "Drag with a lag"
    equation = "c z, tau z' = q' |q'| - z"
    looks_like = "quadratic drag"
    source = "first-order lag"
    memory = (Memory("z", RATIO),)

    coefficient: float = param("drag", QUADRATIC)
    lag: float = param("lag, s", RATIO, silent=None, default=1e-4, fitted=False, grid=(1.0,))

    def joint_torque(self, motion):
        return self.coefficient * motion.memory[0]

    def joint_rate(self, motion):
        return ((motion.v * jnp.abs(motion.v) - motion.memory[0]) / self.lag,)


def two_joints(*effects) -> residyn.Model:
    """Two joints on springs and dampers, and effects."""
    model = residyn.ConstantInertia(MATRIX, JOINTS, UNITS)
    model = model + residyn.Spring("base", 20.0) + residyn.Spring("tip", 12.0)
    model = model + residyn.Damper("base", 0.15) + residyn.Damper("tip", 0.05)
    for effect in effects:
        model = model + effect
    return model


def recorded(model, time, integrator=EXACT, steps=None) -> residyn.Experiment:
    """A release of `two_joints`, read with noise, as a user would have it."""
    with jax.enable_x64(True):
        path = residyn.simulate(model, time, [0.2, -0.1], integrator=integrator, steps=steps)
        q = np.asarray(path.readings)
    q = q + NOISE * np.random.default_rng(1).standard_normal(q.shape)
    recording = residyn.Recording.from_arrays(time, q, noise=NOISE)
    return residyn.Experiment(InertiaTable(JOINTS, MATRIX, UNITS), (recording,))


class Known(NamedTuple):
    """A recording of a random arm, and the effect that is hidden in it, if any."""

    experiment: residyn.Experiment
    effects: tuple[str, ...]


_SMOOTH = (
    "cubic_stiffness:elbow",
    "quadratic_drag:shoulder",
    "coupling_stiffness",
    "asymmetric_damping:elbow",
    "wrist_flexibility",
)
_DRY = ("coulomb_friction:elbow", "coulomb_friction:shoulder")


def twenty_arms(seed: int = 32) -> Iterator[Known]:
    """Five bare arms, one with each of five smooth effects, ten with dry friction at either joint:
    20 s at 100 Hz, 1 mrad of noise, by MuJoCo."""
    rng = np.random.default_rng(seed)
    for label in (*("",) * 5, *_SMOOTH, *_DRY * 5):
        arm, q0 = rig.random_arm(rng, damping_ratio=(0.01, 0.05)), rig.random_release(rng)
        hidden = [rig.random_hidden(rng, label, arm, q0, 0.05)] if label else []
        case = rig.record(rng, arm, q0, hidden, noise=NOISE)
        table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
        recording = residyn.Recording.from_arrays(case.t, case.q, theta2=arm.theta2, noise=NOISE)
        yield Known(residyn.Experiment(table, (recording,)), (label,) if label else ())


def true_readings(fit: residyn.Fit) -> np.ndarray:
    """The readings (N, n) of the first recording at a fit's numbers and initial state, to 1e-12."""
    (beside, *_), model = fit.recordings, fit.model
    time, n = beside.recording.time, len(fit.joints)
    if model.dry:
        return _dry_readings(fit)
    with jax.enable_x64(True):
        q, v, z = np.split(beside.state, [n, 2 * n])
        # Many nodes, so that none of the difference is that of the curve that readings lie on.
        steps = max(2 * len(time), 4 * fit.integration_steps)
        path = residyn.simulate(model, time, q, v, z0=z, integrator=EXACT, steps=steps)
        return np.asarray(path.readings)


def error_of(fit: residyn.Fit) -> float:
    """A fit's true integration error: rms of the worst joint, in times the noise."""
    off = (fit.recordings[0].predicted - true_readings(fit)) / fit.noise
    return float(np.sqrt(np.mean(off**2, axis=0)).max())


def _dry_readings(fit: residyn.Fit) -> np.ndarray:
    """Springs, dampers and Coulomb friction on the bodies of a fit."""
    known = {n.name: n.value for n in fit.numbers}
    names = ("spring", "stiffness"), ("damper", "damping"), ("coulomb_friction", "torque")
    k, c, f = (
        np.array([known.get(f"{what}:{joint}.{number}", 0.0) for joint in fit.joints])
        for what, number in names
    )
    beside, n = fit.recordings[0], len(fit.joints)
    table = fit.experiment.inertia
    if isinstance(table, ArmTable):
        arm = rig.Arm(
            *table.link_lengths,
            table.shoulder,
            table.elbow,
            table.coupling,
            beside.recording.theta2,
        )

        def bodies(q, v):
            s = arm.l1 * arm.coupling * np.sin(arm.theta2 + q[1])
            return arm.mass_matrix(q[1]), np.array([-s * v[1] * (2 * v[0] + v[1]), s * v[0] ** 2])

    else:
        matrix = np.array(table.matrix, float)

        def bodies(q, v):
            return matrix, np.zeros(n)

    def push(q, v):
        mass, centrifugal = bodies(q, v)
        return mass, -centrifugal - k * q - c * v

    state = beside.state[: 2 * n]
    return dry_motion(push, np.abs(f), state, beside.recording.time - beside.recording.time[0])


def dry_motion(push, friction: np.ndarray, state: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Angles (N, n) of joints with Coulomb friction (n,), from one instant at which a joint stops
    or starts to the next. `push(q, v)` is the mass matrix and all other torques."""
    n = len(friction)
    t, y, found = 0.0, np.array(state, float), np.empty((len(time), n))

    def accelerations(y, moves):
        """With each joint's direction (-1, 1) or at rest (0); and the torque that holds it."""
        mass, torque = push(y[:n], y[n:])
        free = moves != 0
        a = np.zeros(n)
        net = (torque - moves * friction)[free]
        a[free] = np.linalg.solve(mass[np.ix_(free, free)], net) if free.any() else net
        return a, torque - mass @ a

    def directions(y):
        options = [(0, -1, 1) if v == 0.0 else (np.sign(v),) for v in y[n:]]
        for moves in map(np.array, itertools.product(*options)):
            a, hold = accelerations(y, moves)
            rests, starts = moves == 0, (moves != 0) & (y[n:] == 0.0)
            if np.all(np.abs(hold[rests]) <= friction[rests]) and np.all(
                a[starts] * moves[starts] > 0
            ):
                return moves
        raise AssertionError("some direction must be right")

    while t < time[-1]:
        moves = directions(y)

        def rate(_, y, moves=moves):
            return np.concatenate([np.where(moves == 0, 0.0, y[n:]), accelerations(y, moves)[0]])

        events = []
        for i in range(n):
            if moves[i]:

                def event(_, y, i=i):
                    return y[n + i]

                event.direction = -moves[i]
            else:

                def event(_, y, i=i, moves=moves):
                    # A little beyond its friction, so that it is let go for good.
                    return abs(accelerations(y, moves)[1][i]) - friction[i] * (1 + 1e-9)

                event.direction = 1
            event.terminal = True
            events.append(event)
        part = solve_ivp(
            rate,
            (t, time[-1]),
            y,
            "DOP853",
            rtol=1e-12,
            atol=1e-14,
            events=events,
            dense_output=True,
        )
        here = (time >= t) & (time <= part.t[-1])
        if here.any():
            found[here] = part.sol(time[here])[:n].T
        t, y = part.t[-1], part.y[:, -1].copy()
        for i, at in enumerate(part.t_events or ()):
            if moves[i] and len(at):
                y[n + i] = 0.0
    return found
