"""A fitted model against measurement: where it fails, and what torque it lacks."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.special import expit

from ..effects import AbstractEffect
from ..fitting import DEFAULT_STARTS, fit
from ..fitting.result import Fit
from ..physics.effect import BASE
from ..recordings.experiment import Experiment
from ..runtime.json import finite
from ..runtime.presentation import Result
from .evidence import NOISE
from .forecast import HeldOut, Horizon, held_out, horizon
from .linearised_fit import predictions
from .missing_torque import CURVES, Missing, missing_of, owning_base, scene_of, with_rests
from .residuals import Where, where
from .search import Search
from .tried import tried_alone
from .whiteness import of_the_least


class OwnNumbers(NamedTuple):
    """One effect's numbers in one run, beside those that the other recordings share."""

    effect: str
    """`name:place`."""
    recording: str
    log_odds: float
    """Nats for numbers of its own, against shared ones, of equal prior probability."""

    @property
    def probability(self) -> float:
        """That they differ."""
        return float(expit(self.log_odds))

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**self._asdict(), "probability": self.probability}


@dataclass(frozen=True, eq=False)
class Comparison(Result, about="compare"):
    """A fitted model against measurement. Print it; or `to_dict()` for the JSON."""

    fit: Fit
    where: Where
    held_out: HeldOut | None
    """None if the fit of the first two thirds did not settle."""
    horizon: Horizon | None
    """None if the fit of the first third did not settle."""
    missing_torque: tuple[Missing, ...]
    """One per fitted recording."""
    runs: tuple[OwnNumbers, ...] = ()
    """Whether recordings that have numbers of their own need them."""

    @property
    def p(self) -> float:
        """Probability that noise alone leaves a residual so far from white, all joints together;
        1 where no joint has enough readings to tell."""
        return of_the_least([p for p in self.where.white.values() if np.isfinite(p)])

    @property
    def explained(self) -> bool:
        """Whether what is left is as white as noise is, or is known to be noise that is not."""
        return self.p >= NOISE or self.fit.coloured_noise

    @property
    def words(self) -> tuple[str, ...]:
        """The verdict: where the model fails, or that it does not, in a few sentences."""
        return self._presented("sentences")

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn compare`: that of `fit`, and more (docs/json.md)."""
        joints = self.fit.joints
        return {
            **self.fit.to_dict(),
            "words": list(self.words),
            "where": self.where.to_dict(),
            "held_out": None if self.held_out is None else self.held_out.to_dict(joints),
            "horizon": None if self.horizon is None else self.horizon.to_dict(joints),
            "runs": [each.to_dict() for each in self.runs],
            "missing_torque": summary(self.missing_torque),
        }


def compare(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    starts: int = DEFAULT_STARTS,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    """Fit a model, and say where it fails: at which joint, when, at what swing and frequency.

    The torque that it lacks is drawn beside what the likeliest effects would draw, by the evidence
    of `diagnose`. Runs in float64 whatever JAX's setting.

    **Arguments:**

    - `experiment`: from `residyn.load`, or made of arrays.
    - `effects`: what to add to the springs and dampers: `name`, `name:joint`, or an effect.
    - `starts`: how many starts the fit tries, at least 1.
    - `progress`: called with a few words as each phase begins.

    **Returns:** a `Comparison`: print it, or `to_dict()`.

    **Raises:** `FitError` if no start led to finite numbers; `ValueError` for an effect that does
    not exist or does not go with this experiment.
    """
    say = progress or (lambda words: None)
    return compare_fit(fit(experiment, effects=effects, starts=starts, progress=say), say)


def compare_fit(
    fitted: Fit,
    progress: Callable[[str], None] | None = None,
    missing: tuple[Missing, ...] | None = None,
) -> Comparison:
    """The comparison of a fit that is there already; see `compare`. `missing`: the torque that its
    model lacks, if that is known."""
    say = progress or (lambda words: None)
    with jax.enable_x64(True):
        say("looking where the residual is")
        found = where(fitted, predictions(fitted, fitted.unknowns)[1])
        say("predicting what was held out")
        ahead = held_out(fitted), horizon(fitted)
        own = [e for e in fitted.model.effects if e.name not in BASE]
        if missing is None:
            say("smoothing the missing torque")
            missing = _missing(fitted.experiment, own, say)
        return Comparison(fitted, found, *ahead, missing, own_numbers(fitted.experiment, own))


def _missing(experiment: Experiment, own, say: Callable[[str], None]) -> tuple[Missing, ...]:
    """The torque that a model with effects of its `own` lacks, and what the likeliest single ones
    more would draw."""
    scene, effects = scene_of(*with_rests(experiment, own))
    search = Search(scene, effects, say=say)
    if search.base.intensity > 0:
        search.extend(search.base, 1)
    better = [t for t in search.singles if t.log_posterior > search.base.log_posterior]
    return missing_of(scene, search.base, [(t, t.added[0]) for t in better[:CURVES]])


def summary(found: tuple[Missing, ...]) -> dict[str, Any] | None:
    """Per joint the rms over all recordings, N m or N, and its share of the spring torque's."""
    if not found:
        return None
    rms, share = (
        np.sqrt(np.mean([getattr(m.torque, name) ** 2 for m in found], axis=0))
        for name in ("rms", "share_of_spring")
    )
    rows = zip(found[0].joints, rms, share, found[0].units, strict=True)
    return finite({j: {"rms": r, "share_of_spring": s, "unit": u} for j, r, s, u in rows})


# -- whether runs of one rig share their numbers ---------------------------------------------

# A recording that has numbers of its own (`own`) says that they may differ, not that they do. Two
# models are compared: in one the run has its own, in the other it shares those of the rest. All
# else that is not known (the numbers, the first states, a random torque for what both lack) is
# integrated over, as in a diagnosis; so a number pays for itself or it does not (Occam's factor:
# MacKay, 2003, ch. 28), and a model that is wrong in other ways does not make every difference
# significant.


def own_numbers(
    experiment: Experiment, effects: Sequence[str | AbstractEffect] = ()
) -> tuple[OwnNumbers, ...]:
    """For each effect and recording that has numbers of its own: whether it needs them.

    Runs in float64 whatever JAX's setting.

    **Arguments:** as of `residyn.fit`; an effect that is not in the model has no numbers to test.

    **Raises:** `ValueError` for an effect that does not exist or does not go with this experiment.
    """
    if not experiment.own:
        return ()
    with jax.enable_x64(True):
        asked = owning_base(experiment, effects).own
        experiment, effects = with_rests(experiment, effects)
        experiment = owning_base(experiment, effects)
        with_all = tried_alone(*scene_of(experiment, effects)).log_evidence
        found = []
        for label, runs in asked.items():
            for _, recording in runs:
                shared = scene_of(_sharing(experiment, label, recording), effects)
                log_odds = with_all - tried_alone(*shared).log_evidence
                found.append(OwnNumbers(label, recording, log_odds))
    return tuple(found)


def _sharing(experiment: Experiment, label: str, recording: str) -> Experiment:
    """The experiment with one recording sharing one effect's numbers."""

    def shared(r):
        if (r.segment_of or r).name != recording:
            return r
        return dataclasses.replace(r, own=tuple(x for x in r.own if x != label))

    return dataclasses.replace(experiment, recordings=tuple(map(shared, experiment.recordings)))
