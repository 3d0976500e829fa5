"""One integration step: Tsitouras' fifth-order stages, and what friction and memory add to them.

A fit calls this hundreds of thousands of times, so the stages are written out in tuples of scalars,
which XLA fuses and keeps in registers. A smooth step is just the stages. Where a joint may reverse
against dry friction inside the step, the direction of sliding is held over the stages and the end
is corrected. A memory that follows the motion needs to know how far a joint went before it turned
round: the stages foresee that, and the end of the step knows.
"""

import itertools
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..physics.model import solve_inertia
from ..physics.motion import Joints, Motion, Scalar
from .dry_friction import break_away, position_within, reversals, sliding, turning_point
from .equation import Args, rates, signs

# What counts as unresolved inside a step, as a share of it: below 0.4 the stages would chatter, and
# means over grains before and after a stage would not reach the next one.
_GRAIN = 0.5


class State(NamedTuple):
    """What is integrated, in tuples of scalars: XLA keeps those in registers, but copies arrays."""

    q: Joints
    v: Joints
    z: Joints = ()

    def motion(self, t: Scalar, direction: Joints | None = None) -> Motion:
        """The motion in this state; `direction` None is the sign of the rates."""
        return Motion(t, self.q, self.v, signs(self.v) if direction is None else direction, self.z)


# Tsitouras' method of fifth order (Computers and Mathematics with Applications 62, 2011), less its
# last stage, which only estimates the error. A trace takes its tables with the precision in force
# (`float`): where none is named, JAX gives what an earlier trace in another precision had.
_METHOD = diffrax.Tsit5.tableau
_STAGES = 6
_WEIGHTS = _METHOD.b_sol[:_STAGES]
_NODES = np.append(0.0, _METHOD.c[: _STAGES - 1])
_TABLE = np.zeros((_STAGES, _STAGES))
for _i, _row in enumerate(_METHOD.a_lower[: _STAGES - 1], start=1):
    _TABLE[_i, :_i] = _row

# How often each stage's torque counts in the rate at the end, and in the position; and minus the
# same by a finer rule, Gauss' two points in each eighth of a step: its error at corners.
_FINE = ((np.arange(8)[:, None] + 0.5 + np.array([-1.0, 1.0]) / 12**0.5) / 8).ravel()
_PLACES = np.append(_NODES, _FINE)
_FINE_GRAIN = 1 / 16  # of a step: half an eighth, so that means over grains leave no gap
_IN_RATE = np.append(_WEIGHTS, np.full(len(_FINE), -1 / len(_FINE)))
_IN_POSITION = np.append(_WEIGHTS @ _TABLE, (_FINE - 1) / len(_FINE))


def _tsit5(rates, h, y: State):
    """Tsitouras' six stages of y' = rates(share of the step, y).

    A loop over the stages is a sixth of the code to compile, and no slower. Each component has its
    own slopes at the six stages: written into one array by index, which XLA makes a scatter of in a
    Jacobian, they cost a quarter of an evaluation.

    **Returns:** the state at the end of the step, and q'' at its first and last stage.
    """
    n, begin = len(y.q), (*y.q, *y.v, *y.z)
    rows, nodes, order = jnp.asarray(_TABLE, float), jnp.asarray(_NODES, float), jnp.arange(_STAGES)

    def at(weights, slopes) -> State:
        x = tuple(b + h * jnp.sum(weights * s) for b, s in zip(begin, slopes, strict=True))
        return State(x[:n], x[n : 2 * n], x[2 * n :])

    def stage(i, slopes):
        here = at(rows[i], slopes)
        a, z = rates(nodes[i], here)
        found = zip((*here.v, *a, *z), slopes, strict=True)
        return tuple(jnp.where(order == i, slope, earlier) for slope, earlier in found)

    slopes = jax.lax.fori_loop(0, _STAGES, stage, (jnp.zeros(_STAGES),) * len(begin))
    first, last = (tuple(s[i] for s in slopes[n : 2 * n]) for i in (0, -1))
    return at(jnp.asarray(_WEIGHTS, float), slopes), first, last


@eqx.filter_jit
def smooth_step(args: Args, t, h, y: State) -> tuple[State, Joints]:
    """One step: its end, and the acceleration at its beginning."""
    turn = _turns_ahead(args, t, h, y)

    def at(share, x: State) -> Motion:
        return turn(share, x.motion(t + share * h)._replace(grain=_GRAIN * h))

    end, first, last = _tsit5(lambda share, x: rates(args, at(share, x)), h, y)
    end = _past_corners(args, t, h, y, end, first, last, signs)
    return _settled(args, t, h, y, end, first, last), first


@eqx.filter_jit
def dry_step(args: Args, t, h, y: State) -> tuple[State, Joints]:
    """`smooth_step` for joints that may reverse or stick inside the step.

    Hardly any step sees a joint rest, reverse or break away: what these ask for is computed only
    where they happen (under `vmap`, where any lane may see one, always).
    """
    begin = y.motion(t)._replace(grain=_GRAIN * h)
    sticking = sliding(args, begin)
    direction, held = sticking.direction, sticking.held
    still = [jnp.where(stuck > 0, 0.0, x) for x, stuck in zip(y.v, held, strict=True)]
    y = y._replace(v=tuple(still))
    turn = _turns_ahead(args, t, h, y)

    def at(share, x: State) -> Motion:
        return turn(share, x.motion(t + share * h, direction)._replace(grain=_GRAIN * h))

    end, first, last = _tsit5(lambda share, x: rates(args, at(share, x), held), h, y)
    end = _past_corners(args, t, h, y, end, first, last, lambda v: direction)
    v1 = tuple(jnp.where(stuck > 0, 0.0, x) for x, stuck in zip(end.v, held, strict=True))
    # The last stage stands at the end of the step.
    ends = (y.q, y.v, first), (end.q, v1, last)
    q, v = reversals(args, h, *ends, at(1.0, end), sticking)
    done = at(1.0, State(q, v, end.z))
    q, v = break_away(args, h, at(0.0, y), done, sticking)
    return _settled(args, t, h, y, State(q, v, end.z), first, last), first


def _turns_ahead(args: Args, t, h, y: State):
    """A function that tells a stage's motion where each joint turned round before it, foreseen from
    the step's beginning; only memories that follow the motion ask for it."""
    if not args.model.follows:
        return lambda share, motion: motion
    a = rates(args, y.motion(t))[0]
    safe = tuple(jnp.where(x == 0.0, 1.0, x) for x in a)
    when = tuple(jnp.where(x == 0.0, -1.0, -v / s) for v, x, s in zip(y.v, a, safe, strict=True))
    where = tuple(q + 0.5 * v * s for q, v, s in zip(y.q, y.v, when, strict=True))

    def tell(share, motion: Motion) -> Motion:
        turned = tuple(
            jnp.where((s > 0.0) & (s < share * h), p, q)
            for s, p, q in zip(when, where, motion.q, strict=True)
        )
        return motion._replace(turn=turned)

    return tell


def _turned(h, y: State, end: State, first: Joints, last: Joints) -> tuple[Joints, Joints]:
    """Where in the step (0 to 1; 2: nowhere) each joint turned round, and at which angle."""
    when, where = [], []
    for q0, q1, v0, v1, a0, a1 in zip(y.q, end.q, y.v, end.v, first, last, strict=True):
        share = turning_point(v0, v1, h * a0, h * a1)
        turns = v0 * v1 < 0
        when.append(jnp.where(turns, share, 2.0))
        where.append(jnp.where(turns, position_within(share, q0, q1, h * v0, h * v1), q1))
    return tuple(when), tuple(where)


def _settled(args: Args, t, h, y: State, end: State, first: Joints, last: Joints) -> State:
    """The end of a step, with the memories that follow the motion brought along."""
    if not args.model.follows:
        return end
    motion = end.motion(t + h)._replace(turn=_turned(h, y, end, first, last)[1])
    return end._replace(z=args.model.memory_follow(motion))


def _past_corners(args: Args, t, h, y: State, end: State, first, last, direction) -> State:
    """The end of a step, corrected for corners of torques and of rates of internal states in it.

    A corner costs the stages their order, as a quadrature of that torque or rate, which is all that
    they are to it: along the step's own path, the difference to a finer quadrature is the error
    made.
    """
    model = args.model
    if not any(effect.rough for effect in model.effects):
        return end
    bodies = model.bodies
    when, where = _turned(h, y, end, first, last)
    follows = [effect.follows for effect in model.effects for _ in effect.memory]

    def rough(share, grain) -> tuple[Joints, Joints]:  # torques and rates
        ends = list(zip(y.q, end.q, y.v, end.v, first, last, strict=True))
        q = tuple(position_within(share, q0, q1, h * v0, h * v1) for q0, q1, v0, v1, _, _ in ends)
        v = tuple(position_within(share, v0, v1, h * a0, h * a1) for _, _, v0, v1, a0, a1 in ends)
        states = zip(y.z, end.z, follows, strict=True)
        z = tuple(z0 if own else z0 + share * (z1 - z0) for z0, z1, own in states)
        turn = tuple(
            jnp.where(share > w, there, x) for w, there, x in zip(when, where, q, strict=True)
        )
        motion = State(q, v, z).motion(t + share * h, direction(v))
        motion = motion._replace(turn=turn, grain=grain * h)
        each = list(model.each(motion))
        torques = zip(*(e.torque(own, bodies) for e, own in each if e.rough), strict=True)
        changes = (
            e.rate(own, bodies) if e.rough and not e.follows else (0.0,) * len(e.memory)
            for e, own in each
        )  # fmt: skip
        found = map(sum, torques), itertools.chain(*changes)
        torque, change = (tuple(jnp.asarray(x, float) for x in part) for part in found)
        return torque, change

    grains = jnp.where(jnp.arange(len(_PLACES)) < _STAGES, _GRAIN, _FINE_GRAIN)
    torques, changes = jax.vmap(rough)(jnp.asarray(_PLACES, float), grains)
    errors = (
        tuple(jnp.dot(jnp.asarray(w, float), x) for x in torques) for w in (_IN_RATE, _IN_POSITION)
    )
    dv, dq = (solve_inertia(bodies.mass_matrix(end.q), error) for error in errors)
    return end._replace(
        q=tuple(x + h**2 * d for x, d in zip(end.q, dq, strict=True)),
        v=tuple(x + h * d for x, d in zip(end.v, dv, strict=True)),
        z=tuple(
            x - h * jnp.dot(jnp.asarray(_IN_RATE, float), r)
            for x, r in zip(end.z, changes, strict=True)
        ),
    )
