"""From an experiment to a fit: start, descend, set wild readings aside, score, and say.

Everything numerical lives in the neighbours of this file; here is their order.
"""

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect
from ..model import Model
from ..modes import Modes, modes
from ..recording import Experiment, wild_samples
from .identify import Spread, spread_of, squeezed
from .levenberg import Polished, polish
from .problem import Layout, Problem, Unknowns, predict
from .result import Fit, FitError, Mode, Number, RecordingFit
from .setup import Ready, ready, reweighted
from .start import closed_form, perturbed
from .words import warnings_for

DEFAULT_STARTS = 6
_FIRST_CYCLES = 3  # of the fastest mode, in the first stretch
_AGREE = 0.5  # starts that end within this many standard errors of the best one agree with it
_MOST_WILD = 0.05  # a larger share of readings is not a few wild ones, it is another motion
_ROUNDS = 3


def fit(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    """Fit springs, dampers and any `effects` to the recordings of an experiment.

    Least squares on the angles themselves (the model simulated beside every recording), over all
    numbers of the model and every recording's own initial state, from a start found in closed form
    and others around it. Runs in float64 whatever JAX's setting.

    **Arguments:**

    - `experiment`: from `residyn.load`, or made of arrays.
    - `effects`: what to add to the springs and dampers: `name`, `name:joint`, or an effect.
    - `starts`: how many starts to try, at least 1.
    - `progress`: called with a few words as each phase begins.

    **Returns:** a `Fit`.

    **Raises:** `FitError` if no start led to finite numbers; `ValueError` for an effect that does
    not exist or does not go with this experiment.
    """
    with jax.enable_x64(True):
        return _fit(experiment, effects, starts, progress or (lambda words: None))


def _fit(experiment, effects, starts, progress) -> Fit:
    began = time.perf_counter()
    if starts < 1:
        raise ValueError(f"starts = {starts}: at least one start is needed")
    if not experiment.fit_recordings:
        raise ValueError('no recording has role = "fit": there is nothing to fit to')
    here = ready(experiment, experiment.fit_recordings, effects)
    wild = _wild(here, [r.angle for r in here.recordings])

    progress("finding a start in closed form")
    candidates = closed_form(here.posed(), here.recordings, wild).numbers
    candidates = candidates[:starts] if len(candidates) else here.typical()
    numbers = np.vstack([candidates, perturbed(candidates[0], starts - len(candidates))])

    progress(f"fitting from {starts} start{'s' * (starts > 1)}")
    begin = here.model.with_vector(jnp.asarray(candidates[0]))
    descent = _descend(here, begin, numbers, wild, progress)

    progress("errors, modes and held-out recordings")
    model = here.model.with_vector(descent.problem.numbers(descent.unknowns))
    fitted = descent.beside(here)
    unknown = numbers.shape[1] + sum(f.state.size for f in fitted)
    readings = sum(int(f.used.sum()) for f in fitted)
    chi2 = descent.cost / max(1, readings - unknown)
    # Errors assume that the residual is white noise of the size that was stated; where it is larger
    # they grow with it.
    spread = spread_of(descent.problem, descent.unknowns, max(1.0, chi2))
    result = Fit(
        experiment=experiment,
        model=model,
        numbers=_numbers(model, np.asarray(candidates[0]), spread),
        covariance=spread.covariance,
        recordings=(*fitted, *_held_out(experiment, effects, model)),
        reduced_chi2=chi2,
        modes=_modes(model, spread.covariance),
        starts=starts,
        agreeing_starts=descent.agreeing,
        converged=descent.converged,
        reason=_reason(descent.converged),
        steps=descent.steps,
        seconds=time.perf_counter() - began,
        warnings=(),
    )
    return result.saying(warnings_for(result, spread.open_groups))


class _Descent(NamedTuple):
    """Where the best start ended."""

    problem: Problem
    layouts: list[Layout]
    wild: list[np.ndarray]
    unknowns: Unknowns
    cost: float
    steps: int
    converged: bool
    agreeing: int

    def beside(self, here: Ready) -> list[RecordingFit]:
        """Each recording beside the model."""
        states = np.asarray(self.problem.states(self.unknowns))
        predicted = _predictions(self.problem, self.unknowns, self.layouts)
        parts = zip(here.recordings, predicted, self.wild, states, strict=True)
        return [RecordingFit(*part) for part in parts]


def _descend(
    here: Ready,
    begin: Model,
    numbers: np.ndarray,
    wild: list[np.ndarray],
    progress: Callable[[str], None],
    active: bool = True,
) -> _Descent:
    """Descend from every row of `numbers`; set wild readings aside; descend again if there were."""
    problem, layouts, states = here.problem(begin, wild, active)
    y = Unknowns(
        jnp.asarray(numbers) / problem.scale.numbers,
        jnp.broadcast_to(jnp.asarray(states) / problem.scale.states, (len(numbers), *states.shape)),
    )
    longest = max(r.duration for r in here.recordings)
    first = min(1.0, _FIRST_CYCLES * 2 * math.pi / here.frequency(begin) / longest)
    out = jax.device_get(polish(problem, y, jnp.asarray([first, math.sqrt(first), 1.0])))
    best, agreeing = int(np.argmin(out.cost)), _agreeing(problem, out)
    steps = int(out.steps[best])
    for _ in range(_ROUNDS):
        if not np.isfinite(out.cost[best]):
            raise FitError("no start led to finite numbers: is this the arm that was recorded?")
        at = jax.tree.map(lambda x: jnp.asarray(x[best]), out.unknowns)  # noqa: B023
        predicted = _predictions(problem, at, layouts)
        pairs = zip(here.recordings, predicted, wild, strict=True)
        found = _wild(here, [r.angle - p for r, p, _ in pairs])
        found = [new | old for new, old in zip(found, wild, strict=True)]
        if all((f == w).all() for f, w in zip(found, wild, strict=True)):
            break
        if any(f.mean() > _MOST_WILD for f in found):
            break
        progress("fitting again without wild readings")
        wild = found
        problem = reweighted(problem, layouts, wild)
        # From the best point, in every lane, so that the compiled program serves again.
        again = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(numbers), *x.shape)), at)
        out = jax.device_get(polish(problem, again, jnp.ones(3)))
        steps, best = steps + int(out.steps[0]), 0
    at = jax.tree.map(lambda x: jnp.asarray(x[best]), out.unknowns)
    total, done = float(out.cost[best]), bool(out.converged[best])
    return _Descent(problem, layouts, wild, at, total, steps, done, agreeing)


def _wild(here: Ready, readings: Sequence[np.ndarray]) -> list[np.ndarray]:
    pairs = zip(here.recordings, readings, strict=True)
    return [wild_samples(r.time, angle, r.noise) for r, angle in pairs]


@eqx.filter_jit
def _grids(problem: Problem, y: Unknowns):
    numbers = problem.numbers(y)
    return jax.vmap(lambda one, state: predict(problem, one, numbers, state))(
        problem.recorded, problem.states(y)
    )


def _predictions(problem: Problem, y: Unknowns, layouts: Sequence[Layout]) -> list[np.ndarray]:
    grids = np.asarray(_grids(problem, y))
    return [layout.take(grid) for layout, grid in zip(layouts, grids, strict=True)]


def _agreeing(problem: Problem, out: Polished) -> int:
    """How many starts ended where the best one did, counting it."""
    best = int(np.argmin(out.cost))
    at = jax.tree.map(lambda x: jnp.asarray(x[best]), out.unknowns)
    factor = np.asarray(squeezed(problem, at).factor)
    off = jax.tree.map(lambda x, y: np.asarray(x) - np.asarray(y), out.unknowns, at)
    everywhere = np.broadcast_to(
        off.numbers[:, None], (*off.states.shape[:2], off.numbers.shape[-1])
    )
    local = np.concatenate([everywhere, off.states], axis=-1)
    distance = np.sqrt(np.sum(np.einsum("rij,srj->sri", factor, local) ** 2, axis=(1, 2)))
    return int(np.sum((distance < _AGREE) & ~np.asarray(out.lost)))


def _held_out(experiment: Experiment, effects, model: Model) -> list[RecordingFit]:
    """Check recordings beside the fitted model: only their initial states are fitted."""
    if not experiment.check_recordings:
        return []
    here = ready(experiment, experiment.check_recordings, effects)
    wild = _wild(here, [r.angle for r in here.recordings])
    begin = here.model.with_vector(model.vector())
    only = np.asarray(model.vector())[None]
    return _descend(here, begin, only, wild, lambda words: None, active=False).beside(here)


def _numbers(model: Model, start: np.ndarray, spread: Spread) -> tuple[Number, ...]:
    values, units = np.asarray(model.vector()), model.mechanism.units
    found = []
    for i, number in enumerate(model.fitted):
        # A number of no one joint (gravity's moment, say) takes the unit of the first.
        unit = units[number.joint or 0] if units else None
        found.append(
            Number(
                name=number.name,
                words=number.meaning.words,
                value=float(values[i]),
                std=float(spread.std[i]),
                start=float(start[i]),
                unit=number.meaning.dimension.unit(unit),
                sign=number.meaning.sign,
                determined=bool(np.isfinite(spread.std[i])),
            )
        )
    return tuple(found)


@eqx.filter_jit
def _modes_and_slopes(model: Model) -> tuple[Modes, Modes]:
    def at(vector):
        return modes(model.with_vector(vector))

    vector = model.vector()
    return at(vector), jax.jacfwd(at)(vector)


def _modes(model: Model, covariance: np.ndarray) -> tuple[Mode, ...]:
    """The modes that ring, with errors carried over from the numbers."""
    values, slopes = jax.device_get(_modes_and_slopes(model))
    found = []
    for i in range(len(values.frequency_hz)):
        if values.frequency_hz[i] <= 0 or values.damping_ratio[i] >= 1 - 1e-9:
            continue
        spread = [_carried(slope[i], covariance) for slope in slopes]
        found.append(
            Mode(
                float(values.frequency_hz[i]),
                spread[0],
                float(values.damping_ratio[i]),
                spread[1],
            )
        )
    return tuple(found)


def _carried(slope: np.ndarray, covariance: np.ndarray) -> float:
    """Standard error of a quantity with this slope in the numbers."""
    use = slope != 0
    return float(np.sqrt(slope[use] @ covariance[np.ix_(use, use)] @ slope[use]))


def _reason(converged: bool) -> str:
    if converged:
        return "converged: the last step moved the fit by less than 1/100 of its error"
    return "step limit reached before the numbers settled"
