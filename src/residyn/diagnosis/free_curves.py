"""A law without a name: a free curve of one variable, as columns of the same filter.

A torque f(x) of the angle, the rate or time, or such a curve times the angle, the rate or the
direction of sliding, is a sum of cubic B-splines. Their heights have a Gaussian process prior
(squared exponential; any curve, an odd or an even one), so along a motion each spline is a column,
and the evidence of the curve is that of a linear Gaussian model (Rasmussen, Williams, Gaussian
Processes for Machine Learning, 2006, ch. 2 and 5). Amplitude and length are summed over. A curve
contains every named law of its variable; it pays for that freedom in its evidence, as any model
does.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag
from scipy.sparse import csr_array
from scipy.special import softmax

from ..filtering.free_curve import HEIGHTS, FreeCurve, FreeFriction
from ..filtering.kalman import Torques, gram
from ..filtering.linearised import Instants, nodes
from ..filtering.trajectory import Scene, Trajectory
from ..runtime.export_cache import kept
from ..runtime.parallel import side_by_side
from .columns import responses
from .evidence import (
    AMPLITUDES,
    CURVE_LENGTHS,
    FALL,
    INTENSITIES,
    NEGLIGIBLE,
    SETTLED,
    conditional,
    gram_factor,
    log_prior_intensity,
    log_sum,
    non_normal_priors,
    prior_sizes,
)
from .iteration import gain_of_torque_times
from .tried import Tried

SPLINES = 32
"""Of one curve."""
_ROOMS = 48, 128, 256
"""Columns of one pass of the filter: of one curve or formula, of several curves, of every function
of a variable. A compiled program for each."""
_AT_ONCE = 4  # curves in one pass
_ITERATIONS = 8
_NEAR = 3  # random torques looked at in an iteration
_LIGHT = 1e-3  # posterior of a prior's width and length below which it is left out of the band


class Kind(NamedTuple):
    """What a curve is of: torque = factor f(variable)."""

    variable: str
    """"angle", "rate" or "time"."""
    factor: str = ""
    """"angle", "rate", "direction" (of sliding), or none."""

    @property
    def family(self) -> str | None:
        """What the catalogue calls laws of this kind; None where it has several."""
        if self.factor:
            names = {"direction": "dry friction", "rate": "damping law", "angle": "stiffness drift"}
            return names[self.factor]
        return "spring shape" if self.variable == "angle" else None


KINDS = (
    Kind("angle"),
    Kind("rate"),
    Kind("time"),
    Kind("angle", "rate"),
    Kind("angle", "direction"),
    Kind("time", "angle"),
    Kind("time", "rate"),
    Kind("time", "direction"),
)
"""All that are tried at each joint: a torque; a damping and a friction that change with the angle;
a stiffness, a damping and a friction that change with time."""


def splines(x: np.ndarray, low: float, high: float, count: int = SPLINES) -> csr_array:
    """(N, count) values at x (N,) of cubic B-splines that cover low to high, four of them not 0."""
    at = np.clip((x - low) / (high - low), 0.0, 1.0) * (count - 3)
    return BSpline.design_matrix(at, np.arange(-3.0, count + 1.0), 3)


@functools.cache
def _fine() -> np.ndarray:
    """(HEIGHTS, 2 HEIGHTS) makes heights of values at `points`."""
    return np.linalg.pinv(splines(points(0.0, 1.0), 0.0, 1.0, HEIGHTS).toarray())


def points(low: float, high: float) -> np.ndarray:
    """(2 HEIGHTS,) where a function is told for its heights."""
    return np.linspace(low, high, 2 * HEIGHTS)


def heights_of(values: np.ndarray) -> np.ndarray:
    """(HEIGHTS, ...) of functions with values (2 HEIGHTS, ...) at `points`."""
    return _fine() @ values


@functools.cache
def _finer() -> np.ndarray:
    """(HEIGHTS, SPLINES) heights of each spline of a free curve."""
    return heights_of(splines(points(0.0, 1.0), 0.0, 1.0).toarray())


@kept(like=(0, 0, 0, 0, 0), seldom=True)
def _along(instants: Instants, path, spread, held, by_x, by_torque, sliding):
    """Angles, rates, times and directions at the nodes, and (K, 3, X, n) `responses`."""
    at = nodes(instants, path, spread, held)
    direction = jax.scipy.special.erf(at.v / (math.sqrt(2) * at.spread))
    direction = jnp.where(jnp.abs(sliding) < 1, sliding, direction)
    return at.q, at.v, at.time, direction, responses(instants, by_x, by_torque)


class Along:
    """A model's motion, for columns of functions of it."""

    def __init__(self, scene: Scene, t: Trajectory):
        self.scene, self.trajectory, self.linear = scene, t, scene.linearised(t)
        _, table = scene.tabulated(t)
        found = _along(
            scene.instants, t.path, t.spread, table.held,
            self.linear.by_x, self.linear.by_torque, self.linear.direction,
        )  # fmt: skip
        self.q, self.v, self.time, self.direction, self._answers = map(np.asarray, found)
        n, K, orders = scene.n, scene.K, np.array(scene.orders or (0,) * scene.n)
        # What a torque adds at once to a reading: to an acceleration.
        pushed = np.asarray(self.linear.by_torque)[n : 2 * n, :, :K].transpose(2, 0, 1)
        self._pushed = pushed * (orders == 2)[:, None]
        self.real = np.tile(scene.real, 3)
        self._squares: dict[tuple[Place, int], np.ndarray] = {}

    def variable(self, name: str, joint: int) -> np.ndarray:
        """(3 K,) a variable at the beginnings, middles and ends of the steps."""
        return {"angle": self.q[joint], "rate": self.v[joint], "time": self.time}[name]

    def factor(self, name: str, joint: int) -> np.ndarray:
        """(3 K,) what a curve is multiplied by."""
        each = {"angle": self.q, "rate": self.v, "direction": self.direction}
        return each[name][joint] if name else np.ones(self.q.shape[1])

    def squares(self, place: "Place", count: int) -> np.ndarray:
        """(count, count) mean over the motion of the products of torques, of splines over a place's
        range: h' squares h is the mean square of the torque of a curve with heights h."""
        if (place, count) not in self._squares:
            x, factor = self.visited(place)
            each = splines(x, place.low, place.high, count)
            weighed = factor[:, None] ** 2 * each.toarray()
            self._squares[place, count] = each.T @ weighed / len(x)
        return self._squares[place, count]

    def visited(self, place: "Place") -> tuple[np.ndarray, np.ndarray]:
        """A curve's variable and its factor, all over the motion."""
        x = self.variable(place.kind.variable, place.joint)
        return x[self.real], self.factor(place.kind.factor, place.joint)[self.real]

    def typical(self, place: "Place") -> float:
        """Rms of a torque that is as large as the spring's at full swing, N m."""
        return float(self.scene.torque[place.joint]) / math.sqrt(2.0)

    def span(self, variable: str, joint: int) -> tuple[float, float]:
        """The visited range of a variable."""
        x = self.variable(variable, joint)[self.real]
        return float(x.min()), float(x.max())

    def gram(
        self, places: "Sequence[Place]", functions: Sequence[np.ndarray],
        intensities: Sequence[float] | np.ndarray, held: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """(I,) log normalisers, and the (I, 1 + P + C, 1 + P + C) Gram matrices of whitened
        innovations with functions (HEIGHTS, C / G) of each of G places at one joint. The model may
        hold a curve of the first place already, of heights `held`: it is taken away."""
        j, K, C = places[0].joint, self.scene.K, sum(f.shape[1] for f in functions)
        if held is not None:
            places, functions = [*places, places[0]], [*functions, held[:, None]]
        torques = [
            self.factor(place.kind.factor, j)[:, None]
            * (splines(self.variable(place.kind.variable, j), place.low, place.high, HEIGHTS) @ f)
            for place, f in zip(places, functions, strict=True)
        ]
        torque = np.concatenate(torques, axis=1)
        room = next(r for r in _ROOMS if r >= torque.shape[1])
        torque = np.pad(torque, ((0, 0), (0, room - torque.shape[1])))
        more = Torques(
            self._answers[..., j : j + 1], self._pushed[..., j : j + 1],
            (torque.reshape(3, K, room).swapaxes(0, 1),),
            np.zeros((K, 3, 1, 0)), np.zeros((K, self.scene.n, 0)),
        )  # fmt: skip
        args = self.linear.system, (more,), self.scene.readings
        noise = self.scene.noise(self.trajectory)
        found = [gram(*args, noise, np.asarray(x, float)) for x in intensities]
        first = 1 + len(self.trajectory.u)
        move = np.eye(first + room)[:, : first + C]
        if held is not None:
            move[first + C, 0] = -1.0
        return np.array([t for t, _ in found]), np.stack(
            [move.T @ np.asarray(g) @ move for _, g in found]
        )


class Place(NamedTuple):
    """A free curve to be found: what of, at which joint, over which range."""

    kind: Kind
    joint: int
    low: float
    high: float

    def taken(self, x: np.ndarray) -> np.ndarray | None:
        """What of a curve springs and dampers are already: a line of the angle or the rate, a
        constant stiffness or damping; nothing of others."""
        if self.kind.factor in ("angle", "rate"):
            return np.ones_like(x)
        return x if not self.kind.factor and self.kind.variable in ("angle", "rate") else None

    def beyond(self, values: np.ndarray, x: np.ndarray, visits: Any = 1.0) -> np.ndarray:
        """Values (G, ...) of curves at x (G,), less what springs and dampers are already, in the
        mean over the visits (G,) of each point."""
        taken = self.taken(x)
        if taken is None:
            return values
        share = (visits * taken) @ values / np.sum(visits * taken**2)
        return values - np.multiply.outer(taken, share)

    def effect(self, scene: Scene, heights: np.ndarray) -> FreeCurve:
        """The curve with these heights (HEIGHTS,)."""
        made = FreeFriction if self.kind.factor == "direction" else FreeCurve
        variable = np.array([self.kind.variable == x for x in ("angle", "rate", "time")], float)
        factor = np.array([self.kind.factor == x for x in ("angle", "rate")], float)
        factor = np.append(factor, 1.0 - factor.sum())
        data = variable, factor, self.low, self.high, heights
        return made(scene.joints[self.joint], *(np.asarray(x, float) for x in data))


def _priors(along: Along, place: Place) -> np.ndarray:
    """(H, SPLINES, SPLINES) square roots of the covariance of heights for each size, length and
    parity, less what springs and dampers have of a curve already."""
    # Where each spline is highest: a line's values there are its heights.
    step, found = (place.high - place.low) / (SPLINES - 3), []
    at = place.low + step * np.arange(-1, SPLINES - 1)
    for length in CURVE_LENGTHS:
        width = length * (place.high - place.low)
        near, far = (np.exp(-0.5 * ((at[:, None] - s * at) / width) ** 2) for s in (1, -1))
        # Any curve; its odd part; its even part (Duvenaud, PhD thesis, Cambridge 2014, ch. 2).
        for covariance in (near, 0.5 * (near - far), 0.5 * (near + far)):
            e, vectors = np.linalg.eigh(covariance)
            found.append(vectors * np.sqrt(np.maximum(e, 0.0)))
    roots, squares, line = np.stack(found), along.squares(place, SPLINES), place.taken(at)
    if line is not None:
        share = line @ squares @ roots / (line @ squares @ line)
        roots = roots - line[:, None] * share[:, None]
    rms = np.sqrt(np.einsum("hij,ik,hkj->h", roots, squares, roots))
    roots = along.typical(place) / rms[:, None, None] * roots
    return np.concatenate([a * roots for a in AMPLITUDES])


class Posterior(NamedTuple):
    """A free curve beside a model, given the readings."""

    evidences: np.ndarray  # (I,) log evidence of model and curve under each random torque
    mean: np.ndarray  # (SPLINES,) heights
    covariance: np.ndarray  # (SPLINES, SPLINES)
    roots: np.ndarray
    """(H, SPLINES, SPLINES) `_priors` along the motion that it was screened along: a prior that
    followed the iterated motion would be none."""

    @property
    def heights(self) -> np.ndarray:
        """(HEIGHTS,) of the mean."""
        return _finer() @ self.mean

    def beside(
        self, along: "Along", place: "Place", intensities: Sequence[float] | np.ndarray
    ) -> "Posterior":
        """The curve beside a model that holds it as it is here already."""
        totals, grams = along.gram([place], [_finer()], intensities, self.heights)
        return _posterior(along, self.roots, intensities, totals, grams)


def _mixed(weights, means, covariances) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of a mixture."""
    mean = np.tensordot(weights, means, 1)
    off = means - mean
    return mean, np.tensordot(weights, covariances + off[:, :, None] * off[:, None, :], 1)


@np.errstate(invalid="ignore")  # where a motion has run away nothing is finite
def _posterior(along: Along, roots: np.ndarray, intensities, totals, grams) -> Posterior:
    P = len(along.trajectory.u)
    each_of = len(roots) // len(AMPLITUDES)
    prior = np.repeat(np.log(prior_sizes(AMPLITUDES) / each_of), each_of)
    bases, rests = conditional(grams, P)
    evidences, each = [], []
    for known, square, rest in zip(totals + bases, grams, rests, strict=True):
        factor = gram_factor(roots.mT @ rest[1:, 1:] @ roots + np.eye(SPLINES))
        x = np.linalg.solve(factor, -(roots.mT @ rest[1:, :1]))
        gains = prior + 0.5 * np.sum(x[..., 0] ** 2, -1)
        gains -= np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
        weights = softmax(gains)
        keep = weights > _LIGHT
        heights = (roots[keep] @ np.linalg.solve(factor[keep].mT, x[keep]))[..., 0]
        spread = np.linalg.solve(factor[keep], roots[keep].mT)
        spread = spread.mT @ spread
        mean, covariance = _mixed(weights[keep] / weights[keep].sum(), heights, spread)
        scale = np.asarray(block_diag(np.eye(1 + P), roots[np.argmax(gains)]))
        (sign,) = signs(along, (scale.T @ square @ scale)[None])
        evidences.append(known + log_sum(gains) + sign)
        each.append((mean, covariance))
    evidences = along.scene.possible(np.array(evidences))
    weights = softmax(evidences + log_prior_intensity(intensities))
    means, covariances = (np.stack(x) for x in zip(*each, strict=True))
    return Posterior(evidences, *_mixed(weights, means, covariances), roots)


def signs(along: Along, grams: np.ndarray) -> np.ndarray:
    """(I,) what the priors of the model's own numbers add to the log evidence, beside some columns
    at their prior's width; `grams` (I, 1 + P + C, 1 + P + C) are of both."""
    P = len(along.trajectory.u)
    factor = gram_factor(grams[:, 1:, 1:] + np.eye(grams.shape[-1] - 1))
    inverse = np.linalg.inv(factor)
    mean = -(inverse.mT @ inverse @ grams[:, 1:, :1])[..., 0]
    covariance = inverse.mT @ inverse
    t = along.trajectory
    return non_normal_priors(t.effects, t.prior, mean[:, :P], covariance[:, :P, :P])


class Screened(NamedTuple):
    """A free curve beside a model, to first order."""

    place: Place
    log_evidence: float  # random torques summed over
    posterior: Posterior


def screen(along: Along, intensities: Sequence[float]) -> list[Screened]:
    """Every free curve beside a model, to first order, the best first."""
    P = len(along.trajectory.u)

    def screened(joint: int, kinds: Sequence[Kind]) -> list[Screened]:
        places = [Place(kind, joint, *along.span(kind.variable, joint)) for kind in kinds]
        totals, grams = along.gram(places, [_finer()] * len(places), intensities)
        found = []
        for i, place in enumerate(places):
            own = 1 + P + SPLINES * i
            keep = np.r_[0 : 1 + P, own : own + SPLINES]
            each = grams[:, keep[:, None], keep]
            post = _posterior(along, _priors(along, place), intensities, totals, each)
            logs = post.evidences + log_prior_intensity(intensities)
            found.append(Screened(place, log_sum(logs), post))
        return found

    parts = [KINDS[k : k + _AT_ONCE] for k in range(0, len(KINDS), _AT_ONCE)]
    every = itertools.product(range(along.scene.n), parts)
    found = side_by_side([functools.partial(screened, *each) for each in every])
    return sorted(itertools.chain(*found), key=lambda s: -s.log_evidence)


def compile_screen(scene: Scene, t: Trajectory) -> None:
    """Compile what `screen` runs, by running it once along a motion."""
    along = Along(scene, t)
    place = Place(KINDS[0], 0, *along.span(KINDS[0].variable, 0))
    along.gram([place] * _AT_ONCE, [_finer()] * _AT_ONCE, [0.0])


@dataclasses.dataclass(frozen=True, eq=False)
class CurveModel(Tried):
    """A model with a free curve, iterated to its evidence; `added` are the names beside it, `best`
    is its motion with the curve in it."""

    place: Place
    curve: Posterior
    held: np.ndarray  # (HEIGHTS,) heights that `best` has
    share: float
    """Rms torque of the curve, beyond what springs and dampers take up, over the spring's torque at
    full swing."""
    formulas: tuple[Any, ...] = ()
    """`formula.Sum`s that say the same, where they were weighed, to first order."""

    @property
    def log_evidence(self) -> float:
        """Of curve and formulas, which have half of the prior each; of the curve, where no formula
        was weighed."""
        curve = super().log_evidence
        if not self.formulas:
            return curve
        return log_sum([curve, *(s.log_evidence for s in self.formulas)]) - math.log(2.0)

    @property
    def matters(self) -> bool:
        """Whether its torque is more than what is called negligible."""
        return self.share > NEGLIGIBLE


class Settled(NamedTuple):
    """A model and a law, iterated to their motion."""

    evidences: np.ndarray  # (I,)
    best: Trajectory  # with the law in it
    law: Any  # as it is in `best`
    found: Any  # the law, along that motion


def settle(
    scene: Scene, start: Trajectory, place: Place, law: Any, loudest: float
) -> Settled | None:
    """Iterate a model and a law to their motion: law and evidences along the motion, then the
    motion with that law. `law` is a `Posterior`, or a `formula.Sum`. None if it runs away."""
    level = next(k for k, x in enumerate(INTENSITIES) if x <= loudest)
    before, prior, t = -math.inf, log_prior_intensity(INTENSITIES), start
    for turn in range(_ITERATIONS):
        t = with_curve(scene, t, place, law.heights)
        t = scene.smoothed(t, scene.linearised(t), INTENSITIES[level])
        if t is None:
            return None
        along = Along(scene, t)
        near = np.arange(max(level - 1, 0), min(level + _NEAR, len(INTENSITIES)))
        found = law.beside(along, place, np.array(INTENSITIES)[near])
        likeliest = int(near[np.argmax(found.evidences + prior[near])])
        here = float(found.evidences.max())
        if not np.isfinite(here):
            return None
        if turn == _ITERATIONS - 1 or (likeliest == level and abs(here - before) < SETTLED):
            found = law.beside(along, place, INTENSITIES)
            more = gain_of_torque_times(scene, t, along.linear, found.evidences)
            return Settled(found.evidences + more, t, law, found)
        level, before, law = min(likeliest, level + FALL), here, found
    return None


def with_curve(scene: Scene, t: Trajectory, place: Place, heights: np.ndarray) -> Trajectory:
    """A model with this curve, instead of the one that it has."""
    own = [e for e in t.effects if not isinstance(e, FreeCurve)]
    return dataclasses.replace(t, effects=(*own, place.effect(scene, heights)))


def settled_curve(
    scene: Scene, added: tuple[str, ...], start: Trajectory, place: Place, curve: Posterior,
    loudest: float, log_prior: float,
) -> CurveModel | None:  # fmt: skip
    """A model and a free curve, iterated to its evidence; None if it runs away."""
    settled = settle(scene, start, place, curve, loudest)
    if settled is None or not np.isfinite(settled.evidences).any():
        return None
    evidences, best, held, found = settled
    share = _share(Along(scene, best), place, found.mean)
    return CurveModel(added, evidences, best, log_prior, place, found, held.heights, share)


def _share(along: Along, place: Place, heights: np.ndarray) -> float:
    x, factor = along.visited(place)
    value = place.beyond(splines(x, place.low, place.high) @ heights, x)
    return float(np.sqrt(np.mean((factor * value) ** 2)) / along.scene.torque[place.joint])
