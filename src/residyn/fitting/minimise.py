"""Any minimiser of optax or optimistix on the objective of Eq. 17, or on least squares.

The objective is differentiated in forward mode, one direction for every unknown, as there are few
of them and many integration steps. It is given to the minimiser with that gradient attached, so
that one which asks for reverse mode gets the same. A least-squares solver of optimistix is given
the whitened residual instead, as our own is. All begin at the closed-form start.
"""

import importlib
import inspect
import time
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ..effects import AbstractEffect
from ..errors import extra
from ..recordings.experiment import Experiment
from .conclusion import Found, searched
from .history import Part, Watch, objective_of, relative_error, watching
from .initial_guess import resolving
from .least_squares import Horizon, rows
from .multistart import beginning
from .problem import Problem, Unknowns
from .result import Fit, FitError

STEPS = 500
_RATE = 0.02  # of an optax method that is named without one; unknowns are of order one
_TOLERANCE = 1e-7
_MODULES = ("optax", "optimistix")


def minimiser(given: Any) -> tuple[str, Any]:
    """The name of a method and the method itself, of `optax.adam`, say, in words or as an object.

    **Raises:** `ValueError` for a name that there is not; `MissingExtra` without optax.
    """
    if not isinstance(given, str):
        if isinstance(given, (optx.AbstractMinimiser, optx.AbstractLeastSquaresSolver)):
            return f"optimistix.{type(given).__name__}", given
        if hasattr(given, "init") and hasattr(given, "update"):
            return "optax", given
        raise ValueError(
            f"method = {given!r}: must be a name, an optax.GradientTransformation, or a minimiser "
            "or least-squares solver of optimistix"
        )
    module, _, name = given.partition(".")
    if module not in _MODULES or not name:
        raise ValueError(f'method = "{given}": there is no such method')
    home = extra(module, f"{given} needs {module}: pip install 'residyn[ga]'")
    make = getattr(home, name, None)
    wrong = ValueError(f'method = "{given}": {module} has no such minimiser')
    if make is None or name.startswith("_") or not callable(make):
        raise wrong
    try:
        known = inspect.signature(make).parameters
        own = {"learning_rate": _RATE, "rtol": _TOLERANCE, "atol": _TOLERANCE}
        made = make(**{k: v for k, v in own.items() if k in known})
        return given, minimiser(made)[1]
    except (TypeError, ValueError):
        raise wrong from None


def fit_minimised(
    experiment: Experiment,
    effects: Sequence[str | AbstractEffect],
    method: Any,
    progress: Callable[[str], None],
    steps: int = STEPS,
) -> Fit:
    """`residyn.fit(..., method="optimistix.BFGS")`: the same `Fit`, with its `history`.

    Readings far off their neighbours are set aside beforehand, none afterwards. Call it in float64.

    **Raises:** as `minimiser`; `FitError` if it finds nothing finite.
    """
    began = time.perf_counter()
    name, made = minimiser(method)
    experiment, here, numbers, memory = beginning(experiment, effects, 1)
    problem, states = here.problem(resolving(here, numbers), here.outliers)
    states[:, states.shape[-1] - memory.shape[-1] :] = memory[0]
    y = problem.scaled(jnp.asarray(numbers[0]), jnp.asarray(states))
    problem = jax.tree.map(lambda x: jnp.asarray(x) if eqx.is_array_like(x) else x, problem)
    ran: list[int] = []
    start, advance = _steps_of(made, problem, ran.append)

    watch = watching() or Watch()
    # Compiles; once more of its own output, whose types JAX may take for others.
    jax.block_until_ready(advance(*advance(y, start(y))[:2]))
    jax.effects_barrier()
    watch.restart()
    state, best, least, step, done = start(y), y, np.inf, 0, False
    for step in range(1, steps + 1):
        ran.clear()
        y, state, done = advance(y, state)
        done = bool(done)
        jax.effects_barrier()
        with watch.paused():
            value = objective_of(problem, y)
        if value < least:
            least, best = value, y
        watch.add(sum(ran), value)
        progress(Part(f"step {step} of {steps}, objective {least:.4g}", step / steps))
        if done or not np.isfinite(value) or watch.over():
            break
    if not np.isfinite(least):
        raise FitError(f"{name} led to nothing finite")
    found = Found(
        np.asarray(problem.numbers(best)),
        np.asarray(problem.states(best)),
        numbers[0],
        watch.history,
        step,
        done,
    )
    words = f"{step} steps of {name}; objective of Eq. 17: {least:.4g}, "
    words += "converged" if done else "not yet converged"
    progress("errors, modes and held-out recordings")
    return searched(experiment, here, found, words, began)


@eqx.filter_custom_vjp
def _objective(y: Unknowns, problem: Problem, ran: Callable[[int], None]):
    _count(ran, 1)
    return relative_error(problem, y)


@_objective.def_fwd
def _objective_fwd(perturbed, y: Unknowns, problem: Problem, ran: Callable[[int], None]):
    del perturbed
    flat, back = jax.flatten_util.ravel_pytree(y)
    _count(ran, 1 + flat.size)

    def at(flat):
        value = relative_error(problem, back(flat))
        return value, value

    slope, value = jax.jacfwd(at, has_aux=True)(flat)
    return value, back(slope)


@_objective.def_bwd
def _objective_bwd(slope, cotangent, perturbed, y, problem, ran):
    del perturbed, y, problem, ran
    return jax.tree.map(lambda s: cotangent * s, slope)


def _count(ran: Callable[[int], None], simulations: int) -> None:
    """Tell of so many simulations whenever the program runs them: a line search has as many as it
    needs."""
    jax.debug.callback(lambda: ran(simulations))


def _steps_of(method: Any, problem: Problem, ran: Callable[[int], None]):
    """How a method begins, and its step from unknowns and state: the next ones, and whether it is
    done. `ran` is told of simulations as they are run."""
    if hasattr(method, "update"):
        optax = importlib.import_module("optax")
        method = optx.OptaxMinimiser(optax.with_extra_args_support(method), _TOLERANCE, _TOLERANCE)
    squares = isinstance(method, optx.AbstractLeastSquaresSolver)
    given, options = (Horizon(problem), {"jac": "fwd"}) if squares else (problem, {})

    def function(y, args):
        if squares:
            _count(ran, 1 + y.numbers.size + y.states.size)
            return rows(y, args)
        return _objective(y, args, ran), None

    @eqx.filter_jit
    def start(y, given):
        out, more = eqx.filter_eval_shape(function, y, given)
        return method.init(function, y, given, options, out, more, frozenset())

    @eqx.filter_jit
    def advance(y, state, given):
        y, state, _ = method.step(function, y, given, options, state, frozenset())
        done, _ = method.terminate(function, y, given, options, state, frozenset())
        return y, state, done

    return lambda y: start(y, given), lambda y, state: advance(y, state, given)
