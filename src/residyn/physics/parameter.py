"""What a number means.

A fit moves plain numbers; a person reads stiffnesses, torques and angles. `param` ties the two
together: an effect declares each of its numbers once, as a field with its meaning (words,
dimension, allowed sign, the *silent value* at which the effect is exactly absent), and everything
that needs the meaning (units in a table, the scale of a step, bounds) reads it from there.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

Sign = Literal["any", "positive"]


class Scales(NamedTuple):
    """Typical size of a joint's motion: what a parameter of that joint can be measured against.

    `inertia` in kg m^2 (or kg), `frequency` in rad/s, `amplitude` (as of a sine with the motion's
    rms) and `swing` (the largest angle, which differs where the motion decays) in rad (or m),
    `length` of the link in m, `duration` of the recording in s.
    """

    inertia: float = 1.0
    frequency: float = 1.0
    amplitude: float = 1.0
    length: float = 1.0
    duration: float = 1.0
    swing: float = 1.0


class Dimension(NamedTuple):
    """A kind of quantity: its unit at a rotary joint, at a sliding joint, its typical size, and its
    unit between joints of either kind, if it can be between joints."""

    rotary: str
    sliding: str
    size: Callable[[Scales], float]
    between: str = ""

    def unit(self, *joints: str) -> str:
        """The unit for joints read in these units, "rad" or "m"; both where that is not known."""
        kinds = set(joints)
        if kinds == {"rad"} or self.rotary == self.sliding:
            return self.rotary
        if kinds == {"m"}:
            return self.sliding
        if kinds and self.between:
            return self.between
        return f"{self.rotary} or {self.sliding}"


RATIO = Dimension("1", "1", lambda s: 1.0)
ANGLE = Dimension("rad", "m", lambda s: s.amplitude)
RATE = Dimension("rad/s", "m/s", lambda s: s.amplitude * s.frequency)
DURATION = Dimension("s", "s", lambda s: 1.0 / s.frequency)
FREQUENCY = Dimension("Hz", "Hz", lambda s: s.frequency / (2 * math.pi))
INERTIA = Dimension("kg m^2", "kg", lambda s: s.inertia)
TORQUE = Dimension("N m", "N", lambda s: s.inertia * s.frequency**2 * s.amplitude)
# Times the sine of an angle: as large as a stiffness, not as the torque at one swing.
MOMENT = Dimension("N m", "N", lambda s: s.inertia * s.frequency**2)
# Between a joint in rad and one in m: V = k q1 q2 is in J, and k in J/(m rad).
STIFFNESS = Dimension("N m/rad", "N/m", lambda s: s.inertia * s.frequency**2, "N/rad")
# Of what changes slowly: in a whole recording, not in a swing.
STIFFNESS_RATE = Dimension(
    "N m/(rad s)", "N/(m s)", lambda s: s.inertia * s.frequency**2 / s.duration
)
# Of powers of the motion: as large as the spring's torque at full swing. In a motion that decays
# their rms is then about what a typical torque's is, too.
CUBIC = Dimension("N m/rad^3", "N/m^3", lambda s: s.inertia * (s.frequency / s.swing) ** 2)
DAMPING = Dimension("N m s/rad", "N s/m", lambda s: s.inertia * s.frequency, "N s/rad")
QUADRATIC = Dimension("N m s^2/rad^2", "N s^2/m^2", lambda s: s.inertia / s.swing)
# Of a point of a link, such as a bearing: forces that turn it as a torque of typical size does.
FORCE = Dimension("N", "N", lambda s: s.inertia * s.frequency**2 * s.amplitude / s.length)
POINT_DAMPING = Dimension("N s/m", "N s/m", lambda s: s.inertia * s.frequency / s.length**2)
POINT_QUADRATIC = Dimension("N s^2/m^2", "N s^2/m^2", lambda s: s.inertia / (s.swing * s.length**3))


@dataclasses.dataclass(frozen=True)
class Parameter:
    """The meaning of one number of an effect, as declared with `param`."""

    field: str
    name: str
    words: str
    dimension: Dimension
    sign: Sign
    silent: float | None
    fitted: bool
    grid: tuple[float, ...]
    joint: int | None
    as_spring: bool


class Memory(NamedTuple):
    """One internal state of an effect: its name and its dimension."""

    name: str
    dimension: Dimension


_KEY = "residyn"


def floating(x: Any) -> Array:
    """As a float array of the precision in force: of NumPy, which is quicker to make and to read,
    unless `x` is of JAX. (`jnp.asarray(0.1)` would be weakly typed, and take the precision of
    whatever it meets.)"""
    wanted = np.float64 if jax.config.jax_enable_x64 else np.float32  # pyrefly: ignore
    if not any(isinstance(each, jax.Array) for each in jax.tree.leaves(x)):
        return np.asarray(x, wanted)  # pyrefly: ignore[bad-return]
    if isinstance(x, jax.Array) and not x.weak_type and x.dtype == wanted:
        return x  # JAX would take its time to find that there is nothing to do
    return jnp.asarray(x, float)


def all_floating(tree: PyTree) -> PyTree:
    """A pytree with its numbers as float arrays. What is no number stays as it is: an effect may
    hold a network, whose activation is a function and whose switches are flags."""

    def leaf(x):
        return floating(x) if eqx.is_array_like(x) and not isinstance(x, bool) else x

    return jax.tree.map(leaf, tree)


def stacked(trees: Sequence[PyTree]) -> PyTree:
    """Pytrees of one structure as one, their arrays along a new first axis. What is no array is
    taken to be the same in all of them."""

    def both(first, *others):
        if not eqx.is_array(first):
            return first
        each = (first, *others)
        return (jnp if any(isinstance(x, jax.Array) for x in each) else np).stack(each)

    return jax.tree.map(both, *trees)


def param(
    words: str,
    dimension: Dimension,
    *,
    sign: Sign = "any",
    silent: float | None = 0.0,
    default: float | None = None,
    fitted: bool = True,
    grid: tuple[float, ...] = (),
    joint: int | None = None,
    as_spring: bool = False,
    name: str | None = None,
) -> Any:
    """Declare a number of an effect: a field of its class whose value is a scalar array.

    **Arguments:**

    - `words`: what it is, for a person.
    - `dimension`: the kind of quantity, which gives its unit and its typical size.
    - `sign`: "positive" if physics allows no negative value; "any" otherwise. A fit is not forced
      to obey (that would bias its errors); it says so when it does not.
    - `silent`: the value at which the effect is exactly absent. None for a *shape* number (a gap,
      a frequency), which says how an effect acts and not how strongly; another number must then
      silence it.
    - `default`: the value of an instance made without one; `silent` if not given.
    - `fitted`: whether a fit moves it.
    - `grid`: values that a fit starts a shape number from, in the dimension's typical size.
    - `joint`: the joint whose motion gives the typical size and the unit, from 0; if not given,
      that of the effect, or else the size of the last one and the unit of all. On a mechanism
      without that joint the number enters no equation, and is not shown.
    - `as_spring`: whether it may be as large as the joint's spring, in whose place it acts, and not
      only a part of it.
    - `name`: what users call it, where that differs from the field's name.
    """
    if silent is None and default is None:
        raise ValueError(f"{words}: a shape number (silent = None) needs a default")
    # Its field, and so its name if there is no other, is known once the class is made.
    meaning = Parameter(
        "", name or "", words, dimension, sign, silent, fitted, grid, joint, as_spring
    )
    return eqx.field(
        default=silent if default is None else default,
        converter=floating,
        metadata={_KEY: meaning},
    )


def parameters_of(effect: Any) -> tuple[Parameter, ...]:
    """The declared numbers of an effect (a class or an instance), in the order of declaration."""
    return _declared_by(effect if isinstance(effect, type) else type(effect))


@functools.cache  # a fit asks some hundred times
def _declared_by(kind: Any) -> tuple[Parameter, ...]:
    return tuple(
        dataclasses.replace(meaning, field=f.name, name=meaning.name or f.name)
        for f in dataclasses.fields(kind)
        if (meaning := f.metadata.get(_KEY))
    )
