"""Which effects could be missing: all of them tried at once, to first order.

The model is led along the motion as it was, by whatever torque that takes. How it answers to small
changes of that torque is then linear, and exact where it matters: if an effect explains what is
missing, the answer to its torque leaves nothing over. One simulation carries all these answers as
tangents. What remains is linear least squares: of each effect's strengths, beside the model's own
numbers and initial states, with the signs that physics allows.

About the fitted motion instead, the same algebra would misjudge any effect that has let the fit's
phase slip.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect
from ..equation import Piecewise
from ..fitting.problem import Problem, Unknowns, over_recordings, posed, predict
from ..fitting.result import RecordingFit
from ..fitting.setup import Ready
from ..model import Model
from ..parameter import parameters_of
from .linear import Near
from .path import Path, Variant, variants, with_fields

_LANES = 32  # columns answered in one go
_BLIND = 1e-9  # of a direction's square: what the model's own numbers do, too
_LEAST = 1e-5  # of a column's square that must be left when the model has adjusted


class Screened(NamedTuple):
    """An effect to first order."""

    effect: AbstractEffect
    """With its numbers as estimated."""
    chi2: float
    """Left over with it."""
    drop: float
    """How much less that is than without it, also to first order."""
    numbers: np.ndarray
    """(P,) the model's own numbers beside it."""
    states: np.ndarray
    """(R, s) initial states, the effect's own last."""


class Answers(NamedTuple):
    """What a model does along the motion as it was, whitened: per recording."""

    left: list[np.ndarray]  # (N n + m,) measured less predicted, then known less assumed
    numbers: list[np.ndarray]  # (N n, P) slopes in the model's numbers
    states: list[np.ndarray]  # (N n + m, s) and in the states, with what is known of memories
    columns: list[np.ndarray]  # (N n, C) answers to torques, or what sensors do
    begin: np.ndarray  # (R, s) initial states that it was led from

    def recordings(self):
        """(left, numbers, states, columns) of each, with as many rows: the readings, then what is
        known of memories."""
        for left, numbers, states, columns in zip(
            self.left, self.numbers, self.states, self.columns, strict=True
        ):
            more = len(states) - len(numbers)
            wide = [np.vstack([x, np.zeros((more, x.shape[1]))]) for x in (numbers, columns)]
            yield left, wide[0], states, wide[1]


class Tried(NamedTuple):
    """A screen's answers, kept: they serve a better model as directions to look into."""

    variants: list[Variant]
    bounds: np.ndarray
    answers: Answers


def screen(
    near: Near, paths: Sequence[Path], candidates: Sequence[AbstractEffect], led: bool = True
) -> tuple[float, list[Screened], Tried]:
    """Each candidate beside the model of `near`.

    With `led`, the model is led along the paths; without, the paths must be its own.

    **Returns:** chi-square to first order without any, the candidates, the best first, and what
    `glance` needs.
    """
    tried = [v for effect in candidates for v in _variants(near, paths, effect)]
    n = len(near.fit.joints)
    needed = [
        path.inverse(posed(near.fit.model, mechanism), r.state[2 * n :])
        for path, mechanism, r in zip(paths, near.ready.mechanisms, near.fitted, strict=True)
    ]
    columns = [_columns(near, paths, v) + _holds(paths, needed, v) for v in tried]
    bounds = np.cumsum([0, *(len(c) for c in columns)])
    flat = list(itertools.chain(*columns))
    answers = _answers(near, paths, needed if led else None, flat)
    solver = _Solver.of(near, answers)
    best: dict[str, tuple[float, Variant, range, np.ndarray]] = {}
    for variant, first, last in zip(tried, bounds, bounds[1:], strict=False):
        which = range(first, last)
        factors, drop = _factors(solver, variant, which)
        label = variant.effect.label
        if np.isfinite(drop) and (label not in best or drop > best[label][0]):
            best[label] = drop, variant, which, factors
    found = [_weigh(near, solver, answers, *each) for each in best.values()]
    kept = Tried(tried, bounds, answers)
    return solver.alone, sorted(found, key=lambda s: s.chi2), kept


def glance(near: Near, slopes: Sequence[np.ndarray], kept: Tried) -> dict[str, float]:
    """By how much chi-square might fall with each effect, seen from a later model with the answers
    of an earlier one: cheap, and good enough to see that nothing is left.

    `slopes` are the later model's own, as from `near.look`.
    """
    numbers, memories = near.numbers, near.memories()
    now = Answers([], [], [], kept.answers.columns, kept.answers.begin)
    rows = zip(near.fitted, near.left(), near.weights(), slopes, strict=True)
    for r, left, weight, slope in rows:
        w = weight.reshape(-1, 1)
        local = np.nan_to_num(slope.reshape(len(w), -1)) * w
        prior = np.zeros((memories, local.shape[1] - numbers))
        known = np.zeros(memories)
        if memories:
            prior[:, -memories:] = np.eye(memories)
            known = -(r.state / np.asarray(near.problem.scale.states)[0])[-memories:]
        now.left.append(np.append((left * weight).reshape(-1), known))
        now.numbers.append(local[:, :numbers])
        now.states.append(np.vstack([local[:, numbers:], prior]))
    solver = _Solver.of(near, now)
    found: dict[str, float] = {}
    for variant, first, last in zip(kept.variants, kept.bounds, kept.bounds[1:], strict=False):
        drop, label = _factors(solver, variant, range(first, last))[1], variant.effect.label
        found[label] = max(drop, found.get(label, 0.0))
    return found


def _variants(near: Near, paths: Sequence[Path], effect: AbstractEffect) -> list[Variant]:
    alone = Model(near.fit.model.mechanism, (effect,))
    typical = Ready(alone, near.ready.recordings, near.ready.mechanisms).typical()
    sizes = {n.meaning.field: float(x) for n, x in zip(alone.fitted, typical, strict=True)}
    joint = alone.numbers[0].joint if alone.numbers else None
    return variants(effect, sizes, paths, joint)


class _Column(NamedTuple):
    """One unknown strength: its torque in each recording as lines (2, M, n), or, of a sensor, its
    effect on the readings (N, n)."""

    lines: list[np.ndarray | None]
    readings: list[np.ndarray | None]


def _columns(near: Near, paths: Sequence[Path], variant: Variant) -> list[_Column]:
    """One column per strength; of an oscillation, two per recording, for its phase."""
    none: list[np.ndarray | None] = [None] * len(paths)
    found = []
    for i in range(len(variant.strengths)):
        lines, readings = none.copy(), none.copy()
        for r, path in enumerate(paths):
            mechanism = near.ready.mechanisms[r]
            bare, full = Model(mechanism), Model(mechanism, (variant.at(i),))
            if full.senses:
                readings[r] = _read(full, near.fitted[r])
                continue
            size = len(full.memory)
            begins = [np.full(size, p) for p in variant.phases] or [np.zeros(size)]
            each = [path.torque(full, z) for z in begins]
            if full.bodies is not full.mechanism:
                without = path.inverse(bare, np.zeros(0))
                each = [path.inverse(full, z) - without for z in begins]
            each = [path.lines(x) for x in each]
            if variant.phases:
                found += [_Column([x if k == r else None for k in range(len(paths))], none)
                          for x in each]  # fmt: skip
            else:
                lines[r] = each[0]
        if not variant.phases:
            found.append(_Column(lines, readings))
    return found


def _holds(paths: Sequence[Path], needed: Sequence[np.ndarray], variant: Variant) -> list[_Column]:
    """Where friction holds a joint at rest, it is whatever that takes (`needed` by a model that is
    not yet right, and a constant): not to be judged, and not to be taken for the law's."""
    found, none = [], [None] * len(paths)
    if not variant.effect.dry:
        return []
    for r, path in enumerate(paths):
        for j in range(path.q.shape[1]) if variant.joint is None else [variant.joint]:
            for torque in (np.ones_like(path.q), -needed[r]):
                if path.rests[:, j].any():
                    only = np.zeros_like(path.q)
                    only[:, j] = path.rests[:, j] * torque[:, j]
                    lines = [path.lines(only) if k == r else None for k in range(len(paths))]
                    found.append(_Column(lines, none))
    return found


def _read(model: Model, fit: RecordingFit) -> np.ndarray:
    """(N, n) by how much the readings differ from the angles, in the motion as fitted: what sensors
    do, they do to what the model predicts."""
    q = fit.predicted
    v = np.gradient(q, fit.recording.time, axis=0)
    late = np.array([float(d) for d in model.delays])
    return np.asarray(model.reading(jnp.asarray(q))) - q - late * v


def _answers(
    near: Near,
    paths: Sequence[Path],
    needed: Sequence[np.ndarray] | None,
    columns: Sequence[_Column],
) -> Answers:
    """The answers to all columns, and, first among them, to the drive that is `needed` to lead the
    model along the paths and is not there."""
    n, fit = len(near.fit.joints), near.fit
    steps, driven = near.problem.steps, near.problem.recorded.drive
    lines, gaps = [], []
    for r, path in enumerate(paths):
        real = np.zeros((2, steps, n))
        if driven is not None:
            real = np.stack([driven.left[r], driven.right[r]])
        lines.append(real if needed is None else path.lines(needed[r]))
        gaps.append(real - lines[-1])
    drive = Piecewise(
        jnp.zeros(len(paths)),
        jnp.asarray([p.h for p in paths]),
        jnp.asarray(np.stack([x[0] for x in lines])),
        jnp.asarray(np.stack([x[1] for x in lines])),
    )
    begin = np.stack([f.state for f in near.fitted])
    for r, path in enumerate(paths if needed is not None else ()):
        h = path.time[0]
        begin[r, :n], begin[r, n : 2 * n] = path.q[0] - h * path.v[0], path.v[0] - h * path.a[0]
    y = near.problem.scaled(fit.model.vector(), jnp.asarray(begin))
    torques = [gaps] + [
        [np.zeros((2, steps, n)) if x is None else -x for x in c.lines] for c in columns
    ]
    blocks = []
    for first in range(0, len(torques), _LANES):
        some = torques[first : first + _LANES]
        filled = some + [some[-1]] * (_LANES - len(some))
        stacked = np.stack([np.stack(c) for c in filled], axis=1)  # (R, C, 2, M, n)
        out = jax.device_get(_respond(near.problem, y, drive, jnp.asarray(stacked)))
        blocks.append((out, len(some)))
    return _whitened(near, blocks, columns, np.asarray(y.states))


def _whitened(near: Near, blocks, columns: Sequence[_Column], states: np.ndarray) -> Answers:
    found = Answers([], [], [], [], states * np.asarray(near.problem.scale.states))
    memories, numbers = near.memories(), near.numbers
    for r, (layout, weight) in enumerate(zip(near.layouts, near.weights(), strict=True)):
        predicted, slopes, _ = (x[r] for x in blocks[0][0])
        w = weight.reshape(-1, 1)
        answers = np.concatenate(
            [layout.take(out[2][r])[..., :count] for out, count in blocks], axis=-1
        )
        answers = answers.reshape(-1, answers.shape[-1])
        readings = np.nan_to_num(near.fitted[r].recording.angle) - layout.take(predicted)
        left = readings.reshape(-1) - answers[:, 0]
        answers = answers[:, 1:]
        for k, column in enumerate(columns):
            seen = column.readings[r]
            if seen is not None:
                answers[:, k] = seen.reshape(-1)
        local = layout.take(slopes).reshape(len(w), -1)
        prior = np.zeros((memories, local.shape[1] - numbers))
        if memories:
            prior[:, -memories:] = np.eye(memories)
        known = -states[r, states.shape[1] - memories :]
        found.left.append(np.append(np.nan_to_num(left * w[:, 0]), known))
        found.numbers.append(np.nan_to_num(local[:, :numbers] * w))
        found.states.append(np.vstack([np.nan_to_num(local[:, numbers:] * w), prior]))
        found.columns.append(np.nan_to_num(answers * w))
    return found


@eqx.filter_jit
def _respond(problem: Problem, y: Unknowns, drive: Piecewise, torques):
    """Predictions (R, M, m, n) under a drive, and their slopes in the unknowns and in torques."""
    numbers = problem.scale.numbers.shape[0]

    def one(recorded, scale, state, drive, torques):
        def local(z, more):
            moved = problem.numbers(Unknowns(z[:numbers], y.states))
            led = Piecewise(drive.start, drive.spacing, drive.left + more[0], drive.right + more[1])
            forced = eqx.tree_at(lambda x: x.drive, recorded, led, is_leaf=lambda x: x is None)
            predicted = predict(problem, forced, moved, scale * z[numbers:])
            return predicted, predicted

        z, none = jnp.concatenate([y.numbers, state]), jnp.zeros_like(torques[0])

        def along(dz, du):
            return jax.jvp(local, (z, none), (dz, du), has_aux=True)[1:]

        own, predicted = jax.vmap(along, in_axes=(0, None), out_axes=(-1, None))(
            jnp.eye(len(z)), none
        )
        answers, _ = jax.vmap(along, in_axes=(None, 0), out_axes=(-1, None))(0 * z, torques)
        clean = lambda x: jnp.where(jnp.isfinite(x), x, 0.0)  # noqa: E731
        return clean(predicted), clean(own), clean(answers)

    each = over_recordings(one, problem.model)
    return each(problem.recorded, problem.scale.states, y.states, drive, torques)


class _Solver(NamedTuple):
    """Least squares with the model's own unknowns taken out."""

    square: np.ndarray  # (C, C) of the columns, less what the model's unknowns do
    slope: np.ndarray  # (C,) of the columns with what is left
    whole: np.ndarray  # (C,) squares of the columns as they are
    alone: float  # chi-square without any column

    @classmethod
    def of(cls, near: Near, answers: Answers) -> "_Solver":
        """Eliminate initial states recording by recording, then the numbers."""
        total, whole = 0.0, 0.0
        for left, numbers, states, columns in answers.recordings():
            rows = np.hstack([numbers, columns, left[:, None]])
            basis = _basis(states)
            total = total + rows.T @ rows - (rows.T @ basis) @ (basis.T @ rows)
            whole = whole + np.sum(columns**2, axis=0)
        p = near.numbers
        inner = _inverse(total[:p, :p])
        rest = total[p:, p:] - total[p:, :p] @ inner @ total[:p, p:]
        return cls(rest[:-1, :-1], rest[:-1, -1], np.asarray(whole), float(rest[-1, -1]))

    def solve(self, which: Sequence[int], free: Sequence[bool]) -> tuple[np.ndarray, float]:
        """Factors of some columns, none negative that is not `free`, and the drop they bring."""
        which = np.asarray(which)
        good = self.square[which, which] > _LEAST * self.whole[which]
        while True:
            factors, use = np.zeros(len(which)), which[good]
            if len(use):
                factors[good] = _inverse(self.square[np.ix_(use, use)]) @ self.slope[use]
            wrong = [i for i, any_sign in enumerate(free) if not any_sign and factors[i] < 0]
            if not wrong:
                drop = 2 * factors @ self.slope[which]
                drop -= factors @ self.square[np.ix_(which, which)] @ factors
                return factors, float(drop)
            good[min(wrong, key=lambda i: factors[i])] = False


def _basis(columns: np.ndarray) -> np.ndarray:
    size = np.sqrt((columns**2).sum(axis=0))
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return u[:, s > 1e-7 * s.max(initial=0.0)]


def _inverse(square: np.ndarray) -> np.ndarray:
    """Of a symmetric matrix, blind where its unit columns are."""
    diagonal = np.diag(square)
    size = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    inverse = np.linalg.pinv(square / size / size[:, None], rcond=_BLIND, hermitian=True)
    return inverse / size / size[:, None]


def _factors(solver: _Solver, variant: Variant, which: range) -> tuple[np.ndarray, float]:
    """What a variant's columns count, with the signs that physics allows, and what they bring."""
    signs = {p.field: p.sign for p in parameters_of(variant.effect)}
    free = [signs[f] == "any" for f in variant.strengths]
    held = len(which) - len(free)
    return solver.solve(
        list(which), [True] * len(which) if variant.phases else [*free, *[True] * held]
    )


def _weigh(
    near: Near,
    solver: _Solver,
    answers: Answers,
    drop: float,
    variant: Variant,
    which: range,
    factors: np.ndarray,
) -> Screened:
    """A variant's strengths, and what goes with them."""
    own = len(variant.effect.memory)
    memory = np.zeros((len(answers.left), own))
    if variant.phases:
        pairs = factors.reshape(-1, 2)
        strengths = np.array([np.sqrt(np.mean(np.sum(pairs**2, axis=1)))])
        memory[:, 0] = np.arctan2(pairs[:, 1], pairs[:, 0])
    else:
        strengths = factors[: len(variant.strengths)]
    fields = dict(zip(variant.strengths, strengths * variant.sizes, strict=True))
    effect = with_fields(variant.effect, {k: float(v) for k, v in fields.items()})
    numbers, states = _beside(near, answers, list(which), factors)
    return Screened(
        effect, solver.alone - drop, drop, numbers, np.concatenate([states, memory], axis=1)
    )


def _beside(near: Near, answers: Answers, which: list[int], factors: np.ndarray):
    """The model's numbers and initial states that go with some factors."""
    p = near.numbers
    square, slope = np.zeros((p, p)), np.zeros(p)
    parts = []
    for left, numbers, states, columns in answers.recordings():
        rest, basis = left - columns[:, which] @ factors, _basis(states)
        parts.append((rest, numbers, states))
        rows, rest = numbers - basis @ (basis.T @ numbers), rest - basis @ (basis.T @ rest)
        square, slope = square + rows.T @ rows, slope + rows.T @ rest
    moved = _inverse(square) @ slope
    steps = [
        np.linalg.lstsq(states, rest - rows @ moved, rcond=1e-9)[0] for rest, rows, states in parts
    ]
    scale = near.problem.scale
    numbers = np.asarray(near.fit.model.vector()) + np.asarray(scale.numbers) * moved
    return numbers, answers.begin + np.asarray(scale.states) * np.stack(steps)
