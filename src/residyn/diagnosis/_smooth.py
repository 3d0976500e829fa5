"""The missing torque of one recording, in arrays: from readings and intensities to a band.

First the extended filter follows the readings with a plain walk as the torque. Its smoothed path is
where the mechanism is linearised, where angles and rates become regressors, and whence readings
have their weights. Everything after is linear in the torque, so any intensities can be tried at
little cost: the likelihood of all readings says which are the likeliest. Every function here can be
jitted, vmapped and differentiated, in the model's numbers too.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model import Model
from ._filter import (
    Adjoint,
    Filtered,
    Local,
    Start,
    Walk,
    backwards,
    by_coefficient,
    extended,
    linear,
    linearised,
    shifted,
    smoothed,
)
from ._grid import Grid
from ._prior import KINDS, Prior, prior_along
from ._step import size

_BEGIN = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
_CLIMBS = 16
_STRIDE = 100.0  # most that one climb multiplies an intensity by


class Data(NamedTuple):
    """A recording as the smoother takes it."""

    grid: Grid
    start: Start
    unit: Float[Array, " n"]  # torque scale of each joint, N m
    level: Float[Array, ""]  # intensity of the walk with which the readings are followed


class Along(NamedTuple):
    """Everything that does not depend on intensities."""

    grid: Grid
    start: Start
    local: Local
    prior: Prior


class Smoothed(NamedTuple):
    """The result at M instants of n joints."""

    state: Float[Array, "M d"]  # (q, v, z)
    torque: Float[Array, "M n"]
    std: Float[Array, "M n"]
    likelihood: Float[Array, ""]  # log of


def smooth(model: Model, data: Data, intensity: Float[Array, "n kinds"]) -> Smoothed:
    """Motion and missing torque in the light of all readings, for given intensities."""
    return estimate(along(model, data), intensity)


def followed(model: Model, data: Data) -> tuple[Filtered, Local]:
    """The extended filter's way through the readings."""
    scale = data.level * data.unit**2
    growth = scale * data.grid.step[:, None] / jnp.sum(data.grid.step)
    walk = Walk(jnp.ones((len(data.grid.time), 1)), growth[..., None], scale[:, None])
    return extended(model, data.grid, data.start, walk)


def along(model: Model, data: Data) -> Along:
    """The path that the readings took, and what the smoother needs along it."""
    n, d = len(model.mechanism.joints), size(model)
    filtered, local = followed(model, data)
    states = smoothed(filtered, backwards(filtered, local))
    path, torque = states[:, :d], states[:, d:]
    grid = data.grid._replace(variance=filtered.trust)
    prior = prior_along(grid, path[:, :n], path[:, n : 2 * n], data.unit)
    local = linearised(model, grid, path, torque)
    local = by_coefficient(local, prior.regressor, shifted(prior.regressor))
    return Along(grid, data.start, local, prior)


def estimate(here: Along, intensity: Float[Array, "n kinds"]) -> Smoothed:
    """`smooth` along a known path."""
    filtered, adjoint = _both_ways(here, intensity)
    n, d = here.prior.begin.shape[0], here.start.state.shape[0]
    state = smoothed(filtered, adjoint)
    # Rows that make each joint's torque of its coefficients.
    regressor = here.prior.regressor
    rows = jnp.einsum("ko,ij->kijo", regressor, jnp.eye(n)).reshape(len(regressor), n, -1)
    spread = jnp.einsum("kim,kDm->kiD", rows, filtered.variance[:, :, d:])
    before = jnp.einsum("kim,kim->ki", rows, spread[..., d:])
    learnt = jnp.einsum("kiD,kDE,kiE->ki", spread, adjoint.square, spread)
    variance = jnp.maximum(before - learnt, 0.0)
    return Smoothed(
        state=state[:, :d],
        torque=jnp.einsum("kim,km->ki", rows, state[:, d:]),
        # A root with a finite slope where there is no freedom at all.
        std=jnp.where(variance > 0, jnp.sqrt(jnp.where(variance > 0, variance, 1.0)), 0.0),
        likelihood=jnp.sum(filtered.likelihood),
    )


def likelihood(here: Along, intensity: Float[Array, "n kinds"]) -> Float[Array, ""]:
    """Log likelihood of all readings."""
    walk = here.prior.walk(intensity)
    return jnp.sum(linear(here.grid, here.start, walk, here.local).likelihood)


def likeliest(here: Along) -> tuple[Float[Array, "n kinds"], Float[Array, ""]]:
    """Intensities of the highest likelihood, and the log likelihood without any torque.

    From the best power of ten, the same for all. Then every intensity grows or shrinks by the ratio
    of what the smoothed torque shows of it to what noise alone would show, which is 1 at the
    maximum; what the data have no use for shrinks without end.
    """
    n = here.prior.begin.shape[0]
    starts = jnp.asarray((0.0, *_BEGIN))[:, None, None] * jnp.ones((n, KINDS))
    first = jax.vmap(lambda s: likelihood(here, s))(starts)
    begin = starts[1 + jnp.argmax(jnp.where(jnp.isnan(first), -jnp.inf, first)[1:])]

    def climb(carry, _):
        intensity, best, highest = carry
        shown, expected, likely = _ratio(here, intensity)
        better = likely > highest
        best = jnp.where(better, intensity, best)
        ratio = shown / jnp.where(expected > 0, expected, 1.0)
        ratio = jnp.where(expected > 0, jnp.clip(ratio, 1 / _STRIDE, _STRIDE), 1.0)
        return (intensity * ratio, best, jnp.where(better, likely, highest)), None

    carry = begin, begin, jnp.asarray(-jnp.inf)
    return jax.lax.scan(climb, carry, None, length=_CLIMBS)[0][1], first[0]


def _both_ways(here: Along, intensity) -> tuple[Filtered, Adjoint]:
    filtered = linear(here.grid, here.start, here.prior.walk(intensity), here.local)
    return filtered, backwards(filtered, here.local)


def _ratio(here: Along, intensity):
    """Twice the likelihood's slope in each intensity, as the two parts whose difference it is, and
    the likelihood (Koopman and Shephard, Biometrika 79, 1992)."""
    filtered, (slope, square) = _both_ways(here, intensity)
    n, d, moved = here.prior.begin.shape[0], here.start.state.shape[0], here.local.moved
    # A step of the walk enters the coefficients, and with them the state at the next instant.
    slope_after, square_after = shifted(slope), shifted(square)
    own = jnp.einsum("kdm,kd->km", moved, slope_after[:, :d]) + slope_after[:, d:]
    rows = jnp.einsum("kdm,kdD->kmD", moved, square_after[:, :d]) + square_after[:, d:]
    noise = jnp.einsum("kmd,kdm->km", rows[:, :, :d], moved)
    noise = noise + jnp.diagonal(rows[:, :, d:], axis1=1, axis2=2)

    def total(steps, first):
        parts = jnp.einsum("kno,nop->knp", steps.reshape(len(steps), n, -1), here.prior.part)
        begin = jnp.einsum("no,nop->np", first.reshape(n, -1), here.prior.part)
        grown = jnp.einsum("knp,knpc->nc", parts, here.prior.growth)
        return grown + jnp.einsum("np,npc->nc", begin, here.prior.begin)

    shown = total(own**2, slope[0, d:] ** 2)
    expected = total(noise, jnp.diagonal(square[0])[d:])
    return shown, expected, jnp.sum(filtered.likelihood)
