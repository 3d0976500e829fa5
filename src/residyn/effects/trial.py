"""A user's effect is traced once when it is brought: a mistake in it is told where it stands.

JAX calls a law with abstract numbers. What Python then says of an `if` on one of them, of a name
that a motion does not have, or of a law that returns nothing, comes from the depths of a fit; here
it becomes one line with the file, the line in it and what to write instead.
"""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..errors import InputError, quote
from ..physics.effect import AbstractEffect, JointEffect
from ..physics.mechanism import PlanarArm
from ..physics.motion import JointMotion, Motion
from ..physics.parameter import parameters_of

_TRACED = (
    (jax.errors.TracerBoolConversionError, "a number that JAX traces has no truth value: "
     "write jnp.where(condition, a, b) instead of `if`, jnp.minimum for min, & for `and`"),
    (jax.errors.TracerArrayConversionError, "NumPy and math take no number that JAX traces: "
     "use jax.numpy, as jnp.sin"),
    (jax.errors.TracerIntegerConversionError, "a number that JAX traces is no index or count"),
    (jax.errors.ConcretizationTypeError, "float() and math take no number that JAX traces: "
     "use jax.numpy, as jnp.sin"),
)  # fmt: skip


def check_law(kind: type[AbstractEffect]) -> None:
    """Trace the law of an effect, on an arm of two links.

    **Raises:** `InputError`, in one line that names the file and the line in it.
    """
    arm = eqx.filter_eval_shape(PlanarArm, [1.0, 1.0], 3.0, 1.0, 0.5)
    try:
        places = kind.places(arm)
    except ValueError:  # it is about some other mechanism
        return
    number: Any = jax.ShapeDtypeStruct((), jnp.result_type(float))
    pair = (number, number)
    own: dict[str, Any] = {p.field: number for p in parameters_of(kind)}
    remembered = (number,) * len(kind.memory)
    motion = Motion(number, pair, pair, pair, remembered)

    def law(own, motion, arm):
        effect = kind(*places[:1], **own)
        if isinstance(effect, JointEffect):
            torque = {"joint_torque": effect.joint_torque(motion.of(0))}
        else:
            torque = {"torque": effect.torque(motion, arm)}
        rates = effect.rate(motion, arm)
        return torque, rates, effect.reading((motion.q[0][None], motion.q[1][None]), arm)

    try:
        torque, rates, _ = _evaluated(law, own, motion, arm)
    except InputError:
        raise
    except Exception as error:  # whatever the user's law does
        raise InputError(f"{_where(kind, error)}{_why(error)}") from None
    ((method, value),) = torque.items()
    shapes = value if method == "torque" and isinstance(value, tuple) else (value,)
    right = "the torque, a number"
    if method == "torque":
        right = "the torques, a tuple of one number for each joint"
    if not all(_is_number(x) for x in shapes) or (method == "torque" and len(shapes) != 2):
        raise InputError(
            f"{_line_of(kind, method)}{method} returns {_words(value)}: must be {right}"
        )
    if len(rates) != len(kind.memory):
        raise InputError(
            f"{_line_of(kind, 'joint_rate')}it has {len(kind.memory)} internal states and "
            f"{len(rates)} rates of them: must be as many"
        )


def _evaluated(law, *given):
    """What a law returns: shapes of arrays, and anything else as it is."""
    found: list[Any] = []

    def traced(*given):
        returned = law(*given)
        found.append(jax.tree.map(lambda x: None if eqx.is_array(x) else x, returned))
        return eqx.filter(returned, eqx.is_array)

    arrays = jax.eval_shape(traced, *given)
    return eqx.combine(arrays, found[0])


def _is_number(value: Any) -> bool:
    return getattr(value, "shape", None) == () or type(value) in (int, float)


def _words(value: Any) -> str:
    if value is None:
        return "nothing"
    if (shape := getattr(value, "shape", None)) is not None:
        return f"an array of shape {shape}"
    return f"{quote(value)}, a {type(value).__name__}"


def _why(error: Exception) -> str:
    for kind, words in _TRACED:
        if isinstance(error, kind):
            return words
    words = f"{type(error).__name__}: {error}".splitlines()[0]
    if isinstance(error, AttributeError) and isinstance(error.obj, JointMotion | Motion):
        words += f"; a motion has {', '.join(JointMotion._fields)} (q the angle, v its rate)"
    return words


def _where(kind: type, error: Exception) -> str:
    """The last line of the class's own file that the error came through."""
    file, line, trace = _file(kind), None, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == file:
            line = trace.tb_lineno
        trace = trace.tb_next
    return f"{kind.__name__}: " if line is None else f"line {line}: "


def _line_of(kind: type, method: str) -> str:
    try:
        return f"line {inspect.getsourcelines(getattr(kind, method))[1]}: "
    except (OSError, TypeError):
        return f"{kind.__name__}: "


def _file(kind: type) -> str | None:
    try:
        return inspect.getsourcefile(kind)
    except (OSError, TypeError):
        return None
