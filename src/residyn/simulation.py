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
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .equation import Args, Drive, Piecewise, acceleration, signs
from .modal import state_matrix
from .model import Model
from .motion import Joints, Scalar, split, stack
from .stick_slip import break_away, reversals, sliding

# Largest step times fastest angular frequency: within 1e-5 rad of MuJoCo over 20 s (tests).
SMOOTH_STEP = 0.3
DRY_STEP = 0.15


class Trajectory(NamedTuple):
    """Simulated motion: `t` (N,) s, `q` (N, n) rad or m, `v` (N, n)."""

    t: Float[Array, " N"]
    q: Float[Array, "N n"]
    v: Float[Array, "N n"]


def _vector_field(t, y, args: Args):
    q, v = map(split, y)
    return y[1], stack(acceleration(args, t, q, v, signs(v)))


_TABLEAU = diffrax.Tsit5.tableau
_NODES = (0.0, *map(float, _TABLEAU.c))
_ROWS = tuple(tuple(map(float, row)) for row in _TABLEAU.a_lower[:-1])
_WEIGHTS = tuple(map(float, _TABLEAU.b_sol[:-1]))


def _tsit5(acceleration, t, h, q, v):
    """Tsitouras' six stages of q'' = acceleration(t, q, v), written out.

    Everything is a tuple of scalars here: XLA keeps those in registers, where it would copy arrays.

    **Returns:** (q, v) at the end of the step, and the acceleration at its first and last stage.
    """
    rates = [(v, acceleration(t, q, v))]
    for row, node in zip(_ROWS, _NODES[1:], strict=False):
        q_stage, v_stage = _advance(q, v, h, row, rates)
        rates.append((v_stage, acceleration(t + node * h, q_stage, v_stage)))
    return _advance(q, v, h, _WEIGHTS, rates), rates[0][1], rates[-1][1]


def _advance(q, v, h, weights, rates):
    used = [(h * w, r) for w, r in zip(weights, rates, strict=False) if w != 0.0]
    return tuple(
        tuple(x + sum(w * rate[part][i] for w, rate in used) for i, x in enumerate(y))
        for part, y in enumerate((q, v))
    )


@jax.jit
def _smooth_step(args: Args, t, h, q, v):
    """One step: its end, and the acceleration at its beginning. All tuples of scalars."""
    end, first, _ = _tsit5(lambda t, q, v: acceleration(args, t, q, v, signs(v)), t, h, q, v)
    return end, first


@jax.jit
def _dry_step(args: Args, t, h, q, v):
    """`_smooth_step` for joints that may reverse or stick inside the step."""
    direction, held = sliding(args, t, q, v)
    (q1, v1), first, last = _tsit5(
        lambda t, q, v: acceleration(args, t, q, v, direction, held), t, h, q, v
    )
    v1 = tuple(jnp.where(stuck > 0, 0.0, x) for x, stuck in zip(v1, held, strict=True))
    # The last stage stands at the end of the step.
    q2, v2 = reversals(args, t, h, (q, v, first), (q1, v1, last), direction, held)
    return break_away(args, t, h, q, q2, v2, held), first


class UnrolledTsit5(diffrax.AbstractSolver):
    """Tsitouras 5(4) with its stages written out and no error estimate, for fixed steps.

    For diffrax: `y = (q, v)`, and the args of the solve are what `march` passes.
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
        (q, v), _ = self.advance(args, t0, t1 - t0, *map(split, y0))
        y1 = stack(q), stack(v)
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful

    def advance(self, args, t, h, q, v):
        """One step from (q, v): its end, and the acceleration at its beginning."""
        return _smooth_step(args, t, h, q, v)


class StickSlip(UnrolledTsit5):
    """`UnrolledTsit5` for joints with dry friction: see the module's first words."""

    def advance(self, args, t, h, q, v):
        return _dry_step(args, t, h, q, v)


class Nodes(NamedTuple):
    """The motion at the ends of the steps: `start` s, `h` s, and (steps + 1, n) arrays."""

    start: Float[Array, ""]
    h: Float[Array, ""]
    q: Float[Array, "M n"]
    v: Float[Array, "M n"]
    a: Float[Array, "M n"]


def march(
    model: Model,
    start,
    stop,
    q0: Float[Array, " n"],
    v0: Float[Array, " n"],
    *,
    steps: int,
    drive: Drive | Piecewise | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    only: Scalar | None = None,
) -> Nodes:
    """Integrate Eq. 1 over `steps` equal steps. Any number here may be traced, `steps` may not.

    `adjoint` None steps the solver in a plain `lax.scan`, which both forward and reverse mode can
    differentiate, and which compiles and runs quickest. A diffrax adjoint instead integrates with
    `diffrax.diffeqsolve` and differentiates as that adjoint says. `only` (which may be traced)
    stops after that many steps and leaves zeros behind; it excludes reverse mode.
    """
    start, stop = jnp.asarray(start, float), jnp.asarray(stop, float)
    h = (stop - start) / steps
    solver = StickSlip() if model.dry else UnrolledTsit5()
    y0 = jnp.asarray(q0, float), jnp.asarray(v0, float)

    def during(index) -> Args:
        return Args(model, None if drive is None else drive.during(index))

    if adjoint is None:

        def advance(index, y):
            return solver.advance(during(index), start + index * h, h, *y)

        y = tuple(map(split, y0))
        if only is None:

            def body(y, index):
                end, a = advance(index, y)
                return end, (*y, a)

            last, path = jax.lax.scan(body, y, jnp.arange(steps))
            path = jax.tree.map(lambda x: jnp.append(x, 0.0), path)
        else:

            def fill(index, carry):
                y, path = carry
                end, a = advance(index, y)
                put = jax.tree.map(lambda row, x: row.at[index].set(x), path, (*y, a))
                return end, put

            empty = jax.tree.map(lambda _: jnp.zeros(steps + 1), (*y, y[0]))
            last, path = jax.lax.fori_loop(0, only, fill, (y, empty))
        end = steps if only is None else only
        rest = _acceleration_at(during(end - 1), start + end * h, *last)
        path = jax.tree.map(lambda row, x: row.at[end].set(x), path, (*last, rest))
        return Nodes(start, h, *(jnp.stack(columns, axis=1) for columns in path))
    args = during(0)
    nodes = start + h * jnp.arange(steps + 1)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_vector_field),  # pyright: ignore[reportArgumentType]
        solver,
        nodes[0],
        nodes[-1],
        None,
        y0,
        args=args,
        saveat=diffrax.SaveAt(t0=True, steps=True),
        stepsize_controller=diffrax.StepTo(ts=nodes),
        adjoint=adjoint,
        max_steps=steps,
        throw=False,
    )
    assert solution.ys is not None
    q, v = solution.ys
    a = jax.vmap(lambda t, q, v: stack(_acceleration_at(args, t, split(q), split(v))))(nodes, q, v)
    return Nodes(start, h, q, v, a)


def _acceleration_at(args: Args, t, q: Joints, v: Joints) -> Joints:
    if not args.model.dry:
        return acceleration(args, t, q, v, signs(v))
    return acceleration(args, t, q, v, *sliding(args, t, q, v))


def read(nodes: Nodes, times: Float[Array, " N"]) -> Trajectory:
    """Motion at any times: quintic Hermite between the nodes (error about (w h)^6 / 46080)."""
    place = (times - nodes.start) / nodes.h
    index = jnp.clip(jnp.floor(place).astype(int), 0, nodes.q.shape[0] - 2)
    curve = [c[index] for c in _curves(nodes)]
    s = (place - index)[:, None]
    rate = _polynomial([k * c for k, c in enumerate(curve)][1:], s) / nodes.h
    return Trajectory(times, _polynomial(curve, s), rate)


def read_slots(nodes: Nodes, place: Float[Array, "M m"]) -> Float[Array, "M m n"]:
    """Positions at `place` (0 to 1) of each of the M steps: `read` for a fit, without look-ups."""
    return _polynomial([c[:, None, :] for c in _curves(nodes)], place[:, :, None])


def _curves(nodes: Nodes) -> list[Float[Array, "M n"]]:
    """Coefficients of each step's quintic in s, which runs from 0 to 1 along the step."""
    h = nodes.h
    (q0, q1), (v0, v1), (a0, a1) = ((x[:-1], x[1:]) for x in (nodes.q, h * nodes.v, h**2 * nodes.a))
    # Taylor at the left end, and three higher powers matched to the right end.
    rest, slope, bend = q1 - q0 - v0 - a0 / 2, v1 - v0 - a0, a1 - a0
    return [
        q0,
        v0,
        a0 / 2,
        10 * rest - 4 * slope + bend / 2,
        -15 * rest + 7 * slope - bend,
        6 * rest - 3 * slope + bend / 2,
    ]


def _polynomial(coefficients, s):
    total = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + s * total
    return total


def fastest(model: Model) -> float:
    """Largest angular frequency of the linearised model, rad/s (concrete numbers only)."""
    matrix = np.asarray(compiled_state_matrix(model))
    return float(np.abs(np.linalg.eigvals(matrix)).max()) if np.isfinite(matrix).all() else np.inf


compiled_state_matrix = eqx.filter_jit(state_matrix)


def steps_for(model: Model, duration: float, frequency: float | None = None) -> int:
    """How many steps resolve the fastest mode over a duration in s (concrete numbers only)."""
    fast = fastest(model) if frequency is None else frequency
    size = DRY_STEP if model.dry else SMOOTH_STEP
    # Without stiffness there is no mode to resolve; sixteen steps still follow any drift.
    return max(16, math.ceil(duration * fast / size))


def simulate(
    model: Model,
    times: ArrayLike | Sequence[float],
    q0: ArrayLike | Sequence[float],
    v0: ArrayLike | Sequence[float] | None = None,
    *,
    drive: Drive | None = None,
    steps: int | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
) -> Trajectory:
    """Motion of a model from the state (q0, v0) at `times[0]`.

    **Arguments:**

    - `times`: (N,) s, increasing; need not be even.
    - `q0`, `v0`: (n,) rad and rad/s (or m and m/s) at the first time; `v0` None is at rest.
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
    nodes = march(model, times[0], times[-1], q0, v0, steps=steps, drive=drive, adjoint=adjoint)
    return read(nodes, times)
