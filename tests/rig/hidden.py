"""Recordings of an arm with something hidden in it, and the truth about what it was.

`Hidden` names an effect as the catalogue does, with the catalogue's numbers, and `record` measures
the arm that has it (or several at once). What is true of the recording besides is kept: the motion
behind the readings and the *hidden torque*, which is whatever the arm that the fit is given would
need, beside its springs and dampers, to move as the true one did. MuJoCo's inverse dynamics of the
given arm along the true motion tell it, without asking which effect it was; so a flexible wrist and
a wrong inertia have one too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arm import Arm
from .bench import Bench
from .cases import random_arm, random_release
from .draw import draw
from .engine import Array, Pair, Trace, trace
from .laws import put
from .stepping import mujoco

Index = NDArray[np.intp]
BEARINGS = ("elbow", "wrist")
DAMPED: Pair = (0.01, 0.05)
"""Damping ratios (of the modes) of arms whose hidden effect cannot exceed their own damping."""


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: "cubic_stiffness:elbow", "gravity", and its numbers in SI units.

    The numbers bear the catalogue's names. Some effects take more, which no fit looks for:
    `phase` (rad) of a disturbance or ripple; `start`, the memory at release (z of a hysteresis, by
    default where a slow pull from 0 to the release leaves it; slip of a brake, in rad, by default 0
    and then as far as the release drags it); `mass` (kg) and `offset` (m) of a hand whose centre is
    off the wrist's axis. Gravity is laid out by `tilt` (rad) and `direction` (rad, downhill from
    link 1 at rest); its catalogue numbers follow from them and are not read.
    """

    label: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class HiddenCase:
    """One recording with its truth."""

    arm: Arm
    """What the fit is given: inertias, lengths, pose; its springs and dampers are the true ones."""
    bearings: tuple[str, ...]
    """Where its air bearings sit: "elbow" (the joint), "wrist" (the end of link 2)."""
    q0: Array
    """Release angles, rad; the release is from rest."""
    hidden: tuple[Hidden, ...]
    noise: float
    """Standard deviation of one reading, rad."""
    t: Array
    """s, N."""
    q: Array
    """What the sensors read, rad, N x 2."""
    truth: Array
    """The readings without noise, rad, N x 2."""
    motion: tuple[Array, Array]
    """The joints' true angles (rad) and velocities (rad/s), N x 2 each."""
    torque: Array | None
    """The hidden torque on the left side of Eq. 1 (N m, N x 2); None if only sensors err."""

    @property
    def numbers(self) -> dict[str, float]:
        """Every hidden number by its full name, as in "cubic_stiffness:elbow.coefficient"."""
        return {f"{h.label}.{name}": x for h in self.hidden for name, x in h.values.items()}


def random_hidden(
    rng: np.random.Generator,
    label: str,
    arm: Arm,
    q0: ArrayLike,
    strength: float | None = None,
    *,
    bearings: Sequence[str] = BEARINGS,
    seconds: float = 20.0,
) -> Hidden:
    """An effect that matters on this arm, released at `q0` (rad).

    `strength` is about the share that its torque has in the joint's spring torque at the joint's
    largest swing, or the share of the swing for a sensor; it is drawn from 0.5 % to 10 % if not
    given. An effect that drains or feeds in turn (asymmetric or coupling damping) is capped at
    0.9 of what the arm's dampers can hold.
    """
    return Hidden(label, draw(rng, label, arm, q0, strength, tuple(bearings), seconds))


def prepare(arm: Arm, q0: ArrayLike, hidden: Sequence[Hidden], bearings: Sequence[str]) -> Bench:
    """The arm with all that is hidden in it."""
    labels = [h.label for h in hidden]
    if len(set(labels)) < len(labels):
        raise ValueError("the same effect is hidden twice")
    start = np.broadcast_to(np.asarray(q0, dtype=float), (2,))
    bench = Bench(arm, [float(x) for x in start], bearings)
    for effect in hidden:
        put(bench, effect.label, effect.values)
    bench.finish()
    return bench


def run(bench: Bench, t: ArrayLike) -> Trace:
    """The true motion at the times `t` (s), released at the first of them."""
    system = bench.system()
    rest = [0.0] * (system.joints - 2)
    return trace(
        system,
        t,
        [*bench.q0, *rest],
        frictionloss=[*bench.friction, *rest],
        gravity=bench.gravity,
        torque=bench.applied(),
        memory=bench.memory(),
        limit=bench.limit(),
    )


def record(
    rng: np.random.Generator,
    arm: Arm,
    q0: ArrayLike,
    hidden: Sequence[Hidden],
    *,
    seconds: float = 20.0,
    rate: float = 100.0,
    noise: float = 1e-3,
    noise_share: float | None = None,
    bearings: Sequence[str] = BEARINGS,
) -> HiddenCase:
    """A release of `arm` from rest at `q0` (rad), `rate` in Hz, with all of `hidden` at once.

    A reading is (1 + error) q(t - delay) + offset + noise. With a delay the release comes that much
    before the first sample, so that the first reading is the release; t = 0 is the first sample
    for every effect that knows the time. `noise` is in rad; `noise_share` makes it a share of the
    motion's rms about its mean instead.
    """
    t = np.arange(round(seconds * rate) + 1) / rate
    bench = prepare(arm, q0, hidden, bearings)
    grid, columns = _merged([t - lag for lag in (0.0, *bench.delay)])
    made = run(bench, grid)
    now, *late = columns
    q, v = made.q[now, :2], made.v[now, :2]
    truth = np.stack([made.q[late[j], j] for j in range(2)], axis=1)
    truth = truth * np.array(bench.scale) + np.array(bench.offset)
    if noise_share is not None:
        noise = noise_share * float(np.sqrt(np.mean(np.var(q, axis=0))))
    readings = truth + noise * rng.standard_normal(truth.shape)
    torque = None
    if not all(h.label.startswith("sensor_") for h in hidden):
        torque = missing_torque(arm, q, v, made.a[now, :2])
    return HiddenCase(
        arm=arm,
        bearings=tuple(bearings),
        q0=np.array(bench.q0),
        hidden=tuple(hidden),
        noise=noise,
        t=t,
        q=readings,
        truth=truth,
        motion=(q, v),
        torque=torque,
    )


def _merged(grids: Sequence[Array]) -> tuple[Array, list[Index]]:
    """All times in order, and where to find each grid's; a nanosecond makes no difference."""
    times = np.sort(np.concatenate(grids))
    times = times[np.concatenate([[True], np.diff(times) > 1e-9])]
    middles = 0.5 * (times[1:] + times[:-1])
    return times, [np.searchsorted(middles, grid) for grid in grids]


def missing_torque(arm: Arm, q: Array, v: Array, a: Array) -> Array:
    """What the springs and dampers of `arm` lack along a motion, N m, on the left of Eq. 1."""
    model = mujoco.MjModel.from_xml_string(arm.mjcf())
    data = mujoco.MjData(model)
    out = np.empty_like(q)
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        out[i] = -data.qfrc_inverse
    return out


def hidden_cases(
    rng: np.random.Generator,
    label: str | Sequence[str],
    count: int,
    *,
    noise_share: float = 0.0025,
    strength: float | None = None,
    amplitude: Pair = (0.05, 0.4),
    damping_ratio: Pair | None = None,
    seconds: float = 20.0,
    rate: float = 100.0,
    bearings: Sequence[str] = BEARINGS,
) -> Iterator[HiddenCase]:
    """Random arms with the effect of that label (or several), each of random size."""
    labels = (label,) if isinstance(label, str) else tuple(label)
    if damping_ratio is None:
        sapping = any(x.startswith(("asymmetric_damping", "coupling_damping")) for x in labels)
        damping_ratio = DAMPED if sapping else (0.002, 0.05)
    for _ in range(count):
        arm = random_arm(rng, damping_ratio=damping_ratio)
        q0 = random_release(rng, amplitude)
        hidden = [
            random_hidden(rng, x, arm, q0, strength, bearings=bearings, seconds=seconds)
            for x in labels
        ]
        yield record(
            rng,
            arm,
            q0,
            hidden,
            seconds=seconds,
            rate=rate,
            noise_share=noise_share,
            bearings=bearings,
        )
