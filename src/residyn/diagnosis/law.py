"""A law for what has no name: free curves beside the names, and a formula for the likeliest one.

When the search over names has ended, every free curve is screened beside the best model, beside
those with one name less, and beside none. Those that may have a part in the posterior are iterated
like any other model, and weigh as one more effect. Where one leads, a sum of a few terms is sought
for it; it is accepted if its own nonlinear evidence beats the curve's and it predicts readings that
were held out better than the model without it. Otherwise the curve itself, as a table, is the law.
"""

import dataclasses
import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..effects.found import FoundLaw, FoundNumber
from ..filtering.law import number_slices, numbers_of, of_one_joint
from ..filtering.trajectory import Scene
from ..fitting import FitError
from ..fitting.result import Fit
from ..physics.motion import JointMotion
from .evidence import (
    CONTENDERS,
    IN_PLAY,
    INDISTINGUISHABLE,
    INTENSITIES,
    NEGLIGIBLE,
    log_prior_intensity,
    log_prior_model,
    prior_of,
)
from .forecast import HeldOut, held_out
from .formula import likeliest, written
from .free_curves import Along, Kind, Settled, screen, splines
from .free_curves import settle as settle_curve
from .linearised_fit import LinearisedFit
from .residuals import number
from .search import OutOfTime, Search, Tried, Weighed, settle

GRID = 101
"""Points at which a law is told."""
_TABLE = 21  # of the class of a law without a formula
_NAMED = 3  # named laws drawn through a curve


@dataclasses.dataclass(frozen=True, eq=False)
class CurveModel(Weighed):
    """A model with a free curve, iterated to its evidence."""

    parent: Tried
    settled: Settled
    log_prior: float
    share: float
    """Rms torque of the curve, beyond what springs and dampers take up, over the spring's torque at
    full swing."""

    @property
    def added(self) -> tuple[str, ...]:
        """Names beside it."""
        return self.parent.added

    @property
    def evidences(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleVariableOverride]
        """(I,) log evidence under each random torque."""
        return self.settled.evidences

    @property
    def matters(self) -> bool:
        """Whether its torque is more than what is called negligible."""
        return self.share > NEGLIGIBLE


def curve_models(search: Search) -> list[CurveModel]:
    """Free curves beside the models that a search has found, those that may have a part in the
    posterior."""
    scene, best = search.scene, search.best
    wanted = {frozenset(), frozenset(best.added)}
    wanted |= {frozenset(best.added) - {x} for x in best.added}
    found = []
    for parent in (search.tried[s] for s in wanted if s in search.tried):
        trajectory, intensity = search.screening_motion(parent)
        used = sorted({intensity, 0.1 * intensity, 0.0}, reverse=True)
        prior = log_prior_model(len(parent.added) + 1, len(search.candidates))
        each = screen(Along(scene, trajectory), used)
        found += [(s.log_evidence + prior, parent, prior, s) for s in each[:CONTENDERS]]
    found.sort(key=lambda f: -f[0])
    least = max(best.log_posterior, found[0][0]) - 2 * INDISTINGUISHABLE
    kept = []
    for total, parent, prior, first in found[:CONTENDERS]:
        if total > least:
            trajectory, intensity = search.screening_motion(parent)
            settled = settle_curve(scene, trajectory, first, intensity)
            if settled is not None:
                kept.append(CurveModel(parent, settled, prior, _share(scene, settled)))
    return kept


def _share(scene: Scene, settled: Settled) -> float:
    place, real = settled.place, np.arange(scene.K) < scene.grid.real
    along = Along(scene, settled.trajectory)
    x = along.variable(place.kind.variable, place.joint)[: scene.K][real]
    factor = along.factor(place.kind.factor, place.joint)[: scene.K][real]
    rows = np.asarray(splines(x, place.low, place.high)).T
    value, taken = rows @ settled.mean, _taken(place.kind, x)
    if taken is not None:
        value = value - taken * (taken @ value) / (taken @ taken)
    return float(np.sqrt(np.mean((factor * value) ** 2)) / scene.torque[place.joint])


def _taken(kind: Kind, x: np.ndarray) -> np.ndarray | None:
    """What of a curve springs and dampers are already: a line of the angle or the rate, a constant
    stiffness or damping; nothing of others."""
    if kind.factor in ("angle", "rate"):
        return np.ones_like(x)
    return x if not kind.factor and kind.variable in ("angle", "rate") else None


def _beyond(taken: np.ndarray | None, visits: np.ndarray) -> np.ndarray:
    """(G, G) takes that part away, in the mean over the visits (G,) of each point."""
    eye = np.eye(len(visits))
    if taken is None:
        return eye
    return eye - np.outer(taken, taken * visits) / np.sum(taken**2 * visits)


class Formula(NamedTuple):
    """A formula that was accepted for a law."""

    equation: str
    families: tuple[str, ...]
    """Kinds of its terms: "power", "sine", "exponential", "saturation", "well", "constant"."""
    parameters: dict[str, tuple[float, float, str]]
    """Value, standard error and unit of its numbers, as fitted."""
    log_evidence: float
    """Nats, relative to the free curve's, the choice of terms counted."""

    def to_dict(self) -> dict[str, Any]:
        """Its JSON."""
        each = self.parameters.items()
        return {
            "equation": self.equation,
            "terms": list(self.families),
            "parameters": {
                k: {"value": number(v), "std": number(s), "unit": u} for k, (v, s, u) in each
            },
            "log_evidence": number(self.log_evidence),
        }


@dataclasses.dataclass(frozen=True, eq=False)
class Law:
    """A law that has no name: torque = factor f(variable) at one joint."""

    joint: str
    variable: str
    """"angle", "rate" or "time"."""
    factor: str
    """"angle", "rate", "direction" (of sliding), or none."""
    beside: tuple[str, ...]
    """Named effects that are in the model with it."""
    probability: float
    log_evidence: float
    """Nats, relative to the best model with names only."""
    grid: np.ndarray
    """(G,) of the variable over the visited range."""
    mean: np.ndarray
    """(G,) f, less the line (or the constant) that springs and dampers take up."""
    std: np.ndarray
    """(G,) its standard deviation: the 95 % band is 1.96 of it to either side."""
    visits: np.ndarray
    """(G,) share of the instants at each point of the grid."""
    unit: str
    """Of f."""
    variable_unit: str
    named: tuple[tuple[str, np.ndarray], ...]
    """Named laws of the same variable at the joint, each alone and fitted: label and (G,) values,
    less the same line."""
    formula: Formula | None = None
    found: FoundLaw | None = None
    """The class that it is written as: the formula, or a table; None for all but the likeliest."""
    fit: Fit | None = None
    """With that class, by least squares; None where there is none."""
    held_out: HeldOut | None = None
    """Errors of that fit where it was not fitted."""

    def to_dict(self) -> dict[str, Any]:
        """Its JSON."""
        return {
            "joint": self.joint,
            "variable": self.variable,
            "factor": self.factor or None,
            "beside": list(self.beside),
            "probability": number(self.probability),
            "log_evidence": number(self.log_evidence),
            "grid": [number(x) for x in self.grid],
            "grid_unit": self.variable_unit,
            "mean": [number(x) for x in self.mean],
            "std": [number(x) for x in self.std],
            "unit": self.unit,
            "formula": None if self.formula is None else self.formula.to_dict(),
            "name": None if self.found is None else self.found.label,
        }

    def on_grid(self, values: np.ndarray) -> np.ndarray:
        """(G,) values of f less what springs and dampers take up, as `mean` is."""
        taken = _taken(Kind(self.variable, self.factor), self.grid)
        return _beyond(taken, self.visits) @ values


def laws_of(
    search: Search,
    models: Sequence[CurveModel],
    probabilities: Sequence[float],
    best: float,
    fits: Any,
    source: str,
) -> tuple[Law, ...]:
    """The laws that curve models speak of, of probability `IN_PLAY` at least, the likeliest first;
    where it has most of the posterior, with its formula or table. `best` is the log evidence of
    the best model with names only; `fits` is `diagnose.Fits`."""
    groups: dict[Any, list[int]] = {}
    for i, m in enumerate(models):
        if m.matters:
            groups.setdefault(m.settled.place.key, []).append(i)
    found = []
    for each in groups.values():
        p = float(sum(probabilities[i] for i in each))
        top = max((models[i] for i in each), key=lambda m: m.log_posterior)
        if p >= IN_PLAY:
            found.append((p, top))
    found.sort(key=lambda f: -f[0])
    laws = [_law(search, top, p, best) for p, top in found]
    if laws and found[0][0] > 0.5:
        laws[0] = _with_class(search, found[0][1], laws[0], fits, source)
    return tuple(laws)


def _law(search: Search, model: CurveModel, probability: float, best: float) -> Law:
    scene, place = search.scene, model.settled.place
    along = Along(scene, model.settled.trajectory)
    real = np.arange(scene.K) < scene.grid.real
    x = along.variable(place.kind.variable, place.joint)[: scene.K][real]
    grid = np.linspace(place.low, place.high, GRID)
    nearest = np.clip(np.rint((x - place.low) / (grid[1] - grid[0])).astype(int), 0, GRID - 1)
    visits = np.bincount(nearest, minlength=GRID) / len(nearest)
    rows = _beyond(_taken(place.kind, grid), visits)
    rows = rows @ np.asarray(splines(grid, place.low, place.high)).T
    variance = np.einsum("gi,ij,gj->g", rows, model.settled.covariance, rows)
    units = scene.mechanisms[0].units
    kind = units[place.joint] if units else "rad"
    torque = "N" if kind == "m" else "N m"
    by = {"angle": f"/{kind}", "rate": f" s/{kind}"}
    law = Law(
        joint=scene.joints[place.joint],
        variable=place.kind.variable,
        factor=place.kind.factor,
        beside=model.added,
        probability=probability,
        log_evidence=model.log_evidence - best,
        grid=grid,
        mean=rows @ model.settled.mean,
        std=np.sqrt(np.maximum(variance, 0.0)),
        visits=visits,
        unit=torque + by.get(place.kind.factor, ""),
        variable_unit={"angle": kind, "rate": f"{kind}/s", "time": "s"}[place.kind.variable],
        named=(),
    )
    return dataclasses.replace(law, named=_named(search, law))


def _named(search: Search, law: Law) -> tuple[tuple[str, np.ndarray], ...]:
    """Named laws of the curve's variable at its joint, each alone, the likeliest first."""
    if law.factor or law.variable == "time":
        return ()
    alone = [m for m in search.tried.values() if len(m.added) == 1]
    found = []
    for model in sorted(alone, key=lambda m: -m.log_posterior):
        t = model.best
        effect = t.valued()[t.labels.index(model.added[0])]
        if not of_one_joint(effect) or effect.joint != law.joint or effect.memory:
            continue
        torques = []
        for x in law.grid:
            q, v = (x, 0.0) if law.variable == "angle" else (0.0, x)
            torques.append(float(effect.joint_torque(JointMotion(0.0, q, v, np.sign(v), (), q))))
        values = law.on_grid(np.array(torques))
        if np.ptp(values) > 0:
            found.append((model.added[0], values))
    return tuple(found[:_NAMED])


# -- its class -------------------------------------------------------------------------------------


def _with_class(search: Search, model: CurveModel, law: Law, fits: Any, source: str) -> Law:
    """The law with its formula, or with a table where none was accepted."""
    scene, settled = search.scene, model.settled
    along = Along(scene, settled.trajectory)
    each = []
    for terms in likeliest(along, settled):
        found = written(scene, settled.place, terms, source)
        tried = _tried(search, model, found)
        if tried is not None:
            each.append((tried.log_evidence + terms.log_prior, terms, found, tried))
    evidence, terms, found, tried = max(each, key=lambda f: f[0], default=(-np.inf, *[None] * 3))
    if evidence > model.log_evidence and terms and found and tried:
        fit, held = _fitted(fits, tried)
        before = _fitted(fits, model.parent)[1]
        if fit is not None and _predicts(held, before):
            parameters = {
                n.name.rpartition(".")[2]: (float(n.value), float(n.std), n.unit)
                for n in fit.numbers
                if n.name.rpartition(".")[0] == found.label
            }
            numbers = (n._replace(value=parameters[n.field][0]) for n in found.numbers)
            found = found._replace(numbers=tuple(numbers))
            more = evidence - model.log_evidence
            formula = Formula(found.equation, terms.families, parameters, more)
            return dataclasses.replace(law, formula=formula, found=found, fit=fit, held_out=held)
    found = _tabulated(law, source)
    tried = _tried(search, model, found)
    fit, held = (None, None) if tried is None else _fitted(fits, tried)
    return dataclasses.replace(law, found=found, fit=fit, held_out=held)


def _tried(search: Search, model: CurveModel, found: FoundLaw) -> Tried | None:
    """The model with the class in the curve's place, iterated to its evidence."""
    scene, before = search.scene, model.settled.trajectory
    effect: Any = found.kind()(found.joint)  # pyright: ignore[reportCallIssue]
    effects = (*model.parent.best.effects, effect)
    prior = prior_of(scene, effects)
    first = number_slices(effects)[-1]
    numbers = np.array(prior.mean)
    numbers[first] = [float(getattr(effect, n.field)) for n in numbers_of(effect)]
    u = np.zeros(scene.regressors(effects))
    u[: first.start] = before.u[: first.start]
    u[first] = prior.regressors(numbers)[first]
    start = dataclasses.replace(before, effects=effects, prior=prior, u=u)
    logs = model.settled.evidences + log_prior_intensity(INTENSITIES)
    loudest = INTENSITIES[max(int(np.argmax(logs)) - 2, 0)]
    try:
        (ended,) = settle(scene, [start], loudest, search.deadline)
    except OutOfTime:
        return None
    if ended is None:
        return None
    return Tried((*model.added, found.label), *ended, model.log_prior)


def _fitted(fits: Any, tried: Tried) -> tuple[Fit | None, HeldOut | None]:
    try:
        fit = fits.of(tried)
    except FitError:
        return None, None
    return fit, held_out(LinearisedFit.of(fit))


def _predicts(with_it: HeldOut | None, without: HeldOut | None) -> bool:
    """Whether held-out readings are predicted better with a law than without it."""
    if with_it is None:
        return False
    if without is None:
        return True
    after, before = (np.nansum(h.held_out.ratio**2) for h in (with_it, without))
    return bool(after < before)


def _tabulated(law: Law, source: str) -> FoundLaw:
    """The curve as a table."""
    x = np.linspace(law.grid[0], law.grid[-1], _TABLE)
    y = np.interp(x, law.grid, law.mean)
    rows = ", ".join(f"{v:.5g}" for v in x), ", ".join(f"{v:.4g}" for v in y)
    at, values = (
        textwrap.fill(row, 84, initial_indent=" " * 12, subsequent_indent=" " * 12) for row in rows
    )
    call = f"jnp.interp(\n            x, jnp.array([\n{at}\n            ]), jnp.array([\n{values}"
    number_of_it = FoundNumber("scale", "its size, 1 as found", "RATIO", 1.0, True)
    symbol = {"angle": "q", "rate": "q'", "time": "t"}[law.variable]
    by = {"angle": "q ", "rate": "q' ", "direction": "sign(q') "}.get(law.factor, "")
    return FoundLaw(
        law.joint, law.variable, law.factor, f"scale {by}f({symbol}), f a table", source,
        (number_of_it,), f"self.scale * {call}\n            ]))",
    )  # fmt: skip
