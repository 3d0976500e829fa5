"""Between the steps: a smooth curve through what the integrator left behind.

An integration step is as long as the motion allows and knows nothing of the samples. Readings are
taken from the quintic Hermite curve through position, rate and acceleration at both ends of the
step, whose error is about (w h)^6 / 46080.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..physics.model import Model
from ..physics.motion import Joints


class Trajectory(NamedTuple):
    """Simulated motion: `t` (N,) s, `q` (N, n) rad or m, `v` (N, n).

    `readings` (N, n) are what the sensors say: `q`, or the derivatives that were asked for, and
    what the model's sensor effects make of them.
    """

    t: Float[Array, " N"]
    q: Float[Array, "N n"]
    v: Float[Array, "N n"]
    readings: Float[Array, "N n"]


class Nodes(NamedTuple):
    """The motion at the ends of the steps: `start` s, `h` s, and `ends`, whose first `steps` + 1
    rows count: angles, h times rates, h^2 times accelerations. All that a step begins with lies in
    one row, so that a reading costs one look-up for its beginning and one for its end."""

    start: Float[Array, ""]
    h: Float[Array, ""]
    steps: Int[Array, ""] | int
    ends: Float[Array, "M 3n"]


def read(
    model: Model, nodes: Nodes, times: Float[Array, " N"], orders: Sequence[int] = ()
) -> Trajectory:
    """Motion at any times, and readings of the `orders`-th derivative of each joint's angle."""
    place = (times - nodes.start) / nodes.h
    row = _row(nodes, place)
    curve, s = _curve(nodes, row), (place - row)[:, None]
    q = _polynomial(curve, s)
    rate = _polynomial([k * c for k, c in enumerate(curve)][1:], s) / nodes.h
    return Trajectory(times, q, rate, read_rows(model, nodes, row, place - row, orders))


def read_rows(
    model: Model,
    nodes: Nodes,
    row: Int[Array, " N"],
    place: Float[Array, " N"],
    orders: Sequence[int] = (),
) -> Float[Array, "N n"]:
    """Readings at `place` (0 to 1) within the steps `row`: `read` for a fit, which knows where its
    readings lie."""
    if model.late:
        return model.reading(_late(nodes, row + place, model.delays, orders))
    return model.reading(_derivatives(_curve(nodes, row), place[:, None], nodes.h, orders))


def _late(
    nodes: Nodes, place: Float[Array, " N"], delays: Joints, orders: Sequence[int]
) -> Float[Array, "N n"]:
    """Each joint as it was `delays` (s) ago; before the beginning the first curve goes on."""
    columns = []
    for joint, delay in enumerate(delays):
        there = place - delay / nodes.h
        row = _row(nodes, there)
        curve = _curve(nodes, row)
        own, order = [c[:, joint, None] for c in curve], orders[joint : joint + 1]
        columns.append(_derivatives(own, (there - row)[:, None], nodes.h, order)[:, 0])
    return jnp.stack(columns, axis=-1)


def _row(nodes: Nodes, place: Float[Array, " N"]) -> Int[Array, " N"]:
    """The step whose curve holds at each place, counted in steps."""
    return jnp.clip(jnp.floor(place).astype(int), 0, nodes.steps - 1)


def _curve(nodes: Nodes, row: Int[Array, " N"]) -> list[Float[Array, "N n"]]:
    """Coefficients of some steps' quintics in s, which runs from 0 to 1 along a step."""
    n = nodes.ends.shape[1] // 3
    at = [nodes.ends.at[i].get(mode="promise_in_bounds") for i in (row, row + 1)]
    (q0, q1), (v0, v1), (a0, a1) = zip(*(jnp.split(x, (n, 2 * n), axis=1) for x in at), strict=True)
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


def _derivatives(curve, s, h, orders: Sequence[int]) -> Float[Array, "N n"]:
    """The derivative of order `orders` of each joint's curve, in 1/s to that power."""
    if not any(orders):
        return _polynomial(curve, s)
    columns = []
    for joint, order in enumerate(orders):
        own = [c[:, joint] for c in curve]
        for _ in range(order):
            own = [k * c / h for k, c in enumerate(own)][1:]
        columns.append(_polynomial(own, s[:, 0]))
    return jnp.stack(columns, axis=-1)


def _polynomial(coefficients, s):
    total = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + s * total
    return total
