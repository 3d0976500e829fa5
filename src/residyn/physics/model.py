"""A model is a mechanism plus effects: Eq. 1 as a value.

`PlanarArm(...) + Spring("shoulder", 16.7) + Damper("shoulder", 0.1)` is a model. Models are
immutable pytrees: adding or removing an effect gives a new one, and their leaves are the numbers
that JAX differentiates, vmaps and fits.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any, Generic, NamedTuple, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PyTree

from ..errors import InputError
from .effect import AbstractEffect, JointEffect, joint_of, unit_of
from .inertia import AbstractInertia
from .motion import Joints, Motion, split, stack
from .parameter import Memory, Parameter, floating, parameters_of

_Module = TypeVar("_Module", bound=eqx.Module)
_Model = TypeVar("_Model", bound="Model")
_Meaning = TypeVar("_Meaning", Parameter, Memory)


class Number(NamedTuple, Generic[_Meaning]):
    """One number, or internal state, of a model: its public name, its meaning, its effect, its
    joint (None: of no one joint), and whether it enters an equation of the mechanism."""

    name: str
    meaning: _Meaning
    effect: int
    joint: int | None
    acts: bool = True


class Model(eqx.Module):
    """Eq. 1: `mechanism.mass_matrix(q) q'' + f^w(q, q') + sum of effect torques = drive`."""

    mechanism: AbstractInertia
    effects: tuple[AbstractEffect, ...] = ()

    def __add__(self, effect: AbstractEffect) -> Self:
        """The model with one more effect.

        **Raises:** `ValueError` if it is there already, or its joint is not; `TypeError` if it is
        no effect, or has no name.
        """
        if not isinstance(effect, AbstractEffect):
            raise TypeError(f"{effect!r} is no effect: a model is a mechanism plus effects")
        if not getattr(effect, "name", None):
            raise TypeError(f"{type(effect).__name__} needs a name")
        if effect.label in self.labels:
            raise InputError(f"{effect.label} is in the model already")
        if effect.place is not None:
            # Not `places` of a joint's effect: a bare arm, or one without load, may be given one.
            own = isinstance(effect, JointEffect)
            places = self.mechanism.joints if own else effect.places(self.mechanism)
            if effect.place not in places:
                raise InputError(f"{effect.label}: {effect.name} goes with {', '.join(places)}")
        return dataclasses.replace(self, effects=(*self.effects, effect))

    def __str__(self) -> str:
        """The mechanism, and each number with its unit on a line."""
        lines = [f"{type(self.mechanism).__name__}: {', '.join(self.mechanism.joints)}"]
        values, shown = self.values(), [n for n in self.numbers if n.acts]
        width = max((len(n.name) for n in shown), default=0)
        for n in shown:
            unit = unit_of(self.labels[n.effect], n.meaning, self.mechanism)
            value = values[n.name]
            plain = jnp.ndim(value) == 0 and not isinstance(value, Tracer)
            told = f"{value:.6g}" if plain else value
            lines.append(f"    {n.name:{width}}  {told} {'' if unit == '1' else unit}".rstrip())
        return "\n".join(lines)

    def without(self, label: str) -> Self:
        """The model less the effect with this label.

        **Raises:** `ValueError` if it is not in the model.
        """
        if label not in self.labels:
            raise ValueError(f"{label} is not in the model ({', '.join(self.labels)})")
        kept = tuple(effect for effect in self.effects if effect.label != label)
        return dataclasses.replace(self, effects=kept)

    @property
    def labels(self) -> tuple[str, ...]:
        """`name` or `name:place` of each effect, in order."""
        return tuple(effect.label for effect in self.effects)

    @property
    def dry(self) -> bool:
        """Whether a joint can stick: whether any torque jumps with the direction of sliding."""
        return any(effect.dry for effect in self.effects)

    @property
    def rough(self) -> bool:
        """Whether the motion has jumps or corners, which ask for short integration steps."""
        return any(effect.dry or effect.rough for effect in self.effects)

    # -- physics -----------------------------------------------------------------------------

    @property
    def bodies(self) -> AbstractInertia:
        """The mechanism as the effects leave it."""
        mechanism = self.mechanism
        for effect in self.effects:
            mechanism = effect.bodies(mechanism)
        return mechanism

    def torque(self, motion: Motion) -> Joints:
        """Sum of the effects' torques on each joint, N m (or N)."""
        bodies = self.bodies
        total: Joints = (0.0,) * len(bodies.joints)
        for effect, own in self.each(motion):
            total = _add(total, effect.torque(own, bodies))
        return total

    def acceleration(
        self, motion: Motion, drive: Joints | None = None, held: Joints | None = None
    ) -> Joints:
        """q'' of Eq. 1, rad/s^2. `held` is 1 for a joint that sticks, whose q'' is then 0."""
        bodies = self.bodies
        load = _add(bodies.inertia_torque(motion.q, motion.v), self.torque(motion))
        load = tuple(-x for x in load) if drive is None else _add(drive, tuple(-x for x in load))
        matrix = bodies.mass_matrix(motion.q)
        return solve_inertia(matrix if held is None else holding(matrix, held), load)

    def vector_field(self, t, y, args=None):
        """(q', q'') at `y = (q, v)`, arrays (n,), in diffrax's signature.

        With internal states z (m,), `y = (q, v, z)` and z' comes last. `args` is None or the drive
        torque, (n,) N m.
        """
        motion = Motion.at(t, *y)
        drive = None if args is None else split(args)
        slopes = y[1], stack(self.acceleration(motion, drive))
        return (*slopes, stack(self.memory_rate(motion))) if len(y) > 2 else slopes

    # -- memory ------------------------------------------------------------------------------

    @property
    def memory(self) -> tuple[Number[Memory], ...]:
        """The internal states of all effects, in order."""
        which: dict[str | None, int] = {j: i for i, j in enumerate(self.mechanism.joints)}
        return tuple(
            Number(f"{effect.label}.{each.name}", each, index, which.get(effect.place))
            for index, effect in enumerate(self.effects)
            for each in effect.memory
        )

    def memory_begin(self, motion: Motion) -> Joints:
        """Internal states at a first instant of which nothing else is known."""
        bodies = self.bodies
        return tuple(z for effect in self.effects for z in effect.begin(motion, bodies))

    def memory_rate(self, motion: Motion) -> Joints:
        """d/dt of the internal states."""
        bodies = self.bodies
        return tuple(z for effect, own in self.each(motion) for z in effect.rate(own, bodies))

    def memory_follow(self, motion: Motion) -> Joints:
        """Internal states after a step that ended in `motion`."""
        bodies = self.bodies
        return tuple(z for effect, own in self.each(motion) for z in effect.follow(own, bodies))

    @property
    def follows(self) -> bool:
        """Whether `memory_follow` changes anything."""
        return any(effect.follows for effect in self.effects)

    @property
    def mirrors(self) -> bool:
        """Whether `upright` could do anything."""
        return any(effect.mirrors for effect in self.effects)

    def upright(self, memory: Joints) -> tuple[Self, Joints]:
        """The same model with every number of the sign that people write, and what `memory` is in
        it (which stays what effects begin with, and beyond)."""
        effects, states = [], ()
        for effect, own in self.each(Motion(0.0, (), (), (), memory)):
            kept, here = effect.upright(own.memory)
            effects, states = [*effects, kept], (*states, *here)
        return dataclasses.replace(self, effects=tuple(effects)), states

    def each(self, motion: Motion) -> Iterator[tuple[AbstractEffect, Motion]]:
        """Every effect with the motion as it sees it: with its own internal states."""
        first = 0
        for effect in self.effects:
            last = first + len(effect.memory)
            yield effect, motion._replace(memory=motion.memory[first:last])
            first = last

    # -- readings ----------------------------------------------------------------------------

    @property
    def senses(self) -> bool:
        """Whether the readings differ from the angles."""
        return any(effect.senses for effect in self.effects)

    def reading(self, angles: Float[Array, "*s n"]) -> Float[Array, "*s n"]:
        """What the sensors say, delays apart, where the angles are these; rad or m."""
        if not self.senses:
            return angles
        parts = tuple(angles[..., i] for i in range(angles.shape[-1]))
        for effect in self.effects:
            parts = effect.reading(parts, self.mechanism)
        return jnp.stack(parts, axis=-1)

    @property
    def late(self) -> bool:
        """Whether a reading is late."""
        return any(not isinstance(delay, float) for delay in self.delays)

    @property
    def delays(self) -> Joints:
        """How late each joint's reading is, s."""
        total: Joints = (0.0,) * len(self.mechanism.joints)
        for effect in self.effects:
            total = _add(total, effect.delays(self.mechanism))
        return total

    # -- numbers -----------------------------------------------------------------------------

    @property
    def numbers(self) -> tuple[Number[Parameter], ...]:
        """Every declared number of every effect, in order."""
        return _numbers(*_named(self))

    @property
    def fitted(self) -> tuple[Number[Parameter], ...]:
        """The numbers that a fit moves."""
        return _fitted(*_named(self))

    def vector(self) -> Float[Array | np.ndarray, " p"]:
        """The fitted numbers as one array, in the order of `fitted`; NumPy's if none is traced."""
        values = [getattr(self.effects[n.effect], n.meaning.field) for n in self.fitted]
        if any(isinstance(v, Tracer) for v in values):
            return jnp.stack([jnp.asarray(v, float) for v in values])
        return floating([float(v) for v in values])

    def with_vector(self, values: Float[Array | np.ndarray, " p"]) -> Self:
        """The model with its fitted numbers replaced.

        **Raises:** `ValueError` for more or fewer than it has.
        """
        if len(values) != len(self.fitted):
            raise ValueError(
                f"{len(values)} values: the model has {len(self.fitted)} fitted numbers: "
                f"{', '.join(n.name for n in self.fitted)}"
            )
        if isinstance(values, jax.Array) and not isinstance(values, Tracer):
            values = jax.device_get(values)
        return _with(self, dict(zip([n.name for n in self.fitted], values, strict=True)))

    def values(self) -> dict[str, Array]:
        """Public name -> value, for every number."""
        return {n.name: getattr(self.effects[n.effect], n.meaning.field) for n in self.numbers}

    def with_values(self, values: Mapping[str, PyTree]) -> Self:
        """The model with some numbers replaced, by public name.

        **Raises:** `ValueError` for a name that the model does not have.
        """
        known = {n.name for n in self.numbers}
        for name in values:
            if name not in known:
                raise ValueError(f"{name} is no number of this model ({', '.join(sorted(known))})")
        return _with(self, values)


def check_model(given: Any) -> None:
    """**Raises:** `TypeError` for what is no model, `ValueError` for a number of one that is not
    finite, or is several; of what is traced only the shape is looked at."""
    if not isinstance(given, Model):
        raise TypeError(f"{type(given).__name__} is no model: a mechanism plus effects is one")
    for name, value in given.values().items():
        if shape := np.shape(value):
            raise ValueError(f"{name} has shape {shape}: must be one number, or mapped by jax.vmap")
        if not isinstance(value, Tracer) and not np.isfinite(value):
            raise ValueError(f"{name} = {value}: must be finite")


# Functions, not methods: Equinox makes a pytree of every bound method, which takes its time.


def _with(model: _Model, values: Mapping[str, PyTree]) -> _Model:
    fields: list[dict[str, PyTree]] = [{} for _ in model.effects]
    for number in model.numbers:
        if number.name in values:
            fields[number.effect][number.meaning.field] = floating(values[number.name])
    pairs = zip(model.effects, fields, strict=True)
    return changed(model, effects=tuple(changed(e, **own) if own else e for e, own in pairs))


def changed(module: _Module, **fields) -> _Module:
    """`dataclasses.replace`, but nothing is converted and checked, which takes as long as a step of
    a fit."""
    new = object.__new__(type(module))
    for name, value in (module.__dict__ | fields).items():
        object.__setattr__(new, name, value)
    return new  # pyrefly: ignore[bad-return]


def _named(model: Model):
    return tuple((type(e), e.label) for e in model.effects), model.mechanism.joints


@functools.cache  # a fit asks some hundred times
def _numbers(effects: tuple[tuple[type[AbstractEffect], str], ...], joints: tuple[str, ...]):
    """The numbers of effects, each told by its class and its label, on a mechanism of `joints`."""
    found = []
    for index, (kind, label) in enumerate(effects):
        for meaning in parameters_of(kind):
            joint = joint_of(label, meaning, joints)
            acts = meaning.joint is None or meaning.joint < len(joints)
            found.append(Number(f"{label}.{meaning.name}", meaning, index, joint, acts))
    return tuple(found)


@functools.cache
def _fitted(effects, joints) -> tuple[Number[Parameter], ...]:
    return tuple(number for number in _numbers(effects, joints) if number.meaning.fitted)


def _add(x: Joints, y: Joints) -> Joints:
    return tuple(a + b for a, b in zip(x, y, strict=True))


def holding(matrix: tuple[Joints, ...], held: Joints) -> tuple[Joints, ...]:
    """The inertia matrix where joints are `held` (1) at rest: they are of very large inertia, so
    that one solve serves every pattern of sticking."""
    return tuple(
        tuple(z * (1.0 + 1e14 * held[i]) if i == j else z for j, z in enumerate(row))
        for i, row in enumerate(matrix)
    )


def solve_inertia(matrix: tuple[Joints, ...], load: Joints) -> Joints:
    """Z^-1 load, by elimination written out: for so few joints a library call costs more."""
    n = len(load)
    rows, right = [list(row) for row in matrix], list(load)
    for pivot in range(n):  # Z is positive definite: no pivoting
        for row in range(pivot + 1, n):
            factor = rows[row][pivot] / rows[pivot][pivot]
            right[row] = right[row] - factor * right[pivot]
            for column in range(pivot + 1, n):
                rows[row][column] = rows[row][column] - factor * rows[pivot][column]
    for row in reversed(range(n)):
        rest = sum(rows[row][column] * right[column] for column in range(row + 1, n))
        right[row] = (right[row] - rest) / rows[row][row]
    return tuple(right)
