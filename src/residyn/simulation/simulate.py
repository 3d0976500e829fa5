"""Simulation: fixed steps that resolve the fastest mode, and a smooth curve between them.

A fit calls the simulator hundreds of times with nearly equal numbers, and differentiates it each
time. So the steps are fixed (an adaptive step makes the cost of a bad guess unbounded and the
result jump with the step count), Tsitouras' fifth-order stages are written out so that XLA fuses
them, and readings are taken from a quintic Hermite curve through position, rate and acceleration
at the step ends: the step need not know where the samples lie.
"""

import math
from collections.abc import Sequence
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float, Int

from ..effects import check_own
from ..errors import quote
from ..physics.modal import fastest, not_finite_at_rest, ringing
from ..physics.model import Model, check_model
from ..physics.motion import Joints, Scalar, split
from ..physics.parameter import all_floating
from .dry_friction import sliding
from .equation import Args, Drive, Piecewise, rates
from .integrator import (
    Integrator,
    StickSlip,
    UnrolledTsit5,
    at_nodes,
    integrator_of,
    tuples_of,
)
from .interpolation import Nodes, Trajectory, read
from .stepping import State, dry_step, smooth_step

# Largest step times fastest angular frequency: within 1e-5 rad of MuJoCo over 20 s (tests).
SMOOTH_STEP = 0.3
ROUGH_STEP = 0.2


def march(
    model: Model,
    start,
    stop,
    q0: Float[Array, " n"],
    v0: Float[Array, " n"],
    *,
    steps: int | Int[Array, ""],
    z0: Float[Array, " m"] | None = None,
    drive: Drive | Piecewise | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    room: int | None = None,
    only: Scalar | None = None,
    integrator: Integrator | None = None,
    tighter: Scalar = 1.0,
) -> Nodes:
    """Integrate Eq. 1 over `steps` equal steps. Any number here may be traced, but, without `room`,
    not the steps.

    `z0` is what the internal states hold beyond what their effects begin with. Without `adjoint`
    and `integrator` a plain loop takes the steps, which both forward and reverse mode can
    differentiate, and which compiles and runs quickest. An `integrator` instead integrates with
    `diffrax.diffeqsolve`, its tolerances divided by `tighter`, and the steps are what it leaves
    behind; `adjoint` alone does so with the same steps, and differentiates as that adjoint says.
    With `room` for that many steps, their number may be traced, too, and `only` so many of them are
    taken; what is left behind after them means nothing. That excludes reverse mode.
    """
    start, stop = jnp.asarray(start, float), jnp.asarray(stop, float)
    h = (stop - start) / steps
    y = State(split(jnp.asarray(q0, float)), split(jnp.asarray(v0, float)))
    begin = model.memory_begin(y.motion(start))
    more = (0.0,) * len(begin) if z0 is None else split(z0)
    y = y._replace(z=tuple(jnp.asarray(b + z, float) for b, z in zip(begin, more, strict=True)))

    def during(index) -> Args:
        return Args(model, None if drive is None else drive.during(index))

    def row(y: State, a: Joints):
        return jnp.stack([*y.q, *(h * x for x in y.v), *(h**2 * x for x in a)])

    if adjoint is None and integrator is None:
        step = dry_step if model.dry else smooth_step

        def advance(index, y):
            return step(during(index), start + index * h, h, y)

        if room is None:

            def body(y, index):
                end, a = advance(index, y)
                return end, row(y, a)

            last, ends = jax.lax.scan(body, y, jnp.arange(steps))
            rest = _acceleration_at(during(steps - 1), stop, last)
            return Nodes(start, h, steps, jnp.concatenate([ends, row(last, rest)[None]]))

        stop_at = steps if only is None else only

        def fill(index, carry):
            y, ends = carry
            end, a = advance(index, y)
            return end, jax.lax.dynamic_update_index_in_dim(ends, row(y, a), index, 0)

        empty = jnp.zeros((room + 1, 3 * len(y.q)))
        last, ends = jax.lax.fori_loop(0, stop_at, fill, (y, empty))
        rest = _acceleration_at(during(stop_at - 1), start + stop_at * h, last)
        return Nodes(start, h, steps, ends.at[stop_at].set(row(last, rest)))
    size = steps if room is None else room
    assert isinstance(size, int), "the number of nodes is compiled in"
    index = jnp.arange(size + 1)
    last = steps if only is None else jnp.minimum(only, steps)
    nodes = start + h * index  # those behind the last one are copies of it
    nodes = jnp.minimum(nodes, jax.lax.stop_gradient(nodes)[last])
    if integrator is None:
        integrator = Integrator(StickSlip() if model.dry else UnrolledTsit5())
    integrator.check(model)
    if adjoint is None:
        adjoint = integrator.adjoint or diffrax.ForwardMode()
    found = at_nodes(integrator, Args(model, drive), y, nodes, adjoint, tighter)  # pyrefly: ignore

    def told(index, t, *arrays):
        here = tuples_of(arrays)
        return row(here, _acceleration_at(during(jnp.minimum(index, last - 1)), t, here))

    return Nodes(start, h, steps, jax.vmap(told)(index, nodes, *found))


def _acceleration_at(args: Args, t, y: State) -> Joints:
    motion = y.motion(t)
    if not args.model.dry:
        return rates(args, motion)[0]
    sticking = sliding(args, motion)
    return rates(args, motion._replace(direction=sticking.direction), sticking.held)[0]


def steps_for(model: Model, duration: float, frequency: float | None = None) -> int:
    """How many steps resolve the fastest mode over a duration in s (concrete numbers only).

    **Raises:** `ValueError` where the model has none, as a torque or its slope is infinite at rest.
    """
    fast = fastest(model) if frequency is None else frequency
    if not math.isfinite(fast):
        raise ValueError(
            f"{not_finite_at_rest(model)}, so that no mode says how short steps must be: give "
            "their number, steps="
        )
    size = ROUGH_STEP if model.rough else SMOOTH_STEP
    # Without stiffness there is no mode to resolve; sixteen steps still follow any drift.
    return max(16, math.ceil(duration * fast / size))


def simulate(
    model: Model,
    times: ArrayLike | Sequence[float],
    q0: ArrayLike | Sequence[float],
    v0: ArrayLike | Sequence[float] | None = None,
    *,
    z0: ArrayLike | Sequence[float] | None = None,
    drive: Drive | None = None,
    steps: int | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    integrator: Integrator | diffrax.AbstractSolver | str | None = None,
    orders: Sequence[int] = (),
) -> Trajectory:
    """Motion of a model from the state (q0, v0) at `times[0]`.

    **Arguments:**

    - `times`: (N,) s, increasing; need not be even.
    - `q0`, `v0`: (n,) rad and rad/s (or m and m/s) at the first time; `v0` None is at rest.
    - `z0`: (m,) internal states of the model at the first time (`model.memory` names them), beyond
      what their effects begin with; None is nothing beyond.
    - `drive`: external torque on the joints.
    - `steps`: number of integration steps; None chooses from the fastest mode, which needs concrete
      numbers: give it inside `jax.jit`, `grad` or `vmap` of the model's numbers. With steps too
      long for the fastest mode the motion runs away; `residyn.steps_for` says how many resolve it.
    - `adjoint`: how to differentiate. None: with fixed steps, forward and reverse mode both work;
      with an `integrator` its own adjoint, or else reverse mode. Or a diffrax adjoint, such as
      `diffrax.ForwardMode()`, or `diffrax.RecursiveCheckpointAdjoint()` for the least memory in
      reverse mode.
    - `integrator`: "fixed" steps (None); or a solver of diffrax, by name ("Tsit5", "Dopri8",
      "Kvaerno5"), as an instance, or as an `Integrator` with tolerances of its own. `steps` is then
      how many nodes the curve goes through from which readings are taken; between two nodes the
      solver steps as it needs.
    - `orders`: (n,) which derivative of its angle the sensor of each joint reads: 0, an encoder; 1,
      a gyroscope; 2, an accelerometer. () is angles.

    **Returns:** a `Trajectory`. Where the motion runs away, as `steps` are too few or the model
    gains energy without bound, its numbers grow and then are not finite, without an error, which
    no traced call could raise: look at `jnp.isfinite(trajectory.q).all()`.

    **Raises:** `ValueError` for arrays of other shapes or not finite, numbers of the model
    included, for instants that are not finite and increasing, two at least, for `steps` or `orders`
    that there cannot be, or if `steps` is needed and cannot be chosen; `TypeError` for what is no
    model or no drive; `InputError` for an integrator that does not exist or cannot integrate an
    effect of the model, and for a law of your own with a mistake. What is traced is checked for its
    shape alone.
    """
    check_model(model)
    check_own(model.effects, model.mechanism)
    joints = model.mechanism.joints
    q0 = jnp.asarray(q0, float)
    v0 = jnp.zeros_like(q0) if v0 is None else jnp.asarray(v0, float)
    z0 = None if z0 is None else jnp.asarray(z0, float)
    states = [m.name for m in model.memory]
    for words, given, each, names in (
        ("q0", q0, "joint", joints),
        ("v0", v0, "joint", joints),
        ("z0", z0, "internal state", states),
    ):
        if given is not None and given.shape != (len(names),):
            raise ValueError(
                f"{words} has shape {given.shape}; it must have a number for each {each}: "
                f"{', '.join(names) or 'none'}"
            )
        known = given is not None and not isinstance(given, Tracer)
        if known and not np.isfinite(given).all():
            raise ValueError(f"{words} = {np.asarray(given)}: all numbers must be finite")
    t = jnp.asarray(times, float)
    instants = _instants(times, t.shape)
    orders = _orders(orders, joints)
    if drive is not None:
        _check_drive(drive, joints)
    chosen = integrator_of(integrator)
    if chosen is not None:
        adjoint = adjoint or chosen.adjoint or diffrax.RecursiveCheckpointAdjoint()
    if steps is None:
        spacing = None if drive is None else drive.spacing
        if instants is None or any(
            isinstance(x, Tracer) for x in jax.tree.leaves((model, spacing))
        ):
            raise ValueError(
                "the number of steps cannot depend on traced numbers: give steps=, "
                "for example residyn.steps_for(model, duration) of a typical model"
            )
        with jax.ensure_compile_time_eval():
            duration = float(instants[-1] - instants[0])
            fast = ringing(model) if chosen is not None and chosen.adapts else None
            steps = steps_for(model, duration, fast)
        if spacing is not None:
            steps = max(steps, math.ceil(duration / float(spacing)))
    count = _count(steps)
    how = {"steps": count, "z0": z0, "drive": drive, "adjoint": adjoint, "integrator": chosen}
    return _motion(all_floating(model), t, q0, v0, how, orders)


def _instants(times: Any, shape: tuple[int, ...]) -> np.ndarray | None:
    """The instants, an array of this shape; None if any is traced.

    **Raises:** `ValueError` as `simulate`.
    """
    if len(shape) != 1:
        raise ValueError(f"times has shape {shape}; it must be (N,)")
    if shape[0] < 2:
        raise ValueError(f"times has {shape[0]} instants; it must have two at least")
    if any(isinstance(x, Tracer) for x in jax.tree.leaves(times)):
        return None
    found = np.asarray(times, float)
    if not np.isfinite(found).all():
        raise ValueError("times: all instants must be finite")
    if not (np.diff(found) > 0).all():
        raise ValueError("times must increase from each instant to the next")
    return found


def _count(steps: Any) -> int:
    """**Raises:** `ValueError` for what is no number of steps."""
    if isinstance(steps, Tracer):
        raise ValueError("steps is traced: their number is compiled in, and must be a plain number")
    whole = not isinstance(steps, str | bool) and np.shape(steps) == ()
    if not whole or not 1 <= (size := float(steps)) < math.inf or size % 1:
        raise ValueError(f"steps = {quote(steps)}: must be a whole number, at least one")
    return int(steps)


def _orders(orders: Sequence[int], joints: Sequence[str]) -> tuple[int, ...]:
    """**Raises:** `ValueError` for what are no orders of the joints' derivatives."""
    found = tuple(np.atleast_1d(orders).tolist())
    if len(found) not in (0, len(joints)) or any(x not in (0, 1, 2) for x in found):
        raise ValueError(
            f"orders = {quote(orders)}: must be 0, 1 or 2 for each of {', '.join(joints)}; or ()"
        )
    return tuple(map(int, found))


def _check_drive(drive: Any, joints: Sequence[str]) -> None:
    """**Raises:** `TypeError`, `ValueError` for what is no drive of the joints."""
    if not isinstance(drive, Drive):
        raise TypeError(
            f"{type(drive).__name__} is no drive: residyn.Drive(start, spacing, values) is"
        )
    for words, x, right in (("start", drive.start, ()), ("spacing", drive.spacing, ())):
        if jnp.shape(x) != right:
            raise ValueError(f"drive: {words} has shape {jnp.shape(x)}; it must be a number, s")
    shape, n = jnp.shape(drive.values), len(joints)
    if len(shape) != 2 or shape[0] < 1 or shape[1] != n:
        raise ValueError(
            f"drive: values has shape {shape}; it must be (M, {n}), a torque on each joint: "
            f"{', '.join(joints)}"
        )
    if not isinstance(drive.spacing, Tracer) and not 0 < float(drive.spacing) < math.inf:
        raise ValueError(f"drive: spacing = {float(drive.spacing):g}: must be positive, s")


@eqx.filter_jit  # else each of its operations is compiled by itself
def _motion(model: Model, times, q0, v0, how: dict[str, Any], orders: Sequence[int]) -> Trajectory:
    nodes = march(model, times[0], times[-1], q0, v0, **how)
    return read(model, nodes, times, orders)
