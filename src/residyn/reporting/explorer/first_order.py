"""What adding effects does to a fit, to first order, before anything is fitted.

Along the smoothed motion of the base model the predicted readings are linear in everything unknown:
the first states, the model's numbers, and the strengths of further effects,

    e = a + X x0 + P u + C s        (e: measured less predicted, over the noise).

For any strengths s the first states and the numbers follow by least squares, linearly; put in,
they leave e = d + D s. The page then needs the Gram matrices of (d, D) alone: a Cholesky of a few
rows gives the strengths of any set of effects, and a quadratic form the error of each joint, where
it was fitted and where it was not. The motion about which all is linear is led by the readings, not
by the base model. Where a joint sticks, nothing is linear: there the answer is too small a fall.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...diagnosis.columns import Columns
from ...filtering.trajectory import Scene, state_slices

_RIDGE = 1e-9  # of the largest square: what cannot be told of first states stays as it is
_RUNAWAY = 1e6  # rad or m: a linear motion that nothing holds back


class ErrorGram(NamedTuple):
    """Errors of predictions as quadratic forms in (1, s)."""

    solve: Float[np.ndarray, "C1 C1"]
    """Strengths minimise (1, s) solve (1, s)' + s s'."""
    joints: Float[np.ndarray, "n C1 C1"]
    """The squared error of each joint, in units of the noise of the grid's readings."""
    noise: Float[np.ndarray, " n"]
    """What noise alone puts into it beyond the grid's readings, where those are averages."""
    readings: Float[np.ndarray, " n"]
    """How many readings of each joint there are."""


class FirstOrder(NamedTuple):
    """The first order of all candidates about one motion."""

    fitted: ErrorGram
    held_out: ErrorGram
    predicted: list[np.ndarray]
    """Per recording (N, n, 1 + C): readings of the base model, rad or m, and what a unit of each
    column adds to them, springs and dampers being fitted anew."""
    time: list[np.ndarray]  # (N,) s from the first sample of each


def first_order(fitted: Columns, held_out: Columns | None) -> FirstOrder | None:
    """The first order about the motion of the fitted recordings, and of those held out; without
    these, the last third of each recording is predicted from the rest.

    All columns are of the same candidates, in the same widths.

    **Returns:** None where the linear motion runs away.
    """
    groups = [fitted] if held_out is None else [fitted, held_out]
    parts = [part for columns in groups for part in _rolled_out(columns)]
    if not all(np.isfinite(e).all() and np.abs(e).max() < _RUNAWAY for e, *_ in parts):
        return None
    P, n = len(fitted.trajectory.u), fitted.scene.n
    noise = [r.noise for c in groups for r in c.scene.recordings]
    instants = [(c.scene.grid, rows) for c in groups for rows in _rows(c.scene)]
    weight = [np.where(g.seen[rows], 1 / np.sqrt(g.variance[rows]), 0.0) for g, rows in instants]
    time = [g.time[rows] for g, rows in instants]
    count = len(fitted.scene.recordings)
    mine, others = slice(count), slice(count, None)

    def solved(used):
        """Residuals (N, n, 1 + C) with first states and numbers from the weights `used`."""
        beyond = [_without_states(e, x, w) for (e, x), w in zip(parts, used, strict=True)]
        each = zip(beyond[mine], used[mine], strict=True)
        white = [(e * w[..., None]).reshape(-1, e.shape[-1]) for e, w in each]
        gram = np.sum([w.T @ w for w in white], axis=0)
        inner = gram[1 : 1 + P, 1 : 1 + P] + np.eye(P)
        keep = np.r_[0, 1 + P : gram.shape[0]]
        across = gram[1 : 1 + P][:, keep]
        numbers = -np.linalg.solve(inner, across)
        left = [e[..., keep] + e[..., 1 : 1 + P] @ numbers for e in beyond]
        return left, gram[np.ix_(keep, keep)] + across.T @ numbers

    def energies(left, used, solve, which):
        total, beyond, count = 0.0, np.zeros(n), np.zeros(n)
        for e, w, sigma in zip(left[which], used[which], noise[which], strict=True):
            white = e * w[..., None]
            total = total + np.einsum("tja,tjb->jab", white, white)
            # An average of m readings stands for m - 1 more of pure noise.
            each = (w > 0) * sigma**2 * w**2
            count, beyond = count + each.sum(0), beyond + (each - (w > 0)).sum(0)
        return ErrorGram(solve, np.asarray(total), beyond, count)

    left, solve = solved(weight)
    inside = energies(left, weight, solve, mine)
    if held_out is not None:
        beside = energies(left, weight, solve, others)
    else:
        early = [(t <= 2 / 3 * t[-1])[:, None] for t in time]
        first = [w * e for w, e in zip(weight, early, strict=True)]
        last = [w * ~e for w, e in zip(weight, early, strict=True)]
        ahead, solve = solved(first)
        beside = energies(ahead, last, solve, mine)
    predicted = []
    for e, (g, rows) in zip(left, instants, strict=True):
        own = -e
        own[..., 0] += g.angle[rows]
        predicted.append(own)
    return FirstOrder(inside, beside, predicted, time)


def _rows(scene: Scene) -> list[np.ndarray]:
    """Which instants each recording has."""
    return [scene.grid.of(i) for i in range(len(scene.recordings))]


def _without_states(e: np.ndarray, x: np.ndarray, w: np.ndarray) -> np.ndarray:
    """What is left of columns e (N, n, F) when first states x (N, n, X) take up all they can."""
    xs = (x * w[..., None]).reshape(-1, x.shape[-1])
    es = (e * w[..., None]).reshape(-1, e.shape[-1])
    square = xs.T @ xs
    size = np.sqrt(np.maximum(np.diag(square), 1e-300))
    scaled = square / size / size[:, None] + _RIDGE * np.eye(len(size))
    return e - x @ (np.linalg.solve(scaled, (xs.T @ es) / size[:, None]) / size[:, None])


def _rolled_out(columns: Columns) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each recording (N, n, 1 + P + C): readings less the linear motion from nothing, and less
    what each number and each column adds; (N, n, X): less what each first state adds."""
    scene, s, t = columns.scene, columns.linear.system, columns.trajectory
    g = scene.grid
    s = type(s)(*map(np.asarray, s))
    more, read = columns.inputs
    X = s.A.shape[-1]
    states = 2 * scene.n + sum(x.stop - x.start for x in state_slices(t.effects))
    drive = np.concatenate([s.c[..., None], s.B, more], -1)
    seen = np.concatenate([s.hc[..., None], s.Hu, read], -1)
    F, found = drive.shape[-1], []
    for first, rows in zip(t.first[: len(scene.begins)], _rows(scene), strict=True):
        M = np.concatenate([np.zeros((X, F)), np.eye(X, states)], 1)
        M[2 * scene.n :, 0] = first  # internal states begin where they are known to
        out = np.empty((len(rows), scene.n, M.shape[1]))
        for k, row in enumerate(rows):
            out[k] = s.Hx[row] @ M
            out[k, :, :F] += seen[row]
            M = s.A[row] @ M
            M[:, :F] += drive[row]
        e = -out[..., :F]
        e[..., 0] += g.angle[rows]
        found.append((e, -out[..., F:]))
    return found
