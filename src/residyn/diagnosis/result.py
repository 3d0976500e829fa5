"""What `diagnose` returns: a verdict with its probability, the models on the way, and who else it
might have been.

A name is worth something only beside what else was possible. Every probability here is a sum of
posterior probabilities of models that were tried (`evidence`).
"""

import dataclasses
import functools
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from ..fitting.result import Fit
from ..runtime.json import finite, number
from ..runtime.presentation import TableResult
from .candidate_tests import Test
from .compare import Comparison, compare_fit, summary
from .forecast import ModelState
from .law import Law
from .missing_torque import Missing
from .residuals import Coloured
from .search import Search

Verdict = Literal["adequate", "missing", "unexplained"]


class Value(NamedTuple):
    """A number and its standard error, NaN where that is not known."""

    value: float
    std: float
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """`value`, `std` (or null), `unit`."""
        return finite(self._asdict())


@dataclass(frozen=True)
class Candidate:
    """An effect that might be what is missing."""

    effect: str
    """`name` or `name:place`."""
    probability: float
    """That it is part of the model, given the recordings."""
    log_evidence: float
    """Of the base model with it alone, nats, relative to the best model with names only."""
    iterated: bool
    """Whether that is its nonlinear evidence; otherwise it is known to first order only."""
    parameters: dict[str, Value]
    """Its numbers, alone beside the base model, by their full names."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one candidate."""
        return {
            "effect": self.effect,
            "probability": float(self.probability),
            "log_evidence": number(self.log_evidence),
            "parameters": {name: v.to_dict() for name, v in self.parameters.items()},
        }


@dataclass(frozen=True)
class Family:
    """Laws of one kind at one place."""

    name: str
    """"dry friction", say."""
    place: str | None
    """A joint, or None for the whole mechanism."""
    probability: float
    """That a law of this kind is part of the model, with a name or without one."""
    members: tuple[tuple[str, float], ...]
    """Labels of effects and how probable each is, the likeliest first."""
    unnamed: float = 0.0
    """That a law of this kind which has no name is."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one family."""
        return {
            "name": self.name,
            "place": self.place,
            "probability": float(self.probability),
            "members": [{"effect": e, "probability": float(p)} for e, p in self.members],
            "without_a_name": float(self.unnamed),
        }


@dataclass(frozen=True)
class RandomTorque:
    """What the best model still lacks at one joint."""

    joint: str
    unit: str
    rms: float
    """Posterior mean, N m or N."""
    low: float
    """Of its 95 % interval."""
    high: float
    share_of_spring: float
    """`rms` over that of the restoring torque: of springs and of what acts in their place, or of
    Z q'' where a joint has neither."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one joint."""
        return finite({name: x for name, x in vars(self).items() if name != "joint"})


class ColouredNoise(NamedTuple):
    """Noise of the readings that is not white: an Ornstein-Uhlenbeck process beside their own."""

    correlation_time: float
    """s, to a factor of two."""
    rms: dict[str, tuple[float, str]]
    """What the last model leaves of each joint's readings: its rms, and their unit."""

    def to_dict(self) -> dict[str, Any]:
        """Its JSON."""
        each = self.rms.items()
        rms = {joint: {"value": number(x), "unit": unit} for joint, (x, unit) in each}
        return {"correlation_time": number(self.correlation_time), "rms": rms}


@dataclass(frozen=True)
class Budget:
    """What was tried."""

    models: int
    """Models iterated to their evidence."""
    candidates: int
    """Effects and places screened."""
    stopped: str | None
    """Why the search ended before nothing more could be gained: "budget" or "interrupted"."""


@dataclass(frozen=True)
class ChannelError:
    """What the columns of the recordings seem to be instead of what the file says."""

    words: str
    """One clause."""
    probability: float
    complete: bool
    """Whether springs and dampers explain all readings so; effects were then not looked for."""


@dataclass(frozen=True, eq=False)
class Diagnosis(TableResult, about="diagnosis"):
    """Which physical effect is missing. Print it; or `to_dict()` for the JSON."""

    verdict: Verdict
    verdict_probability: float
    """Posterior probability of the verdict."""
    ladder: tuple[ModelState, ...]
    """From the base model to the likeliest one, each fitted."""
    candidates: tuple[Candidate, ...]
    """The likeliest first, of equal ones (to 1 %) those with the higher evidence."""
    families: tuple[Family, ...]
    """The likeliest first."""
    lookalikes: tuple[tuple[str, ...], ...]
    """Groups that these recordings cannot tell apart, the accepted name first."""
    next_experiment: Test | None
    """What would tell the two likeliest explanations (kinds of law and their places) apart; None
    where odds do, or not both are in play."""
    missing: tuple[Missing, ...]
    """The torque that the base model lacks, one per fitted recording."""
    still_missing: tuple[Missing, ...]
    """The torque that the likeliest model lacks."""
    laws: tuple[Law, ...]
    """Laws without a name that may be missing, the likeliest first; the first has a class to be
    written (`found`) where it has most of the probability."""
    random_torque: tuple[RandomTorque, ...]
    """How large that is, per joint."""
    parameters: dict[str, Value]
    """Numbers of the likeliest model beside that torque, by name. A fit, which knows of none, has
    others where much is left, and errors that are too small."""
    intensity: float
    """Posterior mean of the likeliest model's random torque, as a share of the spring's torque at
    full swing."""
    coloured: Coloured | None
    """What is left of the readings, where it is not noise though no torque is missing that would
    explain it: the verdict is then "unexplained"."""
    coloured_noise: ColouredNoise | None
    """The noise of the readings, where it is surely not white and a random torque does not explain
    it: all models then have it in the place of that torque."""
    channels: ChannelError | None
    """What the columns are instead, where springs and dampers alone are likelier so than any model
    of the columns as they stand."""
    explains_nothing: bool
    """Whether even the likeliest model is none of this motion."""
    budget: Budget
    seconds: float
    search: Search | None = None
    """The models that were tried, with their smoothed motions; None if it was not kept."""
    fits: Any = None
    """`diagnose.Fits`, which fits any of them."""

    @property
    def added(self) -> tuple[str, ...]:
        """Names that joined the model, in order."""
        first = set(self.base.model.labels)
        return tuple(label for label in self.fit.model.labels if label not in first)

    @property
    def models(self) -> tuple[ModelState, ...]:
        """The `ladder`; and, where the likeliest law without a name was fitted beside the last
        model of it, that."""
        law = self.laws[0] if self.laws else None
        last = self.ladder[-1]
        last = last if self.fit is last.fit else dataclasses.replace(last, fit=self.fit)
        named = *self.ladder[:-1], last
        if law is None or law.model is None or set(law.beside) != set(self.added):
            return named
        return (*named, law.model)

    @property
    def base(self) -> Fit:
        """The fit without what was found."""
        return self.ladder[0].fit

    @functools.cached_property
    def fit(self) -> Fit:
        """The fit with what was found. What it leaves is noise, if nothing else is missing."""
        last = self.ladder[-1].fit
        if self.coloured_noise is None or self.verdict == "unexplained":
            return last
        return dataclasses.replace(last, coloured_noise=True)

    @functools.cached_property
    def comparison(self) -> Comparison:
        """The last model against measurement: what is left. Computed when it is first asked for."""
        return compare_fit(self.fit, missing=self.still_missing)

    def candidate(self, effect: str) -> Candidate:
        """One candidate by name.

        **Raises:** `KeyError` if it is none.
        """
        return {c.effect: c for c in self.candidates}[effect]

    @property
    def words(self) -> tuple[str, ...]:
        """The verdict in a few sentences."""
        return self._presented("sentences")

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn diagnose`."""
        return {
            "verdict": self.verdict,
            "verdict_probability": number(self.verdict_probability),
            "words": list(self.words),
            "added": list(self.added),
            "ladder": [step.to_dict() for step in self.ladder],
            "candidates": [c.to_dict() for c in self.candidates],
            "families": [f.to_dict() for f in self.families],
            "lookalikes": [list(group) for group in self.lookalikes],
            "next_experiment": self.next_experiment and self.next_experiment.to_dict(),
            "channels": self.channels and dict(vars(self.channels)),
            "coloured": self.coloured and self.coloured.to_dict(),
            "coloured_noise": self.coloured_noise and self.coloured_noise.to_dict(),
            "laws": [law.to_dict() for law in self.laws],
            "missing_torque": summary(self.missing),
            "random_torque": {r.joint: r.to_dict() for r in self.random_torque},
            "parameters": {name: v.to_dict() for name, v in self.parameters.items()},
            "budget": dict(vars(self.budget)),
            "fit": self.fit.to_dict(),
            "seconds": number(self.seconds),
        }
