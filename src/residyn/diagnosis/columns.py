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
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect
from ..filtering.kalman import Torques, gram
from ..filtering.law import (
    Laws,
    Table,
    along_delays,
    along_readings,
    changes_bodies,
    group_of,
    law_name,
    laws_for,
    number_slices,
    numbers_of,
    state_slices,
    states_along,
    torque_law,
    usual,
    with_numbers,
)
from ..filtering.linearised import (
    Field,
    Instants,
    Linear,
    Point,
    at_nodes,
    body_columns,
    changed_bodies,
    derivatives,
    nodes,
    transition,
)
from ..filtering.trajectory import Scene, Trajectory
from ..physics.effect import BASE
from ..physics.motion import Motion, split, stack
from ..physics.parameter import FREQUENCY, Parameter
from ..runtime.export_cache import kept
from .evidence import (
    CONTENDERS,
    INDISTINGUISHABLE,
    NOISE,
    Strength,
    conditional,
    gains_of,
    log_prior_intensity,
    log_sum,
    means_of_base,
    prior_of,
    signed,
    width_of,
)
from .spectrum import lines


def candidates(scene: Scene, present: Sequence[str]) -> list[AbstractEffect]:
    """Effects of the catalogue that could be missing from a model, at every place where they can
    act, less those `present` and those that such recordings cannot show.

    Under one load, a friction in proportion to it is Coulomb's. With one joint, a sensor's scale is
    a choice of unit, which the inertia has to bear; its delay is one of the first
    state, or of the drive.
    """
    orders, one_load = scene.recordings[0].orders, len({r.load for r in scene.recordings}) == 1

    def shown(e: AbstractEffect) -> bool:
        scale = e.senses and all(n.dimension.rotary in ("1", "s") for n in numbers_of(e))
        return not (
            (e.of_angles and orders[scene.joint_of(e)])
            or (e.of_load and one_load)
            or (scale and scene.n == 1)
        )

    free = [e for e in scene.catalogued if e.name not in BASE and numbers_of(e)]
    return [e for e in free if e.label not in present and shown(e)]


class Column(NamedTuple):
    """A candidate at one value of its shapes, and what that comes to, to first order."""

    effect: AbstractEffect
    shape: dict[str, float]  # field -> value
    which: tuple[int, ...]  # which columns of the Gram matrix are its strengths (and phases)
    states: np.ndarray  # (K, m) its internal states along the motion
    gain: float = 0.0  # by how much it raises the log evidence; its best, shapes averaged
    regressors: np.ndarray = np.zeros(0)  # posterior mean of its columns, in prior widths
    alike: tuple["Column", ...] = ()  # at other points of its grid, which cannot be told from it
    widths: Sequence[float] = (1.0,)  # prior standard deviations of its strengths, in their units

    @property
    def strengths(self) -> list[list[Strength | None]]:
        """That its columns are of, those together that are of one size; None of sine and cosine of
        an unknown phase."""
        if self.effect.oscillates:
            return [[None]] * len(self.which)
        own = zip(strengths(self.effect), self.widths, strict=True)
        each: list[Strength | None] = [Strength(number, float(width)) for number, width in own]
        return [each] if self.effect.of_one_size else [[s] for s in each]


def strengths(effect: AbstractEffect) -> list[Parameter]:
    """The numbers of an effect whose silent value silences it."""
    return [n for n in numbers_of(effect) if n.silent is not None]


def shapes(
    scene: Scene, effect: AbstractEffect, frequencies: Sequence[float]
) -> list[dict[str, float]]:
    """Every combination of an effect's shape numbers on their grids; a frequency takes those of the
    random torque's spectrum, Hz, too: what rings at it is seen at it alone."""
    own = [n for n in numbers_of(effect) if n.silent is None]
    grids = []
    for number in own:
        size = scene.size(effect, number)
        known = [] if number.field == effect.oscillates else [g * size for g in number.grid]
        if number.dimension is FREQUENCY:
            known += frequencies
        grids.append(known or [float(getattr(effect, number.field))])
    return [
        dict(zip((n.field for n in own), values, strict=True))
        for values in itertools.product(*grids)
    ]


def shaped_numbers(effect: AbstractEffect, shape: dict[str, float]) -> np.ndarray:
    """(p,) numbers of an effect: shapes as given, strengths silent."""
    each = (shape[x.field] if x.silent is None else x.silent for x in numbers_of(effect))
    return np.array([*each], float)


class Shaped(NamedTuple):
    """A law at J places (one, but for effects of one joint) and S shapes each, as data."""

    joints: tuple[int, ...]
    numbers: Any  # (J, S, p), strengths silent
    widths: Any  # (J, s) of the strengths' priors


@kept(like=(0, 0, 0, 0, 0, 0), seldom=True)
def columns(
    laws: Laws,
    shaped: Sequence[Shaped],
    model: tuple[Laws, Table],
    instants: Instants,
    point: Point,
    field: tuple[Any, Any, Any],
):
    """What each strength (and phase) of some laws does along a motion, at its prior's width.

    **Arguments:** `model` is along the motion, `field` its `by_x`, `by_torque`, `acceleration`.

    **Returns:** what `Torques` holds, the joints' columns together, N m, in the order of `_places`,
    then shape, phase, strength; and (F, K) internal states, in the same order.
    """
    n, K = point.spread.shape[1], instants.step.shape[0]
    by_x, by_torque, acceleration = field
    at = nodes(instants, point.path, point.spread, model[1].held)
    slots = model[1].whole
    bodies = changed_bodies(model[0], slots, slots.numbers, instants.mechanisms)
    mechanism, early = at_nodes(bodies, instants.run), at_nodes(bodies, instants.run, 1)
    sensed = at_nodes(instants.mechanisms, instants.run, 1)
    direction = jax.scipy.special.erf(at.v / (math.sqrt(2) * at.spread))
    anew = jnp.concatenate([jnp.ones(1, bool), instants.last[:-1]])

    def three(x):  # (r, N) to (3, r, K)
        return jnp.moveaxis(x.reshape(-1, 3, K), 1, 0)

    def of_law(effect, joint, numbers, widths, begun):
        """Torques (J, S phases s, r, N) at J joints, each of one r = 1, or of the whole mechanism,
        J = 1, and states (J, S phases m, K); `begun` (J, S, m, K) are those that they begin at."""
        which, m, alone = _which(effect), len(effect.memory), group_of(effect) == "joint"
        unit = jnp.eye(numbers.shape[-1])[which]

        def one(joint, numbers, width, begun):
            def own(x):
                return jax.lax.dynamic_slice_in_dim(x, joint, 1) if alone else x

            q, v, d = map(own, (at.q, at.v, direction))
            z = jnp.zeros((m, 3 * K))
            if m:
                args = three(q), three(v), at.time.reshape(3, K), instants.step
                z = states_along(effect, numbers, early, *args, anew, begun)
                begun, z = z[0], jnp.moveaxis(z, 0, 1).reshape(m, 3 * K)
            torque = _strengths(effect, unit, mechanism, q, v, at, z, numbers, d)
            if changes_bodies(effect):

                def change(u, mechanisms):
                    return jax.vmap(lambda b: with_numbers(effect, u[0]).bodies(b))(mechanisms)

                args = bodies, instants.run, at, acceleration
                torque += jnp.moveaxis(
                    body_columns(change, numbers[None], *args)[:, 0, which], 0, 1
                )
            return torque * width[:, None, None], begun

        # One row for each joint, shape and phase: every `vmap` more would be traced through.
        phases = np.array([0.0, math.pi / 2] if effect.oscillates else [0.0])
        J, S, p = numbers.shape
        rows = S * len(phases)
        joint, widths = (jnp.repeat(jnp.asarray(x), rows, axis=0) for x in (joint, widths))
        numbers = jnp.repeat(numbers.reshape(-1, p), len(phases), axis=0)
        begun = begun.reshape(J * S, 1, m, K) + phases[:, None, None]
        torque, z = jax.vmap(one)(joint, numbers, widths, begun.reshape(J * rows, m, K))
        return torque.reshape(J, -1, *torque.shape[-2:]), z.reshape(J, rows * m, K)

    moves, none = jnp.concatenate([at.v, acceleration]), jnp.zeros((2 * n, 0, 3 * K))
    f = Field(moves, by_x[: 2 * n, : 2 * n], none, by_torque[: 2 * n], direction)
    seen, rate, _ = derivatives(at, f, model[0].orders)
    torques, states, readings = [[] for _ in range(n + 1)], [[] for _ in range(n + 1)], []
    for effect, s in zip(laws.each, shaped, strict=True):
        if effect.senses:
            for numbers, width in zip(s.numbers, s.widths, strict=True):
                *_, by_number = along_readings(effect, sensed, seen.value, numbers[0])
                _, late = along_delays(effect, sensed, numbers[0])
                own = by_number - rate.value[:, None] * late
                readings.append(own[:, _which(effect)] * width[:, None])
            continue
        begun = jnp.zeros((*s.numbers.shape[:2], 0, K))
        if effect.memory:
            begin = functools.partial(_begin, effect, at=at, mechanism=early)
            rows = zip(s.joints, s.numbers, strict=True)
            begun = jnp.stack([jax.vmap(functools.partial(begin, j))(u) for j, u in rows])
        each = of_law(effect, s.joints, s.numbers, s.widths, begun)
        for joint, torque, z in zip(s.joints, *each, strict=True):
            place = joint if group_of(effect) == "joint" else n
            torques[place].append(torque)
            states[place].append(z)
    answers = responses(instants, by_x, by_torque)

    def nodes_of(each, rows: int):
        """(K, 3, r, C) of torques (C, r, 3 K)."""
        whole = jnp.concatenate([jnp.zeros((0, rows, 3 * K)), *each])
        return whole.reshape(-1, rows, 3, K).transpose(3, 2, 1, 0)

    joint = nodes_of([x for each in torques[:n] for x in each], 1)[:, :, 0]
    sensors = jnp.concatenate([jnp.zeros((n, 0, K)), *readings], 1).transpose(2, 0, 1)
    states = jnp.concatenate([jnp.zeros((0, K)), *itertools.chain(*states)])
    pushed = seen.by_torque.transpose(2, 0, 1)
    return answers, pushed, joint, nodes_of(torques[n], n), sensors, states


def _which(effect: AbstractEffect) -> np.ndarray:
    """Indices of an effect's strengths among its numbers."""
    return np.array([i for i, x in enumerate(numbers_of(effect)) if x.silent is not None], int)


def _places(laws: Laws, shaped: Sequence[Shaped], n: int):
    """Place, law, numbers (S, p) and widths (s,) in the order of columns: what acts at each joint,
    then on the whole mechanism, then sensors."""
    each = [
        (n + 1 if e.senses else j if group_of(e) == "joint" else n, e, *rows)
        for e, s in zip(laws.each, shaped, strict=True)
        for j, *rows in zip(s.joints, s.numbers, s.widths, strict=True)
    ]
    return sorted(each, key=lambda x: x[0])


def _begin(effect, j: int, numbers, at, mechanism):
    """(m, K) internal states as they begin in the motion of each instant; `mechanism` with leaves
    (K, ...)."""
    if group_of(effect) == "joint":
        effect = dataclasses.replace(effect, joint=mechanism.joints[j])
    own = with_numbers(effect, numbers)

    def begin(q, v, mechanism):
        return stack(own.begin(Motion.at(0.0, split(q), split(v)), mechanism))

    q, v = (x[:, : x.shape[1] // 3] for x in (at.q, at.v))
    return jax.vmap(begin, in_axes=(-1, -1, 0), out_axes=-1)(q, v, mechanism)


def _strengths(effect, unit, mechanism, q, v, at, z, numbers, direction):
    """(s, r, N) d torque / d strength; `direction` (r, N) of sliding."""

    def one(q, v, t, z, step, spread, mechanism, direction):
        def of(u):
            torque, level, _ = torque_law(effect, mechanism, q, v, t, z, step, spread, u)
            return stack(torque) + stack(level) * direction

        return jax.vmap(lambda e: jax.jvp(of, (numbers,), (e,))[1])(unit)

    over = jax.vmap(one, in_axes=(-1, -1, 0, -1, 0, -1, 0, -1), out_axes=-1)
    return over(q, v, at.time, z, at.step, at.spread, mechanism, direction)


def responses(instants: Instants, by_x, by_torque):
    """(K, 3, X, n) how a Runge-Kutta step answers to a unit torque that resists at its beginning,
    middle and end; not at all where another recording follows."""
    X, n, N = by_torque.shape
    third = (jnp.arange(N) // (N // 3) == i for i in range(3))
    field = jnp.concatenate([by_x, *(jnp.where(here, -by_torque, 0.0) for here in third)], 1)
    found = jnp.where(instants.last, 0.0, transition(instants.step, field, X)[:, X:])
    return found.reshape(X, 3, n, -1).transpose(3, 1, 0, 2)


class Columns:
    """Candidates along one model's motion.

    One program holds all effects of the catalogue at all their shapes; those that are not asked for
    are computed as well, and left out of the rows.
    """

    def __init__(
        self,
        scene: Scene,
        trajectory: Trajectory,
        effects: Sequence[AbstractEffect],
        frequencies: Sequence[float],
        shape_of: Mapping[str, dict[str, float]] | None = None,
        linear: Linear | None = None,
    ):
        """Effects at every shape of their grids, or at one each, by label; `linear` is the model
        along the motion, if it is there already."""
        self.scene, self.trajectory = scene, trajectory
        self.linear: Linear = linear or scene.linearised(trajectory)
        self.rows: list[Column] = []
        self._count = 0
        listed, others = ({e.label: e for e in effects if usual(e) is x} for x in (True, False))
        known = [e for e in scene.catalogued if usual(e) and strengths(e)]
        known = [e for e in known if e.name not in BASE]
        parts = []
        for group, wanted in ((known, listed), ([*others.values()], others)):
            if any(e.label in wanted for e in group):
                parts.append(self._part(group, wanted, list(frequencies), shape_of))
        order = [e.label for e in effects]
        self.rows.sort(key=lambda row: order.index(row.effect.label))
        self._used = np.array([i for row in self.rows for i in row.which], int)
        ends = itertools.accumulate((len(row.which) for row in self.rows), initial=0)
        self.rows = [
            row._replace(which=tuple(range(first, first + len(row.which))))
            for row, first in zip(self.rows, ends, strict=False)
        ]
        self._more = tuple(parts)

    def _part(self, group, wanted, frequencies, shape_of):
        """The columns of some effects by one program."""
        scene, t = self.scene, self.trajectory
        most = _most_lines(scene.n)
        laws, shaped = laws_for(group), []
        every: dict[str, list[dict[str, float]]] = {}
        of_law: dict[str, list[AbstractEffect]] = {}
        for effect in group:
            of_law.setdefault(law_name(effect), []).append(effect)
        for law in laws.each:
            members, tables = of_law[law_name(law)], []
            for effect in members:
                own = shapes(scene, effect, frequencies or [1.0])
                room = len(shapes(scene, effect, [1.0] * most))
                if shape_of and effect.label in shape_of:
                    own = [shape_of[effect.label]]
                numbers = [shaped_numbers(effect, s) for s in own]
                tables.append(np.stack(numbers + numbers[-1:] * (room - len(numbers))))
                every[effect.label] = own
            widths = [[width_of(scene, e, x) for x in strengths(e)] for e in members]
            joints = tuple(scene.joint_of(e) for e in members)
            shaped.append(Shaped(joints, np.stack(tables), np.array(widths)))
        first, row, places, counts = self._count, 0, [], np.zeros(scene.n, int)
        for place, law, numbers, width in _places(laws, shaped, scene.n):
            at_joint = group_of(law) == "joint"
            label = f"{law.name}:{scene.joints[place]}" if at_joint else law.label
            phases, own = 2 if law.oscillates else 1, len(width)
            m = 0 if law.senses else len(law.memory)
            for i, shape in enumerate(every[label] if label in wanted else []):
                at = first + i * phases * own
                where = slice(row + i * phases * m, row + i * phases * m + m)
                which = tuple(range(at, at + phases * own))
                places.append((wanted[label], shape, which, where, width))
            first += len(numbers) * phases * own
            row += len(numbers) * phases * m
            if at_joint:
                counts[place] += len(numbers) * phases * own
        linear = self.linear
        answers, pushed, joint, whole, sensors, states = columns(
            laws, tuple(shaped), scene.tabulated(t), scene.instants,
            Point(t.path, t.spread, t.u, t.first),
            (linear.by_x, linear.by_torque, linear.acceleration),
        )  # fmt: skip
        states = np.asarray(states)
        self.rows += [
            Column(e, s, which, states[where].T, widths=widths)
            for e, s, which, where, widths in places
        ]
        self._count = first
        each = np.split(np.asarray(joint), np.cumsum(counts)[:-1], axis=-1)
        return Torques(answers, pushed, tuple(each), whole, sensors)

    @property
    def inputs(self) -> tuple[np.ndarray, np.ndarray]:
        """(K, X, C) what each column adds to the states in a step, (K, n, C) to the readings."""
        each = zip(*(x.inputs() for x in self._more), strict=True)
        found = (np.concatenate(x, -1)[..., self._used] for x in each)
        return next(found), next(found)

    @property
    def torque(self) -> np.ndarray:
        """(K, n, C) of each column, at its prior's width, N m."""
        return np.concatenate([x.torque() for x in self._more], -1)[..., self._used]

    def gram(
        self, intensities: Sequence[float] | np.ndarray, read: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(I,) log normalisers, and the (I, 1 + P + C, 1 + P + C) Gram matrices of whitened
        innovations of readings, of the model's own regressors and of all columns, under each of
        some random torques; after the columns, of what `read` (K, r, D) adds to the readings."""
        scene, noise = self.scene, self.scene.noise(self.trajectory)
        more, D = self._more, 0
        if read is not None:
            D, first = read.shape[-1], more[0]
            none = np.zeros((*first.whole.shape[:-1], 0))
            more = (
                *more,
                first._replace(joint=(none[:, :, 0],) * scene.n, whole=none, sensors=read),
            )
        args = self.linear.system, more, scene.readings, noise
        totals, grams = zip(*(gram(*args, np.asarray(x, float)) for x in intensities), strict=True)
        P, size = 1 + len(self.trajectory.u), len(grams[0])
        keep = np.r_[0:P, P + self._used, size - D : size]
        return np.array(totals), np.stack([np.asarray(g)[np.ix_(keep, keep)] for g in grams])


class Screen:
    """The first-order evidence of any set of candidates along a model's motion, random torques
    summed over, relative to none of them."""

    def __init__(self, columns: Columns, intensities: Sequence[float]):
        totals, every = columns.gram(intensities)
        P, rows = len(columns.trajectory.u), columns.rows
        bases, self.grams = conditional(every, P)
        known = totals + bases + log_prior_intensity(intensities)
        self.rows = rows
        self.weights = known - log_sum(known)
        """(I,) log posterior of each random torque without candidates."""
        self.base_means = means_of_base(every, P)
        gains = self._gains([[row] for row in rows])
        each = (r._replace(gain=g, regressors=u) for r, (g, u) in zip(rows, gains, strict=True))
        self.ranked: list[Column] = []
        """Each candidate at its likeliest shape, the best first."""
        self.revise(each)

    def revise(self, points: Iterable[Column]) -> None:
        """Rank some candidates anew, each by its gains at the points of a grid."""
        ranked, grids = {s.effect.label: s for s in self.ranked}, {}
        for point in points:
            grids.setdefault(point.effect.label, []).append(point)
        for label, grid in grids.items():
            mean = log_sum([p.gain for p in grid]) - math.log(len(grid))
            first, *others = sorted(grid, key=lambda p: -p.gain)
            alike = (p for p in others if p.gain > first.gain - INDISTINGUISHABLE)
            ranked[label] = first._replace(gain=mean, alike=tuple(alike))
        self.ranked = sorted(ranked.values(), key=lambda s: -s.gain)

    def gain(self, rows: Sequence[Column]) -> tuple[float, np.ndarray]:
        """Gain of some columns together, and their regressors at the likeliest random torque."""
        return self._gains([rows])[0]

    def _gains(self, groups: Sequence[Sequence[Column]]) -> list[tuple[float, np.ndarray]]:
        """`gain` of each group of rows."""
        which = [[i for row in rows for i in row.which] for rows in groups]
        each = [[own for row in rows for own in row.strengths] for rows in groups]
        return gains_of(self.grams, self.weights, which, each)

    @functools.cached_property
    def pairs(self) -> list[tuple[float, Column, Column]]:
        """Every two candidates that may be in one model, the best pair first."""
        every = itertools.combinations(self.ranked, 2)
        each = [(a, b) for a, b in every if not of_one_kind(a.effect, b.effect)]
        gains = (gain for gain, _ in self._gains(each))
        found = ((gain, *pair) for gain, pair in zip(gains, each, strict=True))
        return sorted(found, key=lambda own: -own[0])


def of_one_kind(a: AbstractEffect, b: AbstractEffect) -> bool:
    """Whether two effects are laws of one kind at one place: a joint has one friction, whichever
    law that follows, so that no model has both."""
    return a.place == b.place and a.kind() == b.kind()


def nested(a: AbstractEffect, b: AbstractEffect) -> bool:
    """Whether one of two effects is at the other's place and contains its law."""
    return a.place == b.place and (a.extends == b.name or b.extends == a.name)


def spectral_lines(
    scene: Scene, trajectory: Trajectory, linear: Linear, known: Sequence[float] = ()
) -> list[float]:
    """Strongest frequencies, Hz, in the longest recording, beside those that are known: of the
    joints' random torques, for what drives one joint may show at another one; and of what is left
    of the readings, where they stand out of the noise, for a torque much faster than the arm rings
    is no random torque of its correlation time."""
    g = scene.grid
    own = max((g.of(i) for i in range(len(scene.recordings))), key=len)
    dt = float(np.median(g.step[own][:-1]))
    each = []
    left = (g.angle - np.asarray(linear.seen))[own] / np.sqrt(g.variance[own])
    for j, seen in enumerate(g.seen[own].T):
        time = (g.time + g.offset[:, j])[own][seen]
        each.append(lines(time, left[seen, j], dt, chance=NOISE))
    each += [lines(g.time[own], x, dt) for x in trajectory.torque[own].T]
    found, span = list(known), float(np.ptp(g.time[own]))
    for line in itertools.chain(*itertools.zip_longest(*each)):
        if line is not None and all(abs(line - other) >= 1.0 / span for other in found):
            found.append(line)
    return found[: _most_lines(scene.n)]


def _most_lines(n: int) -> int:
    """Frequencies that are screened at once: those of two motions of n joints."""
    return 2 * CONTENDERS * n


def with_effects(
    scene: Scene, t: Trajectory, kept: Sequence[int], more: Sequence[AbstractEffect] = ()
) -> Trajectory:
    """A model with some of its effects, as they are, and others, whose regressors and internal
    states are zero. Beyond springs and dampers they stand by name, so that what joined in another
    order is fitted by the same compiled program."""
    each, n = [*((t.effects[i], i) for i in kept), *((e, None) for e in more)], 2 * scene.n
    each.sort(key=lambda own: "" if own[0].name in BASE else own[0].label)
    effects = tuple(effect for effect, _ in each)

    def places(slices_of: Callable[..., list[slice]]) -> tuple[np.ndarray, np.ndarray]:
        old, new = slices_of(t.effects), slices_of(effects)
        both = [(old[i], own) for (_, i), own in zip(each, new, strict=True) if i is not None]
        before, after = zip((slice(0, 0),) * 2, *both, strict=True)
        return np.r_[before].astype(int), np.r_[after].astype(int)

    (numbers, at), (states, held) = places(number_slices), places(state_slices)
    u, room = np.zeros(scene.regressors(effects)), scene.room(effects)
    path, first = np.zeros((scene.K, n + room)), np.zeros((len(t.first), room))
    u[at], first[:, held] = t.u[numbers], t.first[:, states]
    path[:, np.r_[0:n, n + held]] = t.path[:, np.r_[0:n, n + states]]
    prior = prior_of(scene, effects)
    return dataclasses.replace(t, effects=effects, prior=prior, u=u, path=path, first=first)


def without(scene: Scene, t: Trajectory, label: str) -> Trajectory:
    """A model without one of its effects, from where it is."""
    return with_effects(scene, t, [i for i, x in enumerate(t.labels) if x != label])


def extended(scene: Scene, t: Trajectory, found: Column) -> Trajectory:
    """A model with one more effect, from the screen's answer."""
    begun = shaped_numbers(found.effect, found.shape)
    effect = with_numbers(found.effect, begun)
    t = with_effects(scene, t, range(len(t.effects)), [effect])
    place = t.labels.index(effect.label)
    own, states = number_slices(t.effects)[place], state_slices(t.effects)[place]
    values, phase, least = np.asarray(found.regressors), 0.0, 0.02
    if effect.oscillates:  # the phase is the first strength's
        sine, cosine = values.reshape(2, -1)
        phase = math.atan2(cosine[0], sine[0])
        values = math.cos(phase) * sine + math.sin(phase) * cosine
    strong = iter(values)
    numbers = np.array(t.prior.mean)
    numbers[own] = begun
    t.u[own] = t.prior.regressors(numbers)[own]
    for i, number in enumerate(numbers_of(effect), own.start):
        if number.silent is not None:
            t.u[i] = max(next(strong), least) if signed(number) else next(strong)
    t.path[:, 2 * scene.n :][:, states] = found.states + phase
    t.first[: len(scene.begins), states] = found.states[scene.begins] + phase
    return t
