"""A model along a motion as a linear system: one step from each instant to the next.

The equation of motion is linearised about a given motion at the beginning, middle and end of every
step, and one fourth-order Runge-Kutta step of that affine field gives x+ = A x + B u + T tau + c.
Instants are the last axis of every array until then: each operation is one long vector.

Dry friction is linear nowhere, so its direction enters as the expected one over what is known of
the rate, E clip(v / slow + hold, -1, 1): where friction can hold the joint, it takes the torque
that holds it (`hold`), and `slow` is the rate that friction takes away in RAMP steps.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm

from ..physics.model import solve_inertia
from ..physics.motion import split, stack
from ..runtime.export_cache import kept
from .kalman import System
from .law import (
    RAMP,
    Laws,
    Slopes,
    Slots,
    Table,
    along_delays,
    along_readings,
    along_torque,
    beyond,
    changes_bodies,
    follow,
    most_numbers,
    most_states,
    numbers_of,
    with_numbers,
    with_slopes,
)

_AT_ONCE = 64  # instants: their slopes, some 4 KB each, stay in a second-level cache
_NEWTON = 5  # steps to the friction of joints that hold each other: more change no digit of it
_IN_A_CALL = 8  # times as many: a divisor of all grids' lengths, and long beside what a call costs


class Instants(NamedTuple):
    """K instants of R recordings, as a program takes them."""

    step: Any  # (K,) s to the next one; 0 at the end of a recording
    usual: Any  # () their median
    time: Any  # (K,) s from the recording's first
    drive: Any  # (3, n, K) N m
    offset: Any  # (n, K) s, from each instant to the mean time of the readings averaged there
    spread: Any  # (n, K) s^2, half the variance of their times
    run: Any  # (K,) which recording
    last: Any  # (K,) whether it ends here and another one follows
    first_angle: Any  # (n, K) where the next one begins
    mechanisms: Any  # leaves (R, ...)


class Point(NamedTuple):
    """Where a model is linearised."""

    path: Any  # (K, X) angles, rates, internal states
    spread: Any  # (K, n) standard deviation of the rates
    u: Any  # (P,) regressors
    first: Any  # (R, M) internal states at the beginning of each recording


class Nodes(NamedTuple):
    """A motion at the N = 3 K beginnings, middles and ends of its steps."""

    q: Any  # (n, N)
    v: Any
    z: Any  # (M, N)
    time: Any  # (N,)
    step: Any  # (N,)
    spread: Any  # (n, N)


class Linear(NamedTuple):
    """A model linearised along a motion."""

    system: System
    seen: Any  # (K, n) its readings
    acceleration: Any  # (n, N)
    direction: Any  # (n, N) expected direction of sliding
    by_x: Any  # (X, X, N)
    by_torque: Any  # (X, n, N)
    by_number: Any  # (n, P, K) d torque / d regressor at the beginning of each step
    torque_joint: Any  # (E, 2, K) of each effect of one joint: without dry friction, and its level
    torque_whole: Any  # (E, 2 n, K) the same of the others


class Sums(NamedTuple):
    """A model's effects together, at N nodes."""

    torque: Slopes  # (n, ...) without dry friction
    level: Slopes  # (n, ...) of it
    rate: Slopes  # (M, ...) of the internal states


def _ramp(v, needed, level, spread, slow_time):
    """Mean and standard deviation of the argument of clip(v / slow + hold, -1, 1), v being normal
    of standard deviation `spread`; `needed` is the torque that would hold the joint, `slow_time`
    the ramp's time over its inertia."""
    safe = jnp.where(level != 0, jnp.abs(level), 1.0)
    ratio = needed / safe
    # More than friction can give: the joint is not held, the less the more is needed.
    hold = jnp.where(jnp.abs(ratio) <= 1, ratio, 1 / jnp.where(ratio == 0, 1.0, ratio))
    slow = slow_time * (safe + jnp.abs(needed)) + 1e-12
    return v / slow + hold, spread / slow + 1e-9


def _clipped(m, s):
    """E clip(x, -1, 1) of a normal x, and its slopes in the mean and in the standard deviation."""
    high, low = (m + 1) / s, (m - 1) / s
    inside, edges = norm.cdf(high) - norm.cdf(low), norm.pdf(high) - norm.pdf(low)
    return -1 + (m + 1) * norm.cdf(high) - (m - 1) * norm.cdf(low) + s * edges, inside, edges


def expected_direction(v, needed, level, spread, slow_time):
    """Expected direction of sliding, and its slopes in `v`, `needed` and `level`; see `_ramp`."""
    x = jnp.stack([v, needed, level])

    def with_friction(x):
        def slope(e):
            ramp = lambda x: _ramp(x[0], x[1], x[2], spread, slow_time)  # noqa: E731
            return jax.jvp(ramp, (x,), (e.reshape(3, *[1] * (x.ndim - 1)) * jnp.ones_like(x),))

        (m, s), (by_m, by_s) = jax.vmap(slope, out_axes=(None, 0))(jnp.eye(3))
        direction, inside, edges = _clipped(m, s)
        slopes = jnp.where(level != 0, inside * by_m + edges * by_s, 0.0)
        return jnp.where(level != 0, direction, jnp.sign(v)), slopes

    # Normal distributions cost more than all else, and most models have no dry friction.
    without = lambda x: (jnp.sign(x[0]), jnp.zeros_like(x))  # noqa: E731
    return jax.lax.cond(jnp.any(level != 0), with_friction, without, x)


def nodes(instants: Instants, path, spread, held) -> Nodes:
    """By Hermite's cubic through the motion; states that are `held` (M,) keep within a step. The
    motion, (K, X) or (K + 1, X), stays where it ends."""
    n, h = spread.shape[1], instants.step

    def ends(x):  # of the steps
        x = jnp.concatenate([x, x[-1:]]).T
        return x[:, : len(h)], x[:, 1 : len(h) + 1]

    (x, x1), (s, s1) = ends(path), ends(spread)
    (q, v, z), (q1, v1, z1) = ((x[:n], x[n : 2 * n], x[2 * n :]) for x in (x, x1))
    middle = 0.5 * (q + q1) + h / 8 * (v - v1)
    rate = jnp.where(h > 0, 1.5 * (q1 - q) / jnp.maximum(h, 1e-12) - 0.25 * (v + v1), v)
    inside, end = (jnp.where(held[:, None], z, x) for x in (0.5 * (z + z1), z1))

    def three(*x):
        return jnp.concatenate(x, -1)

    step = jnp.where(h > 0, h, instants.usual)
    return Nodes(
        three(q, middle, q1),
        three(v, rate, v1),
        three(z, inside, end),
        three(instants.time, instants.time + h / 2, instants.time + h),
        three(step, step, step),
        three(s, 0.5 * (s + s1), s1) + 1e-12,
    )


def at_nodes(mechanisms, run, times: int = 3):
    """Mechanisms (R, ...) as leaves (times K, ...)."""
    return jax.tree.map(lambda x: x[jnp.tile(run, times)], mechanisms)


def changed_bodies(laws: Laws, slots: Slots, numbers, mechanisms):
    """Mechanisms as a model's effects leave them, with the numbers (E, p) of `slots`."""
    known = laws.of("whole")
    if not any(map(changes_bodies, known)):
        return mechanisms

    def branch(effect):
        if not changes_bodies(effect):
            return lambda bodies, u: bodies
        own = len(numbers_of(effect))
        return lambda bodies, u: jax.vmap(lambda b: with_numbers(effect, u[:own]).bodies(b))(bodies)

    branches = [*map(branch, known), lambda bodies, u: bodies]

    def change(e, bodies):
        at = jnp.where(e < slots.count, slots.law[e], len(known))
        return jax.lax.switch(at, branches, bodies, numbers[e])

    return jax.lax.fori_loop(0, len(slots.law), change, mechanisms)


def _added(x, rows, *start):
    """x with `rows` added to the block that begins at `start`."""
    start = (*start, *(0,) * (x.ndim - len(start)))
    here = jax.lax.dynamic_slice(x, start, rows.shape)
    return jax.lax.dynamic_update_slice(x, here + rows, start)


def _groups(laws: Laws, table: Table):
    """What acts at one joint, and on the whole mechanism: laws, slots, and of an array (n, ...) the
    rows that the effect in a slot sees."""

    def own(x, e):
        return jax.lax.dynamic_slice_in_dim(x, table.joint.joint[e], 1)

    yield laws.of("joint"), table.joint, own
    yield laws.of("whole"), table.whole, lambda x, e: x


def _summed(laws: Laws, table: Table, at: Nodes, mechanism, P: int):
    """`Sums` of a model at the nodes, and each effect's own torque."""
    (n, N), M = at.q.shape, at.z.shape[0]
    # Room at the end, so that no block of rows would be moved to fit.
    p, m = P + most_numbers(laws.each), M + most_states(laws.each)
    z = jnp.concatenate([at.z, jnp.zeros((m - M, N))])

    def nothing(rows: int) -> Slopes:
        return Slopes(*(jnp.zeros((rows, *wide, N)) for wide in ((), (n,), (n,), (m,), (p,))))

    sums, own = Sums(nothing(n), nothing(n), nothing(m)), []
    for (known, slots, of_own), r in zip(_groups(laws, table), (1, n), strict=True):
        room = most_states(known), most_numbers(known)
        each = jnp.zeros((len(slots.law), 2 * r, N // 3))
        branches = [functools.partial(along_torque, k, room) for k in known]

        def add(e, carry, slots=slots, room=room, branches=branches, r=r, of_own=of_own):
            sums, each = carry
            j, state, column = slots.joint[e], slots.state[e], slots.column[e]
            states = jax.lax.dynamic_slice(z, (state, 0), (room[0], N))
            q, v, spread = (of_own(x, e) for x in (at.q, at.v, at.spread))
            args = mechanism, q, v, at.time, states, at.step, spread, slots.numbers[e]
            f = jax.lax.switch(slots.law[e], branches, *args)
            f = f._replace(by_number=f.by_number * slots.slopes[e][:, None])
            each = each.at[e].set(f.value[: 2 * r, : N // 3])
            # Its rows are r torques, r levels, and rates.
            rows = (slice(r), j), (slice(r, 2 * r), j), (slice(2 * r, None), state)
            starts = (), (j,), (j,), (state,), (column,)
            new = []
            for total, (which, first) in zip(sums, rows, strict=True):
                blocks = zip(total, f, starts, strict=True)
                new.append(Slopes(*(_added(x, y[which], first, *to) for x, y, to in blocks)))
            return Sums(*new), each

        if known:
            sums, each = jax.lax.fori_loop(0, slots.count, add, (sums, each))
        own.append(each)
    return sums, *own


def _asked(mechanism, q, v, a):
    """(n,) Z a + f^w."""
    q, v = split(q), split(v)
    load = mechanism.inertia_torque(q, v)
    rows = mechanism.mass_matrix(q)
    turned = (sum(z * x for z, x in zip(row, split(a), strict=True)) for row in rows)
    return stack(tuple(t + w for t, w in zip(turned, load, strict=True)))


def accelerated(mechanism, q, v, push):
    """(n,) Z^-1 (push - f^w)."""
    load = mechanism.inertia_torque(split(q), split(v))
    load = tuple(a - b for a, b in zip(split(push), load, strict=True))
    return stack(solve_inertia(mechanism.mass_matrix(split(q)), load))


def body_columns(change, numbers, mechanisms, run, at: Nodes, acceleration):
    """(n, E, p, N) the torque that small changes of numbers (E, p) amount to through the bodies:
    d(Z a + f^w) / d number; `change` makes mechanisms (R, ...) of them."""

    def asked(numbers):
        bodies = at_nodes(change(numbers, mechanisms), run)
        axes = 0, -1, -1, -1
        return jax.vmap(_asked, in_axes=axes, out_axes=-1)(bodies, at.q, at.v, acceleration)

    slopes = jax.jacfwd(asked)(numbers)  # (n, N, E, p)
    return jnp.moveaxis(slopes, 1, -1)


def _product(A, B) -> Any:
    """A (X, Y, K) times B (Y, W, K): row by row, in kernels that a cache holds."""
    return jnp.stack([sum(a[i, None] * B[i] for i in range(A.shape[1])) for a in A])


class Field(NamedTuple):
    """The equation of motion x' = f at N nodes."""

    f: Any  # (X, N)
    by_x: Any  # (X, X, N)
    by_u: Any  # (X, P, N)
    by_torque: Any  # (X, n, N)
    direction: Any  # (n, N) expected direction of sliding


def _field(mechanism, at: Nodes, drive, s: Sums) -> Field:
    """The equation of motion and its slopes; `mechanism` with leaves (N, ...)."""
    n, N = at.q.shape
    over = {"in_axes": (0, -1, -1, -1), "out_axes": -1}
    none = jnp.zeros((n, N))
    rest = jax.vmap(accelerated, **over)(mechanism, at.q, at.v, none)
    unit = jax.vmap(jax.jacfwd(accelerated, argnums=3), **over)(mechanism, at.q, at.v, none)

    rest, unit = jax.lax.optimization_barrier((rest, unit))

    def pushed(x):  # Z^-1 of torques (n, ..., N)
        return _product(unit, x) if x.ndim == 3 else jnp.sum(unit * x[None], axis=1)

    free, level = drive - s.torque.value, s.level.value
    light = jnp.stack([unit[j, j] for j in range(n)])
    alone = (rest + pushed(free)) / light
    across = unit / light[:, None] * (1.0 - jnp.eye(n))[..., None]

    def together(level_by_held):  # what friction at each joint makes of it at all
        return tuple(map(tuple, jnp.eye(n)[..., None] + level_by_held[:, None] * across))

    def newton(_, known):
        friction, *_ = known
        needed = alone - jnp.sum(across * friction[None], axis=1)
        found = expected_direction(at.v, needed, level, at.spread, RAMP * at.step * light)
        direction, slopes = jax.lax.optimization_barrier(found)
        off = friction - level * direction
        step = stack(solve_inertia(together(level * slopes[1]), tuple(off)))
        return friction - step, direction, slopes

    # Friction at one joint changes what holds another.
    begin = jnp.zeros((n, N)), jnp.zeros((n, N)), jnp.zeros((3, n, N))
    steps = _NEWTON if n > 1 else 1
    _, direction, slopes = jax.lax.fori_loop(0, steps, newton, begin)
    by_v, by_held, by_level = slopes
    matrix = together(level * by_held)
    # Slopes at the torque that acts, friction included.
    total = free - level * direction
    a = rest + pushed(total)
    both = jax.jacfwd(accelerated, argnums=(1, 2))
    a_q, a_v = jax.lax.optimization_barrier(jax.vmap(both, **over)(mechanism, at.q, at.v, total))
    hold = (level * by_held / light)[:, None]
    grow = (direction + level * by_level)[:, None]  # d friction / d level

    def rubbed(x):  # accelerations by what friction changes where each joint is by itself
        return pushed(stack(solve_inertia(matrix, tuple(x))))

    def whole(slope, own=0.0):
        return slope - rubbed(hold * slope + grow * own)

    to_q = whole(a_q - pushed(s.torque.by_q), s.level.by_q)
    along = jnp.eye(n)[..., None] * (level * by_v)[:, None]
    to_v = whole(a_v - pushed(s.torque.by_v), s.level.by_v) - rubbed(along)
    to_z = whole(-pushed(s.torque.by_z))
    to_u = whole(-pushed(s.torque.by_number), s.level.by_number)
    m, p = s.rate.value.shape[0], to_u.shape[1]
    zero, eye = jnp.zeros((n, n, N)), jnp.broadcast_to(jnp.eye(n)[..., None], (n, n, N))
    rows = (zero, eye, jnp.zeros((n, m, N))), (to_q, to_v, to_z), s.rate[1:4]
    by_x = jnp.concatenate([jnp.concatenate(row, 1) for row in rows])
    by_u = jnp.concatenate([jnp.zeros((n, p, N)), to_u, s.rate.by_number])
    by_torque = jnp.concatenate([zero, whole(unit), jnp.zeros((m, n, N))])
    return Field(jnp.concatenate([at.v, a, s.rate.value]), by_x, by_u, by_torque, direction)


def transition(h, M, X: int):
    """One Runge-Kutta step of the affine field M (X, W, 3 K) of (x, 1, inputs): (X, W, K)."""
    W = M.shape[1]
    begin, middle, end = M.reshape(X, W, 3, -1).transpose(2, 0, 1, 3)
    k1, here = begin, jax.lax.optimization_barrier
    k2 = here(middle + h / 2 * _product(middle[:, :X], k1))
    k3 = here(middle + h / 2 * _product(middle[:, :X], k2))
    k4 = end + h * _product(end[:, :X], k3)
    return jnp.eye(X, W)[..., None] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def linearise(laws: Laws, table: Table, instants: Instants, point: Point) -> Linear:
    """A model as a linear system along a motion.

    In stretches of so many instants that what is computed between, ten times as large as all that
    is kept, stays in the processor's cache. One compiled program takes some of them, of recordings
    of every length.
    """
    K, C = len(instants.step), _AT_ONCE

    def cut(x):  # (..., K) to (K / C, ..., C)
        return np.moveaxis(x.reshape(*x.shape[:-1], K // C, C), -2, 0)

    def cut_ends(x):  # (K, ...) to (K / C, C + 1, ...)
        x = np.concatenate([x, x[-1:]])
        return np.stack([x[i : i + C + 1] for i in range(0, K, C)])

    rest = {"usual": instants.usual, "mechanisms": instants.mechanisms}
    own = jax.tree.map(cut, instants._replace(**dict.fromkeys(rest)))
    path, spread = map(cut_ends, (point.path, point.spread))
    each = []
    for i in range(0, K // C, _IN_A_CALL):
        part, *motion = jax.tree.map(lambda x, i=i: x[i : i + _IN_A_CALL], (own, path, spread))
        moved = point._replace(path=motion[0], spread=motion[1])
        each.append(_stretches(laws, table, part._replace(**rest), moved))
    found: Linear = jax.tree.map(lambda *x: np.concatenate(x), *each)

    def joined(x):  # (K / C, ..., r C) to (..., r K)
        x = np.moveaxis(x.reshape(*x.shape[:-1], -1, C), 0, -2)
        return x.reshape(*x.shape[:-3], -1)

    system = jax.tree.map(lambda x: x.reshape(K, *x.shape[2:]), (found.system, found.seen))
    return Linear(*system, *map(joined, found[2:]))


@kept(like=Linear(System(*[0] * 9), *[0] * 8))
def _stretches(laws: Laws, table: Table, instants: Instants, point: Point) -> Linear:
    """A model along stretches of its motion, the first axis of all."""
    bodies = changed_bodies(laws, table.whole, table.whole.numbers, instants.mechanisms)
    rest = {"usual": instants.usual, "mechanisms": instants.mechanisms}

    def one(part):
        own, path, spread = part
        at = nodes(own._replace(**rest), path, spread, table.held)
        return _linearised(laws, table, own._replace(**rest), at, bodies, point)

    own = instants._replace(**dict.fromkeys(rest))
    return jax.lax.map(one, (own, point.path, point.spread))


def _linearised(laws: Laws, table: Table, instants: Instants, at: Nodes, bodies, point: Point):
    """The same at some of the instants, on `bodies` as the model's effects leave them."""
    K, P, n = len(instants.step), point.u.shape[0], at.q.shape[0]
    h, M = instants.step, at.z.shape[0]
    X = 2 * n + M
    mechanism = at_nodes(bodies, instants.run)
    sums, each_joint, each_whole = _summed(laws, table, at, mechanism, P)
    drive = instants.drive.transpose(1, 0, 2).reshape(n, 3 * K)
    cut = Sums(*(
        Slopes(x.value[:k], x.by_q[:k], x.by_v[:k], x.by_z[:k, :M], x.by_number[:k, :P])
        for x, k in zip(sums, (n, n, M), strict=True)
    ))  # fmt: skip
    # Barriers keep XLA from computing a stage again in all that uses it.
    here = jax.lax.optimization_barrier
    f = here(_field(mechanism, at, drive, here(cut)))
    torque_u = _of_bodies(laws, table, instants, at, f.f[n : 2 * n], sums.torque.by_number)[:, :P]
    f = f._replace(by_u=f.by_u - _product(f.by_torque, torque_u - cut.torque.by_number))
    x = jnp.concatenate([at.q, at.v, at.z])
    const = f.f - jnp.sum(f.by_x * x[None], axis=1)
    field = jnp.concatenate([f.by_x, const[:, None], f.by_torque, f.by_u], 1)
    phi = here(transition(h, here(field), X))
    if any(e.follows for e in laws.each):
        phi = _followed(laws, table, at, h, at_nodes(bodies, instants.run, 1), phi)
    A, c, T, B = phi[:, :X], phi[:, X], phi[:, X + 1 : X + 1 + n], phi[:, X + 1 + n :]
    Hx, Ht, Hu, seen = _readings(laws, table, instants, at, f, point)
    hc = seen - jnp.sum(Hx * x[None, :, :K], 1) - jnp.sum(Hu * point.u[:, None], 1)
    last = instants.last
    A, B, T = (jnp.where(last, 0.0, each) for each in (A, B, T))
    anew = jnp.concatenate(
        [instants.first_angle, jnp.zeros((n, K)), point.first[instants.run + 1].T]
    )
    c = jnp.where(last, anew, c) - jnp.sum(B * point.u[:, None], 1)

    def first(x):
        return jnp.moveaxis(x, -1, 0)

    # An acceleration tells which way friction acts; near a reversal nobody knows beforehand.
    jump = (cut.level.value**2 * (1 - f.direction**2))[None, :, :K]
    unsure = jnp.sum(Ht**2 * jump, axis=1)
    system = System(*map(first, (A, B, T, c, Hx, Hu, hc, Ht, unsure)))
    by_number = torque_u[..., :K] + cut.level.by_number[..., :K] * f.direction[:, None, :K]
    return Linear(
        system, seen.T, f.f[n : 2 * n], f.direction, f.by_x, f.by_torque, by_number,
        each_joint, each_whole,
    )  # fmt: skip


def _of_bodies(laws: Laws, table: Table, instants: Instants, at: Nodes, acceleration, torque_u):
    """The sum (n, P, N) with what numbers do through the bodies."""
    slots = table.whole
    moves = list(map(changes_bodies, laws.of("whole")))
    if not any(moves):
        return torque_u

    def with_bodies(torque_u):
        slopes = body_columns(
            lambda numbers, mechanisms: changed_bodies(laws, slots, numbers, mechanisms),
            slots.numbers, instants.mechanisms, instants.run, at, acceleration,
        )  # fmt: skip
        slopes = slopes * slots.slopes[..., None]
        for e in range(slopes.shape[1]):
            torque_u = _added(torque_u, slopes[:, e], 0, slots.column[e])
        return torque_u

    own = jnp.asarray(moves)[slots.law] & (jnp.arange(len(slots.law)) < slots.count)
    return jax.lax.cond(jnp.any(own), with_bodies, lambda x: x, torque_u)


def _followed(laws: Laws, table: Table, at: Nodes, h, mechanism, phi):
    """The step phi (X, W, K) with the internal states that follow the motion instead of having a
    rate: z+ = f(z, q+)."""
    n, (X, W, K) = at.q.shape[0], phi.shape
    q, v, time, z = at.q[:, 2 * K :], at.v[:, 2 * K :], at.time[2 * K :], at.z[:, :K]
    far, none = beyond(at.v[:, :K], v, h), jnp.zeros(W - X - 1 - n)

    def one(q, z, v, t, far, mechanism):
        def moved(q, z, u):
            for known, slots, of_own in _groups(laws, table):
                if any(e.follows for e in known):
                    columns = slots.column[:, None] + jnp.arange(slots.numbers.shape[1])
                    own = slots._replace(numbers=slots.numbers + slots.slopes * u[columns])
                    z = _moved(known, own, of_own, mechanism, q, v, t, far, z)
            return z

        return with_slopes(moved, 3)(q, z, none)

    axes = -1, -1, -1, 0, -1, 0
    args = q, z, v, time, far, mechanism
    value, by_q, by_z, by_u = jax.vmap(one, in_axes=axes, out_axes=-1)(*args)
    rows = _product(by_q, phi[:n])
    gone = jnp.sum(by_z * z[None], 1) + jnp.sum(by_q * q[None], 1)
    rows = rows.at[:, X].add(value - gone)
    rows = rows.at[:, 2 * n : X].add(by_z).at[:, X + 1 + n :].add(by_u)
    return phi.at[2 * n :].set(jnp.where(table.held[:, None, None], rows, phi[2 * n :]))


@kept(like=0)
def followed(laws: Laws, table: Table, instants: Instants, path):
    """A motion (K, X) along which the internal states that have no rate follow the angles, from
    where they are at the beginning of each recording: z+ = f(z, q+)."""
    n = instants.drive.shape[1]
    bodies = changed_bodies(laws, table.whole, table.whole.numbers, instants.mechanisms)
    begins = jnp.concatenate([jnp.ones(1, bool), instants.last[:-1]])

    def step(z, at):
        x, t, run, begins, far = at
        q, v, given = x[:n], x[n : 2 * n], x[2 * n :]
        mechanism, moved = jax.tree.map(lambda leaf: leaf[run], bodies), z
        for known, slots, of_own in _groups(laws, table):
            if any(e.follows for e in known):
                moved = _moved(known, slots, of_own, mechanism, q, v, t, far, moved)
        z = jnp.where(begins | ~table.held, given, moved)
        return z, z

    v = path[:, n : 2 * n]
    far = beyond(v[:-1], v[1:], instants.step[:-1, None])
    far = jnp.concatenate([jnp.zeros((1, n)), far])
    each = path, instants.time, instants.run, begins, far
    _, z = jax.lax.scan(step, path[0, 2 * n :], each)
    return jnp.concatenate([path[:, : 2 * n], z], axis=1)


def _moved(known, slots: Slots, of_own, mechanism, q, v, t, far, z):
    """Internal states (M,) after one step that ended at q, v (n,), `far` (n,) from a turn."""
    M, m = len(z), most_states(known)

    def branch(effect):
        def moved(z, e):
            state = slots.state[e]
            own = jax.lax.dynamic_slice(z, (state,), (m,))
            here, rates, beside = (of_own(x, e) for x in (q, v, far))
            args = here, rates, t, own, beside, slots.numbers[e], mechanism
            new = follow(effect, m, *args)[: len(effect.memory)]
            return jax.lax.dynamic_update_slice(z, new, (state,))

        return moved if effect.follows else lambda z, e: z

    branches = [branch(e) for e in known]
    move = lambda e, z: jax.lax.switch(slots.law[e], branches, z, e)  # noqa: E731
    return jax.lax.fori_loop(0, slots.count, move, jnp.pad(z, (0, m)))[:M]


class Seen(NamedTuple):
    """What is read of n joints at K instants, and its slopes."""

    value: Any  # (n, K)
    by_x: Any  # (n, X, K)
    by_torque: Any  # (n, n, K)
    by_u: Any  # (n, P, K)


def derivatives(at: Nodes, f: Field, orders: tuple[int, ...]) -> tuple[Seen, Seen, Seen]:
    """What is read of each joint, its angle or the derivative of order `orders`, and the first two
    derivatives of that.

    The derivative of y = h x is h f, f being the equation of motion. From the third derivative of
    an angle on, that leaves out how slopes change, and the rate of a drive: those are of use only
    as corrections, of a delay or an average.
    """
    n, K, X, P = at.q.shape[0], at.q.shape[1] // 3, f.f.shape[0], f.by_u.shape[1]
    f = Field(*(x[..., :K] for x in f))
    angle = jnp.broadcast_to(jnp.eye(n, X)[..., None], (n, X, K))
    each = [Seen(at.q[:, :K], angle, jnp.zeros((n, n, K)), jnp.zeros((n, P, K)))]
    for _ in range(2 + max(orders, default=0)):
        h = each[-1].by_x
        slopes = (_product(h, x) for x in (f.by_x, f.by_torque, f.by_u))
        each.append(Seen(jnp.sum(h * f.f[None], axis=1), *slopes))

    def of_order(more: int) -> Seen:
        own = [each[k + more] for k in orders or (0,) * n]
        rows = ([x[j] for j, x in enumerate(part)] for part in zip(*own, strict=True))
        return Seen(*map(jnp.stack, rows))

    return of_order(0), of_order(1), of_order(2)


def _readings(laws: Laws, table: Table, instants: Instants, at: Nodes, f: Field, point: Point):
    """Slopes of the readings in the state (n, X, K), in the random torque (n, n, K) and in the
    regressors (n, P, K), and the readings (n, K)."""
    n, P, K = at.q.shape[0], point.u.shape[0], len(instants.step)
    known = laws.of("sensor")
    slots, p = table.sensor, most_numbers(known)
    mechanism = at_nodes(instants.mechanisms, instants.run, 1)
    delay, delay_u = jnp.zeros((n, K)), jnp.zeros((n, P + p, K))
    if known:
        delays = [functools.partial(along_delays, k, mechanism) for k in known]

        def late(e, carry):
            delay, delay_u = carry
            d, d_u = jax.lax.switch(slots.law[e], delays, slots.numbers[e])
            return delay + d, _added(delay_u, d_u * slots.slopes[e][:, None], 0, slots.column[e])

        delay, delay_u = jax.lax.fori_loop(0, slots.count, late, (delay, delay_u))
    # r(t - d), averaged: r - d r' + (d^2 / 2 + spread) r''.
    r, rate, bend = derivatives(at, f, laws.orders)
    d = delay - instants.offset
    w = 0.5 * d**2 + instants.spread
    value = r.value - d * rate.value + w * bend.value
    Hx, Ht, Hu = (
        here - d[:, None] * once + w[:, None] * twice
        for here, once, twice in zip(r[1:], rate[1:], bend[1:], strict=True)
    )
    Hu = jnp.pad(Hu, ((0, 0), (0, p), (0, 0)))
    Hu = Hu + (-rate.value + d * bend.value)[:, None] * delay_u
    if known:
        branches = [functools.partial(along_readings, k, mechanism) for k in known]

        def seen(e, carry):
            value, Hx, Ht, Hu = carry
            found = jax.lax.switch(slots.law[e], branches, value, slots.numbers[e])
            value, by_angle, by_number = found
            Hx, Ht, Hu = (_product(by_angle, x) for x in (Hx, Ht, Hu))
            own = by_number * slots.slopes[e][:, None]
            return value, Hx, Ht, _added(Hu, own, 0, slots.column[e])

        value, Hx, Ht, Hu = jax.lax.fori_loop(0, slots.count, seen, (value, Hx, Ht, Hu))
    return Hx, Ht, Hu[:, :P], value
