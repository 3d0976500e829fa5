"""What `plan` returns: tests to make, and what each outcome of them would mean."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..recordings.limits import Limits
from ..runtime.json import number
from ..runtime.presentation import Result


@dataclass(frozen=True)
class InPlay:
    """A model that the recordings leave possible."""

    added: tuple[str, ...]
    """Effects beyond the base model; none of them: springs, dampers, and what was given."""
    probability: float
    """Among the models in play."""


@dataclass(frozen=True)
class Sweep:
    """A motor's torque, a sine of rising frequency, on an arm that begins at rest."""

    joint: str
    torque: float
    """Amplitude, N m or N."""
    low: float
    """Hz, at the beginning."""
    high: float
    """Hz, at the end."""

    def at(self, time: np.ndarray, duration: float) -> np.ndarray:
        """(M,) torque at instants of a recording that lasts so long."""
        rise = (self.high - self.low) / duration
        return self.torque * np.sin(2 * np.pi * (self.low * time + 0.5 * rise * time**2))


@dataclass(frozen=True)
class Outcome:
    """What is to be seen if one of the models is right."""

    added: tuple[str, ...]
    reading: float
    """Of the joint and instant that the test names, rad or m."""
    std: float
    """What the recordings leave open of it, and the noise of a reading."""
    probability: float
    """Which this model is then expected to have."""


@dataclass(frozen=True)
class Test(Result):
    """A recording to make."""

    __test__ = False  # for pytest, which this is not

    release: dict[str, float]
    """Angle (rad or m) of each joint at release, at rest."""
    units: tuple[str, ...]
    """Of the joints' angles; "" where not known."""
    theta2: float | None
    """Elbow angle at rest, rad; None where there is no arm."""
    air_bearings: bool | None
    """Whether the bearings are on; None where there are none."""
    extra_mass: float | None
    """Load on the first coordinate, kg; None where that is not a choice."""
    load: float | None
    """On whatever rubs, N; None where the recordings state none."""
    drive: Sweep | None
    """What the motor does; None: nothing, the arm is released."""
    duration: float
    """s."""
    entropy: float
    """Of the models in play, nats, expected after this test and those before it."""
    probability_right: float
    """Expected probability of the likeliest model then."""
    between: tuple[tuple[str, ...], tuple[str, ...]]
    """What the two likeliest models add, each without what both have."""
    difference: float
    """Their predictions differ by this many standard errors of all readings together, after the
    rival has adjusted its numbers as far as it may."""
    now: float
    """The same for the recordings that there are."""
    joint: str
    """Where the two are told apart most clearly by one reading,"""
    time: float
    """and when, s after the beginning."""
    outcomes: tuple[Outcome, ...]
    """One for each model in play."""
    helps: bool
    """Whether it is expected to tell enough to be worth making."""
    band: float | None = None
    """Expected half width of the 95 % band of what the plan is for, if it is for a quantity."""

    @property
    def words(self) -> str:
        """The test and what it tells, in two or three sentences."""
        return self._presented("sentence")

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one test, and of `next_experiment`."""
        drive = self.drive
        return {
            "between": ["+".join(labels) or "nothing" for labels in self.between],
            "release": dict(self.release),
            "theta2": self.theta2,
            "air_bearings": self.air_bearings,
            "extra_mass": self.extra_mass,
            "load": self.load,
            "drive": None if drive is None else vars(drive) | {},
            "duration": self.duration,
            "entropy": number(self.entropy),
            "probability_right": number(self.probability_right),
            "difference_over_noise": number(self.difference),
            "difference_over_noise_now": number(self.now),
            "reading": {"joint": self.joint, "time": self.time},
            "outcomes": [
                {
                    "added": list(x.added),
                    "reading": number(x.reading),
                    "std": number(x.std),
                    "probability": number(x.probability),
                }
                for x in self.outcomes
            ],
            "helps": self.helps,
            "words": self.words,
        }


@dataclass(frozen=True)
class Plan(Result):
    """The next tests, best first. Print it; or `to_dict()` for the JSON."""

    models: tuple[InPlay, ...]
    """The likeliest first."""
    left_out: float
    """Probability of all models that were not planned for."""
    entropy: float
    """Of the models in play, nats, before any test."""
    tests: tuple[Test, ...]
    """Each is the best beside those above it."""
    tried: int
    """How many tests were compared."""
    settled: bool
    """Whether the recordings tell the models apart already."""
    unexplained: float
    """Probability that no model in play is complete."""
    limits: Limits | None
    joints: tuple[str, ...]

    @property
    def helps(self) -> bool:
        """Whether the first test is worth making."""
        return bool(self.tests) and self.tests[0].helps

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn plan`."""
        return {
            "models": [
                {"added": list(m.added), "probability": number(m.probability)} for m in self.models
            ],
            "left_out": number(self.left_out),
            "entropy": number(self.entropy),
            "settled": self.settled,
            "unexplained": number(self.unexplained),
            "helps": self.helps,
            "tried": self.tried,
            "tests": [t.to_dict() for t in self.tests],
        }
