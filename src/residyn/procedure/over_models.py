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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from ..diagnosis import Diagnosis
from ..diagnosis.candidate_tests import Rival, best_tests, in_play
from ..diagnosis.columns import Columns
from ..diagnosis.diagnose import Posterior
from ..diagnosis.evidence import means_of_base, width_of
from ..diagnosis.experiment_design import Quantity, variance_now
from ..diagnosis.planned import InPlay, Test
from ..diagnosis.search import Tried
from ..effects import InertiaError
from ..filtering.law import numbers_of
from ..filtering.trajectory import Scene
from ..physics.model import Model
from ..recordings.experiment import Experiment
from ..recordings.recording import Recording
from ..runtime.presentation import Result
from .carried import NAMES, Carried, inertias, slopes_of_modes
from .ringdown import DRAWS, RingDown, band_of, draws_of

QUANTITIES = ("frequency_hz", "damping_ratio")


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

    def to_dict(self) -> dict[str, float]:
        """The JSON of one number."""
        return dict(vars(self))


@dataclass(frozen=True)
class ModeOver:
    """One mode without bearings, over all models in which it rings."""

    frequency_hz: Spread
    damping_ratio: Spread
    rings: float
    """Probability of the models in which it does."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one mode."""
        return {
            "frequency_hz": self.frequency_hz.to_dict(),
            "damping_ratio": self.damping_ratio.to_dict(),
            "rings": self.rings,
        }


@dataclass(frozen=True, eq=False)
class OverModels(Result):
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
    bare: tuple[tuple[Model, Model, Carried], ...]
    """Of each model in play, without bearings in the first pose; as fitted; and its errors."""
    joints: tuple[str, ...]

    def ring_down(
        self, times: np.ndarray, q0: np.ndarray, *, draws: int = DRAWS, seed: int = 0
    ) -> RingDown:
        """Angles without bearings at `times` (N,) s, let go at rest from `q0` (n,): those of the
        likeliest model, and the band that holds 95 % over all models."""
        with jax.enable_x64(True):
            found = []
            for model, (bare, fitted, errors) in zip(self.models, self.bare, strict=True):
                many = max(1, round(draws * model.probability))
                start = jnp.asarray(q0)
                found.append(draws_of(bare, fitted, errors, times, start, many, seed))
            return band_of(found[0][0], np.concatenate([f[1] for f in found]))

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `over_models`."""
        return {
            "models": [{"added": list(m.added), "probability": m.probability} for m in self.models],
            "left_out": self.left_out,
            "poses": [
                {"theta2": theta2, "without_bearings": {"modes": [m.to_dict() for m in modes]}}
                for theta2, modes in self.poses
            ],
            "narrows": self.narrows,
            "next_test": None if self.next_test is None else self.next_test.to_dict(),
        }


def over_models(
    found: Diagnosis,
    inertia: np.ndarray | None,
    poses: list[Recording],
    without_bearings: Callable[[Experiment, Model, Recording], Model],
    say: Callable[[str], None],
) -> OverModels:
    """Step 3 over the models that a diagnosis leaves in play; `inertia` is the covariance (3, 3) of
    step 1."""
    assert found.search is not None
    scene, experiment = found.search.scene, found.fits.whole
    posterior = Posterior(found.search)
    models, p, left_out = in_play(posterior.models, posterior.each)
    say(f"taking the bearings off {len(models)} models")
    rivals = [Rival.of(scene, m) for m in models]
    errors = [errors_of(scene, r, m, inertia) for r, m in zip(rivals, models, strict=True)]
    each, quantities, bare = [], {}, []
    for pose in poses:
        off = [without_bearings(experiment, r.model, pose) for r in rivals]
        known = [slopes_of_modes(model, r.model) for model, r in zip(off, rivals, strict=True)]
        bare = bare or list(zip(off, (r.model for r in rivals), errors, strict=True))
        modes = []
        for i in range(max(map(len, known))):
            own = [m for m, modes_of in enumerate(known) if i < len(modes_of)]
            wanted = [
                quantity_of([known[m][i] for m in own], [errors[m] for m in own], k) for k in (0, 1)
            ]
            weights = p[own] / p[own].sum()
            roots = [rivals[m].root for m in own]
            spreads = [spread_of(q, weights, roots) for q in wanted]
            modes.append(ModeOver(*spreads, rings=float(p[own].sum())))
            if not each and i == 0 and len(own) == len(models):
                quantities = dict(zip(QUANTITIES, wanted, strict=True))
        each.append((pose.theta2, tuple(modes)))
    narrows = test = None
    if quantities:
        lowest = each[0][1][0]
        relative = {k: getattr(lowest, k).std / abs(getattr(lowest, k).mean) for k in quantities}
        narrows = max(QUANTITIES, key=lambda k: relative[k])
        say("looking for the test that narrows it most")
        ranking = best_tests(experiment, scene, models, p, quantity=quantities[narrows])
        test = next(iter(ranking.tests), None)
    return OverModels(
        models=tuple(InPlay(m.added, float(x)) for m, x in zip(models, p, strict=True)),
        left_out=left_out,
        poses=tuple(each),
        next_test=test,
        narrows=narrows,
        bare=tuple(bare),
        joints=scene.joints,
    )


def errors_of(scene: Scene, rival: Rival, tried: Tried, inertia: np.ndarray | None) -> Carried:
    """What a model's numbers and the inertias do not know."""
    numbers, count = rival.root @ rival.root.T, len(rival.root)
    nothing = np.zeros((0, count))
    if inertia is None:
        return Carried(numbers, nothing, np.zeros((3, 3)), np.zeros((count, 3)))
    t = tried.best
    parts = [InertiaError(part) for part in NAMES]  # pyright: ignore[reportCallIssue]
    columns = Columns(scene, t, parts, [])
    _, grams = columns.gram([tried.intensity])
    own = means_of_base(grams[0], len(t.u))[:count, 1:]
    widths = [width_of(scene, e, numbers_of(e)[0]) for e in parts]
    sizes = np.asarray(inertias(scene.mechanisms[0]))
    moved = t.prior.slopes(t.u)[:, None] * own / (np.array(widths) * sizes)
    return Carried(numbers, nothing, inertia, moved)


def quantity_of(modes: list, errors: list[Carried], which: int) -> Quantity:
    """Frequency (0) or damping ratio (1) of a mode in each model that has it."""
    means = np.array([m.values[which] for m in modes])
    slopes = [m.by_number[which] for m in modes]
    rest = []
    for m, e in zip(modes, errors, strict=True):
        whole = m.by_inertia[which] + m.by_number[which] @ e.moved
        rest.append(float(whole @ e.inertia @ whole))
    return Quantity(means, slopes, np.array(rest))


def spread_of(wanted: Quantity, p: np.ndarray, roots: list[np.ndarray]) -> Spread:
    own = [r.T @ s for r, s in zip(roots, wanted.slopes, strict=True)]
    parts = np.array(variance_now(p, wanted._replace(slopes=own)))
    stds = np.sqrt(np.array([s @ s for s in own]) + wanted.rest)
    low, high = (quantile(q, p, wanted.mean, stds) for q in (0.025, 0.975))
    total = parts.sum()
    shares = parts / total if total > 0 else np.zeros(3)
    return Spread(float(p @ wanted.mean), low, high, float(np.sqrt(total)), *map(float, shares))


def quantile(q: float, p: np.ndarray, mean: np.ndarray, std: np.ndarray) -> float:
    """Of a mixture of normals."""
    std = np.maximum(std, 1e-12 * np.max(np.abs(mean), initial=1e-300))
    ends = np.min(mean - 9 * std), np.max(mean + 9 * std)
    return float(brentq(lambda x: p @ norm.cdf((x - mean) / std) - q, *ends, xtol=1e-14))  # pyright: ignore
