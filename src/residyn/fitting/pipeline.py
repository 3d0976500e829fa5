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
from ..modal import modes_of
from ..model import Model
from ..motion import split
from ..recording import Experiment, wild_samples
from ..simulation import compiled_state_matrix
from .identify import Spread, spread_of
from .levenberg import Polished, polish
from .problem import Compressed, Layout, Problem, Unknowns
from .result import Fit, FitError, Mode, Number, RecordingFit
from .setup import Ready, ready, reweighted
from .start import closed_form, perturbed
from .words import warnings_for

DEFAULT_STARTS = 6
_FIRST_CYCLES = 3  # of the fastest mode, in the first stretch
_AGREE = 0.5  # starts that end within this many standard errors of the best one agree with it
_MOST_WILD = 0.05  # a larger share of readings is not a few wild ones, it is another motion
_ROUNDS = 3
_USUAL = 0.5  # of the residual's own size: what a wild reading must exceed, too


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
    found = closed_form(here.posed(), here.recordings, wild, here.typical())
    candidates = found.numbers[:starts] if len(found.numbers) else here.typical()[None]
    more = starts - len(candidates)
    numbers = np.vstack([candidates, perturbed(candidates[0], more)])
    memory = found.memory[[*range(len(candidates)), *[0] * more]] if len(found.memory) else None

    progress(f"fitting from {starts} start{'s' * (starts > 1)}")
    begin = here.model.with_vector(jnp.asarray(candidates[0]))
    descent = _descend(here, begin, numbers, wild, progress, memory)

    progress("errors, modes and held-out recordings")
    model = here.model.with_vector(descent.problem.numbers(descent.unknowns))
    fitted = descent.beside(here)
    unknown = numbers.shape[1] + sum(f.state.size for f in fitted)
    readings = sum(int(f.used.sum()) for f in fitted)
    chi2 = descent.cost / max(1, readings - unknown)
    # Errors assume that the residual is white noise of the size that was stated; where it is larger
    # they grow with it.
    sizes = np.asarray(descent.problem.scale.numbers)
    spread = spread_of(np.asarray(descent.compressed.factor), sizes, max(1.0, chi2))
    result = Fit(
        experiment=experiment,
        model=model,
        numbers=_numbers(model, np.asarray(candidates[0]), spread),
        covariance=spread.covariance,
        recordings=(*fitted, *_held_out(experiment, effects, model, descent)),
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
    compressed: Compressed
    cost: float
    steps: int
    converged: bool
    starts: int
    agreeing: int

    def beside(self, here: Ready) -> list[RecordingFit]:
        """Each recording beside the model."""
        states = np.asarray(self.problem.states(self.unknowns))
        predicted = _predictions(self.compressed, self.layouts)
        parts = zip(here.recordings, predicted, self.wild, states, strict=True)
        return [RecordingFit(*part) for part in parts]


def _descend(
    here: Ready,
    begin: Model,
    numbers: np.ndarray,
    wild: list[np.ndarray],
    progress: Callable[[str], None],
    memory: np.ndarray | None = None,
    like: Problem | None = None,
) -> _Descent:
    """Descend from every row of `numbers` (S, P), and of `memory` (S, R, m); set wild readings
    aside; descend again if there were.

    With `like`, the numbers stay as in `begin`, and that problem's compiled program serves.
    """
    problem, layouts, states = here.problem(begin, wild, like)
    if like is not None:
        problem = eqx.tree_at(lambda p: p.active, problem, jnp.zeros_like(problem.active))
    starts = len(numbers)
    first = np.broadcast_to(states, (starts, *states.shape)).copy()
    if memory is not None and memory.size:
        first[..., -memory.shape[-1] :] = memory
    y = Unknowns(
        jnp.asarray(numbers) / problem.scale.numbers, jnp.asarray(first) / problem.scale.states
    )
    longest = max(r.duration for r in here.recordings)
    first = min(1.0, _FIRST_CYCLES * 2 * math.pi / here.frequency(begin) / longest)
    out = jax.device_get(polish(problem, y, jnp.asarray([first, math.sqrt(first), 1.0])))
    best, agreeing = int(np.argmin(out.cost)), _agreeing(out)
    steps = int(out.steps[best])
    at, squeezed = _row(out.unknowns, best), _row(out.compressed, best)
    mirrored = _upright(problem, at)
    if mirrored is not None:
        again = jax.tree.map(lambda x: jnp.broadcast_to(x, (starts, *x.shape)), mirrored)
        out = jax.device_get(polish(problem, again, jnp.ones(3)))
        best = 0
        at, squeezed = _row(out.unknowns, best), _row(out.compressed, best)
    for round_ in range(_ROUNDS + 1):
        if not np.isfinite(out.cost[best]):
            raise FitError("no start led to finite numbers: is this the arm that was recorded?")
        predicted = _predictions(squeezed, layouts)
        pairs = zip(here.recordings, predicted, strict=True)
        found = _wild(here, [r.angle - p for r, p in pairs], beside=True)
        found = [new | old for new, old in zip(found, wild, strict=True)]
        settled = all((f == w).all() for f, w in zip(found, wild, strict=True))
        if settled or round_ == _ROUNDS or any(f.mean() > _MOST_WILD for f in found):
            break
        progress("fitting again without wild readings")
        wild = found
        problem = reweighted(problem, layouts, wild)
        # From the best point, in every lane, so that the compiled program serves again.
        again = jax.tree.map(lambda x: jnp.broadcast_to(x, (starts, *x.shape)), at)
        out = jax.device_get(polish(problem, again, jnp.ones(3)))
        steps, best = steps + int(out.steps[0]), 0
        at, squeezed = _row(out.unknowns, best), _row(out.compressed, best)
    total, done = float(out.cost[best]), bool(out.converged[best])
    return _Descent(problem, layouts, wild, at, squeezed, total, steps, done, starts, agreeing)


def _upright(problem: Problem, at: Unknowns) -> Unknowns | None:
    """The same point with all numbers of the sign that people write; None if they have it."""
    states = np.array(problem.states(at))
    model, n = problem.model.with_vector(problem.numbers(at)), len(problem.model.mechanism.joints)
    found = model
    for state in states:
        found, memory = model.upright(split(state[2 * n :]))
        state[2 * n :] = [float(z) for z in memory]
    if np.array_equal(found.vector(), model.vector()):
        return None
    return problem.scaled(found.vector(), jnp.asarray(states))


def _wild(here: Ready, readings: Sequence[np.ndarray], beside: bool = False) -> list[np.ndarray]:
    """Readings far off their neighbours; `beside` the model, also far off the usual residual."""
    found = []
    for recording, x in zip(here.recordings, readings, strict=True):
        noise = recording.noise
        if beside:  # where the model misses something, the residual has corners of its own
            noise = np.maximum(noise, _USUAL * 1.4826 * np.nanmedian(np.abs(x), axis=0))
        found.append(wild_samples(recording.time, x, noise))
    return found


def _row(tree, index: int):
    return jax.tree.map(lambda x: x[index], tree)


def _predictions(squeezed: Compressed, layouts: Sequence[Layout]) -> list[np.ndarray]:
    pairs = zip(layouts, squeezed.predicted, strict=True)
    return [layout.take(grid) for layout, grid in pairs]


def _agreeing(out: Polished) -> int:
    """How many starts ended where the best one did, counting it."""
    best = int(np.argmin(out.cost))
    off = jax.tree.map(lambda x: x - x[best], out.unknowns)
    everywhere = np.broadcast_to(
        off.numbers[:, None], (*off.states.shape[:2], off.numbers.shape[-1])
    )
    local = np.concatenate([everywhere, off.states], axis=-1)
    moved = np.einsum("rij,srj->sri", out.compressed.factor[best], local)
    distance = np.sqrt(np.sum(moved**2, axis=(1, 2)))
    return int(np.sum((distance < _AGREE) & ~out.lost))


def _held_out(
    experiment: Experiment, effects, model: Model, descent: _Descent
) -> list[RecordingFit]:
    """Check recordings beside the fitted model: only their initial states are fitted."""
    group, found = len(descent.layouts), []
    numbers = np.tile(np.asarray(model.vector()), (descent.starts, 1))
    for first in range(0, len(experiment.check_recordings), group):
        # As many at a time as were fitted, so that no other program need be compiled.
        some = experiment.check_recordings[first : first + group]
        filled = [*some, *[some[-1]] * (group - len(some))]
        here = ready(experiment, filled, effects)
        begin = here.model.with_vector(model.vector())
        wild = _wild(here, [r.angle for r in here.recordings])
        end = _descend(here, begin, numbers, wild, lambda words: None, like=descent.problem)
        found += end.beside(here)[: len(some)]
    return found


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


def _modes(model: Model, covariance: np.ndarray) -> tuple[Mode, ...]:
    """The modes that ring, with errors carried over from the numbers."""
    vector = np.asarray(model.vector())

    def at(numbers: np.ndarray) -> np.ndarray:
        matrix = compiled_state_matrix(model.with_vector(jnp.asarray(numbers)))
        return np.stack(modes_of(jnp.asarray(np.linalg.eigvals(np.asarray(matrix)))))

    best, slopes = at(vector), []
    for i, value in enumerate(vector):
        step = np.zeros_like(vector)
        step[i] = 1e-6 * max(abs(value), 1e-6)
        slopes.append((at(vector + step) - at(vector - step)) / (2 * step[i]))
    found = []
    for i, (frequency, damping) in enumerate(best.T):
        if frequency > 0 and abs(damping) < 1 - 1e-9:
            spread = [_carried(np.array([s[j, i] for s in slopes]), covariance) for j in (0, 1)]
            found.append(Mode(float(frequency), spread[0], float(damping), spread[1]))
    return tuple(found)


def _carried(slope: np.ndarray, covariance: np.ndarray) -> float:
    """Standard error of a quantity with this slope in the numbers."""
    use = slope != 0
    return float(np.sqrt(slope[use] @ covariance[np.ix_(use, use)] @ slope[use]))


def _reason(converged: bool) -> str:
    if converged:
        return "converged: the last step moved the fit by less than 1/100 of its error"
    return "step limit reached before the numbers settled"
