"""The next tests: which recordings would make the name sure, before any of them is made."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from ..recordings.experiment import Experiment, must_be_experiment
from ..runtime.json import finite
from ..runtime.presentation import Result
from .candidate_tests import Test, best_tests, settled
from .diagnose import Posterior, diagnose
from .experiment_design import entropy
from .result import ChannelError, Diagnosis


@dataclass(frozen=True)
class InPlay:
    """A model that the recordings leave possible."""

    added: tuple[str, ...]
    """Effects beyond the base model; none of them: springs, dampers, and what was given."""
    probability: float
    """Among the models in play."""


@dataclass(frozen=True)
class Plan(Result, about="plan"):
    """The next tests, best first. Print it; or `to_dict()` for the JSON."""

    models: tuple[InPlay, ...]
    """The likeliest first."""
    left_out: float
    """Probability of all that was not planned for,"""
    unnamed: float
    """of which this is of laws without a name, which predict no other test."""
    channels: ChannelError | None
    """What the columns are instead, if that is to be put right first: nothing is planned then."""
    entropy: float
    """Of the models in play, nats, before any test."""
    tests: tuple[Test, ...]
    """Each is the best beside those above it."""
    tried: int
    """How many tests were compared."""
    settled: bool
    """Whether the recordings tell the likeliest model from all else already."""
    unexplained: float
    """Probability that no model in play is complete."""
    joints: tuple[str, ...]

    @property
    def helps(self) -> bool:
        """Whether the first test is worth making."""
        return bool(self.tests) and self.tests[0].helps

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn plan`."""
        told = {k: v for k, v in vars(self).items() if k not in ("joints", "unnamed")}
        return finite(
            told
            | {
                "without_a_name": self.unnamed,
                "channels": self.channels and asdict(self.channels),
                "models": [asdict(m) for m in self.models],
                "helps": self.helps,
                "tests": [t.to_dict() for t in self.tests],
            }
        )


def plan(
    found: Diagnosis | Experiment,
    *,
    tests: int = 3,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Plan:
    """The next tests within the experiment's limits, each with what its outcomes would mean.

    All models with names that a diagnosis leaves in play predict every test that the limits allow.
    Tests are ranked by the expected fall of the entropy over these models (Lindley 1956; Box and
    Hill 1967), and planned greedily: each is the best beside those before it.

    **Arguments:**

    - `found`: a `Diagnosis`, or an experiment, which is then diagnosed with the `options` of
      `residyn.diagnose`.
    - `tests`: how many tests to plan, at least 1.
    - `progress`: called with a few words as each phase begins.

    **Returns:** a `Plan`: print it, or `to_dict()`.

    **Raises:** `ValueError` for less than one test or a diagnosis whose search was not kept;
    `TypeError` for what is neither; as `residyn.diagnose` does.
    """
    if tests < 1:
        raise InputError(f"tests = {tests}: at least one test is planned")
    say = progress or (lambda words: None)
    if not isinstance(found, Diagnosis):
        must_be_experiment(found)
        found = diagnose(found, progress=progress, **options)
    if found.search is None:
        raise ValueError("this diagnosis has not kept its search: diagnose again to plan tests")
    with jax.enable_x64(True):
        posterior = Posterior(found.search)
        models, p, left_out = posterior.in_play()
        done = len(models) > 0 and settled(posterior.log_with_negligible)
        planned, tried = (), 0
        if len(models) > 1 and not done:
            say(f"comparing tests for {len(models)} models")
            planned, tried = best_tests(found.fits.whole, found.search.scene, models, p, tests)
    complete = float(p @ np.array([m.complete for m in models]))
    return Plan(
        models=tuple(InPlay(m.added, float(x)) for m, x in zip(models, p, strict=True)),
        left_out=left_out,
        unnamed=posterior.of_unnamed,
        channels=found.channels,
        entropy=float(entropy(p)),
        tests=planned,
        tried=tried,
        settled=done,
        unexplained=1.0 - complete,
        joints=found.search.scene.joints,
    )
