"""What `diagnose` returns: a verdict, the ladder that led to it, and how sure each name is.

A name is worth something only beside what else it might have been. So each candidate carries a
probability, names that the data cannot tell apart stand together, and the ladder's errors are shown
on readings that were fitted and on readings that were not.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..fitting.result import Fit
from .comparison import Comparison
from .horizon import HeldOut
from .missing import Missing, summary
from .where import number

Verdict = Literal["adequate", "missing", "unexplained"]


@dataclass(frozen=True)
class Value:
    """A fitted number of a candidate. `std` is NaN where it is not known."""

    value: float
    std: float
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """`value`, `std` (or null), `unit`."""
        return {"value": number(self.value), "std": number(self.std), "unit": self.unit}


@dataclass(frozen=True)
class Candidate:
    """An effect that might be what is missing."""

    effect: str
    """`name` or `name:place`."""
    probability: float
    """That it is physically there, given all that was tried."""
    chi2_drop_screened: float
    """By how much chi-square falls if it joins the model, to first order."""
    chi2_drop_refit: float | None
    """The same after the whole model was fitted again with it; None if it was not tried."""
    parameters: dict[str, Value]
    """Its numbers as refitted, or as screened, by their full names."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one candidate."""
        return {
            "effect": self.effect,
            "probability": float(self.probability),
            "chi2_drop_screened": number(self.chi2_drop_screened),
            "chi2_drop_refit": None
            if self.chi2_drop_refit is None
            else number(self.chi2_drop_refit),
            "parameters": {name: v.to_dict() for name, v in self.parameters.items()},
        }


@dataclass(frozen=True, eq=False)
class Rung:
    """One step of the ladder: a model, fitted."""

    added: str | None
    """The effect that joined it here; None for the base model."""
    dropped: tuple[str, ...]
    """Effects that the newcomer made needless."""
    fit: Fit
    held_out: HeldOut | None
    """Its errors where it was not fitted; None if they could not be had."""
    white: float
    """Probability that noise alone leaves a residual so far from white; NaN if not known."""

    @property
    def times_noise(self) -> np.ndarray:
        """(n,) rms residual over the noise, per joint, where it was fitted."""
        return self.fit.rmse / self.fit.noise

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one rung."""
        joints = self.fit.joints

        def each(x: np.ndarray) -> dict[str, float | None]:
            return dict(zip(joints, map(number, x), strict=True))

        held = self.held_out
        return {
            "model": list(self.fit.model.labels),
            "rmse": each(self.fit.rmse),
            "check_rmse": None if held is None else each(held.held_out.rmse),
            "reduced_chi2": number(self.fit.reduced_chi2),
        }


@dataclass(frozen=True)
class NextExperiment:
    """The recording that would tell two look-alikes apart."""

    between: tuple[str, str]
    """The accepted name, and its rival."""
    release: dict[str, float]
    """Angle (rad or m) of each joint at release, at rest."""
    theta2: float | None
    """Elbow angle at rest, rad; None where there is no arm."""
    air_bearings: bool | None
    """Whether the bearings are on; None where there are none."""
    extra_mass: float | None
    """Load on the first coordinate, kg; None where that is not a choice."""
    difference: float
    """The rivals' predictions then differ by this many standard errors of all readings together,
    after the rival has adjusted its numbers as far as it may."""
    now: float
    """The same for the recordings that there are."""
    words: str
    """All this, in a sentence or two."""

    @property
    def helps(self) -> bool:
        """Whether any experiment tried would separate them."""
        return self.difference >= 5.0

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `next_experiment`."""
        return {
            "between": list(self.between),
            "release": dict(self.release),
            "theta2": self.theta2,
            "air_bearings": self.air_bearings,
            "extra_mass": self.extra_mass,
            "difference_over_noise": number(self.difference),
            "difference_over_noise_now": number(self.now),
            "words": self.words,
        }


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Which physical effect is missing. Print it; or `to_dict()` for the JSON."""

    verdict: Verdict
    ladder: tuple[Rung, ...]
    """From the base model to the last that was accepted."""
    candidates: tuple[Candidate, ...]
    """For the base model, the likeliest first."""
    lookalikes: tuple[tuple[str, ...], ...]
    """Groups that these recordings cannot tell apart, the accepted name first."""
    next_experiment: NextExperiment | None
    missing: tuple[Missing, ...]
    """The torque that the base model lacks, one per fitted recording."""
    comparison: Comparison
    """The last model against measurement: what is left."""
    words: tuple[str, ...]
    """The verdict in a few sentences."""
    seconds: float

    @property
    def added(self) -> tuple[str, ...]:
        """Names that the ladder accepted and kept, in order."""
        first = set(self.base.model.labels)
        return tuple(label for label in self.fit.model.labels if label not in first)

    @property
    def base(self) -> Fit:
        """The fit without what was found."""
        return self.ladder[0].fit

    @property
    def fit(self) -> Fit:
        """The fit with what was found."""
        return self.ladder[-1].fit

    def candidate(self, effect: str) -> Candidate:
        """One candidate by name.

        **Raises:** `KeyError` if it is none.
        """
        return {c.effect: c for c in self.candidates}[effect]

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn diagnose`."""
        return {
            "verdict": self.verdict,
            "words": list(self.words),
            "added": list(self.added),
            "ladder": [rung.to_dict() for rung in self.ladder],
            "candidates": [c.to_dict() for c in self.candidates],
            "lookalikes": [list(group) for group in self.lookalikes],
            "next_experiment": None
            if self.next_experiment is None
            else self.next_experiment.to_dict(),
            "missing_torque": summary(self.missing),
            "fit": self.fit.to_dict(),
            "seconds": number(self.seconds),
        }

    def to_latex(self) -> str:
        """Two tables for a paper (package booktabs): the ladder, and the suspects."""
        from .publish import latex

        return latex(self)

    def to_csv(self) -> str:
        """The ladder and all candidates, a line each: table, model, name, value, std, unit."""
        from .publish import comma_separated

        return comma_separated(self)

    def __str__(self) -> str:
        from .printed import lines

        return "\n".join(lines(self))
