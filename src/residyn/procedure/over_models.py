"""Step 3 where the name is not sure: how the arm rings in orbit, over all models in play.

A diagnosis leaves models m with posterior p_m, the numbers of each with a posterior covariance, and
step 1 leaves the inertias uncertain. So a frequency or damping ratio g without bearings is a
mixture of normals with means g_m and variances n_m + i_m, of the numbers and of the inertias. Its
variance has three parts (law of total variance),

    Var g = sum of p_m (g_m - g)^2  +  sum of p_m n_m  +  sum of p_m i_m,

the name, the numbers, and the inertias. Errors of the inertias move the numbers too: in the filter
an inertia that is off by a share is one more column, whose Gram matrix says by how much. The prior
of the numbers is in their covariance, so that what no recording shows is as wide as was plausible,
and not without bound.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import log_softmax, softmax
from scipy.stats import norm

from ..diagnosis.candidate_tests import Rival, Test, best_tests, in_play
from ..diagnosis.columns import Columns
from ..diagnosis.diagnose import Posterior
from ..diagnosis.evidence import DECADES, log_prior_model, means_of_base, over_widths, width_of
from ..diagnosis.experiment_design import Quantity
from ..diagnosis.plan import InPlay
from ..diagnosis.search import Search
from ..diagnosis.tried import Tried
from ..effects import BearingDrag, InertiaError
from ..filtering.law import number_slices, numbers_of
from ..filtering.trajectory import Scene
from ..fitting.problem import mechanism_of
from ..physics.model import Model
from ..recordings.experiment import Experiment
from ..recordings.recording import Recording
from ..runtime.presentation import Result
from .carried import NAMES, Carried, ModeSlopes, inertias, slopes_of_modes

QUANTITIES = ("frequency_hz", "damping_ratio")


class Bare(NamedTuple):
    """A model in play without its bearings; as fitted, on them; and what its numbers and the
    inertias do not know."""

    model: Model
    fitted: Model
    errors: Carried


@dataclass(frozen=True)
class Spread:
    """A number over all models."""

    mean: float
    low: float
    """Of its 95 % band."""
    high: float
    std: float
    from_name: float
    """Share of the variance: which model it is,"""
    from_numbers: float
    """what the recordings leave open of its numbers,"""
    from_inertias: float
    """and what step 1 leaves open of the inertias."""


@dataclass(frozen=True)
class ModeOver:
    """One mode without bearings, over all models in which it rings."""

    frequency_hz: Spread
    damping_ratio: Spread
    rings: float
    """Probability of the models in which it does."""


@dataclass(frozen=True, eq=False)
class OverModels(Result, about="over_models"):
    """How the arm rings without its bearings, over the models of a diagnosis. Print it."""

    models: tuple[InPlay, ...]
    left_out: float
    """Probability of all models that are not among them."""
    poses: tuple[tuple[float, tuple[ModeOver, ...]], ...]
    """Elbow angle at rest (rad), and the modes there, lowest first; as those of `Unloading`."""
    next_test: Test | None
    """Which would narrow most what is known worst of the lowest mode of the first pose."""
    narrows: str | None
    """Which of `QUANTITIES` that is."""
    joints: tuple[str, ...]
    stopped: str | None = None
    """Why the search for models ended early, if it did: "interrupted" or "budget"."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `over_models`."""
        return {
            "models": [asdict(m) for m in self.models],
            "left_out": self.left_out,
            "stopped": self.stopped,
            "poses": [
                {"theta2": theta2, "without_bearings": {"modes": [asdict(m) for m in modes]}}
                for theta2, modes in self.poses
            ],
            "narrows": self.narrows,
            "next_test": None if self.next_test is None else self.next_test.to_dict(),
        }


def over_models(
    search: Search,
    experiment: Experiment,
    inertia: np.ndarray | None,
    poses: list[Recording],
    say: Callable[[str], None],
) -> OverModels:
    """Step 3 over the models that a search leaves in play; `inertia` is the covariance (3, 3) of
    step 1."""
    scene = search.scene
    say("weighing the drag of the bearings beside each model")
    models, p, left_out = with_and_without_drag(search)
    say(f"taking the bearings off {len(models)} models")
    rivals = [Rival.of(scene, m) for m in models]
    errors = [errors_of(scene, r, inertia) for r in rivals]
    each = list(zip(rivals, errors, strict=True))
    free = [
        tuple(Bare(bare(experiment, r.model, pose), r.model, e) for r, e in each) for pose in poses
    ]
    modes = [modes_over(own, p) for own in free]
    narrows = test = None
    if modes[0] and modes[0][0].rings > 1 - 1e-9:
        spreads = {k: getattr(modes[0][0], k) for k in QUANTITIES}
        narrows = max(QUANTITIES, key=lambda k: spreads[k].std / abs(spreads[k].mean))
        say("looking for the test that narrows it most")
        lowest = [slopes_of_modes(b.model, b.fitted)[0][0] for b in free[0]]
        wanted = _quantity(lowest, errors, QUANTITIES.index(narrows))
        test = next(iter(best_tests(experiment, scene, models, p, quantity=wanted)[0]), None)
    return OverModels(
        models=tuple(InPlay(m.added, float(x)) for m, x in zip(models, p, strict=True)),
        left_out=left_out,
        poses=tuple((pose.theta2, each) for pose, each in zip(poses, modes, strict=True)),
        next_test=test,
        narrows=narrows,
        joints=scene.joints,
        stopped=search.stopped,
    )


def bare(experiment: Experiment, model: Model, recording: Recording) -> Model:
    """A model in a recording's pose, without bearings and what they do (Eq. 18)."""
    mechanism = mechanism_of(experiment, replace(recording, air_bearings=False))
    return without_effects_of_bearings(replace(model, mechanism=mechanism))


def without_effects_of_bearings(model: Model) -> Model:
    """The model less every effect that leaves with the air bearings."""
    kept = tuple(e for e in model.effects if not e.of_bearings)
    return replace(model, effects=kept)


def with_and_without_drag(search: Search) -> tuple[list[Tried], np.ndarray, float]:
    """The models in play with and without damping of the whole mechanism, their probabilities among
    each other, and that of all that are left out.

    To a search, drag of the bearings is one of many effects that may be missing, unlikely
    beforehand, and as large as effects that are worth a name. A film of air does drag; whether by
    enough to count beside the joints' dampers is as likely as not, and how much it is nobody knows
    within decades (`at_any_width`). Nor which law it has: all of its kind that act on the whole
    mechanism are as likely as each other. The recordings hardly say, for dampers of the joints do
    much the same; without bearings they stay.
    """
    posterior = Posterior(search)
    models, p, rest = in_play(posterior.models, log_softmax(posterior.log_tried))
    left_out = 1.0 - (1.0 - rest) * float(np.exp(posterior.log_tried).sum())
    count = len(search.candidates)
    if BearingDrag.name not in (e.label for e in search.candidates):
        models = [at_any_width(m, BearingDrag.name) for m in models]
        return models, softmax(np.array([m.log_posterior for m in models])), left_out
    laws = [e.label for e in search.candidates if e.kind() == BearingDrag.kind() and not e.place]
    found = {frozenset(m.added): m for m in models}
    for rest in dict.fromkeys(key.difference(laws) for key in tuple(found)):
        without, prior = search.tried.get(rest), log_prior_model(len(rest), count)
        if without is None:
            continue
        found[rest] = replace(without, log_prior=prior)
        for law in laws:
            model = search.beside(without, law)
            if model is not None:
                model = at_any_width(model, law)
                found[rest | {law}] = replace(model, log_prior=prior - math.log(len(laws)))
    every = list(found.values())
    kept, p, _ = in_play(every, log_softmax([m.log_posterior for m in every]))
    return kept, p, left_out


def at_any_width(model: Tried, label: str) -> Tried:
    """A model, the strength of its effect `label` of any prior width of `DECADES`."""
    slices = zip(model.best.effects, number_slices(model.best.effects), strict=True)
    i = next((own.start for e, own in slices if e.label == label), None)
    if i is None:
        return model
    t = model.posterior
    count = len(t.covariance)
    gain, mean, covariance = over_widths(t.u[:count], t.covariance, i, DECADES)
    best = replace(t, u=np.append(mean, t.u[count:]), covariance=covariance)
    return replace(model, best=best, evidences=model.evidences + gain, simulated=None)


def errors_of(scene: Scene, rival: Rival, inertia: np.ndarray | None) -> Carried:
    """What a model's numbers and the inertias do not know."""
    numbers, count = rival.root @ rival.root.T, len(rival.root)
    nothing = np.zeros((0, count))
    if inertia is None:
        return Carried(numbers, nothing, np.zeros((3, 3)), np.zeros((count, 3)))
    t = rival.tried.best
    parts = [InertiaError(part) for part in NAMES]
    _, grams = Columns(scene, t, parts, []).gram([rival.tried.intensity])
    own = means_of_base(grams[0], len(t.u))[:count, 1:]
    widths = [width_of(scene, e, numbers_of(e)[0]) for e in parts]
    sizes = np.asarray(inertias(scene.mechanisms[0]))
    moved = t.prior.slopes(t.u)[:, None] * own / (np.array(widths) * sizes)
    return Carried(numbers, nothing, inertia, moved)


def modes_over(bare: Sequence[Bare], p: np.ndarray) -> tuple[ModeOver, ...]:
    """The modes over models with these probabilities (M,), lowest first."""
    known, found = [slopes_of_modes(b.model, b.fitted)[0] for b in bare], []
    for i in range(max(map(len, known))):
        own = [m for m, each in enumerate(known) if i < len(each)]
        modes, errors = [known[m][i] for m in own], [bare[m].errors for m in own]
        weights = p[own] / p[own].sum()
        spreads = [_spread(_quantity(modes, errors, k), weights, errors) for k in (0, 1)]
        found.append(ModeOver(*spreads, rings=float(p[own].sum())))
    return tuple(found)


def _quantity(modes: list[ModeSlopes], errors: Sequence[Carried], which: int) -> Quantity:
    """Frequency (0) or damping ratio (1) of a mode in each model that has it."""
    rest = []
    for m, e in zip(modes, errors, strict=True):
        whole = m.by_inertia[which] + m.by_number[which] @ e.moved
        rest.append(float(whole @ e.inertia @ whole))
    means = np.array([m.values[which] for m in modes])
    return Quantity(means, [m.by_number[which] for m in modes], np.array(rest))


def _spread(wanted: Quantity, p: np.ndarray, errors: Sequence[Carried]) -> Spread:
    numbers = np.array([
        s @ e.numbers @ s for s, e in zip(wanted.slopes, errors, strict=True)
    ])  # fmt: skip
    mean = float(p @ wanted.mean)
    parts = np.array([p @ (wanted.mean - mean) ** 2, p @ numbers, p @ wanted.rest])
    low, high = (
        quantile(q, p, wanted.mean, np.sqrt(numbers + wanted.rest)) for q in (0.025, 0.975)
    )
    total = float(parts.sum())
    return Spread(mean, low, high, total**0.5, *map(float, parts / (total or 1.0)))


def quantile(q: float, p: np.ndarray, mean: np.ndarray, std: np.ndarray) -> float:
    """Of a mixture of normals."""
    std = np.maximum(std, 1e-12 * np.max(np.abs(mean), initial=1e-300))
    ends = np.min(mean - 9 * std), np.max(mean + 9 * std)
    return float(brentq(lambda x: p @ norm.cdf((x - mean) / std) - q, *ends, xtol=1e-14))  # pyrefly: ignore
