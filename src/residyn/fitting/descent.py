"""From starts to where the best one ended, wild readings set aside on the way."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..physics.model import Model
from ..physics.motion import split
from ..recordings.outliers import outlier_mask
from ..recordings.recording import Recording
from .least_squares import Polished, polish
from .problem import Compressed, Problem, Unknowns
from .result import FitError, RecordingFit
from .setup import Ready, reweighted

_FIRST_CYCLES = 3  # of the fastest mode, in the first stretch
_MOST_WILD = 0.05  # a larger share of readings is not a few wild ones, it is another motion
_ROUNDS = 3
_MISLED = 2.0  # times the noise: where a law that sticks or rattles ends above, all count at once
_ABSURD = 1e9  # rad or m
_FAR = 5.0  # sigma: what is nearer to the model than this is not wild beside it
_USUAL = 0.5  # of the residual's own size: what a wild reading must exceed, too


class Descent(NamedTuple):
    """Where the best start ended."""

    problem: Problem
    wild: list[np.ndarray]
    unknowns: Unknowns
    compressed: Compressed
    cost: float
    steps: int
    converged: bool
    starts: int
    agreeing: int
    finer: int = 1
    """How many times as many integration steps were taken as usual."""

    def beside(self, recordings: Sequence[Recording]) -> list[RecordingFit]:
        """Each recording beside the model."""
        states = np.asarray(self.problem.states(self.unknowns))
        predicted = _predictions(self.compressed, recordings)
        parts = zip(recordings, predicted, self.wild, states, strict=True)
        return [RecordingFit(*part) for part in parts]


def descend(
    here: Ready,
    begin: Model,
    numbers: np.ndarray,
    wild: list[np.ndarray],
    progress: Callable[[str], None],
    memory: np.ndarray | None = None,
    like: Problem | None = None,
    near: np.ndarray | None = None,
    hopeless: Callable[[float], bool] = lambda cost: False,
    staged: bool = False,
    search: Callable[..., Polished] = polish,
) -> Descent:
    """Descend from every row of `numbers` (S, P), and of `memory` (S, R, m); set wild readings
    aside; descend again if there were.

    With `like`, the numbers stay as in `begin`, and that problem's compiled program serves. With
    `near` (S, R, s), initial states which are near enough that no phase can slip, all readings
    count from the first step on, unless that is to be `staged`, too. `search` is what descends.
    """
    frequency = here.frequency(begin)
    problem, states = here.problem(begin, wild, like, frequency=frequency)
    if like is not None:
        problem = eqx.tree_at(lambda p: p.active, problem, np.zeros_like(problem.active))
    starts = len(numbers)
    first = np.broadcast_to(states, (starts, *states.shape)).copy()
    if memory is not None and memory.size:
        first[..., -memory.shape[-1] :] = memory
    y = Unknowns(numbers / problem.scale.numbers, first / problem.scale.states)
    shares = shares_of(here, frequency) if near is None or staged else [1.0]
    if near is not None:
        y = y._replace(states=near / problem.scale.states)
    out = search(problem, y, shares, hopeless)
    if len(shares) > 1:
        # The first cycles can lead away from the rest: of a brake that slips at first and holds
        # then, or of springs with a memory, of which they show but one half.
        lost = not _sane(out, here.recordings)
        if lost or (near is None and like is None and _misled(problem, out)):
            whole = search(problem, y, (1.0,), hopeless)
            out = whole if lost or whole.cost < out.cost else out
    steps, agreeing = out.steps, out.agreeing
    mirrored = _upright(problem, out.unknowns)
    if mirrored is not None:
        out = search(problem, _single(mirrored), (1.0,))
    for round_ in range(_ROUNDS + 1):
        if not np.isfinite(out.cost):
            raise FitError("no start led to finite numbers: is this the arm that was recorded?")
        if not _sane(out, here.recordings):
            raise FitError("no start led to a motion that could be: is this the arm recorded?")
        predicted = _predictions(out.compressed, here.recordings)
        pairs = zip(here.recordings, predicted, strict=True)
        found = wild_beside(here, [r.angle - p for r, p in pairs], beside=True)
        found = [new | old for new, old in zip(found, wild, strict=True)]
        settled = all((f == w).all() for f, w in zip(found, wild, strict=True))
        if settled or round_ == _ROUNDS or any(f.mean() > _MOST_WILD for f in found):
            break
        progress("fitting again without wild readings")
        wild = found
        problem = reweighted(problem, wild)
        out = search(problem, _single(out.unknowns), (1.0,))
        steps += out.steps
    return Descent(
        problem,
        wild,
        out.unknowns,
        out.compressed,
        out.cost,
        steps,
        out.converged,
        starts,
        agreeing,
        here.finer,
    )


def _misled(problem: Problem, out: Polished) -> bool:
    """Whether a law of many valleys has ended well above the noise."""
    readings = np.count_nonzero(problem.recorded.weights)
    return problem.model.rough and out.cost > _MISLED * readings


def shares_of(here: Ready, frequency: float) -> list[float]:
    """The growing shares (0 to 1) of the recordings that a start is fitted to; `frequency` is the
    fastest one, rad/s."""
    longest = max(r.duration for r in here.recordings)
    first = min(1.0, _FIRST_CYCLES * 2 * math.pi / frequency / longest)
    return sorted({first, math.sqrt(first), 1.0})


def _sane(out: Polished, recordings: Sequence[Recording]) -> bool:
    """Whether a start ended in a motion that could be."""
    if not np.isfinite(out.cost):
        return False
    return all(np.all(np.abs(x) < _ABSURD) for x in _predictions(out.compressed, recordings))


def _upright(problem: Problem, at: Unknowns) -> Unknowns | None:
    """The same point with all numbers of the sign that people write; None if they have it."""
    if not problem.model.mirrors:
        return None
    states = np.array(problem.states(at))
    model, n = (
        problem.model.with_vector(jnp.asarray(problem.numbers(at))),
        len(problem.model.mechanism.joints),
    )
    found = model
    for state in states:
        found, memory = model.upright(split(state[2 * n :]))
        state[2 * n :] = [float(z) for z in memory]
    if np.array_equal(found.vector(), model.vector()):
        return None
    return problem.scaled(found.vector(), jnp.asarray(states))


def wild_beside(
    here: Ready, readings: Sequence[np.ndarray], beside: bool = False
) -> list[np.ndarray]:
    """Readings far off their neighbours; `beside` the model, also far off the usual residual."""
    found = []
    for recording, x in zip(here.recordings, readings, strict=True):
        noise = recording.noise
        if beside:  # where the model misses something, the residual has corners of its own
            noise = np.maximum(noise, _USUAL * 1.4826 * np.nanmedian(np.abs(x), axis=0))
            if not np.any(np.abs(x) > _FAR * noise):
                found.append(np.zeros(x.shape, bool))
                continue
        found.append(outlier_mask(recording.time, x, noise))
    return found


def _single(y: Unknowns) -> Unknowns:
    """As starts, of which there is but one."""
    return jax.tree.map(lambda x: np.asarray(x)[None], y)


def _predictions(squeezed: Compressed, recordings: Sequence[Recording]) -> list[np.ndarray]:
    pairs = zip(recordings, np.asarray(squeezed.predicted), strict=True)
    return [x[: len(r.time)] for r, x in pairs]
