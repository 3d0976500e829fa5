"""Dry friction inside an integration step: where a joint reverses, stops, and breaks away.

Inside a step the direction of sliding is held. These functions find what must be held, and correct
the end of the step for what changed inside it; each correction is exact to the order that matters
and is differentiable in the model's numbers.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..physics.model import holding, solve_inertia
from ..physics.motion import Joints, Motion, Scalar
from .equation import Args, acceleration, signs

_SOON = 12.0  # grains of the integrator's time in which friction must stop what it is to hold


class Sticking(NamedTuple):
    """Per joint: direction of sliding; 1 if friction holds it at rest; 1 if it all but rests and
    friction that is not of one joint holds the whole mechanism."""

    direction: Joints
    held: Joints
    gripped: Scalar


def _friction(args: Args, motion: Motion) -> list[Scalar | None]:
    """Half the jump of each joint's torque where its direction flips; None without dry friction."""
    level: list[Scalar | None] = [None] * len(motion.q)
    for effect, own in args.model.each(motion):
        if effect.dry:
            for joint, more in enumerate(effect.jumps(own, args.model.bodies)):
                known = level[joint]
                level[joint] = known if more is None else more if known is None else known + more
    return level


def _level(args: Args, motion: Motion, joint: int, speed: Scalar) -> Scalar:
    """`_friction` of one joint at some speed."""
    v = tuple(speed if i == joint else x for i, x in enumerate(motion.v))
    level = _friction(args, motion._replace(v=v))[joint]
    assert level is not None
    return level


def sliding(args: Args, motion: Motion) -> Sticking:
    """What holds at the beginning of a step."""
    motion = motion._replace(direction=signs(motion.v))
    dry = [limit is not None for limit in _friction(args, motion)]
    none = tuple(0.0 for _ in motion.v)
    rests = [x == 0.0 for x, rough in zip(motion.v, dry, strict=True) if rough]
    rests += [e.crawls(own, args.model.bodies) for e, own in args.model.each(motion) if e.grips]
    return _where(
        rests,
        lambda: _resting(args, motion),
        lambda: Sticking(motion.direction, none, 0.0),
    )


def _where(happens: list, then: Callable, otherwise: Callable):
    """`then()` if any of the conditions holds, else `otherwise()`; only that one is computed."""
    if not happens:
        return otherwise()
    happening = functools.reduce(jnp.logical_or, happens)

    def arrays(branch: Callable):
        return lambda: jax.tree.map(lambda x: jnp.asarray(x, float), branch())

    return jax.lax.cond(happening, arrays(then), arrays(otherwise))


def _resting(args: Args, motion: Motion) -> Sticking:
    """`sliding` where a joint is at rest, or nearly.

    What holds a joint depends on which others are held. All that rest are held at first; then the
    one that is overloaded most is let go, as long as there is one.
    """
    level = _friction(args, motion)
    limits = tuple(0.0 if limit is None else limit for limit in level)
    rests = tuple(v == 0.0 for v in motion.v)
    inertia, direction = args.model.bodies.mass_matrix(motion.q), motion.direction
    free = acceleration(args, motion)  # without friction at what rests
    held = tuple(
        jnp.where(rest & (limit > 0), 1.0, 0.0) for rest, limit in zip(rests, limits, strict=True)
    )
    for _ in range(sum(limit is not None for limit in level)):
        slides = zip(rests, held, limits, direction, strict=True)
        rubs = tuple(jnp.where(rest & (h == 0), -f * d, 0.0) for rest, h, f, d in slides)
        load = _holding_load(inertia, _plus(free, solve_inertia(inertia, rubs)), held)
        excess = tuple(jnp.abs(x) - f for x, f in zip(load, limits, strict=True))
        most = functools.reduce(jnp.maximum, excess)
        goes = [(h > 0) & (x > 0.0) & (x == most) for h, x in zip(held, excess, strict=True)]
        pairs = zip(held, load, direction, strict=True)
        direction = tuple(jnp.where(h > 0, jnp.sign(x), d) for h, x, d in pairs)
        held = tuple(jnp.where(go, 0.0, h) for go, h in zip(goes, held, strict=True))
    gripped = _gripped(args, motion, level)
    if not isinstance(gripped, float):
        held = tuple(jnp.maximum(h, gripped) for h in held)
    return Sticking(direction, held, gripped)


def _holding_load(inertia: tuple[Joints, ...], free: Joints, held: Joints) -> Joints:
    """The torque that friction at held joints withstands, by what they would do if nothing held
    them; 0 at others."""
    load = tuple(sum(z * a for z, a in zip(row, free, strict=True)) for row in inertia)
    there = solve_inertia(holding(inertia, held), load)
    lost = tuple(sum(z * a for z, a in zip(row, there, strict=True)) for row in inertia)
    return tuple(jnp.where(h > 0, x - y, 0.0) for h, x, y in zip(held, load, lost, strict=True))


def _gripped(args: Args, motion: Motion, level: list[Scalar | None]) -> Scalar:
    """1 where friction that is not of one joint stops and holds the whole mechanism, else 0."""
    bodies, none = args.model.bodies, (0.0,) * len(motion.q)
    if not any(effect.grips for effect in args.model.effects):
        return 0.0
    free = acceleration(args, motion._replace(v=none, direction=none))
    # What holds it must take its momentum, too: where the point that rubs hardly moves, an arm that
    # turns about it, or is stretched out, still may.
    time = _SOON * jnp.asarray(motion.grain, float)
    brisk = jnp.where(time > 0, 1.0 / jnp.where(time > 0, time, 1.0), 0.0)
    stopped = tuple(a + brisk * v for a, v in zip(free, motion.v, strict=True))
    inertia = bodies.mass_matrix(motion.q)
    loads = [
        tuple(-sum(z * a for z, a in zip(row, each, strict=True)) for row in inertia)
        for each in (free, stopped)
    ]
    joints = tuple(0.0 if limit is None else jnp.abs(limit) for limit in level)
    grip: Scalar = 0.0
    for effect, own in args.model.each(motion):
        if effect.grips:
            still, slowing = (effect.holds(load, joints, own, bodies) for load in loads)
            grip = jnp.maximum(grip, still * slowing)
    return grip


def _mobility(args: Args, q: Joints, joint: int, held: Joints) -> Joints:
    """Acceleration of every joint per unit torque on one: a column of Z^-1, where nothing is
    `held` besides."""
    unit = tuple(1.0 if i == joint else 0.0 for i in range(len(q)))
    others = tuple(0.0 if i == joint else h for i, h in enumerate(held))
    column = solve_inertia(holding(args.model.bodies.mass_matrix(q), others), unit)
    return tuple(jnp.where(h > 0, 0.0, c) for h, c in zip(others, column, strict=True))


def reversals(args: Args, h, begin, end, motion: Motion, sticking: Sticking):
    """The end of the step, corrected for joints which came to rest inside it.

    `begin` and `end` are (q, v, q''), and `motion` stands at the end.
    """
    (_, v0, _), (q1, v1, _) = begin, end
    direction, held = sticking.direction, sticking.held
    motion = motion._replace(q=q1, v=v1, direction=direction)
    level = _friction(args, motion._replace(v=(0.0,) * len(v1)))
    crosses = {
        j: (held[j] == 0) & (v0[j] != 0.0) & (v1[j] * direction[j] < 0.0)
        for j, limit in enumerate(level)
        if limit is not None
    }
    return _where(
        list(crosses.values()),
        lambda: _reversed(args, h, begin, end, motion, held, level, crosses),
        lambda: (q1, v1),
    )


def _reversed(args: Args, h, begin, end, motion: Motion, held: Joints, level, crossing):
    """`reversals` where a joint does reverse."""
    (q0, v0, a0), (q1, v1, _) = begin, end
    direction = motion.direction
    # A stage's acceleration is good enough for its method, but not to be subtracted from.
    a1 = acceleration(args, motion, held)
    q, v, still = q1, v1, held
    for j, crosses in crossing.items():
        limit, column = level[j], _mobility(args, q1, j, still)
        share = turning_point(v0[j], v1[j], h * a0[j], h * a1[j])
        rest = (1.0 - share) * h
        slowing = a0[j] + share * (a1[j] - a0[j])
        sticks = crosses & (jnp.abs(slowing) <= 2.0 * column[j] * limit)
        # Torque change after the reversal: the friction flips, or takes what holds the joint, which
        # runs from `slowing` to the end's a1; its mean counts for v, its first moment for q.
        # Friction may fade as the joint speeds up again: Simpson's rule over its level on the way.
        gained = v1[j] + rest * column[j] * 2.0 * limit * direction[j]
        middle, later = (_level(args, motion, j, share * gained) for share in (0.5, 1.0))
        flip_v = direction[j] * (limit + 4.0 * middle + later) / 3.0
        flip_q = direction[j] * (limit + 2.0 * middle) / 1.5
        for_v = jnp.where(sticks, -0.5 * (slowing + a1[j]) / column[j], flip_v)
        for_q = jnp.where(sticks, -(2.0 * slowing + a1[j]) / 3.0 / column[j], flip_q)
        dq = tuple(jnp.where(crosses, 0.5 * rest**2 * for_q, 0.0) * c for c in column)
        dv = tuple(jnp.where(crosses, rest * for_v, 0.0) * c for c in column)
        # The springs answer to dq, which grows as the square of the time since the reversal:
        # integrated once and twice, their answer at the end counts 1/3 and 1/12.
        answer = _less(acceleration(args, motion._replace(q=_plus(q1, dq)), held), a1, crosses)
        # The dampers answer to dv, which grows as that time: 1/2 and 1/6.
        loss = _less(acceleration(args, motion._replace(v=_plus(v1, dv)), held), a1, crosses)
        q = _plus(q, dq, _times(rest**2 / 12.0, answer), _times(rest**2 / 6.0, loss))
        v = _plus(v, dv, _times(rest / 3.0, answer), _times(rest / 2.0, loss))
        stop = position_within(share, q0[j], q1[j], h * v0[j], h * v1[j])
        q = tuple(jnp.where(sticks, stop, x) if i == j else x for i, x in enumerate(q))
        v = tuple(jnp.where(sticks, 0.0, x) if i == j else x for i, x in enumerate(v))
        still = tuple(jnp.where(sticks, 1.0, x) if i == j else x for i, x in enumerate(still))
    # Rest is a rate of nothing, to the last digit.
    return q, tuple(jnp.where(h > 0, 0.0, x) for h, x in zip(still, v, strict=True))


def break_away(args: Args, h, begin: Motion, end: Motion, sticking: Sticking):
    """The end of the step, corrected for joints that friction could no longer hold inside it."""
    return _where(
        [(x > 0) & (sticking.gripped == 0) for x in sticking.held if not isinstance(x, float)],
        lambda: _broken(args, h, begin, end, sticking),
        lambda: (end.q, end.v),
    )


def _broken(args: Args, h, begin: Motion, end: Motion, sticking: Sticking):
    """`break_away` where a joint is held."""
    q, v, held = end.q, end.v, sticking.held
    loose = signs(v)
    motions = begin._replace(v=v, direction=loose), end._replace(direction=loose)
    level = _friction(args, motions[1])
    # What has stopped inside the step is held at its end.
    still = tuple(
        h if limit is None else jnp.where(x == 0.0, 1.0, h)
        for h, limit, x in zip(held, level, v, strict=True)
    )
    before, after = (
        _holding_load(args.model.bodies.mass_matrix(m.q), acceleration(args, m), still)
        for m in motions
    )
    for j, limit in enumerate(level):
        if limit is None:
            continue
        column = _mobility(args, end.q, j, still)
        stuck = (held[j] > 0) & (sticking.gripped == 0)
        excess = jnp.where(stuck, jnp.maximum(jnp.abs(after[j]) - limit, 0.0), 0.0)
        grown = jnp.where(excess > 0, jnp.abs(after[j]) - jnp.abs(before[j]), 1.0)
        rest = h * jnp.clip(excess / grown, 0.0, 1.0)
        # From then on the torque that is not held grows in proportion to time.
        kick = tuple(c * excess * jnp.sign(after[j]) for c in column)
        q = _plus(q, tuple(rest**2 / 6.0 * k for k in kick))
        v = _plus(v, tuple(rest / 2.0 * k for k in kick))
    return q, v


def _plus(*terms: Joints) -> Joints:
    return tuple(sum(parts[1:], parts[0]) for parts in zip(*terms, strict=True))


def _less(x: Joints, y: Joints, where) -> Joints:
    return tuple(jnp.where(where, a - b, 0.0) for a, b in zip(x, y, strict=True))


def _times(factor: Scalar, x: Joints) -> Joints:
    return tuple(factor * each for each in x)


def turning_point(v0, v1, d0, d1):
    """Where in [0, 1] the cubic with ends v0, v1 and slopes d0, d1 is zero, if the ends differ."""
    gap = v0 - v1
    share = jnp.clip(v0 / jnp.where(gap == 0.0, 1.0, gap), 0.0, 1.0)
    for _ in range(3):
        value = position_within(share, v0, v1, d0, d1)
        slope = _hermite3_slope(share, v0, v1, d0, d1)
        # Only a slope of the crossing's own sign can be trusted.
        good = slope * gap < 0.0
        share = jnp.clip(
            share - jnp.where(good, value / jnp.where(good, slope, 1.0), 0.0), 0.0, 1.0
        )
    return share


def position_within(s, p0, p1, d0, d1):
    """The cubic with ends p0, p1 and slopes d0, d1, at s in [0, 1]."""
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
