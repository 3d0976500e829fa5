"""All the way up the ladder, and once more without a law that may have done two others' work.

A ladder is greedy. Where two simple effects are missing, a law with many numbers may explain a part
of both and join first; later rungs then explain what it left, and it stays, for by then something
has to do its part. Nothing but another climb without it shows that two simpler names do as well.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from ..effects import AbstractEffect
from ..recording import Experiment
from .curves import candidates as candidates_for
from .ladder import MATTERS, MORE_THAN_NOISE, accepted, needless, ranked, with_another
from .missing_torque import MissingTorque
from .rung import Step
from .suspects import search, seen_afresh

_TRIED = 2  # of a rung's candidates that may be the next one
_RIVAL = 0.5  # share of what an effect explained that another one must, for a climb without it


class Climbed(NamedTuple):
    """The rungs of the climb that stands, and where others ended."""

    steps: list[Step]
    others: list[Step]


def climb(
    experiment: Experiment,
    base: Step,
    torques: Sequence[MissingTorque],
    most: int,
    say: Callable[[str], None],
) -> Climbed:
    """The rungs from the base model up, with at most so many effects joining it; `torques` are what
    is missing along each fitted recording."""
    candidates, first = candidates_for(base.fit.model), len(base.effects)
    ladder = _Ladder(experiment, torques, first, most, say)
    steps, ends = ladder.up(base, candidates), []
    for effect in steps[-1].effects[first:]:
        at = next(i for i, s in enumerate(steps) if effect.label in s.fit.model.labels) - 1
        left = without(steps[at], effect, room=effect is steps[-1].effects[-1])
        if left is None:
            continue
        say(f"looking once more without {effect.label}")
        others = [c for c in candidates if c.label != effect.label]
        instead = [*steps[:at], *ladder.up(left, others)]
        if does_better(instead[-1], steps[-1], first):
            return Climbed(instead, [steps[-1]])
        ends.append(instead[-1])
    return Climbed(steps, ends)


class _Ladder(NamedTuple):
    """What a climb needs on every rung."""

    experiment: Experiment
    torques: Sequence[MissingTorque]
    first: int  # effects that were there from the start
    most: int  # effects that may join
    say: Callable[[str], None]

    def up(self, step: Step, candidates: Sequence[AbstractEffect]) -> list[Step]:
        """The rungs from a step up: itself, looked at, and what follows."""
        firm, waits = 0, False
        steps: list[Step] = []
        while True:
            full = len(step.effects) - self.first >= self.most
            step = seen_afresh(step, self.torques)
            # What might come next matters only if it may; and a step may have been looked at.
            if not step.screened and (not full or not steps):
                step = search(step, self.experiment, self.torques, candidates, self.say)
            steps.append(step)
            firm = firm if waits else len(steps) - 1
            if full:
                return steps[: firm + 1]
            new = None
            for chosen in ranked(step)[:_TRIED]:
                found = accepted(step, chosen, self.experiment, steps[firm])
                if found is not None and (new is None or found.firm):
                    new = found
                if new is not None and new.firm:
                    break
            if new is None and not waits:
                new = with_another(step, self.experiment)
            if new is None:
                return steps[: firm + 1]
            label = new.step.effects[-1].label
            self.say(f"{label} joins the model" if new.firm else f"looking on with {label}")
            waits = not new.firm
            step = needless(new.step, self.experiment, self.first)
            # What has become needless does not come back, or the ladder might go round and round.
            gone = set(new.step.fit.model.labels) - set(step.fit.model.labels)
            candidates = [c for c in candidates if c.label not in gone]


def without(step: Step, effect: AbstractEffect, room: bool = False) -> Step | None:
    """The step from which an effect joined, as if it could not; None where no law with fewer
    numbers explained much of what it did; `room`: with so many fewer that another one could join,
    for nothing else has joined beside it that may do the rest. Of a law and the one that it extends
    the rung has decided."""
    own = next((r for r in step.refits if r.label == effect.label), None)
    if own is None or (room and effect.extends is not None):
        return None
    leaner = [r for r in step.refits if r.possible and r.numbers + room < own.numbers]
    most = max((step.cost - r.cost for r in leaner), default=0.0)
    if not leaner or most < _RIVAL * (step.cost - own.cost):
        return None
    return step._replace(
        screened=tuple(s for s in step.screened if s.effect.label != effect.label),
        refits=tuple(r for r in step.refits if r is not own),
    )


def does_better(one: Step, other: Step, first: int) -> bool:
    """Whether one climb's end is to be preferred to another's. Where both leave more than noise,
    every number bends to what no name explains: then it is only if the error is less by what
    matters."""
    if price(one, first, other) >= price(other, first, one):
        return False
    left = min(one.cost, other.cost) / one.readings
    return left <= MORE_THAN_NOISE or one.cost < (1.0 - MATTERS) ** 2 * other.cost


def price(step: Step, first: int, other: Step) -> float:
    """Chi-square of a step in units of what the better one of two leaves, plus what the effects
    beyond the `first` ones cost: each its numbers, and that it is one of so many that might be."""
    unit = max(1.0, min(step.cost, other.cost) / step.readings)
    added = step.effects[first:]
    choice = 2.0 * math.log(len(added) + len(candidates_for(step.fit.model)))
    return step.cost / unit + sum(step.price(e) + choice for e in added)
