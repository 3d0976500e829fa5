"""A fit seen from close by: a linear problem.

Near its minimum a fit is linear least squares. What the unknowns (numbers and initial states) can
do to the readings is the span of the Jacobian's columns, the *tangent*. Two things follow. The
residual of a right model is noise less its part along the tangent, which the fit has swallowed: any
test of the residual must know that. And a prediction beyond the fitted readings errs by the noise
in them, carried over by the same columns: a prediction is bad only if it is off by more than that.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..fitting.least_squares import RUNAWAY, Compressed, look
from ..fitting.linalg import damped_step
from ..fitting.problem import Problem, Unknowns, reweighted, tight
from ..fitting.result import Fit, FitError
from .evidence import gram_factor

# A direction of the tangent this much shorter than the longest is rounding, or undetermined.
_BLIND = 1e-5
_STEPS = 60  # of Levenberg and Marquardt, at the most
_SETTLED = 3e-3  # of the rms residual, or of sigma: the last step moves all of them by less
_DAMPING = 1e-6, 1e6  # of a step, relative to the squares of each unknown: at first, at the most
_STEEP = 1 / np.finfo(float).eps  # sigma for an unknown of one: its own rounding is a sigma then
_NOTHING = np.finfo(float).tiny / np.finfo(float).eps  # squares from which on all digits are there


class Hopeless(Exception):
    """A descent that would end too high."""


class Minimum(NamedTuple):
    """Where a descent ended."""

    at: Unknowns
    predicted: np.ndarray  # (R, N, n) rad or m
    residual: np.ndarray  # (R, N, n) whitened
    cost: float
    """Sum of squared whitened residuals, what is known beforehand included."""
    steps: int
    converged: bool
    square: np.ndarray
    """(R, L, L) J'J of the whitened readings, and of what is known beforehand, in each recording's
    L unknowns: the shared numbers, then its own initial state, in the problem's scales."""
    slope: np.ndarray  # (R, L) J'r

    def compressed(self) -> Compressed:
        """Predictions, and what least squares need of residual and Jacobian."""
        silent = np.einsum("rii->ri", self.square) < _NOTHING  # what moves no reading
        lower = gram_factor(self.square + silent[:, :, None] * np.eye(silent.shape[-1]))
        along = np.linalg.solve(lower, self.slope[..., None])[..., 0]
        total = np.sum(self.residual**2, axis=(1, 2))
        beside = np.sqrt(np.maximum(total - np.sum(along**2, axis=1), 0.0))
        found = self.predicted, lower.transpose(0, 2, 1), along, beside
        return Compressed(*map(jnp.asarray, found))


Known = Callable[[Unknowns], tuple[np.ndarray, np.ndarray]]
"""What is known of unknowns beforehand: by how much (R, L) each is off its prior mean, in standard
deviations, and the slope (R, L) of that in the unknown itself; 0 and 0 where nothing is known."""


def minimum(
    problem: Problem,
    at: Unknowns,
    most: int = _STEPS,
    enough: float = math.inf,
    known: Known | None = None,
) -> Minimum:
    """Levenberg and Marquardt's descent from unknowns that are near already, in `most` steps.

    One compiled program evaluates predictions and slopes, up to the last reading that counts; what
    is linear is done here. Where the motion has kinks no step is small enough to end by itself:
    there the descent ends when even a short step gains nothing. Unless something else is `known`,
    internal states are, to their scale.

    **Raises:** `FitError` where the motion runs away from the beginning; `Hopeless` where the cost
    stays above `enough`, and would if all steps to come took as much from it as the last one.
    """
    problem = tight(problem)
    moves = np.asarray(problem.active) > 0
    P, S = len(moves), np.shape(at.states)[1]
    counts = np.asarray(problem.recorded.weights) > 0
    readings, every = max(1, np.count_nonzero(counts)), np.asarray(problem.steps)
    last = np.asarray(problem.recorded.row)[counts.any(axis=-1)].max(initial=0)
    only = np.minimum(last + 1, every).astype(every.dtype)  # integration steps
    inner = np.arange(P + S) >= P + 2 * problem.recorded.angles.shape[-1]

    def of_internal_states(at: Unknowns) -> tuple[np.ndarray, np.ndarray]:
        off = np.pad(np.asarray(at.states), ((0, 0), (P, 0)))
        return off * inner, np.ones_like(off) * inner

    known = known or of_internal_states

    def evaluated(at: Unknowns, steps: int) -> Minimum:
        predicted, slopes, residual = map(np.asarray, look(problem, at, only))
        R, (off, by) = len(slopes), known(at)
        with np.errstate(over="ignore", invalid="ignore"):  # of a motion that runs away
            J = slopes * np.asarray(problem.recorded.weights)[..., None]
            J = np.concatenate([J[..., :P] * moves, J[..., P:]], -1).reshape(R, -1, P + S)
            square = J.transpose(0, 2, 1) @ J + by[:, :, None] ** 2 * np.eye(P + S)
            slope = np.einsum("rml,rm->rl", J, residual.reshape(R, -1)) + by * off
        cost = float(np.sum(residual**2) + np.sum(off**2))
        sane = np.isfinite(cost) and np.abs(residual).max() < RUNAWAY and np.abs(J).max() < _STEEP
        cost = cost if sane else np.inf
        return Minimum(at, predicted, residual, cost, steps, False, square, slope)

    here = evaluated(Unknowns(np.asarray(at.numbers, float), np.asarray(at.states, float)), 0)
    if here.cost == np.inf:
        raise FitError("the motion runs away")
    damping, steps, converged = _DAMPING[0], 0, False
    while steps < most and damping <= _DAMPING[1] and not converged:
        numbers, states = damped_step(here.square, here.slope, P, damping)
        numbers, steps = numbers * moves, steps + 1
        there = evaluated(problem.stepped(here.at, Unknowns(numbers, states)), steps)
        gain = here.cost - there.cost
        if gain < 0:
            damping = max(10 * damping, 1e3 * _DAMPING[0])
            continue
        if there.cost - gain > enough:
            here = there
            break
        step = np.concatenate([np.tile(numbers, (len(states), 1)), states], axis=1)
        size_of = np.einsum("ra,rab,rb->", step, here.square, step)
        converged = min(gain, size_of) < _SETTLED**2 * max(1.0, there.cost / readings)
        damping, here = max(0.1 * damping, _DAMPING[0]), there
    if here.cost > enough:
        raise Hopeless
    if only < every:
        here = here._replace(predicted=np.asarray(look(problem, here.at, every)[0]))
    return here._replace(steps=steps, converged=bool(converged or damping > _DAMPING[1]))


def on_host(problem: Problem, y: Unknowns, shares, size, enough: float = math.inf):
    """`least_squares.one_start` by `minimum`: first of the first so many readings only, which cost
    no more than all, then of all. It is not to go on where it has not converged: of descents it
    says one more than there were, then."""
    shares, steps, found = shares[shares > 0], 0, None
    for share in shares:
        recorded = problem.recorded
        early = np.asarray(recorded.row) < np.ceil(share * problem.steps)
        weights = np.where(early[..., None], recorded.weights, 0.0)
        part = eqx.tree_at(lambda p: p.recorded.weights, problem, weights)
        found = minimum(part, y, _STEPS if np.isfinite(size) else 0, enough)
        y, steps = found.at, steps + found.steps
    assert found is not None
    done = len(shares) + (not found.converged)
    return y, found.compressed(), found.cost, steps, found.converged, done


def refitted(fit: Fit, kept: Sequence[np.ndarray]) -> tuple[Unknowns, bool]:
    """The unknowns that fit only the `kept` (N,) instants of each fitted recording.

    **Returns:** they, and whether the search for them, from the whole fit's, settled.
    """
    dropped = [
        ~(np.isfinite(r.recording.angle) & k[:, None])
        for k, r in zip(kept, fit.fitted, strict=True)
    ]
    try:
        found = minimum(reweighted(fit.problem, dropped), fit.unknowns)
    except FitError:
        return fit.unknowns, False
    return found.at, found.converged


def predictions(fit: Fit, at: Unknowns) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Predicted readings (N, n) of each fitted recording, and their slopes (N, n, L) in its L
    unknowns: the shared numbers, then its own initial state, in the problem's scales."""
    problem = tight(fit.problem)
    predicted, slopes = (
        [x[: len(f.recording.time)] for f, x in zip(fit.fitted, each, strict=True)]
        for each in jax.device_get(look(problem, at, np.asarray(problem.steps))[:2])
    )
    return predicted, slopes


class Tangent(NamedTuple):
    """Orthonormal columns that span what the unknowns can do to the whitened readings."""

    columns: list[np.ndarray]
    """(N, n, K) per recording; orthonormal over all recordings together."""
    shared: int
    """How many of them, the last ones, are of the numbers and shared by all recordings."""

    @classmethod
    def of(
        cls, slopes: Sequence[np.ndarray], weights: Sequence[np.ndarray], numbers: int
    ) -> "Tangent":
        """From slopes (N, n, L), of which the first `numbers` are shared, and weights (N, n) =
        1/sigma, 0 where there is no reading, of each recording."""
        own, shared = [], []
        for slope, weight in zip(slopes, weights, strict=True):
            whitened = (slope * weight[:, :, None]).reshape(-1, slope.shape[-1])
            states = _orthonormal(whitened[:, numbers:])
            rest = whitened[:, :numbers]
            own.append(states)
            shared.append(rest - states @ (states.T @ rest))
        together = _orthonormal(np.concatenate(shared))
        parts = np.split(together, np.cumsum([len(s) for s in shared])[:-1])
        columns = [
            np.hstack([a, b]).reshape(*weight.shape, -1)
            for a, b, weight in zip(own, parts, weights, strict=True)
        ]
        return cls(columns, together.shape[1])

    def part(self, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The part of whitened residuals (N, n) that the unknowns can take up."""
        along = [np.einsum("tjk,tj->k", c, r) for c, r in zip(self.columns, residuals, strict=True)]
        total = sum(a[len(a) - self.shared :] for a in along)
        for a in along:
            a[len(a) - self.shared :] = total
        return [c @ a for c, a in zip(self.columns, along, strict=True)]


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    size = np.sqrt((columns**2).sum(axis=0))
    columns = columns[:, size > 0] / size[size > 0]
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, s > _BLIND * s.max(initial=0.0)]


def spread(
    slopes: Sequence[np.ndarray], weights: Sequence[np.ndarray], numbers: int, memories: int
) -> list[np.ndarray]:
    """Standard errors of predictions, (N, n) rad or m per recording, of a fit to the readings that
    have a weight; see `Tangent.of`. Internal states, the last `memories` unknowns of each
    recording, are known beforehand to their scale."""
    total, parts = np.zeros((numbers, numbers)), []
    for slope, weight in zip(slopes, weights, strict=True):
        whitened = (slope * weight[:, :, None]).reshape(-1, slope.shape[-1])
        known = np.zeros(slope.shape[-1])
        known[len(known) - memories :] = 1.0
        square = whitened.T @ whitened + np.diag(known)
        # How a recording's states follow the numbers, and their own covariance.
        inverse = np.linalg.pinv(square[numbers:, numbers:], hermitian=True)
        gain = inverse @ square[numbers:, :numbers]
        total += square[:numbers, :numbers] - square[:numbers, numbers:] @ gain
        parts.append((slope[..., numbers:], slope[..., :numbers], gain, inverse))
    size = np.sqrt(np.where(np.diag(total) > 0, np.diag(total), 1.0))
    covariance = np.linalg.pinv(total / size / size[:, None], rcond=_BLIND**2, hermitian=True)
    covariance = covariance / size / size[:, None]
    found = []
    for own, shared, gain, inverse in parts:
        beyond = shared - own @ gain
        variance = np.einsum("tja,ab,tjb->tj", own, inverse, own)
        variance += np.einsum("tja,ab,tjb->tj", beyond, covariance, beyond)
        found.append(np.sqrt(np.maximum(variance, 0.0)))
    return found
