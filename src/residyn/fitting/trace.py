"""Levenberg-Marquardt once more, step by step, to draw it beside a genetic algorithm.

A fit keeps no history, since it runs in one compiled program. This descends from the same starts
over the same growing shares of the recordings, one step at a time.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ..effects import AbstractEffect
from ..recordings.experiment import Experiment
from .descent import shares_of, wild_beside
from .fit import DEFAULT_STARTS
from .history import History, relative_error
from .least_squares import STEPS, Polished, Stretch, rows, solver, together
from .multistart import beginning, resolving
from .problem import Problem, Unknowns
from .setup import ready

_OPTIONS = {"jac": "fwd"}


def levenberg_history(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
) -> History:
    """How Eq. 17 falls in a fit by Levenberg-Marquardt: the best of all starts, which go abreast.

    A step counts as one simulation and one for every unknown, as that many are carried along for
    the Jacobian, also where it covers a share of the recordings only. The objective, which is not
    the one that is minimised, is that of all fitted readings. Seconds are not kept: one compiled
    program is quicker than its steps one by one.
    """
    with jax.enable_x64(True):
        here = ready(experiment, experiment.fit_recordings, effects)
        wild = wild_beside(here, [r.angle for r in here.recordings])
        numbers, memory = beginning(here, wild, starts)
        begin = resolving(here, numbers)
        frequency = here.frequency(begin)
        problem, states = here.problem(begin, wild, frequency=frequency)
        first = np.broadcast_to(states, (starts, *states.shape)).copy()
        if memory is not None and memory.size:
            first[..., -memory.shape[-1] :] = memory
        each = [
            problem.scaled(jnp.asarray(n), jnp.asarray(s))
            for n, s in zip(numbers, first, strict=True)
        ]
        return _descents(problem, each, shares_of(here, frequency))


def _descents(problem: Problem, each: list[Unknowns], shares: Sequence[float]) -> History:
    cost_of_step = 1 + problem.scale.numbers.size + problem.scale.states.size
    spent, simulations, objective = 0, [], []
    for share in shares:
        stage = Stretch.of(problem, jnp.asarray(share))
        paths = [_descent(stage, problem, y) for y in each]
        for step in range(max(len(errors) for errors, _ in paths)):
            going = [errors[step] for errors, _ in paths if step < len(errors)]
            spent += cost_of_step * len(going)
            simulations.append(spent)
            objective.append(min([*going, *objective[-1:]]))
        each = [end.unknowns for end in together([end for _, end in paths])]
    return History(np.asarray(simulations), np.asarray(objective))


def _descent(stage: Stretch, problem: Problem, y: Unknowns) -> tuple[list[float], Polished]:
    """Objective after every step, and where it ends."""
    state, errors = _first(y, stage), []
    for _ in range(STEPS):
        y, state = _step(y, stage, state)
        errors.append(float(_error(problem, y)))
        if bool(state.terminate) or state.result != optx.RESULTS.successful:
            break
    squeezed = jax.device_get(rows(y, stage)[1])
    cost = float(np.sum(squeezed.along**2) + np.sum(squeezed.beside**2))
    return errors, Polished(jax.device_get(y), squeezed, cost, len(errors), False, 1)


@eqx.filter_jit
def _first(y: Unknowns, stage: Stretch):
    out, more = eqx.filter_eval_shape(rows, y, stage)
    return solver(y).init(rows, y, stage, _OPTIONS, out, more, frozenset())


@eqx.filter_jit
def _step(y: Unknowns, stage: Stretch, state):
    y, state, _ = solver(y).step(rows, y, stage, _OPTIONS, state, frozenset())
    return y, state


_error = eqx.filter_jit(relative_error)
