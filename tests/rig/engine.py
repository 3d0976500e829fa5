"""Running MuJoCo so that its answer can serve as truth.

Three things need care.

*Order.* MuJoCo's RK4 is of fourth order only if every torque is evaluated inside its stages. A
drive or a hidden torque written into the state once per step would be held constant over it, which
is first order. So the drive enters as an actuator that integrates its own slope (exact for linear
interpolation), and a hidden torque enters through the passive callback, called in every stage.

*Times.* The step is chosen anew for each sampling interval so that a whole number of steps fills
it. Uneven times thus cost no interpolation.

*Jumps.* Where a torque jumps or bends, dry friction first of all, the step is cut: see `stepping`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from .stepping import Advance, Array, Limit, Settle, mujoco

Pair = tuple[float, float]
Torque = Callable[[float, Array, Array], ArrayLike]


@dataclass(frozen=True)
class Setting:
    """How MuJoCo integrates: the step in s, and the number of memory states."""

    step: float = 1e-3
    memories: int = 0


@dataclass(frozen=True)
class Memory:
    """A hidden torque with inner states z, as in hysteresis, on the joints (N m).

    `start` is z at the first time, `rate(t, q, v, z)` its derivative, `torque(t, q, v, z)` the
    torque; both are evaluated inside the RK4 stages. `settle(t, q, v, z)`, if any, is what z
    becomes at the end of a step, for a memory that follows the angle and has no rate of its own.
    """

    start: Sequence[float]
    rate: Callable[[float, Array, Array, Array], ArrayLike]
    torque: Callable[[float, Array, Array, Array], ArrayLike]
    settle: Settle | None = None


@dataclass(frozen=True)
class Trace:
    """A simulated motion."""

    q: Array
    """Angles, rad, N x joints."""
    v: Array
    """Velocities, rad/s, N x joints."""
    a: Array
    """Accelerations, rad/s^2, N x joints; where one jumps, that of the side just reached."""
    z: Array
    """Memories, N x memories."""


class System(Protocol):
    """What can be simulated: the arm or the cart."""

    @property
    def joints(self) -> int: ...

    def fastest(self, gravity: Pair = ...) -> float: ...

    def mjcf(
        self, *, gravity: Pair = ..., frictionloss: Any = ..., setting: Setting | None = ...
    ) -> str: ...


def document(
    world: str,
    joints: Sequence[str],
    gravity: Pair,
    setting: Setting | None = None,
    tendons: str = "",
) -> str:
    """A complete MJCF text around the bodies in `world`, with a torque integrator on each joint."""
    setting = setting or Setting()
    drives = "".join(
        f'<general name="{j} drive" joint="{j}" dyntype="integrator" gainprm="1" biastype="none"/>'
        for j in joints
    )
    # A memory is an actuator state that pushes nothing: its torque comes from the passive callback.
    memories = "".join(
        f'<general name="memory {i}" joint="{joints[0]}" dyntype="user" actdim="1" gainprm="0"/>'
        for i in range(setting.memories)
    )
    return f"""<mujoco>
  <compiler angle="radian" boundmass="0" boundinertia="0" autolimits="true"/>
  <option timestep="{setting.step!r}" integrator="RK4" gravity="{gravity[0]!r} {gravity[1]!r} 0"
          solver="Newton" tolerance="1e-14" iterations="50">
    <flag contact="disable"/>
  </option>
  <default>
    <joint armature="0" springref="0"
           solimpfriction="0.9999 0.9999 0.001 0.5 2" solreffriction="-1 {-1.0 / setting.step!r}"/>
  </default>
  <worldbody>{world}</worldbody>
  <tendon>{tendons}</tendon>
  <actuator>{drives}{memories}</actuator>
</mujoco>"""


def simulate(
    system: System,
    t: ArrayLike,
    q0: ArrayLike,
    v0: ArrayLike = 0.0,
    *,
    frictionloss: ArrayLike = 0.0,
    gravity: Pair = (0.0, 0.0),
    drive: ArrayLike | None = None,
    torque: Torque | None = None,
    memory: Memory | None = None,
    step: float | None = None,
) -> tuple[Array, Array]:
    """Angles (rad) and velocities (rad/s) at the times `t` (s), each N x joints.

    `t` increases, unevenly if need be; its first entry is the release, with the state `q0`, `v0`.
    `frictionloss` is Coulomb torque per joint (N m). `gravity` is the in-plane vector (m/s^2), see
    `HANGING` and `tilt`. `drive` (N x joints, N m) is linear between samples. `torque(t, q, v)`
    returns a hidden torque *on* the joints (N m): a drag is negative. It keeps the fourth order
    while it is smooth; at a jump the order falls to one, so give a smaller `step` (s), which is
    otherwise a fiftieth of the fastest mode's time per radian.

    Errors over 20 s, arms of 0.2 to 5 Hz: some 1e-8 rad, with friction some 3e-8. A release large
    enough to be chaotic multiplies both.
    """
    run = trace(
        system,
        t,
        q0,
        v0,
        frictionloss=frictionloss,
        gravity=gravity,
        drive=drive,
        torque=torque,
        memory=memory,
        step=step,
    )
    return run.q, run.v


def trace(
    system: System,
    t: ArrayLike,
    q0: ArrayLike,
    v0: ArrayLike = 0.0,
    *,
    frictionloss: ArrayLike = 0.0,
    gravity: Pair = (0.0, 0.0),
    drive: ArrayLike | None = None,
    torque: Torque | None = None,
    memory: Memory | None = None,
    limit: Limit | None = None,
    step: float | None = None,
) -> Trace:
    """As `simulate`, with accelerations and memories; `limit` is the longest step a torque bears.

    A torque with jumps or corners keeps its accuracy if its `limit` shortens the step there.
    """
    n = system.joints
    times = np.asarray(t, dtype=float)
    friction = np.broadcast_to(np.asarray(frictionloss, dtype=float), (n,))
    if times.ndim != 1 or np.any(np.diff(times) <= 0.0):
        raise ValueError("t must be one-dimensional and increasing")
    if step is None:
        step = min(0.02 / max(system.fastest(gravity), 1.0), 5e-3)
        if np.any(friction > 0.0):
            step = min(step, 1e-3)
    setting = Setting(step=step, memories=len(memory.start) if memory else 0)
    model = mujoco.MjModel.from_xml_string(
        system.mjcf(gravity=gravity, frictionloss=tuple(friction.tolist()), setting=setting)
    )
    data = mujoco.MjData(model)
    data.time = times[0]
    data.qpos[:] = q0
    data.qvel[:] = v0
    if memory:
        data.act[n:] = memory.start
    loads = None if drive is None else np.asarray(drive, dtype=float).reshape(len(times), n)
    advance = Advance(model, data, friction, limit, memory.settle if memory else None)
    out = Trace(*(np.empty((len(times), k)) for k in (n, n, n, setting.memories)))
    with _callbacks(n, torque, memory):
        mujoco.mj_forward(model, data)
        for i, now in enumerate(times):
            if i:
                span = now - times[i - 1]
                if loads is not None:
                    data.act[:n] = loads[i - 1]
                    data.ctrl[:n] = (loads[i] - loads[i - 1]) / span
                advance(span, max(1, math.ceil(span / step - 1e-9)))
                data.time = now
            out.a[i] = advance.accelerations()
            out.q[i], out.v[i], out.z[i] = data.qpos, data.qvel, data.act[n:]
    return out


@contextmanager
def _callbacks(n: int, torque: Torque | None, memory: Memory | None) -> Iterator[None]:
    """Hidden torques inside MuJoCo's stages.

    The callbacks are global to the process: one simulation at a time, and always taken back.
    """

    def passive(_: Any, data: Any) -> None:
        if torque:
            data.qfrc_passive += np.asarray(torque(data.time, data.qpos, data.qvel), dtype=float)
        if memory:
            data.qfrc_passive += np.asarray(
                memory.torque(data.time, data.qpos, data.qvel, data.act[n:]), dtype=float
            )

    def rate(_: Any, data: Any, index: int) -> float:
        assert memory
        return float(
            np.asarray(memory.rate(data.time, data.qpos, data.qvel, data.act[n:]))[index - n]
        )

    try:
        if torque or memory:
            mujoco.set_mjcb_passive(passive)
        if memory:
            mujoco.set_mjcb_act_dyn(rate)
        yield
    finally:
        mujoco.set_mjcb_passive(None)
        mujoco.set_mjcb_act_dyn(None)
