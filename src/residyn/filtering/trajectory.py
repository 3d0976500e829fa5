"""The iterated smoother: a model, its numbers and the motion, made to agree with each other.

The model is linearised along a motion, the Kalman smoother gives a better motion and better
numbers, and so on: Gauss-Newton's method on the whole motion (Bell, SIAM J. Optimization 4, 1994).
With a loud random torque the readings lead, whatever the model; without one it is the fit by least
squares. From loud to silent, each from where the louder one ended, no start slips a cycle.

Every number of a model is a *regressor* u with a unit normal prior: number = mean + width u, or
mean exp(width u) for a shape.
"""

import copy
import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..effects import AbstractEffect
from ..fitting.layout import bucket
from ..fitting.problem import identifiable, richest
from ..physics.effect import joint_of, unit_of
from ..physics.inertia import AbstractInertia
from ..physics.model import Model
from ..physics.motion import Motion
from ..physics.parameter import Parameter, Scales
from ..recordings.recording import Recording
from .grid import Grid, Spectrum, lay_out, moving
from .kalman import Evidences, Noise, Readings, evidences, smooth
from .law import (
    REGRESSORS,
    RUNS,
    STATES,
    Laws,
    Table,
    catalogue_on,
    curves_of,
    each_number,
    group_of,
    laws_for,
    number_slices,
    stacked_mechanisms,
    state_slices,
    tabulated,
    with_numbers,
)
from .linearised import Instants, Linear, Point, followed, linearise


class Prior(NamedTuple):
    """How P regressors become numbers."""

    mean: np.ndarray
    width: np.ndarray
    log: np.ndarray  # (P,) bool: mean exp(width u), else mean + width u

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
    u: np.ndarray  # (P,) regressors, filled up: 0 where the model has no number
    path: np.ndarray  # (K, 2n + M) smoothed angles, rates and internal states
    spread: np.ndarray  # (K, n) standard deviation of the rates
    first: np.ndarray  # (R, M) internal states where recordings begin, as known beforehand; R: room
    log_evidence: float
    # Until the model is smoothed of size 0:
    covariance: np.ndarray  # (P, P) of u
    torque: np.ndarray  # (K, n) the random torque, on the drive's side of Eq. 1
    torque_variance: np.ndarray
    coloured: float | None = None  # correlation time of the noise, if it was smoothed under that
    torque_time: float = 1.0
    """Correlation time of the random torque, in radians of each joint's ringing."""

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


class Scene:
    """Recordings on one grid, and the typical sizes of their motion: inertia, pace, reach and noise
    are those of the longest one."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        mechanisms: Sequence[AbstractInertia],
        wild: Sequence[np.ndarray],
        fast: float | None = None,
    ):
        """`wild` (N, n) of each recording marks readings that do not count; `fast`: rad/s of the
        fastest motion, if that is known."""
        self.recordings, self.mechanisms, self.wild = tuple(recordings), tuple(mechanisms), wild
        self.joints = mechanisms[0].joints
        n = len(self.joints)
        self.units = mechanisms[0].units or ("rad",) * n
        self.torque_units = tuple("N" if unit == "m" else "N m" for unit in self.units)
        long = int(np.argmax([r.duration for r in recordings]))
        rows = mechanisms[long].mass_matrix((0.0,) * n)
        inertia = np.array([[float(x) for x in row] for row in rows])
        driven = recordings[long].drive is not None
        mirrored = not (driven or any(recordings[long].orders))
        spectrum = Spectrum.of(recordings[long], wild[long], mirrored)
        stiffness = spectrum.stiffness(inertia, driven)
        roots = np.linalg.eigvals(np.linalg.solve(inertia, np.diag(stiffness)))
        rings = 0.0 if driven else math.sqrt(np.abs(roots).max())  # rad/s, the fastest mode
        self.grid: Grid = lay_out(recordings, wild, fast, rings)
        g = self.grid
        self.catalogued = [
            e for e in catalogue_on(richest(mechanisms)) if identifiable(e, recordings)
        ]
        self.fixed: tuple[str, ...] = ()
        """Labels of the effects that all models of a search have: one program serves all."""
        self.coloured: float | None = None
        """Correlation time, s, of noise of the readings that is not white, whose intensity then
        stands where the random torque's does; None: all their noise is white."""
        self.orders = recordings[0].orders if any(recordings[0].orders) else ()
        self._laws: dict[tuple[tuple[str, type], ...], Laws] = {}
        self.n, self.K = n, len(g.time)
        self.real = np.arange(self.K) < g.real
        self.begins = [int(np.argmax(g.run == i)) for i in range(len(recordings))]
        q, v = np.zeros_like(g.angle), np.zeros_like(g.angle)
        for i in range(len(recordings)):
            own = g.of(i)
            for j in range(n):
                time, angle, use = g.time[own] + g.offset[own, j], g.angle[own, j], g.seen[own, j]
                if self.orders and self.orders[j]:
                    r = recordings[i].as_angles
                    time, angle, use = r.time - r.time[0], r.angle[:, j], np.isfinite(r.angle[:, j])
                q[own, j] = np.interp(g.time[own], time[use], angle[use]) if use.any() else 0
            v[own] = np.gradient(q[own], g.time[own], axis=0)
        q[g.real :], v[g.real :] = q[g.real - 1], 0.0
        self.q, self.v = q, v
        each = map(g.of, range(len(recordings)))
        moves = np.concatenate([own[: moving(q[own])] for own in each])
        noise = np.sqrt(np.median(g.variance[g.of(long)], axis=0))
        noise = noise * recordings[long].as_angles.noise / recordings[long].noise
        amplitude = np.maximum(np.std(q[moves], axis=0), 3 * noise)
        amplitude = math.sqrt(2) * amplitude
        swing = np.maximum(recordings[long].extent.largest, amplitude)
        duration = recordings[long].duration
        pace = np.maximum(np.sqrt(stiffness / np.diag(inertia)), 2 * math.pi / duration)
        sizes = np.diag(inertia), pace, amplitude, mechanisms[long].reach()
        self._set_scales([
            Scales(*map(float, own), duration=duration, swing=float(most))
            for *own, most in zip(*sizes, swing, strict=True)
        ])  # fmt: skip
        self.readings = Readings(g.angle, g.seen, g.variance)
        self.instants = Instants(
            step=g.step,
            usual=np.median(g.step[g.step > 0]),
            time=g.time,
            drive=np.moveaxis(g.drive, 0, -1),
            offset=g.offset.T,
            spread=g.spread.T,
            run=g.run,
            last=g.last,
            first_angle=np.concatenate([q[1:], q[-1:]]).T,
            mechanisms=stacked_mechanisms(mechanisms, bucket(len(mechanisms), least=RUNS)),
        )

    def scale_torques(self, times: np.ndarray) -> None:
        """Take torques at the joints to be (n,) times as large as what accelerates them. Their pace
        stays, and with it how fast anything is that acts."""
        pairs = zip(self.scales, times.tolist(), strict=True)
        self._set_scales([s._replace(inertia=s.inertia * k) for s, k in pairs])

    def _set_scales(self, scales: list[Scales]) -> None:
        self.scales = scales
        self.torque = np.array([s.inertia * s.frequency**2 * s.amplitude for s in scales])

    def with_noise(self, coloured: float | None) -> "Scene":
        """The same recordings with noise of this correlation time, s, or white."""
        other = copy.copy(self)
        other.coloured = coloured
        return other

    @property
    def length(self) -> int:
        """How many readings count."""
        return int(self.grid.seen.sum())

    @property
    def highest(self) -> float:
        """Log density of the readings without any residual."""
        g = self.grid
        return float(-0.5 * np.sum(np.where(g.seen, np.log(2 * np.pi * g.variance), 0.0)))

    def joint_of(self, effect: AbstractEffect) -> int:
        """The joint whose typical sizes an effect's numbers have."""
        return self.joints.index(effect.place) if effect.place in self.joints else self.n - 1

    def size(self, effect: AbstractEffect, number: Parameter) -> float:
        """Typical size of one number."""
        joint = joint_of(effect.label, number, self.joints)
        return float(number.dimension.size(self.scales[-1 if joint is None else joint]))

    def unit(self, effect: AbstractEffect, number: Parameter) -> str:
        """Unit of one number."""
        return unit_of(effect.label, number, self.mechanisms[0])

    def start(self, effects: Sequence[AbstractEffect], prior: Prior) -> Trajectory:
        """A model, led by nothing but the readings yet."""
        room = self.room(effects)
        path = np.concatenate([self.q, self.v, np.zeros((self.K, room))], axis=1)
        spread = np.tile([0.1 * s.amplitude * s.frequency for s in self.scales], (self.K, 1))
        first = np.zeros((bucket(len(self.recordings), least=RUNS), room))
        u, none = np.zeros(self.regressors(effects)), np.zeros((0, 0))
        t = Trajectory(tuple(effects), prior, u, path, spread, first, -math.inf, none, none, none)
        for run, k in enumerate(self.begins):
            motion = Motion.at(0.0, tuple(self.q[k]), tuple(self.v[k]))
            each = [float(z) for e in t.valued() for z in e.begin(motion, self.mechanisms[run])]
            first[run, : len(each)] = each
        path[:, 2 * self.n :] = first[self.grid.run]
        return t

    def regressors(self, effects: Sequence[AbstractEffect]) -> int:
        """Room for a model's numbers."""
        return REGRESSORS * math.ceil(len(each_number(effects)) / REGRESSORS)

    @staticmethod
    def room(effects: Sequence[AbstractEffect]) -> int:
        return max(STATES, STATES * math.ceil(sum(len(e.memory) for e in effects) / STATES))

    def tabulated(self, t: Trajectory) -> tuple[Laws, Table]:
        """A model as data, and the laws of the program that takes it."""
        kinds = tuple((e.label, type(e)) for e in t.effects)
        laws = self._laws.get(kinds)
        if laws is None or laws.others:  # the others may hold data of their own
            laws = laws_for(t.effects, self.catalogued, self.fixed)._replace(orders=self.orders)
        self._laws[kinds] = laws
        laws = laws._replace(curves=curves_of(t.effects))
        slopes = t.prior.slopes(t.u)
        return laws, tabulated(laws, t.effects, self.joints, t.numbers, slopes, t.first.shape[1])

    def linearised(self, t: Trajectory) -> Linear:
        """A model as a linear system along its own motion."""
        point = Point(t.path, t.spread, t.u, t.first)
        found = linearise(*self.tabulated(t), self.instants, point)
        if self.coloured is None:
            return found
        # Coloured noise has the random torque's law, but is added to the readings.
        system = found.system
        added = np.tile(np.eye(self.n), (self.K, 1, 1))
        silent = {"T": np.zeros_like(system.T), "unsure": np.zeros_like(system.unsure)}
        return found._replace(system=system._replace(Ht=added, **silent))

    def torques(self, t: Trajectory, linear: Linear | None = None) -> dict[str, np.ndarray]:
        """(K, n) torque of each effect of a model along its own motion, N m; what acts on readings
        or inertias has none. `linear`: the model along the motion, if it is there already."""
        linear = linear or self.linearised(t)
        direction = np.asarray(linear.direction)[:, : self.K]
        joint, whole = iter(np.asarray(linear.torque_joint)), iter(np.asarray(linear.torque_whole))
        found = {}
        for effect in t.effects:
            torque, group = np.zeros((self.n, self.K)), group_of(effect)
            if group == "joint":
                own = next(joint)
                j = self.joint_of(effect)
                torque[j] = own[0] + own[1] * direction[j]
            elif group == "whole":
                own = next(whole)
                torque = own[: self.n] + own[self.n :] * direction
            found[effect.label] = torque.T
        return found

    def rms_torque(self, t: Trajectory) -> np.ndarray:
        """(n,) of the random torque at intensity 1: with a correlation time of a radian of the
        joint's ringing the typical torque. With another one as much as has the same spectral
        density at the ringing, 2 rms^2 T / (1 + T^2), so that it does as much to the motion."""
        time = t.torque_time
        return self.torque * math.sqrt((1.0 + time**2) / (2.0 * time))

    def noise(self, t: Trajectory) -> Noise:
        """First state, known to its typical size, and random torque (`rms_torque` at intensity 1).
        Coloured noise in its place: of the readings' own rms at intensity 1."""
        n, g = self.n, self.grid
        amplitude = np.array([s.amplitude for s in self.scales])
        pace = np.array([s.frequency for s in self.scales])
        memory = np.zeros(t.first.shape[1])
        for effect, own in zip(t.effects, state_slices(t.effects), strict=True):
            scale = self.scales[self.joint_of(effect)]
            memory[own] = [float(each.dimension.size(scale)) for each in effect.memory]
        mean = np.concatenate([self.q[self.begins[0]], np.zeros(n), t.first[0]])
        variance = np.concatenate([amplitude, amplitude * pace, memory]) ** 2
        loud, fades = self.rms_torque(t) ** 2, pace / t.torque_time
        if self.coloured is not None:
            loud, fades = np.var(g.angle, axis=0, where=g.seen), np.full(n, 1.0 / self.coloured)
        decay = np.where(g.last[:, None], 0.0, np.exp(-g.step[:, None] * fades))
        growth = np.concatenate([np.zeros((self.K, len(mean))), loud * (1 - decay**2)], 1)
        growth[g.last, : len(mean)] += variance
        return Noise(mean, np.concatenate([variance, loud]), decay, growth)

    def possible(self, evidences: np.ndarray) -> np.ndarray:
        """Log evidences, but -inf where they are not finite, or above the density of the readings
        without any residual: noise is in every innovation, so that only rounding comes so high, of
        a model whose motion grows exponentially."""
        return np.where(evidences <= self.highest, evidences, -np.inf)

    def evidences(
        self, t: Trajectory, linear: Linear, intensities: Sequence[float] | np.ndarray
    ) -> Evidences:
        """A model, linearised along its motion, under each of some random torques."""
        each = np.asarray(intensities, float)
        return Evidences(
            *map(np.asarray, evidences(linear.system, self.readings, self.noise(t), each))
        )

    def smoothed(
        self, t: Trajectory, linear: Linear, intensity: float, share: float = 1.0
    ) -> Trajectory | None:
        """A model's motion and numbers given the readings and a random torque: one Gauss-Newton
        step from where it is, or a share of it; None where the model runs away.

        Internal states that follow the angles are functions of them, with corners: these are
        evaluated along the new motion, for the linear step is right on one side of a corner only.
        """
        n, X = self.n, t.path.shape[1]
        found = smooth(linear.system, self.readings, self.noise(t), np.asarray(intensity, float))
        evidence, u, covariance, mean, variance = map(np.asarray, found)
        if not (np.isfinite(evidence) and np.isfinite(mean).all()):
            return None
        coloured = self.coloured is not None  # then there is no random torque
        torque = 0.0 * mean[:, X:] if coloured else mean[:, X:]
        moved = dataclasses.replace(
            t,
            u=t.u + share * (u - t.u),
            path=t.path + share * (mean[:, :X] - t.path),
            spread=np.sqrt(np.maximum(variance[:, n : 2 * n], 1e-18)),
            log_evidence=float(evidence),
            covariance=covariance,
            torque=torque,
            # Readings make nothing less sure; rounding may, of a motion that grows exponentially.
            torque_variance=np.clip(
                variance[:, X:], 0.0, 0.0 if coloured else (intensity * self.rms_torque(t)) ** 2
            ),
            coloured=self.coloured,
        )
        return self.consistent(moved)

    def consistent(self, t: Trajectory) -> Trajectory:
        """A motion with the internal states that follow its angles."""
        if not any(e.follows for e in t.effects):
            return t
        path = followed(*self.tabulated(t), self.instants, t.path)
        return dataclasses.replace(t, path=np.asarray(path))

    def model(self, t: Trajectory) -> Model:
        """The model of the first recording's pose."""
        return Model(self.mechanisms[0], t.valued())
