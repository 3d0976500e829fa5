"""Whether runs of one rig share their numbers: a test by evidence.

A recording that has numbers of its own (`own`) says that they may differ, not that they do. Two
models are compared: in one the run has its own, in the other it shares those of the rest. All else
that is not known (the numbers, the first states, a random torque for what both lack) is integrated
over, as in a diagnosis; so a number pays for itself or it does not (Occam's factor: MacKay, 2003,
ch. 28), and a model that is wrong in other ways does not make every difference significant.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
from scipy.special import expit

from ..effects import AbstractEffect
from ..recordings.experiment import Experiment
from .missing_torque import owning_base, scene_of, with_rests
from .search import tried_alone


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
