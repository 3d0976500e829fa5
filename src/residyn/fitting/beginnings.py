"""Where the closed-form start begins: what linear least squares cannot find.

How strongly an effect acts follows from the readings in one linear step. The number that shapes it
(a gap, a yield angle, a frequency) does not, nor do its internal states. So a few values of each
shape are tried, internal states are run along the measured motion, and the frequency of a periodic
disturbance is read off the spectrum of the torque that is missing without it.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.model import Model
from ..physics.motion import Motion, stack

_MOST = 48  # beginnings tried; beyond, shapes vary one at a time
_LINES = 3  # frequencies tried for each periodic disturbance
_SUBSTEPS = 2


class Beginnings(NamedTuple):
    """(B, P) numbers, and (B, R, m) internal states at each recording's first sample."""

    numbers: np.ndarray
    memory: np.ndarray


def plain(model: Model, sizes: np.ndarray, recordings: int) -> Beginnings:
    """Every combination of the shapes' grid values, or, if these are many, one shape at a time."""
    values = np.asarray(model.vector())
    choices = [
        tuple(g * size for g in n.meaning.grid) or (value,)
        for n, value, size in zip(model.fitted, values, sizes, strict=True)
    ]
    if np.prod([len(c) for c in choices]) <= _MOST:
        found = list(itertools.product(*choices))
    else:
        middle = [c[len(c) // 2] for c in choices]
        found = [middle]
        for i, c in enumerate(choices):
            found += [(*middle[:i], x, *middle[i + 1 :]) for x in c if x != middle[i]]
    numbers = np.asarray(found, float).reshape(-1, len(values))
    return Beginnings(numbers, np.zeros((len(numbers), recordings, len(model.memory))))


def oscillates(model: Model) -> bool:
    """Whether an effect has a frequency to be found in a spectrum."""
    return any(effect.oscillates for effect in model.effects)


def tuned(
    model: Model, begin: Beginnings, missing: np.ndarray, spacing: np.ndarray, fits: np.ndarray
) -> Beginnings:
    """The beginnings with frequencies and phases of periodic disturbances read off the torque
    (K, R, G, n) that is missing without them, for those kernels K that fit."""
    memory = [m.effect for m in model.memory]
    for i, effect in enumerate(model.effects):
        if not effect.oscillates:
            continue
        joint = model.mechanism.joints.index(effect.place)
        found = lines(missing[fits][..., joint], spacing)
        number = frequency_of(model, i)
        first = begin.numbers[:1] if len(begin.numbers) * len(found) > _MOST else begin.numbers
        same = np.unique(np.delete(first, number, axis=1), axis=0)
        numbers, states = [], []
        for frequency, phases in found:
            for row in same:
                numbers.append(np.insert(row, number, frequency))
                states.append(begin.memory[0].copy())
                states[-1][:, memory.index(i)] = phases
        begin = Beginnings(np.asarray(numbers), np.asarray(states))
    return begin


def frequency_of(model: Model, index: int) -> int:
    """Which of a model's fitted numbers is the frequency of its effect `index`."""
    field = model.effects[index].oscillates
    pairs = enumerate(model.fitted)
    return next(k for k, n in pairs if n.effect == index and n.meaning.field == field)


def lines(torque: np.ndarray, spacing: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Strongest frequencies (Hz) of that of (K, R, G) torques which shows one best, and each
    recording's phase there."""
    _, recordings, length = torque.shape
    dt = float(spacing.max())
    frequencies = np.arange(0.5, 0.2 * length, 0.25) / (length * dt)
    frequencies = frequencies[frequencies < 0.25 / dt]
    # One window for all: without it a strong slow line would drown the others in its skirts.
    window = np.hanning(length)
    best = None
    for kernel in torque:
        waves = []
        for r in range(recordings):
            turn = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(length) * spacing[r]))
            waves.append(turn @ (window * kernel[r]))
        power = np.sum([np.abs(w) ** 2 for w in waves], axis=0)
        contrast = power.max() / max(np.median(power), 1e-300)
        if best is None or contrast > best[0]:
            best = (contrast, power, waves)
    assert best is not None
    _, power, waves = best
    found = []
    for _ in range(_LINES):
        top = int(np.argmax(power))
        # A sin(x + phase) has the transform (A/2i) exp(i phase).
        found.append((frequencies[top], np.array([np.angle(1j * w[top]) for w in waves])))
        power = np.where(np.abs(frequencies - frequencies[top]) < 2 / (length * dt), 0.0, power)
    return found


def memory_along(
    model: Model, dt, q: Float[Array, "G n"], v: Float[Array, "G n"], z0: Float[Array, " m"]
) -> Float[Array, "G m"]:
    """Internal states of a model that is led along a motion sampled every `dt` s."""
    if not model.memory:
        return jnp.zeros((q.shape[0], 0))
    first = Motion.at(0.0, q[0], v[0])
    begin = stack(model.memory_begin(first)) + z0

    def step(z, ends):
        t, q0, q1, v0, v1 = ends
        for k in range(_SUBSTEPS):
            part = (k + 0.5) / _SUBSTEPS
            middle = q0 + part * (q1 - q0), v0 + part * (v1 - v0)
            h = dt / _SUBSTEPS
            half = z + 0.5 * h * stack(model.memory_rate(Motion.at(t, *middle, z)))
            z = z + h * stack(model.memory_rate(Motion.at(t, *middle, half)))
        z = stack(model.memory_follow(Motion.at(t + dt, q1, v1, z)))
        return z, z

    t = dt * jnp.arange(q.shape[0] - 1)
    path = jax.lax.scan(step, begin, (t, q[:-1], q[1:], v[:-1], v[1:]))[1]
    return jnp.concatenate([begin[None], path])


def torque_along(
    model: Model, dt, q: Float[Array, "G n"], v: Float[Array, "G n"], z0: Float[Array, " m"]
) -> Float[Array, "G n"]:
    """Sum of a model's torques along a motion sampled every `dt` s, N m."""
    z = memory_along(model, dt, q, v, z0)
    t = dt * jnp.arange(q.shape[0])
    return jax.vmap(lambda *x: stack(model.torque(Motion.at(*x))))(t, q, v, z)
