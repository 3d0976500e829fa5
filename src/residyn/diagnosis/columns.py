"""Effects that a model may lack, as columns along its motion.

Along the smoothed motion an effect of small strength adds to the readings in proportion to it: a
column. An effect has as many as it has strengths (and phases), at each value of its shapes on a
grid. The filter of the model takes all columns of all candidates as right-hand sides of one
recursion (`filtering.kalman`), and the Gram matrix that it leaves holds the evidence of every
subset of them, to first order.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import erf, logsumexp

from ..effects import AbstractEffect, catalogue
from ..filtering.kalman import System, innovations
from ..filtering.law import changes_bodies, law, numbers_of, of_one_joint, reading, with_numbers
from ..filtering.linearised import nodes, transition
from ..filtering.trajectory import Along, Scene, Trajectory
from ..runtime.parallel import side_by_side
from .evidence import (
    conditional,
    half_normal,
    log_prior_intensity,
    means_of_base,
    signed,
    subset,
    width_of,
)

_BLOCK = 32  # columns in one call of the filter


def candidates(scene: Scene, present: Sequence[str]) -> list[AbstractEffect]:
    """Effects of the catalogue that could be missing from a model, at every place where they can
    act, less those `present` and those that such recordings cannot show.

    With one joint, a sensor's scale is a choice of unit, which the inertia has to bear; its delay
    is one of the first state, or of the drive.
    """
    found: list[AbstractEffect] = []
    mechanism = scene.mechanisms[0]
    for kind in catalogue().values():
        if kind.name in ("spring", "damper"):
            continue
        try:
            places = kind.places(mechanism)
        except ValueError:  # it makes no sense here
            continue
        each = [kind(p) for p in places] if places else [kind()]  # pyright: ignore
        found += [e for e in each if e.label not in present and numbers_of(e)]
    if scene.n == 1:
        found = [e for e in found if not (e.senses and _not_an_offset(e))]
    return found


def _not_an_offset(effect: AbstractEffect) -> bool:
    return all(n.dimension.rotary in ("1", "s") for n in numbers_of(effect))


class Column(NamedTuple):
    """A candidate at one value of its shapes."""

    effect: AbstractEffect
    shape: dict[str, float]
    """Field -> value."""
    which: tuple[int, ...]
    """Which columns of the Gram matrix are its strengths (and phases)."""


class Screened(NamedTuple):
    """A candidate at its likeliest shape, to first order."""

    effect: AbstractEffect
    gain: float
    """By how much it raises the log evidence, shapes averaged over their grid."""
    shape: dict[str, float]
    regressors: np.ndarray
    """Posterior mean of its columns, in prior widths."""
    which: tuple[int, ...]


def strengths(effect: AbstractEffect):
    """The numbers of an effect whose silent value silences it."""
    return [n for n in numbers_of(effect) if n.silent is not None]


def shapes(
    scene: Scene, effect: AbstractEffect, frequencies: Sequence[float]
) -> list[dict[str, float]]:
    """Every combination of an effect's shape numbers on their grids; a frequency takes those of the
    random torque's spectrum, Hz."""
    own = [n for n in numbers_of(effect) if n.silent is None]
    grids = []
    for number in own:
        if number.field == effect.oscillates:
            grids.append(list(frequencies))
        else:
            size = scene.size(effect, number)
            known = [g * size for g in number.grid]
            grids.append(known or [float(getattr(effect, number.field))])
    return [
        dict(zip((n.field for n in own), values, strict=True))
        for values in itertools.product(*grids)
    ]


def shaped_numbers(effect: AbstractEffect, shape: dict[str, float]) -> np.ndarray:
    """(p,) numbers of an effect: shapes as given, strengths silent."""
    return np.array([shape.get(x.field, x.silent) for x in numbers_of(effect)], float)


def columns_of(
    along: Along, effect: AbstractEffect, shape: dict[str, float]
) -> list[tuple[Any, Any]]:
    """What each strength of an effect does along a motion, at its prior's width.

    **Returns:** for each column the torque (K, 3, n), N m, that it amounts to, and what it adds to
    the readings (K, n); None for nothing.
    """
    scene = along.scene
    n, K, g = scene.n, scene.K, scene.grid
    silent = shaped_numbers(effect, shape)
    fields = [x.field for x in numbers_of(effect)]
    own = [(fields.index(x.field), width_of(scene, effect, x)) for x in strengths(effect)]
    if effect.senses:
        late = reading(effect, silent, scene.mechanisms[0], along.q[:, 0])
        v, by_number = along.v[:, 0], np.asarray(late.by_number)
        delay = np.asarray(late.delay_by_number)
        return [(None, w * (by_number[..., i] - v * delay[:, i])) for i, w in own]
    out: list[tuple[Any, Any]] = []
    if changes_bodies(effect):
        effects = [*along.effects, effect]
        motion = along.q, along.v, along.push
        body = [scene.body_column(effects, len(effects) - 1, silent, i, *motion) for i, _ in own]
    else:
        body = [0.0] * len(own)
    q, v, time = (x.reshape(3 * K, *x.shape[2:]) for x in (along.q, along.v, along.time))
    spread = along.node_spread.reshape(3 * K, n)
    step = np.repeat(np.where(g.step > 0, g.step, np.median(g.step[g.step > 0])), 3)
    bodies = along.bodies if of_one_joint(effect) else along.node_bodies
    phases = (0.0, math.pi / 2) if effect.oscillates else (0.0,)
    for phase in phases:
        z = np.zeros((3 * K, len(effect.memory)))
        if effect.memory:
            first = scene.begin_states(with_numbers(effect, silent), along.trajectory.path) + phase
            z = scene.states(effect, silent, along.q, along.v, along.time, first)
            z = z.reshape(3 * K, -1)
        found = law(effect, silent, bodies, time, q, v, z, step, spread)
        direction = erf(v / (math.sqrt(2) * spread))
        for (i, width), inertial in zip(own, body, strict=True):
            torque = found.whole(found.torque.by_number[..., i], n)
            if found.level is not None:
                torque = torque + found.whole(found.level.by_number[..., i], n) * direction
            out.append((width * (torque.reshape(K, 3, n) + inertial), None))
    return out


class Columns:
    """All candidates along one model's motion."""

    def __init__(
        self,
        scene: Scene,
        trajectory: Trajectory,
        effects: Sequence[AbstractEffect],
        frequencies: Sequence[float],
        shape_of: Mapping[str, dict[str, float]] | None = None,
    ):
        """Effects at every shape of their grids, or at one each, by label."""
        self.scene, self.trajectory = scene, trajectory
        along = scene.along(trajectory)
        self.system = scene.system(along)
        self.rows: list[Column] = []
        kinds: dict[type, list[AbstractEffect]] = {}
        for effect in effects:
            kinds.setdefault(type(effect), []).append(effect)

        def of_kind(members: list[AbstractEffect]):  # one program, so one thread
            return [
                (effect, shape, columns_of(along, effect, shape))
                for effect in members
                for shape in (
                    [shape_of[effect.label]] if shape_of else shapes(scene, effect, frequencies)
                )
            ]

        calls = [functools.partial(of_kind, members) for members in kinds.values()]
        torques, readings = [], []
        for effect, shape, new in itertools.chain.from_iterable(side_by_side(calls)):
            first = len(torques)
            self.rows.append(Column(effect, shape, tuple(range(first, first + len(new)))))
            torques += [t for t, _ in new]
            readings += [r for _, r in new]
        self.count = len(torques)
        none = np.zeros((scene.K, scene.n))
        self.torque = np.stack([none if t is None else t[:, 0] for t in torques] or [none], -1)
        """(K, n, C) of each column, at its prior's width, N m."""
        self._blocks = [
            self._block(along, torques[i : i + _BLOCK], readings[i : i + _BLOCK])
            for i in range(0, self.count, _BLOCK)
        ]

    def _block(self, along: Along, torques, readings):
        """Responses B (K, X, 32) and Hu (K, n, 32) of some columns."""
        scene = self.scene
        K, n, X = scene.K, scene.n, along.field.by_x.shape[-1]
        push, read = np.zeros((K, 3, X, _BLOCK)), np.zeros((K, n, _BLOCK))
        for i, (torque, seen) in enumerate(zip(torques, readings, strict=True)):
            if torque is not None:
                push[..., i] = -np.einsum("kaij,kaj->kai", along.field.by_torque, torque)
            if seen is not None:
                read[..., i] = seen
        zero = np.zeros((K, 3, X))
        f = along.field
        B = transition(scene.grid.step, zero, f.by_x, push, f.by_torque, zero).B
        B = np.array(B)
        B[scene.grid.last] = 0.0
        return B, read

    def inputs(self) -> tuple[np.ndarray, np.ndarray]:
        """(K, X, C) what each column adds to the states in a step, and (K, n, C) to the
        readings."""
        B, read = (
            np.concatenate(x, -1)[..., : self.count] for x in zip(*self._blocks, strict=True)
        )
        return B, read

    def gram(self, intensity: float) -> tuple[float, np.ndarray]:
        """Log normaliser, and the (1 + P + C)^2 Gram matrix of whitened innovations of readings, of
        the model's own regressors and of all columns, under a random torque."""
        scene, s = self.scene, self.system
        noise = scene.noise(self.trajectory)
        parts, total = [], 0.0
        for B, read in self._blocks:
            wide = System(
                s.A, np.concatenate([s.B, B], -1), s.T, s.c, s.Hx,
                np.concatenate([s.Hu, read], -1), s.hc,
            )  # fmt: skip
            total, white = innovations(wide, scene.readings, noise, np.asarray(intensity, float))
            white = np.asarray(white)
            parts.append(white if not parts else white[:, 1 + len(self.trajectory.u) :])
        white = np.concatenate(parts, axis=1)[:, : 1 + len(self.trajectory.u) + self.count]
        return float(total), white.T @ white

    def screen(self, intensities: Sequence[float]) -> "Screen":
        """Every candidate's first-order evidence, random torques summed over."""
        evidences, grams, base_means, P = [], [], [], len(self.trajectory.u)
        for intensity in intensities:
            total, gram = self.gram(intensity)
            base, rest = conditional(gram, P)
            evidences.append(total + base)
            grams.append(rest)
            base_means.append(means_of_base(gram, P))
        known = np.array(evidences) + log_prior_intensity(intensities)
        return Screen(self.rows, known - logsumexp(known), grams, base_means)


class Screen:
    """The first-order evidence of any set of candidates, relative to none of them."""

    def __init__(
        self,
        rows: Sequence[Column],
        weights: np.ndarray,
        grams: Sequence[np.ndarray],
        base_means: Sequence[np.ndarray],
    ):
        """`weights` (I,) log posterior of each random torque without candidates, `grams` (1 + C)^2
        for each; `base_means` (P, 1 + C) for each, see `means_of_base`."""
        self.rows, self.weights, self.grams, self.base_means = rows, weights, grams, base_means
        best: dict[str, list[Screened]] = {}
        for row in rows:
            gain, u = self.gain([row])
            best.setdefault(row.effect.label, []).append(
                Screened(row.effect, gain, row.shape, u, row.which)
            )
        found = []
        for each in best.values():
            gains = np.array([s.gain for s in each])
            top = each[int(np.argmax(gains))]
            found.append(top._replace(gain=float(logsumexp(gains) - math.log(len(gains)))))
        self.ranked = sorted(found, key=lambda s: -s.gain)
        """Each candidate at its likeliest shape, the best first."""

    def gain(self, rows: Sequence[Column] | Sequence[Screened]) -> tuple[float, np.ndarray]:
        """Gain of some columns together, and their regressors at the likeliest random torque."""
        which = [i for row in rows for i in row.which]
        gains, means = [], []
        for rest in self.grams:
            gain, u, covariance = subset(rest, which)
            spread, first = np.sqrt(np.diag(covariance)), 0
            for row in rows:
                if not row.effect.oscillates:
                    for i, number in enumerate(strengths(row.effect), first):
                        if signed(row.effect, number):
                            gain += float(half_normal(u[i] / spread[i]))
                first += len(row.which)
            gains.append(gain)
            means.append(u)
        each = np.array(gains) + self.weights
        return float(logsumexp(each)), means[int(np.argmax(each))]

    def pairs(self, most: int) -> list[tuple[float, Screened, Screened]]:
        """Every two of the best candidates, the best pair first."""
        found = []
        for a, b in itertools.combinations(self.ranked[:most], 2):
            found.append((self.gain([a, b])[0], a, b))
        return sorted(found, key=lambda f: -f[0])


def spectral_lines(scene: Scene, trajectory: Trajectory, count: int = 5) -> list[float]:
    """Strongest frequencies, Hz, of the joints' random torques in the longest recording: what
    drives one joint may show at another one."""
    g = scene.grid
    lengths = [np.sum((g.run == i) & (np.arange(scene.K) < g.real))
               for i in range(len(scene.recordings))]  # fmt: skip
    own = np.flatnonzero((g.run == int(np.argmax(lengths))) & (np.arange(scene.K) < g.real))
    time = g.time[own]
    dt = float(np.median(g.step[own][:-1]))
    even = np.arange(time[0], time[-1], dt)
    span = even[-1] - even[0]
    found: list[float] = []
    for x in trajectory.torque[own].T:
        x = np.interp(even, time, x)
        f = np.fft.rfftfreq(4 * len(even), dt)
        power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(even)), 4 * len(even)))
        power = power * (f > 1.5 / span)
        for _ in range(count):
            line = float(max(f[np.argmax(power)], 0.5 / span))
            power[np.abs(f - line) < 2.0 / span] = 0
            if all(abs(line - known) >= 1.0 / span for known in found):
                found.append(line)
    return found


def extended(scene: Scene, trajectory: Trajectory, prior_of, found: Screened) -> Trajectory:
    """A model with one more effect, from the screen's answer."""
    effect, shape = found.effect, found.shape
    begun = with_numbers(effect, shaped_numbers(effect, shape))
    effects = (*trajectory.effects, begun)
    prior = prior_of(scene, effects)
    P0 = len(trajectory.prior.mean)
    u = np.zeros(scene.regressors(effects))
    u[:P0] = trajectory.u[:P0]
    phase = 0.0
    values = list(found.regressors)
    if effect.oscillates:
        phase = math.atan2(values[1], values[0])
        values = [math.hypot(*values)]
    values = iter(values)
    # Dry friction is found from above: where it never holds a joint, no slope says that it might.
    least = 1.0 if effect.dry else 0.02
    numbers = np.array(prior.mean)
    for i, number in enumerate(numbers_of(effect), P0):
        if number.silent is None:
            numbers[i] = shape[number.field]
        else:
            x = next(values)
            u[i] = max(x, least) if signed(effect, number) else x
    shaped = prior.regressors(numbers)
    for i, number in enumerate(numbers_of(effect), P0):
        if number.silent is None:
            u[i] = shaped[i]
    n = scene.n
    m0 = sum(len(e.memory) for e in trajectory.effects)
    m = len(effect.memory)
    room = scene.room(effects)
    path = np.zeros((scene.K, 2 * n + room))
    old = trajectory.path.shape[1]
    path[:, :old] = trajectory.path
    first = np.zeros(room)
    first[:m0] = trajectory.first[:m0]
    if m:
        own = shaped_numbers(effect, shape)
        begin = scene.begin_states(begun, path) + phase
        q, v, _ = nodes(scene.grid.step, path, n)
        z = scene.states(effect, own, q, v, scene.times(), begin)
        path[:, 2 * n + m0 : 2 * n + m0 + m] = z[:, 0]
        first[m0 : m0 + m] = begin
    return dataclasses.replace(
        trajectory,
        effects=effects,
        prior=prior,
        u=u,
        path=path,
        first=first,
    )
