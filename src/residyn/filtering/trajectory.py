"""The iterated smoother: a model, its numbers and the motion, made to agree with each other.

The model is linearised along a motion, the Kalman smoother gives a better motion and better
numbers, and so on: Gauss-Newton's method on the whole motion (Bell, SIAM J. Optimization 4, 1994).
With a loud random torque the readings lead, whatever the model; without one it is the fit by least
squares. From loud to silent, each from where the louder one ended, no start slips a cycle.

Every number of a model is a *regressor* u with a unit normal prior: number = mean + width u, or
mean exp(width u) for a shape.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import erf

from ..effects import AbstractEffect
from ..physics.inertia import AbstractInertia
from ..physics.model import Model
from ..physics.parameter import Parameter, Scales
from ..recordings.recording import Recording
from .grid import Grid, Spectrum, lay_out
from .kalman import Evidences, Noise, Readings, System, evidences, smooth
from .law import (
    Law,
    along_instants,
    changes_bodies,
    first_states,
    followed,
    law,
    numbers_of,
    of_one_joint,
    reading,
    states_along,
    with_numbers,
)
from .linearised import (
    Field,
    Sums,
    array_leaves,
    body_torque,
    field,
    nodes,
    transition,
)

REGRESSORS = 8
"""Room for a model's numbers comes in multiples of this."""
STATES = 2
"""Room for internal states comes in multiples of this."""
SQRT2 = math.sqrt(2.0)
_FIRST = 3.0  # typical sizes that the first angle and rate may be off
_MEMORY = 0.5  # typical sizes that an internal state may be off at first
_TINY = 1e-6  # relative step of a difference in the bodies


def _not_yet() -> np.ndarray:
    return np.zeros((0, 0))


class Prior(NamedTuple):
    """How P regressors become numbers."""

    mean: np.ndarray
    width: np.ndarray
    log: np.ndarray
    """(P,) bool: mean exp(width u), else mean + width u."""

    def numbers(self, u: np.ndarray) -> np.ndarray:
        """(P,) numbers at regressors."""
        u = np.asarray(u)[: len(self.mean)]
        grown = self.mean * np.exp(np.where(self.log, np.clip(self.width * u, -20, 20), 0.0))
        return np.where(self.log, grown, self.mean + self.width * u)

    def slopes(self, u: np.ndarray) -> np.ndarray:
        """(P,) d number / du."""
        return np.where(self.log, self.width * self.numbers(u), self.width)

    def regressors(self, numbers: np.ndarray) -> np.ndarray:
        """The inverse of `numbers`."""
        ratio = np.where(self.log, numbers / np.where(self.log, self.mean, 1.0), 1.0)
        linear = (numbers - self.mean) / self.width
        return np.where(self.log, np.log(np.maximum(ratio, 1e-300)) / self.width, linear)


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """A model with its numbers and the motion that goes with them."""

    effects: tuple[AbstractEffect, ...]
    prior: Prior
    u: np.ndarray
    """(P,) regressors, filled up: 0 where the model has no number."""
    path: np.ndarray
    """(K, 2n + M) smoothed angles, rates and internal states."""
    spread: np.ndarray
    """(K, n) standard deviation of the rates."""
    first: np.ndarray
    """(M,) internal states at the beginning of each recording, as known beforehand."""
    log_evidence: float = -math.inf
    covariance: np.ndarray = dataclasses.field(default_factory=_not_yet)
    """(P, P) of u; this and the next two are empty until the model is smoothed."""
    torque: np.ndarray = dataclasses.field(default_factory=_not_yet)
    """(K, n) the random torque, on the drive's side of Eq. 1."""
    torque_variance: np.ndarray = dataclasses.field(default_factory=_not_yet)
    """(K, n)"""

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(e.label for e in self.effects)

    @property
    def numbers(self) -> np.ndarray:
        """(P,) all numbers of the model, in the order of its effects."""
        return self.prior.numbers(self.u)

    def valued(self) -> tuple[AbstractEffect, ...]:
        """The effects with these numbers."""
        return tuple(
            with_numbers(e, self.numbers[s]) if s.stop > s.start else e
            for e, s in zip(self.effects, number_slices(self.effects), strict=True)
        )


def number_slices(effects: Sequence[AbstractEffect]) -> list[slice]:
    """Where each effect's numbers stand among a model's."""
    ends = np.cumsum([0, *(len(numbers_of(e)) for e in effects)])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def state_slices(effects: Sequence[AbstractEffect]) -> list[slice]:
    """Where each effect's internal states stand among a model's."""
    ends = np.cumsum([0, *(len(e.memory) for e in effects)])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


class Scene:
    """Recordings on one grid, and the typical sizes of their motion."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        mechanisms: Sequence[AbstractInertia],
        wild: Sequence[np.ndarray],
        rest: float = 0.0,
        correlation: float = 1.0,
    ):
        """`rest`: standard deviation of each recording's own rest, in amplitudes; 0: it is 0.
        `correlation`: time of the random torque, in radians of a joint's ringing."""
        self.recordings, self.mechanisms = tuple(recordings), tuple(mechanisms)
        self.grid: Grid = lay_out(recordings, wild)
        g = self.grid
        self.joints = mechanisms[0].joints
        self.n = n = len(self.joints)
        self.K = len(g.time)
        self.rest, self.correlation = rest, correlation
        self.begins = [int(np.argmax(g.run == i)) for i in range(len(recordings))]
        q = np.zeros_like(g.angle)
        v = np.zeros_like(g.angle)
        for i in range(len(recordings)):
            own = np.flatnonzero((g.run == i) & (np.arange(self.K) < g.real))
            for j in range(n):
                use = own[g.seen[own, j]]
                q[own, j] = np.interp(g.time[own], g.time[use], g.angle[use, j]) if len(use) else 0
            v[own] = np.gradient(q[own], g.time[own], axis=0)
        q[g.real :], v[g.real :] = q[g.real - 1], 0.0
        self.q, self.v = q, v
        seen = np.arange(self.K) < g.real
        rows = mechanisms[0].mass_matrix((0.0,) * n)
        inertia = np.array([[float(x) for x in row] for row in rows])
        amplitude = np.maximum(np.std(q[seen], axis=0), 3 * np.sqrt(g.variance[0]))
        long = int(np.argmax([r.duration for r in recordings]))
        stiffness = Spectrum.of(recordings[long], wild[long]).stiffness(inertia)
        slowest = 2 * math.pi / recordings[long].duration
        pace = np.maximum(np.sqrt(stiffness / np.diag(inertia)), slowest)
        self.scales = [
            Scales(float(inertia[j, j]), float(pace[j]), float(math.sqrt(2) * amplitude[j]))
            for j in range(n)
        ]
        self.torque = np.array([s.inertia * s.frequency**2 * s.amplitude for s in self.scales])
        self.readings = Readings(jnp.asarray(g.angle), jnp.asarray(g.seen), jnp.asarray(g.variance))

    @property
    def length(self) -> int:
        """How many readings count."""
        return int(self.grid.seen.sum())

    def joint_of(self, effect: AbstractEffect) -> int:
        """The joint whose typical sizes an effect's numbers have."""
        return self.joints.index(effect.place) if effect.place in self.joints else self.n - 1

    def size(self, effect: AbstractEffect, number: Parameter) -> float:
        """Typical size of one number."""
        return float(number.dimension.size(self.scales[self.joint_of(effect)]))

    def start(self, effects: Sequence[AbstractEffect], prior: Prior) -> Trajectory:
        """A model, led by nothing but the readings yet."""
        room = self.room(effects)
        path = np.concatenate([self.q, self.v, np.zeros((self.K, room))], axis=1)
        spread = np.tile([0.1 * s.amplitude * s.frequency for s in self.scales], (self.K, 1))
        u = np.zeros(self.regressors(effects))
        return Trajectory(tuple(effects), prior, u, path, spread, np.zeros(room))

    def regressors(self, effects: Sequence[AbstractEffect]) -> int:
        """Room for a model's numbers, and for the recordings' own rests."""
        count = sum(len(numbers_of(e)) for e in effects)
        count += len(self.recordings) * self.n if self.rest else 0
        return REGRESSORS * math.ceil(count / REGRESSORS)

    @staticmethod
    def room(effects: Sequence[AbstractEffect]) -> int:
        return max(STATES, STATES * math.ceil(sum(len(e.memory) for e in effects) / STATES))

    # -- the linear system --------------------------------------------------------------------

    def bodies(self, effects: Sequence[AbstractEffect]):
        """The mechanism of each instant as the effects leave it, leaves (K, ...)."""
        found = []
        for mechanism in self.mechanisms:
            bodies = array_leaves(mechanism)
            for effect in effects:
                if changes_bodies(effect):
                    bodies = array_leaves(effect.bodies(bodies))
            found.append(bodies)
        return along_instants(found, self.grid.run)

    def states(self, effect: AbstractEffect, numbers: np.ndarray, q, v, time, first: np.ndarray):
        """(K, 3, m) an effect's internal states along the nodes of a motion, which begin each
        recording at `first` (m,)."""
        anew = np.full((self.K, len(effect.memory)), np.nan)
        anew[self.begins] = first
        bodies = self.bodies(())
        return np.asarray(states_along(effect, numbers, bodies, q, v, time, self.grid.step, anew))

    def begin_states(self, effect: AbstractEffect, path: np.ndarray) -> np.ndarray:
        """(m,) an effect's internal states where nothing is known of them."""
        k, n = self.begins[0], self.n
        return first_states(effect, self.mechanisms[0], path[k, :n], path[k, n : 2 * n])

    def times(self) -> np.ndarray:
        """(K, 3) of the nodes."""
        g = self.grid
        return np.stack([g.time, g.time + g.step / 2, g.time + g.step], axis=1)

    def along(self, t: Trajectory) -> "Along":
        """The model along its motion."""
        n, g = self.n, self.grid
        effects = t.valued()
        q, v, z = nodes(g.step, t.path, n)
        for effect, own in zip(effects, state_slices(effects), strict=True):
            if effect.follows:  # it changes only at the end of a step
                z[:, 1:, own] = z[:, :1, own]
        time, K, M = self.times(), self.K, z.shape[-1]
        bodies = self.bodies(effects)
        spread = np.stack([t.spread, *(2 * [np.concatenate([t.spread[1:], t.spread[-1:]])])], 1)
        spread[:, 1] = 0.5 * (spread[:, 0] + spread[:, 2])
        spread = spread + 1e-12
        slopes, numbers = t.prior.slopes(t.u), t.numbers
        sums = Sums.zeros(K, n, M, len(t.u))
        step = np.where(g.step > 0, g.step, np.median(g.step[g.step > 0]))

        def flat(x):
            return x.reshape(K * 3, *x.shape[2:])

        flat_bodies = None
        parts = zip(effects, number_slices(effects), state_slices(effects), strict=True)
        for effect, own, states in parts:
            if effect.senses:
                continue
            if flat_bodies is None and not of_one_joint(effect):
                flat_bodies = jax.tree.map(lambda x: np.repeat(x, 3, axis=0), bodies)
            found = law(
                effect,
                numbers[own],
                bodies if flat_bodies is None else flat_bodies,
                flat(time),
                flat(q),
                flat(v),
                flat(z[..., states]),
                np.repeat(step, 3),
                flat(spread),
            )
            _add(sums, found, own, states, slopes[own], effect.follows)
        for i, (effect, own) in enumerate(zip(effects, number_slices(effects), strict=True)):
            if changes_bodies(effect):
                # Torque that the change of bodies amounts to; friction held apart.
                for p in range(own.start, own.stop):
                    push = g.drive - sums.torque - sums.level * erf(v / (SQRT2 * spread))
                    column = self.body_column(effects, i, numbers[own], p - own.start, q, v, push)
                    sums.torque_u[..., p] += column * slopes[p]
        found = Field(*map(np.asarray, field(bodies, step, q, v, g.drive, spread, sums)))
        return Along(self, t, effects, time, q, v, z, bodies, found, sums, spread)

    def body_column(self, effects, index: int, numbers, which: int, q, v, push) -> np.ndarray:
        """(K, 3, n) d torque / d number of an effect that changes the bodies."""
        effect = effects[index]
        size = _TINY * max(abs(float(numbers[which])), 1e-2)
        beside = []
        for side in (1.0, -1.0):
            moved = np.array(numbers, float)
            moved[which] += side * size
            others = [*effects]
            others[index] = with_numbers(effect, moved)
            beside.append(self.bodies(others))
        own = self.bodies(effects)
        up, down = (np.asarray(body_torque(own, b, q, v, push)) for b in beside)
        return (up - down) / (2 * size)

    def linearised(self, t: Trajectory) -> System:
        """A model as a linear system along its own motion."""
        return self.system(self.along(t))

    def system(self, along: "Along") -> System:
        """The linear system along a motion."""
        t, n, g = along.trajectory, self.n, self.grid
        f = along.field
        x = np.concatenate([along.q, along.v, along.z], axis=-1)
        found = transition(g.step, f.f, f.by_x, f.by_u, f.by_torque, x)
        changes = g.last.any() or any(e.follows for e in along.effects)
        A, B, T, c = (np.array(x) if changes else np.asarray(x) for x in found)
        slopes, numbers = t.prior.slopes(t.u), t.numbers
        parts = zip(along.effects, number_slices(along.effects), state_slices(along.effects),
                    strict=True)  # fmt: skip
        for effect, own, states in parts:
            if not effect.follows:
                continue
            z0, q1, v1 = along.z[:, 0, states], along.q[:, 2], along.v[:, 2]
            late = followed(effect, numbers[own], along.bodies, along.time[:, 2], q1, v1, z0)
            value, by_z, by_q, by_u = (np.asarray(a) for a in late)
            rows = slice(2 * n + states.start, 2 * n + states.stop)
            A[:, rows] = by_q @ A[:, :n]
            A[:, rows, rows] += by_z
            B[:, rows], T[:, rows] = by_q @ B[:, :n], by_q @ T[:, :n]
            B[:, rows, own] += by_u * slopes[own]
            gone = np.einsum("kij,kj->ki", by_z, z0) + np.einsum("kij,kj->ki", by_q, q1)
            c[:, rows] = value - gone + np.einsum("kij,kj->ki", by_q, c[:, :n])
        Hx, Hu, seen = self.reading_rows(along)
        path, u = x[:, 0], t.u
        hc = seen - np.einsum("kij,kj->ki", Hx, path) - Hu @ u
        if self.rest:
            for i in range(len(self.recordings)):
                for j in range(n):
                    at = len(u) - 1 - i * n - j
                    Hu[self.grid.run == i, j, at] = self.rest * self.scales[j].amplitude
        last = g.last
        if last.any():
            A[last], B[last], T[last] = 0.0, 0.0, 0.0
            following = np.concatenate([path[1:], path[-1:]])
            begin = np.zeros_like(following)
            begin[:, :n] = np.concatenate([self.q[1:], self.q[-1:]])
            begin[:, 2 * n :] = t.first
            c[last] = begin[last]
        return System(A, B, T, c - B @ u, Hx, Hu, hc)

    def reading_rows(self, along: "Along"):
        """Slopes of the readings in the state and in the regressors, and the readings."""
        n, g, t = self.n, self.grid, along.trajectory
        q, v = along.q[:, 0], along.v[:, 0]
        K, X = self.K, 2 * n + along.z.shape[-1]
        a, by_x = along.field.f[:, 0, n : 2 * n], along.field.by_x[:, 0, n : 2 * n]
        delay, slopes, numbers = np.zeros(n), t.prior.slopes(t.u), t.numbers
        sensors, delay_u = [], np.zeros((n, len(t.u)))
        for effect, own in zip(along.effects, number_slices(along.effects), strict=True):
            if effect.senses:
                sensors.append((effect, own))
                late = reading(effect, numbers[own], self.mechanisms[0], q)
                delay = delay + np.asarray(late.delay)
                delay_u[:, own] += np.asarray(late.delay_by_number) * slopes[own]
        # q(t - d), averaged: q - d q' + (d^2 / 2 + spread) q''.
        w = 0.5 * delay**2 + g.spread[:, None]
        value = q - delay * v + w * a
        Hx = w[..., None] * by_x
        Hx[:, range(n), range(n)] += 1.0
        Hx[:, range(n), range(n, 2 * n)] -= delay
        Hu = (w[..., None] * along.field.by_u[:, 0, n : 2 * n]) if w.any() else np.zeros(
            (K, n, len(t.u)))  # fmt: skip
        Hu = Hu + (-v + delay * a)[..., None] * delay_u
        for effect, own in sensors:
            seen = reading(effect, numbers[own], self.mechanisms[0], value)
            value, by_angle = np.asarray(seen.value), np.asarray(seen.by_angle)
            Hx, Hu = by_angle @ Hx, by_angle @ Hu
            Hu[..., own] += np.asarray(seen.by_number) * slopes[own]
        assert Hx.shape == (K, n, X)
        return Hx, Hu, value

    def noise(self, t: Trajectory) -> Noise:
        """First state and random torque: of typical torques (rms) at intensity 1, correlated over
        the scene's `correlation` in radians of a joint's ringing."""
        n, g = self.n, self.grid
        M = t.path.shape[1] - 2 * n
        mean, variance = np.zeros(2 * n + M), np.zeros(2 * n + M)
        mean[:n] = self.q[self.begins[0]]
        for j, s in enumerate(self.scales):
            variance[j] = (_FIRST * s.amplitude) ** 2
            variance[n + j] = (_FIRST * s.amplitude * s.frequency) ** 2
        for effect, own in zip(t.effects, state_slices(t.effects), strict=True):
            scale = self.scales[self.joint_of(effect)]
            for i, each in zip(range(own.start, own.stop), effect.memory, strict=True):
                mean[2 * n + i] = t.first[i]
                variance[2 * n + i] = (_MEMORY * float(each.dimension.size(scale))) ** 2
        loud = self.torque**2
        pace = np.array([s.frequency for s in self.scales]) / self.correlation
        decay = np.where(g.last[:, None], 0.0, np.exp(-g.step[:, None] * pace))
        growth = np.concatenate([np.zeros((self.K, 2 * n + M)), loud * (1 - decay**2)], 1)
        growth[g.last, : 2 * n + M] += variance
        return Noise(mean, np.concatenate([variance, loud]), decay, growth)

    def evidences(self, t: Trajectory, system: System, intensities: Sequence[float]) -> Evidences:
        """A model, linearised along its motion, under each of some random torques."""
        each = np.asarray(intensities, float)
        return Evidences(*map(np.asarray, evidences(system, self.readings, self.noise(t), each)))

    def smoothed(
        self, t: Trajectory, system: System, intensity: float, share: float = 1.0
    ) -> Trajectory | None:
        """A model's motion and numbers given the readings and a random torque: one Gauss-Newton
        step from where it is, or a share of it; None where the model runs away."""
        n, X = self.n, t.path.shape[1]
        found = smooth(system, self.readings, self.noise(t), np.asarray(intensity, float))
        evidence, u, covariance, mean, variance = map(np.asarray, found)
        if not (np.isfinite(evidence) and np.isfinite(mean).all()):
            return None
        return dataclasses.replace(
            t,
            u=t.u + share * (u - t.u),
            path=t.path + share * (mean[:, :X] - t.path),
            spread=np.sqrt(np.maximum(variance[:, n : 2 * n], 1e-18)),
            log_evidence=float(evidence),
            covariance=covariance,
            torque=mean[:, X:],
            torque_variance=np.maximum(variance[:, X:], 0.0),
        )

    def model(self, t: Trajectory) -> Model:
        """The model of the first recording's pose."""
        return Model(self.mechanisms[0], t.valued())


@dataclasses.dataclass(frozen=True, eq=False)
class Along:
    """A model along its motion: what its linear system, and columns of further effects, need."""

    scene: Scene
    trajectory: Trajectory
    effects: tuple[AbstractEffect, ...]
    time: np.ndarray  # (K, 3)
    q: np.ndarray  # (K, 3, n)
    v: np.ndarray
    z: np.ndarray  # (K, 3, M)
    bodies: AbstractInertia  # leaves (K, ...)
    field: Field
    sums: Sums
    node_spread: np.ndarray  # (K, 3, n) standard deviation of the rates

    @functools.cached_property
    def node_bodies(self):
        """The bodies at every node, leaves (3 K, ...)."""
        return jax.tree.map(lambda x: np.repeat(x, 3, axis=0), self.bodies)

    @property
    def push(self) -> np.ndarray:
        """(K, 3, n) what accelerates the bodies: drive less all torques."""
        friction = self.sums.level * self.field.direction
        return self.scene.grid.drive - self.sums.torque - friction


def _add(sums: Sums, found: Law, own: slice, states: slice, slopes: np.ndarray, follows: bool):
    """Add an effect along its motion to the sums; `slopes` (p,) turn its numbers into
    regressors."""
    K = len(sums.torque)

    def rows(x: np.ndarray) -> np.ndarray:
        return x.reshape(K, 3, *x.shape[1:])

    j = slice(None) if found.joint is None else slice(found.joint, found.joint + 1)
    s = found.torque
    sums.torque[..., j] += rows(s.value)
    sums.torque_q[..., j, j] += rows(s.by_q)
    sums.torque_v[..., j, j] += rows(s.by_v)
    sums.torque_z[..., j, states] += rows(s.by_z)
    sums.torque_u[..., j, own] += rows(s.by_number * slopes)
    if found.level is not None:
        s = found.level
        sums.level[..., j] += rows(s.value)
        sums.level_q[..., j, j] += rows(s.by_q)
        sums.level_v[..., j, j] += rows(s.by_v)
        sums.level_u[..., j, own] += rows(s.by_number * slopes)
    if found.rate is not None and not follows:
        s = found.rate
        sums.rate[..., states] += rows(s.value)
        sums.rate_q[..., states, j] += rows(s.by_q)
        sums.rate_v[..., states, j] += rows(s.by_v)
        sums.rate_z[..., states, states] += rows(s.by_z)
        sums.rate_u[..., states, own] += rows(s.by_number * slopes)
