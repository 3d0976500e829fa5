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
from ..recordings.experiment import Experiment
from .evolution import MissingExtra
from .genetic import Found, Part, concluded
from .history import History, relative_error, watching
from .initial_guess import first_guess, resolving
from .least_squares import Horizon, rows
from .multistart import outliers_among
from .problem import Problem, Unknowns, ready
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
    try:
        make = getattr(importlib.import_module(module), name, None)
    except ImportError:
        raise MissingExtra(f"{given} needs {module}: pip install 'residyn[ga]'") from None
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
    progress: Callable[[str], None] = lambda words: None,
    steps: int = STEPS,
) -> Fit:
    """`residyn.fit(..., method="optimistix.BFGS")`: the same `Fit`, with its `history`.

    Readings far off their neighbours are set aside beforehand, none afterwards. Call it in float64.

    **Raises:** as `minimiser`; `FitError` if it finds nothing finite.
    """
    began = time.perf_counter()
    name, made = minimiser(method)
    if not experiment.fit_recordings:
        raise ValueError('no recording has role = "fit": there is nothing to fit to')
    here = ready(experiment, experiment.fit_recordings, effects)
    wild = outliers_among(here)
    numbers, memory = first_guess(here, wild, 1)
    problem, states = here.problem(resolving(here, numbers), wild)
    if memory is not None and memory.size:
        states[..., -memory.shape[-1] :] = memory[0]
    y = problem.scaled(jnp.asarray(numbers[0]), jnp.asarray(states))
    problem = jax.tree.map(lambda x: jnp.asarray(x) if eqx.is_array_like(x) else x, problem)
    kind = _optax if hasattr(made, "update") else _optimistix
    start, advance = kind(made, problem)

    watch, each = watching(), 1 + y.numbers.size + y.states.size
    if watch is not None:
        jax.block_until_ready(advance(y, start(y))[2])  # compiles
        watch.restart()
    state, best, least = start(y), y, np.inf
    spent, objective, seconds, done = [], [], [], False
    for step in range(steps):
        y, state, value, at, done = advance(y, state)
        value, done = float(value), bool(done)
        if value < least:
            least, best = value, at
        spent.append(each * (step + 1))
        objective.append(least)
        if watch is not None:
            watch.add(each, value if np.isfinite(value) else np.inf)
            seconds.append(watch.seconds)
        progress(Part(f"step {step + 1} of {steps}, objective {least:.4g}", (step + 1) / steps))
        if done or not np.isfinite(value) or (watch is not None and watch.over()):
            break
    if not np.isfinite(least):
        raise FitError(f"{name} led to nothing finite")
    history = History(
        np.asarray(spent, float), np.asarray(objective), np.asarray(seconds) if seconds else None
    )
    found = Found(
        np.asarray(problem.numbers(best)), np.asarray(problem.states(best)), numbers[0], history
    )
    words = f"{len(spent)} steps of {name}; objective of Eq. 17: {least:.4g}, "
    words += "converged" if done else "not yet converged"
    progress("errors, modes and held-out recordings")
    return concluded(experiment, here, wild, found, len(spent), done, words, began)


@eqx.filter_custom_vjp
def _objective(y: Unknowns, problem: Problem):
    return relative_error(problem, y)


@_objective.def_fwd
def _objective_fwd(perturbed, y: Unknowns, problem: Problem):
    del perturbed
    flat, back = jax.flatten_util.ravel_pytree(y)

    def along(direction):
        return jax.jvp(lambda x: relative_error(problem, back(x)), (flat,), (direction,))

    value, slope = jax.vmap(along, out_axes=(None, 0))(jnp.eye(flat.size))
    return value, back(slope)


@_objective.def_bwd
def _objective_bwd(slope, cotangent, perturbed, y, problem):
    del perturbed, y, problem
    return jax.tree.map(lambda s: cotangent * s, slope)


def _optax(method, problem: Problem):
    """How an optax method begins, and its step: unknowns, state, an objective and the unknowns that
    it is of, whether done."""
    optax = importlib.import_module("optax")
    method = optax.with_extra_args_support(method)

    @eqx.filter_jit
    def advance(y, state, problem):
        value_of = lambda x: _objective(x, problem)  # noqa: E731
        value, slope = eqx.filter_value_and_grad(value_of)(y)
        more = {"value": value, "grad": slope, "value_fn": value_of}
        change, state = method.update(slope, state, y, **more)
        # What was evaluated are the unknowns before the step.
        return eqx.apply_updates(y, change), state, value, y, False

    return method.init, lambda y, state: advance(y, state, problem)


def _optimistix(method, problem: Problem):
    """The same for a minimiser or a least-squares solver of optimistix."""
    squares = isinstance(method, optx.AbstractLeastSquaresSolver)
    given = Horizon(problem) if squares else problem

    def function(y, args):
        return rows(y, args) if squares else (_objective(y, args), None)

    options = {"jac": "fwd"} if squares else {}

    @eqx.filter_jit
    def start(y, given):
        out, more = eqx.filter_eval_shape(function, y, given)
        return method.init(function, y, given, options, out, more, frozenset())

    @eqx.filter_jit
    def advance(y, state, given):
        y, state, _ = method.step(function, y, given, options, state, frozenset())
        done, _ = method.terminate(function, y, given, options, state, frozenset())
        return y, state, relative_error(problem, y), y, done

    return lambda y: start(y, given), lambda y, state: advance(y, state, given)
