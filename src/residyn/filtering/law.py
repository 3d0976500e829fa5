"""Effects as data: one compiled program evaluates any model of a mechanism along a motion.

Along a given motion only the values and slopes of an effect's torque matter to a filter. A program
holds the law of every effect of the catalogue once, as the branches of a switch; a model is a table
of which law acts where and with which numbers, so no other model is compiled. A curve is data, too
(`free_curve`). Any other effect that is not in the catalogue, or whose fixed numbers are not the
usual ones, is handed to the program itself and compiled for the models that have it.

Dry friction jumps with the direction of sliding. It is split into the torque without it and the
*level* L of friction at each joint: torque = torque + L direction, -1 <= direction <= 1.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple, TypeGuard, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect, JointEffect, catalogue
from ..physics.inertia import AbstractInertia
from ..physics.motion import Motion, split, stack
from ..physics.parameter import Parameter, parameters_of
from .free_curve import FreeCurve, no_curves

_Effect = TypeVar("_Effect", bound=AbstractEffect)

RAMP = 0.4
"""Half-width of dry friction's ramp in steps: the Runge-Kutta step is stable above 1 / 2.78."""
RUNS = 4
"""Room for recordings is this, or twice that, and so on ..."""
ROOM = 4
"""... for a model's effects it comes in multiples of this, a search's three and a free curve beside
springs and dampers ..."""
REGRESSORS = 11
"""... for its numbers, of this: 1 + 11 columns of means are whole vectors of 4 or 8 float64 ..."""
STATES = 2
"""... and for its internal states, of this, the most of one effect of the catalogue: a state of two
joints, random torques included, is then one vector of 8 float64."""


def numbers_of(effect: AbstractEffect) -> list[Parameter]:
    """The p numbers of an effect that a fit moves."""
    return [each for each in parameters_of(effect) if each.fitted]


def each_number(effects: Iterable[AbstractEffect]) -> list[tuple[AbstractEffect, Parameter]]:
    """The numbers of a model in their order, each with its effect."""
    return [(effect, number) for effect in effects for number in numbers_of(effect)]


def with_numbers(effect: _Effect, values) -> _Effect:
    """The effect with its p fitted numbers replaced."""
    fields = [each.field for each in numbers_of(effect)]
    return dataclasses.replace(effect, **dict(zip(fields, split(values), strict=True)))


def _slices(counts: Iterable[int]) -> list[slice]:
    ends = np.cumsum([0, *counts]).tolist()
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def number_slices(effects: Sequence[AbstractEffect]) -> list[slice]:
    """Where each effect's numbers stand in `each_number`."""
    return _slices(len(numbers_of(e)) for e in effects)


def state_slices(effects: Sequence[AbstractEffect]) -> list[slice]:
    """Where each effect's internal states stand among a model's."""
    return _slices(len(e.memory) for e in effects)


def of_one_joint(effect: AbstractEffect) -> TypeGuard[JointEffect]:
    """Whether the effect's torque and states depend on the motion of its own joint alone."""
    return group_of(effect) == "joint"


def changes_bodies(effect: AbstractEffect) -> bool:
    """Whether the effect is an error of the inertias."""
    return type(effect).bodies is not AbstractEffect.bodies


# -- laws that a program holds ---------------------------------------------------------------------


class Laws(NamedTuple):
    """The laws of a program: by name, those of the catalogue; others, as they are; and curves."""

    names: tuple[str, ...]
    """See `law_name`."""
    others: tuple[AbstractEffect, ...] = ()
    orders: tuple[int, ...] = ()
    """Which derivative is read of each joint; () is angles."""
    curves: tuple[FreeCurve, ...] = ()

    @property
    def each(self) -> tuple[AbstractEffect, ...]:
        """An effect of each law, in the order of `Table.law`."""
        return (*map(_made, self.names), *self.others, *self.curves)

    def of(self, group: str) -> list[AbstractEffect]:
        """Those that act at one "joint", on the "whole" mechanism, or are of the "sensor"."""
        return [e for e in self.each if group_of(e) == group]

    def place(self, effect: AbstractEffect) -> int:
        """Where an effect's law is among those of its group."""
        names = [*self.names, *map(law_name, (*self.others, *self.curves))]
        index = names.index(law_name(effect), 0 if usual(effect) else len(self.names))
        return sum(group_of(e) == group_of(effect) for e in self.each[:index])


def group_of(effect: AbstractEffect) -> str:
    """The part of a program in which an effect's law stands."""
    return _group_of(type(effect))


@functools.cache
def _group_of(kind: type[AbstractEffect]) -> str:
    if kind.senses:
        return "sensor"
    alone = (
        issubclass(kind, JointEffect)
        and kind.torque is JointEffect.torque
        and kind.rate is JointEffect.rate
        and kind.jumps is JointEffect.jumps
    )
    return "joint" if alone else "whole"


@functools.cache
def _made(name: str) -> AbstractEffect:
    kind, _, place = name.partition(":")
    made = catalogue()[kind]
    with jax.ensure_compile_time_eval():
        if place or issubclass(made, JointEffect):
            return made(place)  # pyrefly: ignore[bad-argument-count]
        return made()


def law_name(effect: AbstractEffect) -> str:
    """What an effect's law is called in `Laws`: by `name` if it is one at all joints, as a usual
    effect's and a curve's are; else by its label."""
    one = of_one_joint(effect) and (isinstance(effect, FreeCurve) or usual(effect))
    return effect.name if one else effect.label


def usual(effect: AbstractEffect) -> bool:
    """Whether an effect is of this package's catalogue, its fixed numbers the usual ones."""
    kind = type(effect)
    if catalogue().get(effect.name) is not kind or not kind.__module__.startswith("residyn."):
        return False
    fixed = [p.field for p in parameters_of(effect) if not p.fitted]
    like = _made(effect.label)
    return all(float(getattr(effect, f)) == float(getattr(like, f)) for f in fixed)


def catalogue_on(mechanism: AbstractInertia) -> list[AbstractEffect]:
    """Every effect of the catalogue at every place where it can act on a mechanism."""
    found = []
    for kind in catalogue().values():
        try:
            places = kind.places(mechanism)
        except ValueError:  # it makes no sense here
            continue
        found += [kind(p) for p in places] if places else [kind()]  # pyrefly: ignore
    return found


def laws_for(
    effects: Sequence[AbstractEffect],
    catalogued: Sequence[AbstractEffect] = (),
    fixed: Collection[str] = (),
) -> Laws:
    """The laws of a program for some effects: the whole catalogue beside those that are `fixed`, by
    label; or no others, if another one of the effects is in no catalogue."""
    own = (e for e in effects if not usual(e) and not isinstance(e, FreeCurve))
    others = tuple(sorted(own, key=lambda e: e.label))  # in whatever order a model has them
    beside = [*effects, *catalogued] if all(e.label in fixed for e in others) else effects
    names = sorted({law_name(e) for e in beside if usual(e)})
    return Laws(tuple(names), others)


def curves_of(effects: Sequence[AbstractEffect]) -> tuple[FreeCurve, ...]:
    """The curves of a model, one of a kind at the most, as a program holds them."""
    known = {e.name: dataclasses.replace(e, joint="") for e in effects if isinstance(e, FreeCurve)}
    return tuple(known.get(e.name, e) for e in no_curves())


class Slots(NamedTuple):
    """Some of a model's effects as data; slots beyond `count` are empty."""

    count: Any  # ()
    law: Any  # (E,) index among the program's laws of the group
    joint: Any  # (E,)
    numbers: Any  # (E, p)
    slopes: Any  # (E, p) d number / d regressor
    column: Any  # (E,) where its numbers stand among the model's
    state: Any  # (E,) where its internal states stand


class Table(NamedTuple):
    """A model as data."""

    joint: Slots
    whole: Slots
    sensor: Slots
    held: Any  # (M,) whether an internal state changes only at the end of a step


def most_numbers(effects: Sequence[AbstractEffect]) -> int:
    """p of slots of some laws."""
    return max((len(numbers_of(e)) for e in effects), default=0)


def most_states(effects: Sequence[AbstractEffect]) -> int:
    """m of slots of some laws."""
    return max((len(e.memory) for e in effects), default=0)


def tabulated(
    laws: Laws,
    effects: Sequence[AbstractEffect],
    joints: Sequence[str],
    numbers: np.ndarray,
    slopes: np.ndarray,
    states: int,
) -> Table:
    """A model with some numbers (P,) as data; `slopes` (P,) turn them into regressors, and there is
    room for so many internal states."""
    own, memory = number_slices(effects), state_slices(effects)
    held = np.zeros(states, bool)
    for effect, each in zip(effects, memory, strict=True):
        held[each] = effect.follows

    def slots(group: str) -> Slots:
        members = [i for i, e in enumerate(effects) if group_of(e) == group]
        least = 2 * len(joints) if group == "joint" else 0  # springs and dampers
        room = ROOM * math.ceil(max(len(members), least + ROOM) / ROOM)
        p = most_numbers(laws.of(group))
        law, joint, column, state = np.zeros((4, room), int)
        values, widths = np.zeros((2, room, p))
        for k, i in enumerate(members):
            effect, count = effects[i], own[i].stop - own[i].start
            law[k] = laws.place(effect)
            joint[k] = joints.index(effect.joint) if of_one_joint(effect) else 0
            values[k, :count], widths[k, :count] = numbers[own[i]], slopes[own[i]]
            column[k], state[k] = own[i].start, memory[i].start
        return Slots(np.asarray(len(members)), law, joint, values, widths, column, state)

    return Table(slots("joint"), slots("whole"), slots("sensor"), held)


# -- laws along a motion ---------------------------------------------------------------------------


class Slopes(NamedTuple):
    """A vector of r entries at N instants, and its derivatives; instants are the last axis."""

    value: Any  # (r, N)
    by_q: Any  # (r, n, N); of what acts at one joint n = 1
    by_v: Any  # (r, n, N)
    by_z: Any  # (r, m, N) the effect's own m internal states
    by_number: Any  # (r, p, N) the effect's own p numbers


def _rows(values: tuple, room: int):
    """Scalars as an array, filled up."""
    return stack(values + (0.0,) * (room - len(values)))


class _Place(NamedTuple):
    """What an effect of one joint knows of the mechanism."""

    joints: tuple[str]


def _around(effect: AbstractEffect, mechanism) -> Any:
    """The mechanism as an effect sees it: of what acts at one joint, that joint alone."""
    return _Place((effect.joint,)) if of_one_joint(effect) else mechanism


def torque_law(effect: AbstractEffect, mechanism, q, v, t, z, step, spread, numbers):
    """Torques (r,) without dry friction, levels (r,) of it, and rates of the internal states of an
    effect at one instant; `q`, `v` (r,), of what acts at one joint r = 1."""
    own, around = with_numbers(effect, numbers), _around(effect, mechanism)
    alone = of_one_joint(effect)
    direction = tuple(float(alone) if effect.dry else jnp.sign(x) for x in v)
    motion = Motion(t, split(q), split(v), direction, split(z))
    if effect.grips:
        # A point's direction is smoothed over the ramp's time, and over what is not known of its
        # velocity (1.5 standard deviations, as a normal velocity's mean direction is).
        now = jax.lax.stop_gradient(own)
        lost = now.lost_speed(motion._replace(grain=1.0), mechanism) + 1e-12
        unsure = now.speed_spread(split(spread), mechanism)
        motion = motion._replace(grain=2 * RAMP * step + 1.5 * unsure / lost)
    torque, level = own.torque(motion, around), (0.0,) * len(v)
    if effect.dry:
        level = tuple(0.0 if x is None else x for x in own.jumps(motion, around))
    if effect.dry and alone:  # the mean of both directions
        torque = (torque[0] - level[0],)
    rates = own.rate(motion, around) if effect.memory and not effect.follows else ()
    return torque, level, rates


def with_slopes(f, count: int):
    """Value and derivatives in the first so many arguments of a function of one instant."""

    def at(*args):
        def twice(*args):
            value = f(*args)
            return value, value

        slopes, value = jax.jacfwd(twice, argnums=tuple(range(count)), has_aux=True)(*args)
        return value, *slopes

    return at


def along_torque(effect, room: tuple[int, int], mechanism, q, v, t, z, step, spread, numbers):
    """`torque_law` (2 r + m rows) at N instants as `Slopes`: `q`, `v`, `spread` (r, N), `t`, `step`
    (N,), `z` (m, N), `numbers` (p,); `room` (m, p)."""
    states, count = len(effect.memory), len(numbers_of(effect))

    def at(q, v, z, u, t, step, spread, mechanism):
        args = mechanism, q, v, t, z[:states], step, spread, u[:count]
        torques, levels, rates = torque_law(effect, *args)
        return _rows((*torques, *levels, *rates), 2 * q.shape[0] + room[0])

    def one(q, v, t, z, step, spread, mechanism):
        return Slopes(*with_slopes(at, 4)(q, v, z, numbers, t, step, spread, mechanism))

    axes = -1, -1, 0, -1, 0, -1, 0
    return jax.vmap(one, in_axes=axes, out_axes=-1)(q, v, t, z, step, spread, mechanism)


def beyond(v0, v1, h):
    """How far beyond its end a joint was that turned round in a step from rate v0 to v1: by a
    parabola."""
    turns = v0 * v1 < 0
    return jnp.where(turns, -0.5 * h * v1**2 / jnp.where(turns, v1 - v0, 1.0), 0.0)


def follow(effect, room: int, q, v, t, z, far, numbers, mechanism):
    """(room,) internal states after a step that began with states `z` (m,) and ended at `q`, `v`
    (r,), `far` (r,) from where it turned round."""
    own: Any = with_numbers(effect, numbers[: len(numbers_of(effect))])
    motion = Motion.at(t, q, v, z[: len(effect.memory)])._replace(turn=split(q + far))
    return _rows(tuple(own.follow(motion, _around(effect, mechanism))), room)


def along_readings(effect, mechanism, angle, numbers):
    """What an effect of the sensors makes of angles (n, N): readings, and their slopes (n, n, N)
    and (n, p, N); `mechanism` with leaves (N, ...)."""
    count = len(numbers_of(effect))

    def at(angle, u, mechanism):
        own = with_numbers(effect, u[:count])
        return stack(own.reading(split(angle), mechanism))

    def one(angle, mechanism):
        return with_slopes(at, 2)(angle, numbers, mechanism)

    return jax.vmap(one, in_axes=(-1, 0), out_axes=-1)(angle, mechanism)


def along_delays(effect, mechanism, numbers):
    """Delays (n, N) of the joints' sensors, s, and their slopes (n, p, N); else as above."""
    count = len(numbers_of(effect))

    def late(u, mechanism):
        return stack(with_numbers(effect, u[:count]).delays(mechanism))

    return jax.vmap(lambda m: with_slopes(late, 1)(numbers, m), out_axes=-1)(mechanism)


def states_along(effect: Any, numbers, mechanism, q, v, t, h, anew, z0):
    """Internal states (3, m, K) of an effect along a motion, at the nodes of each step.

    **Arguments:** `q`, `v` (3, r, K), `t` (3, K), `h` (K,) steps;
    `anew` (K,) where the states begin anew, at `z0` (m, K); `mechanism` with leaves (K, ...).
    """
    own: Any = with_numbers(effect, numbers)

    def step(z, at):
        q, v, t, h, anew, z0, mechanism = at
        held, around = jnp.where(anew, z0, z), _around(effect, mechanism)
        if effect.follows:
            z = held
            for i in (1, 2):
                far = beyond(v[i - 1], v[i], h / 2)
                z = follow(effect, len(z0), q[i], v[i], t[i], z, far, numbers, mechanism)
            return z, jnp.stack([held, held, held])

        def rate(z, i, k):
            t_, q_, v_ = (0.5 * (x[i] + x[k]) for x in (t, q, v))
            return stack(own.rate(Motion.at(t_, q_, v_, z), around))

        def half(z, i):
            return z + h / 2 * rate(z + h / 4 * rate(z, i, i), i, i + 1)

        middle = half(held, 0)
        end = half(middle, 1)
        return end, jnp.stack([held, middle, end])

    def first(x):  # (3, ..., K) to (K, 3, ...)
        return jnp.moveaxis(x, -1, 0)

    each = first(q), first(v), first(t), h, anew, z0.T, mechanism
    return jnp.moveaxis(jax.lax.scan(step, z0[:, 0], each)[1], 0, -1)


def stacked_mechanisms(mechanisms: Sequence[AbstractInertia], room: int):
    """Mechanisms, one for each recording, as one whose leaves are (R, ...), R being the `room`."""
    mechanisms = [*mechanisms, *(mechanisms[-1],) * (room - len(mechanisms))]
    return jax.tree.map(
        lambda *leaves: np.stack([np.asarray(x, float) for x in leaves]),
        *[eqx.filter(m, eqx.is_array_like) for m in mechanisms],
    )
