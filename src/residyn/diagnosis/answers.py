"""How a model answers to small torques along a motion: one simulation carries them as tangents.

A column is one unknown strength: the torque of an effect at its typical size, as one straight line
an integration step. Sensors change no motion; their columns are what they do to the readings.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..equation import Piecewise
from ..fitting.problem import Problem, Unknowns, over_recordings, predict, tight
from ..fitting.result import RecordingFit
from ..kept import kept
from ..model import Model
from .linear import Near
from .path import Path, Variant

_LANES = 32  # columns answered in one go


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


class Column(NamedTuple):
    """One unknown strength: its torque in each recording as lines (2, M, n), or, of a sensor, its
    effect on the readings (N, n)."""

    lines: list[np.ndarray | None]
    readings: list[np.ndarray | None]


def columns_of(near: Near, paths: Sequence[Path], variant: Variant) -> list[Column]:
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
                found += [Column([x if k == r else None for k in range(len(paths))], none)
                          for x in each]  # fmt: skip
            else:
                lines[r] = each[0]
        if not variant.phases:
            found.append(Column(lines, readings))
    return found


def holds(paths: Sequence[Path], needed: Sequence[np.ndarray], variant: Variant) -> list[Column]:
    """Where friction holds a joint at rest, it is whatever that takes (`needed` by a model that is
    not yet right, and a constant): not to be judged, and not to be taken for the law's."""
    found: list[Column] = []
    none: list[np.ndarray | None] = [None] * len(paths)
    if not variant.effect.dry:
        return []
    for r, path in enumerate(paths):
        for j in range(path.q.shape[1]) if variant.joint is None else [variant.joint]:
            for torque in (np.ones_like(path.q), -needed[r]):
                if path.rests[:, j].any():
                    only = np.zeros_like(path.q)
                    only[:, j] = path.rests[:, j] * torque[:, j]
                    lines = [path.lines(only) if k == r else None for k in range(len(paths))]
                    found.append(Column(lines, none))
    return found


def _read(model: Model, fit: RecordingFit) -> np.ndarray:
    """(N, n) by how much the readings differ from the angles, in the motion as fitted: what sensors
    do, they do to what the model predicts."""
    q = fit.predicted
    v = np.gradient(q, fit.recording.time, axis=0)
    late = np.array([float(d) for d in model.delays])
    return np.asarray(model.reading(jnp.asarray(q))) - q - late * v


def answers_to(
    near: Near,
    paths: Sequence[Path],
    needed: Sequence[np.ndarray] | None,
    columns: Sequence[Column],
) -> Answers:
    """The answers to all columns, and, first among them, to the drive that is `needed` to lead the
    model along the paths and is not there."""
    n, fit = len(near.fit.joints), near.fit
    room, driven = near.problem.room, near.problem.recorded.drive
    lines, gaps = [], []
    for r, path in enumerate(paths):
        real = np.zeros((2, room, n))
        if driven is not None:
            real = np.stack([driven.left[r], driven.right[r]])
        lines.append(real if needed is None else _filled(path.lines(needed[r]), room))
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
        [np.zeros((2, room, n)) if x is None else -_filled(x, room) for x in c.lines]
        for c in columns
    ]
    blocks = []
    for first in range(0, len(torques), _LANES):
        some = torques[first : first + _LANES]
        filled = some + [some[-1]] * (_LANES - len(some))
        stacked = np.stack([np.stack(c) for c in filled], axis=1)  # (R, C, 2, M, n)
        out = jax.device_get(_respond(tight(near.problem), y, drive, jnp.asarray(stacked)))
        blocks.append((out, len(some)))
    return _whitened(near, blocks, columns, np.asarray(y.states))


def _filled(lines: np.ndarray, room: int) -> np.ndarray:
    """(2, M, n) lines with zeros behind, (2, room, n)."""
    return np.pad(lines, ((0, 0), (0, room - lines.shape[1]), (0, 0)))


def seen_from(near: Near, slopes: Sequence[np.ndarray], kept: Answers) -> Answers:
    """The answers of an earlier model as directions in which to look from a later one; `slopes` are
    the later model's own, as from `near.look`."""
    numbers, memories = near.numbers, near.memories()
    now = Answers([], [], [], kept.columns, kept.begin)
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
    return now


def _whitened(near: Near, blocks, columns: Sequence[Column], states: np.ndarray) -> Answers:
    found = Answers([], [], [], [], states * np.asarray(near.problem.scale.states))
    memories, numbers = near.memories(), near.numbers
    for r, weight in enumerate(near.weights()):
        predicted, slopes, _ = (x[r, : len(weight)] for x in blocks[0][0])
        w = weight.reshape(-1, 1)
        answers = np.concatenate(
            [out[2][r, : len(weight), :, :count] for out, count in blocks], axis=-1
        )
        answers = answers.reshape(-1, answers.shape[-1])
        readings = np.nan_to_num(near.fitted[r].recording.angle) - predicted
        left = readings.reshape(-1) - answers[:, 0]
        answers = answers[:, 1:]
        for k, column in enumerate(columns):
            seen = column.readings[r]
            if seen is not None:
                answers[:, k] = seen.reshape(-1)
        local = slopes.reshape(len(w), -1)
        prior = np.zeros((memories, local.shape[1] - numbers))
        if memories:
            prior[:, -memories:] = np.eye(memories)
        known = -states[r, states.shape[1] - memories :]
        found.left.append(np.append(np.nan_to_num(left * w[:, 0]), known))
        found.numbers.append(np.nan_to_num(local[:, :numbers] * w))
        found.states.append(np.vstack([np.nan_to_num(local[:, numbers:] * w), prior]))
        found.columns.append(np.nan_to_num(answers * w))
    return found


@kept(like=(0, 0, 0))
def _respond(problem: Problem, y: Unknowns, drive: Piecewise, torques):
    """Predictions (R, N, n) under a drive, and their slopes in the unknowns and in torques."""
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
