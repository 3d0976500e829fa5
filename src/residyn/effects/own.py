"""Effects that users bring: from a Python file, or from an installed package.

A user's effect is a class like any of the catalogue's, and joins it: from then on it goes by its
name in every command. A package offers effects as entry points of the group `residyn.effects`; a
file needs only be named.

Its law is traced once when it is brought, or when an instance of it is fitted or simulated. JAX
calls a law with abstract numbers: what Python then says of an `if` on one of them, of a name that a
motion does not have, or of a law that returns nothing, comes from the depths of a fit. Here it
becomes one line with the file, the line in it and what to write instead.
"""

import dataclasses
import functools
import importlib.metadata
import importlib.util
import inspect
import math
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError, inside, quote
from ..files import check_ordinary
from ..physics.effect import AbstractEffect, JointEffect
from ..physics.inertia import AbstractInertia
from ..physics.mechanism import PlanarArm
from ..physics.motion import JointMotion, Motion
from ..physics.parameter import parameters_of

GROUP = "residyn.effects"
_READINGS = 3  # as many are traced: no number of anything else


def read_effects(path: str | Path) -> list[type[AbstractEffect]]:
    """The effects that a Python file defines.

    **Raises:** `InputError`, in one line, if the file cannot be run or defines none.
    """
    where = str(path)
    check_ordinary(path, "Python file of effects")
    spec = importlib.util.spec_from_file_location(f"residyn_own_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{where}: is not a Python file (its name must end in .py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look up a class's own names
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise InputError(f"{where}, line {error.lineno}: {error.msg}") from None
    except Exception as error:  # whatever the user's file does
        line = _line_in(error, where)
        at = "" if line is None else f", line {line}"
        raise InputError(f"{where}{at}: {type(error).__name__}: {error}") from None
    found = _defined_in(module)
    if not found:
        raise InputError(f"{where}: defines no effect (a subclass of residyn.JointEffect, say)")
    return [checked(kind, where) for kind in found]


def installed() -> list[type[AbstractEffect]]:
    """The effects that installed packages offer.

    **Raises:** `InputError`, in one line, for an entry point that offers something else.
    """
    found = []
    for point in importlib.metadata.entry_points(group=GROUP):
        where = f"entry point {point.name} ({point.value})"
        try:
            offered = point.load()
        except Exception as error:
            raise InputError(f"{where}: {type(error).__name__}: {error}") from None
        kinds = _defined_in(offered) if isinstance(offered, ModuleType) else [offered]
        found += [checked(kind, where) for kind in kinds]
    return found


def checked(kind: object, where: str) -> type[AbstractEffect]:
    """A class that can join the catalogue.

    **Raises:** `InputError`, in one line, that says what is missing.
    """
    if not (isinstance(kind, type) and issubclass(kind, AbstractEffect)):
        raise InputError(f"{where}: {quote(kind)} is no effect (a subclass of AbstractEffect)")
    with inside(where):
        _check_name(kind)
        lacking = sorted(getattr(kind, "__abstractmethods__", ()))
        if lacking:
            raise InputError(f"{kind.__name__} lacks the method {lacking[0]}")
        check_numbers(kind)
        check_law(kind)
    return kind


def check_instance(effect: AbstractEffect, mechanism: AbstractInertia) -> None:
    """Trace the law of an effect on the mechanism that it is to act on: once, whatever its numbers.

    **Raises:** `InputError`, in one line, as `checked`.
    """
    _check_name(type(effect))
    leaves, structure = jax.tree.flatten(jax.tree.map(_shape, (effect, mechanism)))
    _check_structure(structure, tuple(leaves))


@functools.lru_cache
def _check_structure(structure: Any, leaves: tuple[Any, ...]) -> None:
    effect, mechanism = jax.tree.unflatten(structure, leaves)
    kind = type(effect)
    with inside(effect.label):
        check_numbers(kind)
        if not isinstance(effect, JointEffect) or effect.joint in mechanism.joints:
            _check_traced(kind, lambda effect: effect, effect, mechanism)


def _check_name(kind: type[AbstractEffect]) -> None:
    name = getattr(kind, "name", None)
    if not isinstance(name, str) or not name.isidentifier():
        raise InputError(
            f"{kind.__name__} needs a name, such as name = "
            f'"{_snake(kind.__name__)}", by which commands call it'
        )


def _defined_in(module: ModuleType) -> list[type[AbstractEffect]]:
    """Its own effects, in the order they are written; what it imports or calls _private is not."""
    kinds = [
        kind
        for kind in vars(module).values()
        if isinstance(kind, type)
        and issubclass(kind, AbstractEffect)
        and kind.__module__ == module.__name__
        and not kind.__name__.startswith("_")
    ]
    return sorted(set(kinds), key=lambda kind: inspect.getsourcelines(kind)[1])


def _line_in(error: Exception, file: str | None) -> int | None:
    """The last line of a file that an error came through."""
    name, trace = Path(file or "").name, traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in trace if name and Path(frame.filename).name == name]
    return lines[-1] if lines else None


def _snake(name: str) -> str:
    return "".join(f"_{c.lower()}" if c.isupper() and i else c.lower() for i, c in enumerate(name))


# -- its law, traced once --------------------------------------------------------------------

_TRACED = (
    (jax.errors.TracerBoolConversionError, "a number that JAX traces has no truth value: "
     "write jnp.where(condition, a, b) instead of `if`, jnp.minimum for min, & for `and`"),
    (jax.errors.TracerArrayConversionError, "NumPy and math take no number that JAX traces: "
     "use jax.numpy, as jnp.sin"),
    (jax.errors.TracerIntegerConversionError, "a number that JAX traces is no index or count"),
    (jax.errors.ConcretizationTypeError, "float() and math take no number that JAX traces: "
     "use jax.numpy, as jnp.sin"),
)  # fmt: skip


def check_numbers(kind: type[AbstractEffect]) -> None:
    """The numbers that a fit moves are strengths, one at least, and positive shapes.

    **Raises:** `InputError`, in one line that names the number.
    """
    fitted = [p for p in parameters_of(kind) if p.fitted]
    if fitted and all(p.silent is None for p in fitted):
        raise InputError(
            f"{kind.__name__}: has shapes only (silent=None): one of its numbers must be a "
            "strength, whose silent value makes it nothing"
        )
    defaults = {f.name: f.default for f in dataclasses.fields(kind)}
    for p in fitted:
        begun: tuple[Any, ...] = defaults[p.field], *p.grid
        if p.silent is None and not all(0 < x < math.inf for x in begun):
            raise InputError(
                f"{kind.__name__}: default and grid of the shape {p.field} (silent=None) must be "
                "positive: it is known to an e-fold about them, and its sign must not matter"
            )


def check_law(kind: type[AbstractEffect]) -> None:
    """Trace the law of an effect, on an arm of two links.

    **Raises:** `InputError`, in one line that names the file and the line in it.
    """
    arm = eqx.filter_eval_shape(PlanarArm, [1.0, 1.0], 3.0, 1.0, 0.5)
    try:
        places = kind.places(arm)
    except ValueError:  # it is about some other mechanism
        return
    own: dict[str, Any] = {p.field: _number() for p in parameters_of(kind)}
    _check_traced(kind, lambda own: kind(*places[:1], **own), own, arm)


def _number(*shape: int) -> Any:
    return jax.ShapeDtypeStruct(shape, jnp.result_type(float))


def _check_traced(
    kind: type[AbstractEffect],
    made: Callable[[Any], AbstractEffect],
    given: Any,
    mechanism: AbstractInertia,
) -> None:
    """Trace the effect that is made of `given`, a pytree of numbers."""
    n = len(mechanism.joints)
    each, angles = (_number(),) * n, (_number(_READINGS),) * n
    motion = Motion(_number(), each, each, each, (_number(),) * len(kind.memory))
    own = "joint_" if issubclass(kind, JointEffect) else ""
    a_state, states = "one number for each internal state", _each(len(kind.memory), _is_number)
    said: dict[str, tuple[str, Callable[[Any], bool]]] = {
        "torque": ("the torques, a tuple of one number for each joint", _each(n, _is_number)),
        "joint_torque": ("the torque, a number", _is_number),
        f"{own}rate": (f"a tuple of rates, {a_state}", states),
        f"{own}follow": (f"a tuple, {a_state}", states),
        "reading": (
            "a tuple of one array for each joint, of its angles' shape",
            _each(n, _is_column),
        ),
        "delays": ("a tuple of one number for each joint, s", _each(n, _is_number)),
    }
    said.pop("torque" if own else "joint_torque")

    def law(given, motion, mechanism, angles):
        effect = made(given)
        here = motion
        if isinstance(effect, JointEffect):
            here = motion.of(mechanism.joints.index(effect.joint))
        told = {"reading": (angles, mechanism), "delays": (mechanism,)}
        usual = (here,) if own else (motion, mechanism)
        return {name: getattr(effect, name)(*told.get(name, usual)) for name in said}

    try:
        # Shapes of arrays, and anything else as it is.
        given, mechanism = jax.tree.map(_shape, (given, mechanism))
        found = eqx.filter_eval_shape(law, given, motion, mechanism, angles)
    except InputError:
        raise
    except Exception as error:  # whatever the user's law does
        raise InputError(f"{_where(kind, error)}{_why(error)}") from None
    for name, (right, good) in said.items():
        if not good(found[name]):
            words = _words(found[name])
            raise InputError(f"{_where(kind, name)}{name} returns {words}: must be {right}")


def _shape(x: Any) -> Any:
    return jax.ShapeDtypeStruct(x.shape, x.dtype) if isinstance(x, np.ndarray | jax.Array) else x


def _each(count: int, good: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda x: isinstance(x, tuple | list) and len(x) == count and all(map(good, x))


def _is_column(value: Any) -> bool:
    return getattr(value, "shape", None) == (_READINGS,)


def _is_number(value: Any) -> bool:
    return getattr(value, "shape", None) == () or type(value) in (int, float)


def _words(value: Any) -> str:
    if value is None:
        return "nothing"
    if _is_number(value):
        return "a number"
    if (shape := getattr(value, "shape", None)) is not None:
        return f"an array of shape {shape}"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_words, value))})"
    return f"{quote(value)}, a {type(value).__name__}"


def _why(error: Exception) -> str:
    for kind, words in _TRACED:
        if isinstance(error, kind):
            return words
    words = f"{type(error).__name__}: {error}".splitlines()[0]
    if isinstance(error, AttributeError) and isinstance(error.obj, JointMotion | Motion):
        words += f"; a motion has {', '.join(JointMotion._fields)} (q the angle, v its rate)"
    return words


def _where(kind: type, cause: Exception | str) -> str:
    """The line that an error came through, or that a method begins with; else the class."""
    try:
        if isinstance(cause, str):
            line = inspect.getsourcelines(getattr(kind, cause))[1]
        else:
            line = _line_in(cause, inspect.getsourcefile(kind))
    except (OSError, TypeError):
        line = None
    return f"{kind.__name__}: " if line is None else f"line {line}: "
