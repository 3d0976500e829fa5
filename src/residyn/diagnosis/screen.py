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
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..effects import AbstractEffect
from ..fitting.problem import posed
from ..model import Model
from ..parameter import Scales, parameters_of
from .answers import Answers, Column, answers_to, columns_of, holds, seen_from
from .elimination import Solver
from .linear import Near
from .path import Path, Variant, resonant, variants, with_fields
from .unnamed import Shape, Unnamed, shapes, unnamed

_SHAPES = 4  # of an effect that are kept
_FINER = (1.32, 1.15, 1.07, 1.035)  # steps of a shape between the grid's values, one by one
_NEAR = 2.0  # times the noise: more, and not everything is explained
_SHAPES_OF_TWO = 2  # the same, of each of two at once


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
    variant: Variant
    """What its strengths and shapes were estimated as."""
    others: tuple["Screened", ...] = ()
    """The same effect with other shapes, the next best first."""


class Tried(NamedTuple):
    """A screen's answers, kept: they serve a better model as directions to look into."""

    variants: list[Variant]
    bounds: np.ndarray
    """Where each variant's columns begin, and where those of any shape do."""
    answers: Answers
    sizes: np.ndarray
    """(C,) rms torque of each column; 0 of a sensor's."""
    shapes: Sequence[Shape] = ()
    """What the columns beyond the candidates' are."""
    led: bool = True
    """Whether the model was led along measured motion, noise and all."""


def screen(
    near: Near,
    paths: Sequence[Path],
    candidates: Sequence[AbstractEffect],
    led: bool = True,
    any_shape: bool = False,
) -> tuple[float, list[Screened], Tried]:
    """Each candidate beside the model of `near`.

    With `led`, the model is led along the paths; without, the paths must be its own. With
    `any_shape`, torques of any shape are answered, too, and kept for `left_over`.

    **Returns:** chi-square to first order without any, the candidates, the best first, and what
    `glance` needs.
    """
    scales = near.ready.scales()
    tried = [v for effect in candidates for v in _variants(near, paths, effect, scales)]
    more, found_shapes = shapes(near, paths) if any_shape else ([], [])
    answered = _answered(near, paths, tried, led, more)
    solver, readings = answered.solver, near.readings
    by_label: dict[str, list] = {}
    for variant, which in zip(tried, answered.ranges(), strict=True):
        factors, drop = _factors(solver, variant, which)
        # So near a mode it must explain everything, or it is but a mimic.
        mimic = solver.alone - drop > _NEAR * readings and _beside_a_mode(variant, near)
        if np.isfinite(drop) and not mimic:
            each = by_label.setdefault(variant.effect.label, [])
            each.append((drop, variant, which, factors))
    found = []
    for each in by_label.values():
        each.sort(key=lambda x: -x[0])
        best, *others = [_weigh(near, answered, *x) for x in each[:_SHAPES]]
        found.append(best._replace(others=tuple(others)))
    sizes = np.array([_rms(c) for c in answered.flat])
    kept = Tried(tried, answered.bounds, answered.answers, sizes, found_shapes, led)
    return solver.alone, sorted(found, key=lambda s: s.chi2), kept


def sharpened(
    near: Near, paths: Sequence[Path], found: Sequence[Screened], led: bool
) -> list[Screened]:
    """Candidates with their shapes between the grid's values: a fit that begins with a gap a third
    off may never find it."""
    best = list(found)
    for factor in _FINER:
        some = [(i, v) for i, s in enumerate(best) for v in _beside_shapes(s.variant, factor)]
        if not some:
            break
        answered = _answered(near, paths, [v for _, v in some], led)
        for (i, variant), which in zip(some, answered.ranges(), strict=True):
            factors, drop = _factors(answered.solver, variant, which)
            if np.isfinite(drop) and drop > best[i].drop:
                new = _weigh(near, answered, drop, variant, which, factors)
                best[i] = new._replace(others=(best[i], *best[i].others)[:_SHAPES])
    return best


class _Answered(NamedTuple):
    """Variants' columns, and what a model answers to them."""

    flat: list[Column]
    bounds: np.ndarray
    answers: Answers
    solver: Solver

    def ranges(self) -> Iterator[range]:
        """Each variant's columns."""
        return (range(a, b) for a, b in itertools.pairwise(self.bounds))


def _answered(
    near: Near,
    paths: Sequence[Path],
    tried: Sequence[Variant],
    led: bool,
    more: Sequence[Column] = (),
) -> _Answered:
    n = len(near.fit.joints)
    needed = [
        path.inverse(posed(near.fit.model, mechanism), r.state[2 * n :])
        for path, mechanism, r in zip(paths, near.ready.mechanisms, near.fitted, strict=True)
    ]
    columns = [columns_of(near, paths, v) + holds(paths, needed, v) for v in tried]
    bounds = np.cumsum([0, *(len(c) for c in columns)])
    flat = [*itertools.chain(*columns), *more]
    answers = answers_to(near, paths, needed if led else None, flat)
    return _Answered(flat, bounds, answers, Solver.of(near, answers))


def _beside_shapes(variant: Variant, factor: float) -> list[Variant]:
    """The same effect with one of its shapes a little smaller or larger, each in turn."""
    found = []
    for p in parameters_of(variant.effect):
        if p.fitted and p.silent is None and p.grid and p.field != variant.effect.oscillates:
            value = float(getattr(variant.effect, p.field))
            for times in (1.0 / factor, factor):
                effect = with_fields(variant.effect, {p.field: value * times})
                found.append(variant._replace(effect=effect))
    return found


def glance(near: Near, slopes: Sequence[np.ndarray], kept: Tried) -> dict[str, float]:
    """By how much chi-square might fall with each effect, seen from a later model with the answers
    of an earlier one: cheap, and good enough to see that nothing is left.

    `slopes` are the later model's own, as from `near.look`.
    """
    solver = Solver.of(near, seen_from(near, slopes, kept.answers))
    found: dict[str, float] = {}
    for variant, first, last in zip(kept.variants, kept.bounds, kept.bounds[1:], strict=False):
        drop, label = _factors(solver, variant, range(first, last))[1], variant.effect.label
        found[label] = max(drop, found.get(label, 0.0))
    return found


def pair(near: Near, kept: Tried, among: Collection[str]) -> tuple[str, str, float] | None:
    """Two effects, with labels `among` these, that explain most together, the one of the larger
    torque first, and chi-square with both; None if there are no two."""
    solver = Solver.of(near, kept.answers)
    best: dict[str, list[tuple[float, Variant, range]]] = {}
    for variant, first, last in zip(kept.variants, kept.bounds, kept.bounds[1:], strict=False):
        which = range(first, last)
        drop = _factors(solver, variant, which)[1]
        if np.isfinite(drop) and variant.effect.label in among:
            best.setdefault(variant.effect.label, []).append((drop, variant, which))
    some = {k: sorted(v, key=lambda x: -x[0])[:_SHAPES_OF_TWO] for k, v in best.items()}
    found = None
    for (one, ones), (two, others) in itertools.combinations(some.items(), 2):
        for (_, a, of_a), (_, b, of_b) in itertools.product(ones, others):
            which = [*of_a, *of_b]
            factors, drop = solver.solve(which, [*_free(a, of_a), *_free(b, of_b)])
            if np.isfinite(drop) and (found is None or drop > found[0]):
                pull = np.abs(factors) * kept.sizes[which]
                first = pull[: len(of_a)].max() >= pull[len(of_a) :].max()
                found = drop, *((one, two) if first else (two, one))
    return None if found is None else (found[1], found[2], solver.alone - found[0])


def left_over(near: Near, slopes: Sequence[np.ndarray], kept: Tried) -> Unnamed:
    """What torques of any shape would explain, seen from a later model like `glance`."""
    return unnamed(near, slopes, kept.answers, int(kept.bounds[-1]), kept.shapes)


def _variants(
    near: Near,
    paths: Sequence[Path],
    effect: AbstractEffect,
    scales: Callable[[int | None], Scales],
) -> list[Variant]:
    alone = Model(near.fit.model.mechanism, (effect,))
    sizes = {
        n.meaning.field: float(n.meaning.dimension.size(scales(n.joint))) for n in alone.fitted
    }
    joint = alone.numbers[0].joint if alone.numbers else None
    modes = [m.frequency_hz for m in near.fit.modes]
    return variants(effect, sizes, paths, joint, modes)


def _factors(solver: Solver, variant: Variant, which: range) -> tuple[np.ndarray, float]:
    """What a variant's columns count, with the signs that physics allows, and what they bring."""
    return solver.solve(list(which), _free(variant, which))


def _beside_a_mode(variant: Variant, near: Near) -> bool:
    """Whether it oscillates so near a mode that it may be but a correction of the ringing."""
    if variant.effect.oscillates is None:
        return False
    modes = [m.frequency_hz for m in near.fit.modes]
    longest = max(r.recording.duration for r in near.fitted)
    return bool(resonant(getattr(variant.effect, variant.effect.oscillates), modes, longest))


def _free(variant: Variant, which: range) -> list[bool]:
    """Which of a variant's columns may have either sign."""
    if variant.phases:
        return [True] * len(which)
    signs = {p.field: p.sign for p in parameters_of(variant.effect)}
    free = [signs[f] == "any" for f in variant.strengths]
    return [*free, *[True] * (len(which) - len(free))]


def _rms(column: Column) -> float:
    squares = [np.mean(np.square(x)) for x in column.lines if x is not None]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def _weigh(
    near: Near,
    answered: _Answered,
    drop: float,
    variant: Variant,
    which: range,
    factors: np.ndarray,
) -> Screened:
    """A variant's strengths, and what goes with them."""
    own = len(variant.effect.memory)
    memory = np.zeros((len(answered.answers.left), own))
    if variant.phases:
        pairs = factors.reshape(-1, 2)
        strengths = np.array([np.sqrt(np.mean(np.sum(pairs**2, axis=1)))])
        memory[:, 0] = np.arctan2(pairs[:, 1], pairs[:, 0])
    else:
        strengths = factors[: len(variant.strengths)]
    fields = dict(zip(variant.strengths, strengths * variant.sizes, strict=True))
    effect = with_fields(variant.effect, {k: float(v) for k, v in fields.items()})
    scale, (numbers, states) = near.problem.scale, answered.solver.beside(which, factors)
    states = answered.answers.begin + np.asarray(scale.states) * states
    return Screened(
        effect,
        answered.solver.alone - drop,
        drop,
        np.asarray(near.fit.model.vector()) + np.asarray(scale.numbers) * numbers,
        np.concatenate([states, memory], axis=1),
        variant,
    )
