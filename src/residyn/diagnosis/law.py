"""A law for what has no name: free curves beside the names, and a formula for the likeliest one.

When the search over names has ended, every free curve is screened beside the best model, beside
those with one name less, and beside none, whether or not names explain the readings. Those that may
have a part in the posterior are iterated like any other model, beside fewer and fewer names, and
weigh as one more effect, each with the sums of a few terms that say the same. The leading curve's
formula is accepted if its own nonlinear evidence beats the curve's and it predicts readings that
were held out better than the model without it. Otherwise the curve itself, as a table, is the law.
"""

import dataclasses
import datetime
import functools
import math
import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..effects.found import FoundLaw, FoundNumber
from ..filtering.free_curve import FreeCurve
from ..filtering.law import number_slices, numbers_of, of_one_joint
from ..filtering.trajectory import Scene, Trajectory
from ..fitting import FitError
from ..physics.motion import JointMotion
from ..runtime.json import number
from ..runtime.parallel import side_by_side
from .columns import with_effects, without
from .evidence import (
    CONTENDERS,
    FURTHER,
    HOPELESS,
    IN_PLAY,
    INTENSITIES,
    OUTSIDE,
    READINGS_LEAD,
    over_intensities,
)
from .forecast import ModelState, held_out
from .formula import FACTORS, SYMBOLS, likeliest, unit_of, written
from .free_curves import (
    KINDS,
    Along,
    CurveModel,
    Kind,
    Place,
    Posterior,
    heights_of,
    points,
    screen,
    settle,
    settled_curve,
    splines,
    with_curve,
)
from .search import Search
from .tried import Tried, screened_at, screening_motion, silenced

GRID = 101
"""Points at which a law is told."""
_TABLE = 21  # of the class of a law without a formula
_NAMED = 3  # named laws drawn through a curve


def curve_models(search: Search) -> list[CurveModel]:
    """Free curves beside the models that a search has found, those that may have a part in the
    posterior.

    **Raises:** `search.OutOfTime` after the search's deadline.
    """
    scene, best = search.scene, search.best

    def prior_of(parent: Tried) -> float:
        """One more effect, which is in no catalogue, and any of the curves."""
        return parent.log_prior + math.log(FURTHER * OUTSIDE / (len(KINDS) * scene.n))

    own, few = frozenset(best.added), []
    wanted = dict.fromkeys([frozenset(), own, *(own - {x} for x in best.added)])
    for parent in (search.tried[s] for s in wanted if s in search.tried):
        search.in_time()
        trajectory, intensity = screening_motion(scene, parent)
        prior = prior_of(parent)
        # Where little is left, the first order is right, and by it most curves have no part; where
        # no model explains the readings, a curve that does may be far from it at first order.
        behind = HOPELESS if best.complete > 0.5 else math.inf
        if parent.complete > 0.5:
            behind = -math.log(IN_PLAY)
        # One beside names, which may be there in its place.
        each = screen(Along(scene, trajectory), screened_at(intensity))
        each = each[: 1 if parent.added else CONTENDERS]
        least = max(best.log_posterior - behind - prior, each[0].log_evidence - HOPELESS)
        few += [
            (parent, trajectory, s.place, s.posterior, intensity)
            for s in each if s.log_evidence > least
        ]  # fmt: skip

    def settled(
        parent: Tried, start: Trajectory, place: Place, curve: Posterior, loudest: float
    ) -> CurveModel | None:
        search.in_time()
        prior = prior_of(parent)
        model = settled_curve(scene, parent.added, start, place, curve, loudest, prior)
        if model is None:
            return None
        # The law that has a simple formula is the likelier one.
        formulas = tuple(likeliest(Along(scene, model.best), model))
        return dataclasses.replace(model, formulas=formulas)

    models: list[CurveModel] = []
    begun, todo = 0, few
    # Whether a name is at work beside a curve shows beside the curve without it.
    known: set[tuple[Kind, int, frozenset[str]]] = set()
    while todo:
        each = side_by_side([functools.partial(settled, *start) for start in todo])
        models += [model for model in each if model is not None]
        known |= {(m.place.kind, m.place.joint, frozenset(m.added)) for m in models}
        top, todo = max(m.log_posterior for m in (best, *models)), []
        for model in models[begun:]:
            for x in model.added if model.log_posterior > top + math.log(IN_PLAY) else ():
                rest = frozenset(model.added) - {x}
                key = model.place.kind, model.place.joint, rest
                if key not in known and rest in search.tried:
                    known.add(key)
                    law = model.place, model.curve, max(model.intensity, READINGS_LEAD)
                    todo.append((search.tried[rest], without(scene, model.best, x), *law))
        begun = len(models)
    return models


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
    model: ModelState | None = None
    """With that class, by least squares; None where no fit was found."""

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
            "fitted": None if self.model is None else self.model.to_dict(),
        }

    def values(self, effect: Any) -> np.ndarray:
        """(G,) f of an effect at the joint, less what springs and dampers take up, as `mean` is."""
        found = []
        for x in self.grid:
            at = {"time": 0.0, "angle": 0.0, "rate": 0.0, self.factor: 1.0, self.variable: x}
            direction = np.sign(x) if self.variable == "rate" else 1.0
            motion = JointMotion(at["time"], at["angle"], at["rate"], direction, (), at["angle"])
            found.append(float(effect.joint_torque(motion)))
        return self.on_grid(np.array(found))

    def on_grid(self, values: np.ndarray) -> np.ndarray:
        """(G,) values of f less what springs and dampers take up, as `mean` is."""
        place = Place(Kind(self.variable, self.factor), 0, self.grid[0], self.grid[-1])
        return place.beyond(values, self.grid, self.visits)


def laws_of(
    search: Search, models: Sequence[float], laws: Sequence[float], best: float, fits: Any
) -> tuple[Law, ...]:
    """The laws that a search's curves speak of, of probability `IN_PLAY` at least, the likeliest
    first; where its model has most of the posterior, with its formula or table. `models`: the
    posterior of each curve's model, `laws`: the probability that there is its law; `best` is the
    log evidence of the best model with names only; `fits` is `diagnose.Fits`."""
    groups: dict[Any, list[tuple[CurveModel, float, float]]] = {}
    for model, p, law in zip(search.curves, models, laws, strict=True):
        if model.matters:
            groups.setdefault((model.place.kind, model.place.joint), []).append((model, p, law))
    found = []
    for each in groups.values():
        own, p, law = zip(*each, strict=True)
        found.append((sum(law), sum(p), max(own, key=lambda m: m.log_posterior)))
    found = sorted((f for f in found if f[0] >= IN_PLAY), key=lambda f: -f[0])
    told = [_law(search, top, law, best) for law, _, top in found]
    if told and found[0][1] > 0.5:
        told[0] = _with_class(search, found[0][2], told[0], fits)
    return tuple(told)


def _law(search: Search, model: CurveModel, probability: float, best: float) -> Law:
    scene, place = search.scene, model.place
    along = Along(scene, model.best)
    x = along.variable(place.kind.variable, place.joint)[: scene.K][scene.real]
    grid = np.linspace(place.low, place.high, GRID)
    nearest = np.clip(np.rint((x - place.low) / (grid[1] - grid[0])).astype(int), 0, GRID - 1)
    visits = np.bincount(nearest, minlength=GRID) / len(nearest)
    rows = place.beyond(splines(grid, place.low, place.high).toarray(), grid, visits)
    variance = np.einsum("gi,ij,gj->g", rows, model.curve.covariance, rows)
    kind = scene.units[place.joint]
    by = {"angle": f"/{kind}", "rate": f" s/{kind}"}.get(place.kind.factor, "")
    law = Law(
        joint=scene.joints[place.joint],
        variable=place.kind.variable,
        factor=place.kind.factor,
        beside=model.added,
        probability=probability,
        log_evidence=model.log_evidence - best,
        grid=grid,
        mean=rows @ model.curve.mean,
        std=np.sqrt(np.maximum(variance, 0.0)),
        visits=visits,
        unit=scene.torque_units[place.joint] + by,
        variable_unit=unit_of(scene, place),
        named=(),
    )
    return dataclasses.replace(law, named=_named(search, law))


def _named(search: Search, law: Law) -> tuple[tuple[str, np.ndarray], ...]:
    """Named laws of the curve's variable at its joint, each alone, the likeliest first."""
    if law.factor or law.variable == "time":
        return ()
    found = []
    for model in search.singles:
        t = model.best
        effect = t.valued()[t.labels.index(model.added[0])]
        if not of_one_joint(effect) or effect.joint != law.joint or effect.memory:
            continue
        values = law.values(effect)
        if np.ptp(values) > 0:
            found.append((model.added[0], values))
    return tuple(found[:_NAMED])


# -- its class -------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Written(Tried):
    """A model with a law that is written as a class; `best` has it as a curve."""

    found: FoundLaw

    def starts(self, scene: Scene) -> tuple[Trajectory, ...]:
        """The model without a random torque, with the class."""
        t = silenced(scene, self.best, self.intensity)
        effect: Any = self.found.kind()(self.found.joint)  # pyrefly: ignore[bad-argument-count]
        own = [i for i, e in enumerate(t.effects) if not isinstance(e, FreeCurve)]
        t = with_effects(scene, t, own, [effect])
        its = number_slices(t.effects)[t.labels.index(effect.label)]
        numbers = np.array(t.prior.mean)
        numbers[its] = [float(getattr(effect, n.field)) for n in numbers_of(effect)]
        t.u[its] = t.prior.regressors(numbers)[its]
        return (t,)


def _with_class(search: Search, model: CurveModel, law: Law, fits: Any) -> Law:
    """The law with its formula, or with a table where none was accepted."""
    names = [r.name for r in fits.whole.fit_recordings]
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    source = f"found in {names[0]}{more}, {datetime.date.today().isoformat()}"
    scene, parent, place = search.scene, search.tried[frozenset(model.added)], model.place
    curve = over_intensities(model.evidences)
    terms = (model.formulas or likeliest(Along(scene, model.best), model))[0]
    loudest = INTENSITIES[max(INTENSITIES.index(model.intensity) - 2, 0)]
    settled = settle(scene, model.best, place, terms, loudest)

    def of(found: FoundLaw, evidences: np.ndarray, t: Trajectory) -> Written:
        return Written((*model.added, found.label), evidences, t, model.log_prior, found)

    if settled is not None:
        more = over_intensities(settled.evidences) + terms.log_prior - curve
        found = written(scene, place, settled.found, source)
        if more > 0:
            fitted = _fitted(fits, of(found, settled.evidences, settled.best), law)
            parameters = _as_fitted(found, fitted)
            if parameters and _predicts(fitted, _fitted(fits, parent, law)):
                numbers = (n._replace(value=parameters[n.field][0]) for n in found.numbers)
                found = found._replace(numbers=tuple(numbers))
                own = Formula(found.equation, terms.families, parameters, more)
                return dataclasses.replace(law, formula=own, found=found, model=fitted)
    found = _tabulated(law, source)
    values = np.interp(points(place.low, place.high), law.grid, law.mean)
    t = with_curve(scene, model.best, place, heights_of(values))
    fitted = _fitted(fits, of(found, model.evidences, t), law)
    return dataclasses.replace(law, found=found, model=fitted)


def _as_fitted(found: FoundLaw, fitted: ModelState | None) -> dict[str, tuple[float, float, str]]:
    """Value, standard error and unit of a law's numbers; none where the readings leave a shape
    open: least squares, which know no prior, may have left the formula then."""
    each = {n.name: n for n in (fitted.fit.numbers if fitted else ())}
    own = {n.field: each.get(f"{found.label}.{n.field}") for n in found.numbers}
    told = {k: (float(n.value), float(n.std), n.unit) for k, n in own.items() if n}
    shapes = [told.get(n.field, (0.0, 0.0)) for n in found.numbers if not n.strength]
    return told if all(value > std for value, std, *_ in shapes) else {}


def _fitted(fits: Any, tried: Tried, law: Law) -> ModelState | None:
    try:
        fit = fits.of(tried)
    except FitError:
        return None
    return ModelState(tried.added[-1:], fit, held_out(fit), law.log_evidence)


def _predicts(with_it: ModelState | None, without: ModelState | None) -> bool:
    """Whether held-out readings are predicted better with a law than without it."""

    def error(model: ModelState | None) -> float:
        held = None if model is None else model.held_out
        return math.inf if held is None else float(np.nansum(held.held_out.ratio**2))

    return error(with_it) < error(without)


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
    equation = f"scale {FACTORS[law.factor]}f({SYMBOLS[law.variable]}), f a table"
    return FoundLaw(
        law.joint, law.variable, law.factor, equation, source,
        (number_of_it,), f"self.scale * {call}\n            ]))",
    )  # fmt: skip
