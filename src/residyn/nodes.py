"""Between the steps: a smooth curve through what the integrator left behind.

An integration step is as long as the motion allows and knows nothing of the samples. Readings are
taken from the quintic Hermite curve through position, rate and acceleration at both ends of the
step, whose error is about (w h)^6 / 46080.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .model import Model
from .motion import Joints


class Trajectory(NamedTuple):
    """Simulated motion: `t` (N,) s, `q` (N, n) rad or m, `v` (N, n).

    `readings` (N, n) are what the sensors say: `q`, unless the model has sensor effects.
    """

    t: Float[Array, " N"]
    q: Float[Array, "N n"]
    v: Float[Array, "N n"]
    readings: Float[Array, "N n"]


class Nodes(NamedTuple):
    """The motion at the ends of the steps: `start` s, `h` s, and (steps + 1, n) arrays; `z`
    (steps + 1, m) are internal states."""

    start: Float[Array, ""]
    h: Float[Array, ""]
    q: Float[Array, "M n"]
    v: Float[Array, "M n"]
    a: Float[Array, "M n"]
    z: Float[Array, "M m"]


def read(model: Model, nodes: Nodes, times: Float[Array, " N"]) -> Trajectory:
    """Motion at any times."""
    place = (times - nodes.start) / nodes.h
    curve, s = _at(nodes, place)
    q = _polynomial(curve, s)
    rate = _polynomial([k * c for k, c in enumerate(curve)][1:], s) / nodes.h
    seen = _late(nodes, place, model.delays) if model.late else q
    return Trajectory(times, q, rate, model.reading(seen))


def read_slots(model: Model, nodes: Nodes, place: Float[Array, "M m"]) -> Float[Array, "M m n"]:
    """Readings at `place` (0 to 1) of each of the M steps: `read` for a fit, without look-ups."""
    if not model.late:
        return model.reading(
            _polynomial([c[:, None, :] for c in _curves(nodes)], place[:, :, None])
        )
    where = (jnp.arange(place.shape[0])[:, None] + place).reshape(-1)
    late = _late(nodes, where, model.delays)
    return model.reading(late.reshape(*place.shape, late.shape[-1]))


def _late(nodes: Nodes, place: Float[Array, " N"], delays: Joints) -> Float[Array, "N n"]:
    """Each joint as it was `delays` (s) ago; before the beginning the first curve goes on."""
    columns = []
    for joint, delay in enumerate(delays):
        curve, s = _at(nodes, place - delay / nodes.h)
        columns.append(_polynomial([c[:, joint] for c in curve], s[:, 0]))
    return jnp.stack(columns, axis=-1)


def _at(nodes: Nodes, place: Float[Array, " N"]):
    """The curve that holds at each place, counted in steps, and where on it, (N, 1)."""
    index = jnp.clip(jnp.floor(place).astype(int), 0, nodes.q.shape[0] - 2)
    return [c[index] for c in _curves(nodes)], (place - index)[:, None]


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
