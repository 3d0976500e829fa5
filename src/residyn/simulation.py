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

from .modal import state_matrix
from .model import Model, solve_inertia
from .motion import Joints, Motion, Scalar, split, stack
from .parameter import floating

# Largest step times fastest angular frequency. Measured on random arms (benchmarks/accuracy.py).
SMOOTH_STEP = 0.3
DRY_STEP = 0.15


class Trajectory(NamedTuple):
    """Simulated motion: `t` (N,) s, `q` (N, n) rad or m, `v` (N, n)."""

    t: Float[Array, " N"]
    q: Float[Array, "N n"]
    v: Float[Array, "N n"]


class Drive(eqx.Module):
    """External torque on a uniform grid, joined by straight lines.

    `values` (M, n) in N m (or N) at `start + spacing * arange(M)`; constant beyond the ends.
    """

    start: Float[Array, ""] = eqx.field(converter=floating)
    spacing: Float[Array, ""] = eqx.field(converter=floating)
    values: Float[Array, "M n"] = eqx.field(converter=floating)

    def __call__(self, t: Scalar) -> Joints:
        """Torque on each joint at an instant."""
        last = self.values.shape[0] - 1
        place = jnp.clip((t - self.start) / self.spacing, 0.0, last)
        index = jnp.clip(jnp.floor(place).astype(int), 0, last - 1)
        part = place - index
        return split((1.0 - part) * self.values[index] + part * self.values[index + 1])

    def during(self, index) -> "Drive":
        """The torque during one integration step."""
        return self


class Piecewise(eqx.Module):
    """External torque that is a straight line within each of M integration steps.

    `left` and `right` (M, n) in N m (or N): its values at the ends of the steps, where it may jump.
    """

    start: Float[Array, ""] = eqx.field(converter=floating)
    spacing: Float[Array, ""] = eqx.field(converter=floating)
    left: Float[Array, "M n"] = eqx.field(converter=floating)
    right: Float[Array, "M n"] = eqx.field(converter=floating)

    def during(self, index) -> Drive:
        """The torque during one integration step."""
        values = jnp.stack([self.left[index], self.right[index]])
        return Drive(self.start + index * self.spacing, self.spacing, values)


class _Args(NamedTuple):
    model: Model
    drive: Drive | None


@jax.jit  # traced once for all stages of all steps: tracing is most of a first fit's cost
def _acceleration(args: _Args, t, q, v, direction, held=None):
    drive = None if args.drive is None else args.drive(t)
    return args.model.acceleration(Motion(t, q, v, direction), drive, held)


def _vector_field(t, y, args: _Args):
    q, v = map(split, y)
    return y[1], stack(_acceleration(args, t, q, v, _signs(v)))


def _signs(v: Joints) -> Joints:
    return tuple(jnp.sign(x) for x in v)


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
def _smooth_step(args: _Args, t, h, q, v):
    """One step: its end, and the acceleration at its beginning. All tuples of scalars."""
    end, first, _ = _tsit5(lambda t, q, v: _acceleration(args, t, q, v, _signs(v)), t, h, q, v)
    return end, first


@jax.jit
def _dry_step(args: _Args, t, h, q, v):
    """`_smooth_step` for joints that may reverse or stick inside the step."""
    direction, held = sliding(args, t, q, v)
    (q1, v1), first, last = _tsit5(
        lambda t, q, v: _acceleration(args, t, q, v, direction, held), t, h, q, v
    )
    v1 = tuple(jnp.where(stuck > 0, 0.0, x) for x, stuck in zip(v1, held, strict=True))
    # The last stage stands at the end of the step.
    q2, v2 = _reversals(args, t, h, (q, v, first), (q1, v1, last), direction, held)
    return _break_away(args, t, h, q, q2, v2, held), first


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


def _friction(args: _Args, t, q: Joints, v: Joints) -> list[Scalar | None]:
    """Half the jump of each joint's torque where its direction flips; None without dry friction."""
    bodies, n = args.model.bodies, len(q)
    level: list[Scalar | None] = [None] * n
    for effect in args.model.effects:
        if not effect.dry:
            continue
        signs = _signs(v)
        for joint in range(n):
            up, down = (
                effect.torque(Motion(t, q, v, (*signs[:joint], s, *signs[joint + 1 :])), bodies)
                for s in (1.0, -1.0)
            )
            if not isinstance(up[joint], float):  # a plain 0.0: the effect leaves this joint alone
                known = level[joint]
                more = 0.5 * (up[joint] - down[joint])
                level[joint] = more if known is None else known + more
    return level


def sliding(args: _Args, t, q: Joints, v: Joints) -> tuple[Joints, Joints]:
    """Direction of sliding of each joint, and 1 for those that friction holds at rest."""
    level = _friction(args, t, q, v)
    # Joints at rest: what would they do if nothing held them?
    free = _acceleration(args, t, q, v, _signs(v))
    direction, held = [], []
    for joint, limit in enumerate(level):
        if limit is None:
            direction.append(jnp.sign(v[joint]))
            held.append(0.0)
            continue
        rests = v[joint] == 0.0
        # Torque that would keep it at rest.
        push = jnp.abs(free[joint] / _mobility(args, q, joint)[joint])
        direction.append(jnp.where(rests, jnp.sign(free[joint]), jnp.sign(v[joint])))
        held.append(jnp.where(rests & (limit > 0) & (push <= limit), 1.0, 0.0))
    return tuple(direction), tuple(held)


def _mobility(args: _Args, q: Joints, joint: int) -> Joints:
    """A column of Z^-1: acceleration of every joint per unit torque on one."""
    unit = tuple(1.0 if i == joint else 0.0 for i in range(len(q)))
    return solve_inertia(args.model.bodies.mass_matrix(q), unit)


def _reversals(args: _Args, t, h, begin, end, direction, held) -> tuple[Joints, Joints]:
    """The end of the step, corrected for joints which came to rest inside it."""
    (q0, v0, a0), (q1, v1, a1) = begin, end
    level = _friction(args, t + h, q1, direction)
    q, v = q1, v1
    for j, limit in enumerate(level):
        if limit is None:
            continue
        column = _mobility(args, q1, j)
        crosses = (held[j] == 0) & (v0[j] != 0.0) & (v1[j] * direction[j] < 0.0)
        share = _root(v0[j], v1[j], h * a0[j], h * a1[j])
        rest = (1.0 - share) * h
        slowing = a0[j] + share * (a1[j] - a0[j])
        sticks = crosses & (jnp.abs(slowing) <= 2.0 * column[j] * limit)
        # Torque change after the reversal: the friction flips, or takes what holds the joint, which
        # runs from `slowing` to the end's a1; its mean counts for v, its first moment for q.
        flip = 2.0 * limit * direction[j]
        for_v = jnp.where(sticks, -0.5 * (slowing + a1[j]) / column[j], flip)
        for_q = jnp.where(sticks, -(2.0 * slowing + a1[j]) / 3.0 / column[j], flip)
        dq = tuple(jnp.where(crosses, 0.5 * rest**2 * for_q, 0.0) * c for c in column)
        dv = tuple(jnp.where(crosses, rest * for_v, 0.0) * c for c in column)
        # The springs answer to dq, which grows as the square of the time since the reversal:
        # integrated once and twice, their answer at the end counts 1/3 and 1/12.
        answer = _acceleration(args, t + h, _plus(q1, dq), v1, direction, held)
        answer = tuple(jnp.where(crosses, x - y, 0.0) for x, y in zip(answer, a1, strict=True))
        q = _plus(q, dq, tuple(rest**2 / 12.0 * x for x in answer))
        v = _plus(v, dv, tuple(rest / 3.0 * x for x in answer))
        stop = _hermite3(share, q0[j], q1[j], h * v0[j], h * v1[j])
        q = tuple(jnp.where(sticks, stop, x) if i == j else x for i, x in enumerate(q))
        v = tuple(jnp.where(sticks, 0.0, x) if i == j else x for i, x in enumerate(v))
    return q, v


def _break_away(args: _Args, t, h, begin: Joints, q, v, held) -> tuple[Joints, Joints]:
    """The end of the step, corrected for joints that friction could no longer hold inside it."""
    free = {
        "begin": _acceleration(args, t, begin, v, _signs(v)),
        "end": _acceleration(args, t + h, q, v, _signs(v)),
    }
    for j, limit in enumerate(_friction(args, t + h, q, v)):
        if limit is None:
            continue
        column = _mobility(args, q, j)
        before, after = (jnp.abs(free[when][j] / column[j]) for when in ("begin", "end"))
        excess = jnp.where(held[j] > 0, jnp.maximum(after - limit, 0.0), 0.0)
        grown = jnp.where(excess > 0, after - before, 1.0)
        rest = h * jnp.clip(excess / grown, 0.0, 1.0)
        # From then on the torque that is not held grows in proportion to time.
        kick = tuple(c * excess * jnp.sign(free["end"][j]) for c in column)
        q = _plus(q, tuple(rest**2 / 6.0 * k for k in kick))
        v = _plus(v, tuple(rest / 2.0 * k for k in kick))
    return q, v


def _plus(*terms: Joints) -> Joints:
    return tuple(sum(parts[1:], parts[0]) for parts in zip(*terms, strict=True))


def _root(v0, v1, d0, d1):
    """Where in [0, 1] the cubic with ends v0, v1 and slopes d0, d1 is zero, if the ends differ."""
    gap = v0 - v1
    share = jnp.clip(v0 / jnp.where(gap == 0.0, 1.0, gap), 0.0, 1.0)
    for _ in range(3):
        value = _hermite3(share, v0, v1, d0, d1)
        slope = _hermite3_slope(share, v0, v1, d0, d1)
        # Only a slope of the crossing's own sign can be trusted.
        good = slope * gap < 0.0
        share = jnp.clip(
            share - jnp.where(good, value / jnp.where(good, slope, 1.0), 0.0), 0.0, 1.0
        )
    return share


def _hermite3(s, p0, p1, d0, d1):
    s2, s3 = s * s, s * s * s
    return (
        p0 * (2 * s3 - 3 * s2 + 1)
        + d0 * (s3 - 2 * s2 + s)
        + p1 * (3 * s2 - 2 * s3)
        + d1 * (s3 - s2)
    )


def _hermite3_slope(s, p0, p1, d0, d1):
    s2 = s * s
    return (p0 - p1) * (6 * s2 - 6 * s) + d0 * (3 * s2 - 4 * s + 1) + d1 * (3 * s2 - 2 * s)


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

    def during(index) -> _Args:
        return _Args(model, None if drive is None else drive.during(index))

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


def _acceleration_at(args: _Args, t, q: Joints, v: Joints) -> Joints:
    if not args.model.dry:
        return _acceleration(args, t, q, v, _signs(v))
    return _acceleration(args, t, q, v, *sliding(args, t, q, v))


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
