"""A formula for a free curve: at most three terms out of a small grammar.

A term is a function of one variable, with up to two shape numbers on a grid. Every function of the
variable is a sum of the same fine splines, whose Gram matrix along the curve's motion takes one
pass of the filter. So the evidence of any sum of terms is a Cholesky factorisation of a few rows:
strengths are integrated out in closed form, shapes are summed over their grids. Sums are sought by
adding the best term to the best sums; those of laws that have names are left to these names. The
likeliest is iterated as a curve is, and fitted as a class.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from ..effects.found import FoundLaw, FoundNumber
from ..filtering.free_curve import HEIGHTS
from ..filtering.trajectory import Scene
from .evidence import (
    FURTHER,
    HOPELESS,
    INDISTINGUISHABLE,
    INTENSITIES,
    SHAPE,
    WIDTH,
    conditional,
    gains_of,
    log_prior_intensity,
    log_prior_model,
    log_sum,
    subset,
)
from .free_curves import Along, CurveModel, Kind, Place, heights_of, points, signs
from .iteration import gain_of_torque_times

MOST_TERMS = 3
_KEPT = 12  # sums that a further term is tried with
_ITERATIONS = 8  # of a sum's shapes
_FURTHEST = 0.5  # of one iteration, in the logarithm of a shape
_STEP = 1e-4  # of the logarithm of a shape, for a slope


class Term(NamedTuple):
    """A term of the grammar; texts are of `x`, its scale `{x0}` and its shapes by name."""

    family: str
    parts: tuple[str, ...]  # expressions, each with a strength of its own
    words: tuple[str, ...]  # the same for people, of `{x}`
    shapes: tuple[tuple[str, tuple[float, ...]], ...] = ()
    """Names, and grids in units of the variable's scale."""


def _power(p: float, odd: bool) -> Term:
    if p % 2 == odd:
        return Term("power", (f"(x / {{x0}}) ** {p:g}",), (f"({{x}}/{{x0}})^{p:g}",))
    size, word = f"jnp.abs(x / {{x0}}) ** {p:g}", f"|{{x}}/{{x0}}|^{p:g}"
    if odd:
        size, word = f"jnp.sign(x) * {size}", f"sign({{x}}) {word}"
    return Term("power", (size,), (word,))


# Of one side only: what drags or stops in one direction.
_ONE_SIDED = tuple(
    Term("power", (f"jnp.maximum({x} / {{x0}}, 0.0) ** 2",), (f"max({word}/{{x0}}, 0)^2",))
    for x, word in (("x", "{x}"), ("-x", "-{x}"))
)
_WIDTHS = 0.05, 0.1, 0.2, 0.5
_SATURATION = Term("saturation", ("jnp.tanh(x / {width})",), ("tanh({x}/width)",),
                   (("width", _WIDTHS),))  # fmt: skip
_EXPONENTIALS = (
    Term("exponential", ("jnp.exp((x - {x0}) / {rise})",), ("exp(({x} - {x0})/rise)",),
         (("rise", _WIDTHS),)),
    Term("exponential", ("jnp.exp(-(x + {x0}) / {rise})",), ("exp(-({x} + {x0})/rise)",),
         (("rise", _WIDTHS),)),
)  # fmt: skip
_TURN = "2 * jnp.pi * x / {period}"
_SINE = Term(
    "sine",
    (f"jnp.sin({_TURN})", f"jnp.cos({_TURN})"),
    ("sin(2 pi {x}/period)", "cos(2 pi {x}/period)"),
    (("period", tuple(4.0 / n for n in range(1, 25))),),
)
_Z = "((x + {x0} - {centre}) / {width})"
_WELL = Term(
    "well",
    (f"{_Z} * jnp.exp(0.5 - 0.5 * {_Z} ** 2)",),
    ("z exp((1 - z^2)/2), z = ({x} + {x0} - centre)/width",),
    (("centre", tuple(0.1 * n for n in range(1, 20))), ("width", (0.05, 0.1, 0.2, 0.4))),
)
_ANGLE = (
    *(_power(p, True) for p in (1.5, 2, 3, 5, 7)),
    *(_power(p, False) for p in (1, 2, 4)), *_ONE_SIDED,
    _SATURATION, *_EXPONENTIALS, _SINE, _WELL,
)  # fmt: skip
_RATE = (
    *(_power(p, True) for p in (1.5, 2, 3, 5)),
    *(_power(p, False) for p in (1, 1.5, 2, 3)), *_ONE_SIDED,
    _SATURATION, *_EXPONENTIALS,
)  # fmt: skip
_CONSTANT = Term("constant", ("1.0",), ("",))
_LINEAR = Term("power", ("x / {x0}",), ("{x}/{x0}",))
_TIME = (
    _LINEAR,
    _power(2, False),
    Term("exponential", ("jnp.exp(-x / {decay})",), ("exp(-{x}/decay)",),
         (("decay", (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)),)),
    Term("saturation", ("jnp.tanh((x - {centre}) / {width})",), ("tanh(({x} - centre)/width)",),
         (("centre", tuple(0.05 * n for n in range(1, 20))), ("width", (0.01, 0.03, 0.1, 0.3)))),
)  # fmt: skip

NAMED = {
    Kind("angle"): (_CONSTANT, _power(3, True), _power(1, False), _SINE),
    Kind("rate"): (_power(2, True), _power(1, False)),
    Kind("time"): (_CONSTANT,),
    Kind("time", "angle"): (_LINEAR,),
    Kind("angle", "direction"): (_CONSTANT,),
    Kind("time", "direction"): (_CONSTANT,),
}
"""Terms that are laws of the catalogue: a constant torque, cubic and asymmetric stiffness, cogging;
quadratic drag, asymmetric damping; stiffness drift; Coulomb friction."""


def grammar(place: Place) -> tuple[Term, ...]:
    """The terms that a curve of this kind may be a sum of. What springs and dampers are already is
    left out; a constant is left in where it is neither."""
    variable, factor = place.kind
    own = {"angle": _ANGLE, "rate": _RATE, "time": _TIME}[variable]
    if variable == "angle" and factor:
        own = (_LINEAR, *own)
    constant = factor not in ("angle", "rate") and variable != "rate"
    return (_CONSTANT, *own) if constant else own


class Column(NamedTuple):
    """A term at one value of its shapes."""

    term: Term
    shape: tuple[float, ...]
    price: float  # log of the number of values on its grid


class Sum(NamedTuple):
    """A sum of terms, to first order."""

    place: Place
    columns: tuple[Column, ...]
    log_evidence: float  # with the prior of its terms and shapes
    log_prior: float  # of the choice of its terms
    strengths: np.ndarray  # one for each part of each term, in the height's unit
    evidences: np.ndarray = np.zeros(0)
    """(I,) log evidence of a model and these terms under each random torque, where it is beside
    one."""

    @property
    def families(self) -> tuple[str, ...]:
        """Kinds of its terms."""
        return tuple(c.term.family for c in self.columns)

    @property
    def has_names(self) -> bool:
        """Whether it is a model of the catalogue's laws, which is weighed under their names."""
        terms, named = [c.term for c in self.columns], NAMED.get(self.place.kind, ())
        return all(terms.count(t) == 1 and t in named for t in terms)

    @property
    def heights(self) -> np.ndarray:
        """(HEIGHTS,) of its curve."""
        return _functions(self.place, self.columns) @ self.strengths

    def beside(
        self, along: Along, place: Place, intensities: Sequence[float] | np.ndarray
    ) -> "Sum":
        """The terms beside a model that holds them as they are here already, each shape known to an
        e-fold."""
        strong, count = _functions(place, self.columns), len(self.strengths)
        width = _widths(along, place, strong)
        columns = np.concatenate([width * strong, _bends(self)], axis=1)
        totals, grams = along.gram([place], [columns], intensities, self.heights)
        bases, rests = conditional(grams, len(along.trajectory.u))
        gains, means, _ = subset(rests, np.arange(columns.shape[1]))
        evidences = along.scene.possible(totals + bases + gains + signs(along, grams))
        mean = means[int(np.argmax(evidences + log_prior_intensity(intensities)))]
        moved = self.moved(np.clip(SHAPE * mean[count:], -_FURTHEST, _FURTHEST))
        return moved._replace(strengths=width * mean[:count], evidences=evidences)

    def moved(self, by: np.ndarray) -> "Sum":
        """The sum with the logarithms of its shapes moved."""
        steps = iter(np.exp(by))
        shapes = (tuple(x * float(next(steps)) for x in c.shape) for c in self.columns)
        moved = (c._replace(shape=s) for c, s in zip(self.columns, shapes, strict=True))
        return self._replace(columns=tuple(moved))


def scale_of(place: Place) -> float:
    """The variable's scale: its largest visited value, to two digits."""
    return float(f"{max(abs(place.low), abs(place.high)):.1e}")


def value_of(expression: str, x: np.ndarray, x0: float, shapes: dict[str, float]) -> np.ndarray:
    """A term's expression at x: the text that the class will have, with NumPy in JAX's place."""
    code = expression.format(x0=repr(x0), **{k: repr(v) for k, v in shapes.items()})
    with np.errstate(over="ignore"):
        return eval(code, {"jnp": np, "x": x}) * np.ones_like(x)


def columns_of(place: Place) -> list[Column]:
    """Every term at every value on its grids."""
    x0, found = scale_of(place), []
    for term in grammar(place):
        grids = [[x0 * g for g in grid] for _, grid in term.shapes]
        values = list(itertools.product(*grids))
        found += [Column(term, v, math.log(len(values))) for v in values]
    return found


def parts_of(place: Place, column: Column) -> np.ndarray:
    """(HEIGHTS, p) curve of each part of a term at unit strength."""
    x, x0 = points(place.low, place.high), scale_of(place)
    shapes = dict(zip((name for name, _ in column.term.shapes), column.shape, strict=True))
    return heights_of(np.stack([value_of(part, x, x0, shapes) for part in column.term.parts], 1))


def _functions(place: Place, columns: Sequence[Column]) -> np.ndarray:
    """(HEIGHTS, C) `parts_of` some columns."""
    return np.concatenate([parts_of(place, c) for c in columns], axis=1)


def _widths(along: Along, place: Place, functions: np.ndarray) -> np.ndarray:
    """(C,) prior standard deviations of the strengths of functions (HEIGHTS, C): of the torque that
    an effect has beforehand."""
    square = np.sum(functions * (along.squares(place, HEIGHTS) @ functions), axis=0)
    return WIDTH * along.typical(place) / np.sqrt(np.maximum(square, np.finfo(float).tiny))


class Every:
    """Every function of a curve's variable beside its model, to first order."""

    def __init__(self, along: Along, model: CurveModel):
        self.along, self.model = along, model
        logs = np.where(np.isfinite(model.evidences), model.evidences, -np.inf)
        logs = logs + log_prior_intensity(INTENSITIES)
        order = np.argsort(-logs)
        # A formula is a curve: where no curve has a part in the evidence, it has none.
        order = order[logs[order] > logs[order[0]] - HOPELESS]
        at = np.array(INTENSITIES)[order]
        totals, self.grams = along.gram([model.place], [np.eye(HEIGHTS)], at, model.held)
        bases, self.rests = conditional(self.grams, len(along.trajectory.u))
        # Summed over the random torque's correlation time, as the curve's are.
        t, linear = along.trajectory, along.linear
        more = gain_of_torque_times(along.scene, t, linear, model.evidences)
        self.bases = totals + bases + log_prior_intensity(at) + more[order]
        """(I,) the likeliest random torque first."""


def _among(square: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """A Gram matrix (..., F + HEIGHTS, F + HEIGHTS) as that of sums (HEIGHTS, C) of its last ones:
    (..., F + C, F + C)."""
    first = square.shape[-1] - len(columns)
    move = np.asarray(block_diag(np.eye(first), columns))
    return move.T @ square @ move


class Sums:
    """All sums of some columns beside a model, to first order, under its `most` likeliest random
    torques; `more` (HEIGHTS, C) are further functions, at their prior's width, which no sum has."""

    def __init__(
        self, every: Every, columns: Sequence[Column], more: np.ndarray | None = None,
        most: int | None = 1,
    ):  # fmt: skip
        self.columns, self.place = list(columns), every.model.place
        ends = itertools.accumulate((len(c.term.parts) for c in columns), initial=0)
        self.which = [tuple(range(a, b)) for a, b in itertools.pairwise(ends)]
        strong = _functions(self.place, columns)
        self.width = _widths(every.along, self.place, strong)
        strong = self.width * strong
        self.functions = strong if more is None else np.concatenate([strong, more], axis=1)
        self.bases, self.rests = every.bases[:most], _among(every.rests[:most], self.functions)

    def of(self, sets: list[tuple[int, ...]]) -> list[Sum]:
        """Sums of these columns."""
        which = [tuple(i for k in each for i in self.which[k]) for each in sets]
        terms, found = len(grammar(self.place)), []
        each = gains_of(self.rests, self.bases, which)
        for own, (evidence, mean), where in zip(sets, each, which, strict=True):
            columns = tuple(self.columns[j] for j in own)
            # There is one term at least.
            prior = log_prior_model(len(columns), terms) - math.log(FURTHER)
            evidence += prior - sum(c.price for c in columns)
            found.append(Sum(self.place, columns, evidence, prior, self.width[list(where)] * mean))
        return found

    def best(self) -> list[tuple[tuple[int, ...], Sum]]:
        """The likeliest sums, the best first: the best so far with each further term."""
        every: dict[tuple[int, ...], Sum] = {}
        last: list[tuple[int, ...]] = [()]
        for _ in range(MOST_TERMS):
            further = itertools.product(last, range(len(self.columns)))
            sets = sorted({tuple(sorted((*s, k))) for s, k in further if self._may_join(k, s)})
            found = dict(zip(sets, self.of(sets), strict=True))
            every |= found
            last = sorted(found, key=lambda s: -found[s].log_evidence)[:_KEPT]
        return sorted(every.items(), key=lambda item: -item[1].log_evidence)

    def _may_join(self, k: int, others: tuple[int, ...]) -> bool:
        """Whether a sum takes a term: each once, but sines of several periods."""
        term, known = self.columns[k].term, [self.columns[i].term for i in others]
        return k not in others and (term is _SINE or term not in known)


def likeliest(along: Along, model: CurveModel) -> list[Sum]:
    """For a curve the likeliest sum of one, of two and of three terms that the catalogue has no
    names for, shapes moved off their grids: those that cannot be told from the likeliest, which
    comes first."""
    columns, every = columns_of(model.place), Every(along, model)
    singles = Sums(every, columns).of([(k,) for k in range(len(columns))])
    for _, own in itertools.groupby(singles, lambda s: s.columns[0].term):
        best = max(own, key=lambda s: s.log_evidence)
        columns += _refined(every, best).columns if best.columns[0].shape else ()
    sums = [(k, s) for k, s in Sums(every, columns).best() if not s.has_names]
    tops = [next((s for k, s in sums if len(k) == size), None) for size in range(1, MOST_TERMS + 1)]
    refined = [_weighed(every, _refined(every, s)) for s in tops if s is not None]
    refined.sort(key=lambda s: -s.log_evidence)
    least = refined[0].log_evidence - INDISTINGUISHABLE
    return [s for s in refined if s.log_evidence > least]


def _bends(found: Sum) -> np.ndarray:
    """(HEIGHTS, b) what a change of each shape of a sum does to its curve, at the shape's prior
    width."""
    bends = np.zeros((HEIGHTS, sum(len(c.shape) for c in found.columns)))
    for bend, step in zip(bends.T, _STEP * np.eye(bends.shape[1]), strict=True):
        bend[:] = found.moved(step).heights - found.moved(-step).heights
    return SHAPE * bends / (2 * _STEP)


def _refined(every: Every, found: Sum) -> Sum:
    """The sum with its shapes where its evidence is highest (Gauss and Newton's method)."""
    best, here, share = None, found, 1.0
    move = np.zeros(sum(len(c.shape) for c in found.columns))
    for _ in range(_ITERATIONS):
        sums = Sums(every, here.columns, _bends(here))
        (here,) = sums.of([tuple(range(len(found.columns)))])
        if best is None or here.log_evidence > best.log_evidence:
            best, share = here, 1.0
            _, mean, _ = subset(sums.rests[0], np.arange(sums.rests.shape[-1] - 1))
            move = np.clip(SHAPE * mean[len(found.strengths) :], -_FURTHEST, _FURTHEST)
        else:
            share *= 0.5
        if np.max(np.abs(share * move), initial=0.0) < _STEP:
            break
        here = best.moved(share * move)
    return found if best is None else best


def _weighed(every: Every, found: Sum) -> Sum:
    """The sum with the evidence that an effect has, each shape known to an e-fold."""
    sums = Sums(every, found.columns, _bends(found), None)
    gain, _, _ = subset(sums.rests, np.arange(sums.functions.shape[1]))
    (sign,) = signs(every.along, _among(every.grams[:1], sums.functions))
    return found._replace(log_evidence=log_sum(gain + sums.bases) + found.log_prior + sign)


_LETTERS = "abcdefg"
SYMBOLS = {"angle": "q", "rate": "q'", "time": "t"}
_STRENGTH = {"": "TORQUE", "direction": "TORQUE", "angle": "STIFFNESS", "rate": "DAMPING"}
_SHAPE = {"angle": "ANGLE", "rate": "RATE", "time": "DURATION"}
FACTORS = {"": "", "angle": "q ", "rate": "q' ", "direction": "sign(q') "}


def unit_of(scene: Scene, place: Place) -> str:
    """Of a curve's variable."""
    kind = scene.units[place.joint]
    return {"angle": kind, "rate": f"{kind}/s", "time": "s"}[place.kind.variable]


def written(scene: Scene, place: Place, found: Sum, source: str) -> FoundLaw:
    """A sum of terms as a law that can be written as a class."""
    x0, (variable, factor) = scale_of(place), place.kind
    numbers: list[FoundNumber] = []
    shapes: list[FoundNumber] = []
    code, words, letters = [], [], iter(_LETTERS)
    strengths, unit = iter(found.strengths), unit_of(scene, place)
    taken: dict[str, int] = {}
    for column in found.columns:
        names = {}
        for (name, _), value in zip(column.term.shapes, column.shape, strict=True):
            taken[name] = taken.get(name, 0) + 1
            names[name] = name if taken[name] == 1 else f"{name}{taken[name]}"
            named = names[name], f"{name} of the {column.term.family}", _SHAPE[variable]
            shapes.append(FoundNumber(*named, value, False))
        for part, word in zip(column.term.parts, column.term.words, strict=True):
            letter = next(letters)
            named = letter, f"strength of its {column.term.family}", _STRENGTH[factor]
            numbers.append(FoundNumber(*named, float(next(strengths)), True))
            own = part.format(x0=repr(x0), **{k: f"self.{v}" for k, v in names.items()})
            code.append(f"self.{letter}" if own == "1.0" else f"self.{letter} * {own}")
            said = word.format(x=SYMBOLS[variable], x0=f"{x0:g}")
            for name, own_name in names.items():
                said = said.replace(name, own_name)
            words.append(f"{letter} {said}".strip())
    sums, by = " + ".join(words), FACTORS[factor]
    equation = f"{by}({sums})" if by and len(words) > 1 else f"{by}{sums}"
    if any("{x0}" in part for c in found.columns for part in c.term.parts):
        equation += f" ({SYMBOLS[variable]} in {unit})"
    return FoundLaw(
        scene.joints[place.joint], variable, factor, equation, source,
        tuple(numbers + shapes), " + ".join(code),
    )  # fmt: skip
