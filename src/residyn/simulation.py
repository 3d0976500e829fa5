"""Simulation: fixed steps that resolve the fastest mode, and a smooth curve between them.

A fit calls the simulator hundreds of times with nearly equal numbers, and differentiates it each
time. So the steps are fixed (an adaptive step makes the cost of a bad guess unbounded and the
result jump with the step count), Tsitouras' fifth-order stages are written out so that XLA fuses
them, and readings are taken from a quintic Hermite curve through position, rate and acceleration
at the step ends: the step need not know where the samples lie.

Dry friction breaks smoothness where a joint reverses. `StickSlip` holds the direction of sliding
fixed inside a step, finds the instant of reversal on the step's own cubic, and corrects the rest of
the step for the torque that changed sign there, or stops the joint if friction can hold it. It is
exact to the order that matters, costs nearly what a smooth step costs, and differentiates.
"""

import math
from collections.abc import Sequence
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from .equation import Args, Drive, Piecewise, rates
from .modal import fastest
from .model import Model
from .motion import Joints, Scalar, split, stack
from .nodes import Nodes, Trajectory, read
from .stepping import State, dry_step, smooth_step
from .stick_slip import sliding

# Largest step times fastest angular frequency: within 1e-5 rad of MuJoCo over 20 s (tests).
SMOOTH_STEP = 0.3
ROUGH_STEP = 0.2


class UnrolledTsit5(diffrax.AbstractSolver):
    """Tsitouras 5(4) with its stages written out and no error estimate, for fixed steps.

    For diffrax: `y = (q, v, z)`, and the args of the solve are what `march` passes.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 5

    def init(self, terms, t0, t1, y0, args):
        return None

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        y1 = _arrays(self.advance(args, t0, t1 - t0, _tuples(y0))[0])
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful

    def advance(self, args, t, h, y: State) -> tuple[State, Joints]:
        """One step: its end, and the acceleration at its beginning."""
        return smooth_step(args, t, h, y)


class StickSlip(UnrolledTsit5):
    """`UnrolledTsit5` for joints with dry friction: see the module's first words."""

    def advance(self, args, t, h, y):
        return dry_step(args, t, h, y)


def _arrays(y: State) -> tuple[Array, Array, Array]:
    return stack(y.q), stack(y.v), stack(y.z) if y.z else jnp.zeros(0)


def _tuples(y) -> State:
    return State(*map(split, y))


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
) -> Nodes:
    """Integrate Eq. 1 over `steps` equal steps. Any number here may be traced, but, without `room`,
    not the steps.

    `z0` is what the internal states hold beyond what their effects begin with. `adjoint` None steps
    the solver in a plain `lax.scan`, which both forward and reverse mode can differentiate, and
    which compiles and runs quickest. A diffrax adjoint instead integrates with
    `diffrax.diffeqsolve` and differentiates as that adjoint says. With `room` for that many steps,
    their number may be traced, too, and `only` so many of them are taken; zeros are left behind.
    That excludes reverse mode.
    """
    start, stop = jnp.asarray(start, float), jnp.asarray(stop, float)
    h = (stop - start) / steps
    solver = StickSlip() if model.dry else UnrolledTsit5()
    y = State(split(jnp.asarray(q0, float)), split(jnp.asarray(v0, float)))
    begin = model.memory_begin(y.motion(start))
    more = (0.0,) * len(begin) if z0 is None else split(z0)
    y = y._replace(z=tuple(jnp.asarray(b + z, float) for b, z in zip(begin, more, strict=True)))

    def during(index) -> Args:
        return Args(model, None if drive is None else drive.during(index))

    def row(y: State, a: Joints):
        return jnp.stack([*y.q, *(h * x for x in y.v), *(h**2 * x for x in a)])

    if adjoint is None:

        def advance(index, y):
            return solver.advance(during(index), start + index * h, h, y)

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
    assert isinstance(steps, int), "diffrax compiles the number of steps in"
    args = during(0)
    nodes = start + h * jnp.arange(steps + 1)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_vector_field),  # pyright: ignore[reportArgumentType]
        solver,
        nodes[0],
        nodes[-1],
        None,
        _arrays(y),
        args=args,
        saveat=diffrax.SaveAt(t0=True, steps=True),
        stepsize_controller=diffrax.StepTo(ts=nodes),
        adjoint=adjoint,
        max_steps=steps,
        throw=False,
    )
    assert solution.ys is not None

    def told(t, *arrays):
        here = _tuples(arrays)
        return row(here, _acceleration_at(args, t, here))

    return Nodes(start, h, steps, jax.vmap(told)(nodes, *solution.ys))


def _vector_field(t, y, args: Args):
    motion = _tuples(y).motion(t)
    a, z = rates(args, motion)
    return _arrays(State(motion.v, a, z))


def _acceleration_at(args: Args, t, y: State) -> Joints:
    motion = y.motion(t)
    if not args.model.dry:
        return rates(args, motion)[0]
    sticking = sliding(args, motion)
    return rates(args, motion._replace(direction=sticking.direction), sticking.held)[0]


def steps_for(model: Model, duration: float, frequency: float | None = None) -> int:
    """How many steps resolve the fastest mode over a duration in s (concrete numbers only)."""
    fast = fastest(model) if frequency is None else frequency
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
) -> Trajectory:
    """Motion of a model from the state (q0, v0) at `times[0]`.

    **Arguments:**

    - `times`: (N,) s, increasing; need not be even.
    - `q0`, `v0`: (n,) rad and rad/s (or m and m/s) at the first time; `v0` None is at rest.
    - `z0`: (m,) internal states of the model at the first time (`model.memory` names them), beyond
      what their effects begin with; None is nothing beyond.
    - `drive`: external torque on the joints.
    - `steps`: number of integration steps; None chooses from the fastest mode, which needs concrete
      numbers: give it inside `jax.jit`, `grad` or `vmap` of the model's numbers.
    - `adjoint`: how to differentiate. None: forward and reverse mode both work. Or a diffrax
      adjoint, such as `diffrax.RecursiveCheckpointAdjoint()` for the least memory in reverse mode.

    **Returns:** a `Trajectory`.

    **Raises:** `ValueError` if `steps` is needed and cannot be chosen.
    """
    times = jnp.asarray(times, float)
    q0 = jnp.asarray(q0, float)
    v0 = jnp.zeros_like(q0) if v0 is None else jnp.asarray(v0, float)
    if steps is None:
        try:
            steps = steps_for(model, float(times[-1] - times[0]))
        except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError):
            raise ValueError(
                "the number of steps cannot depend on traced numbers: give steps=, "
                "for example residyn.steps_for(model, duration) of a typical model"
            ) from None
        if drive is not None:
            steps = max(steps, math.ceil(float((times[-1] - times[0]) / drive.spacing)))
    z0 = None if z0 is None else jnp.asarray(z0, float)
    nodes = march(
        model, times[0], times[-1], q0, v0, steps=steps, z0=z0, drive=drive, adjoint=adjoint
    )
    return read(model, nodes, times)
