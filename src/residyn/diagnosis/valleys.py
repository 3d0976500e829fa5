"""Out of wrong valleys: fits that begin again where no phase can slip.

Joints that stick or rattle make chi-square a landscape of many valleys: a few cycles out of step, a
model improves by no small change. Stretches of a few cycles cannot be out of step; nor can the
first cycles, if later ones join only when those fit.
"""

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np

from .._stretches import in_stretches
from ..effects import AbstractEffect
from ..fitting.base_first import usual as usual_of
from ..fitting.pipeline import begin_afresh, refit
from ..fitting.result import FitError
from ..model import Model
from ..recording import Experiment
from .joined import possible, silent
from .rung import Refit, Step, worth
from .screen import Screened

PROMISED = 1.5
"""Times the screened chi-square: a fit that ends worse starts again."""
_FAR = 10.0  # times what the screen promised
_VALLEYS = 2  # candidates that are fitted stage by stage
_MUCH = 0.5  # of the best promise
_PLAIN = 2.0  # times the noise: something plain is missing
_STRETCH = 2.0  # cycles of the slowest mode in a stretch, at least
_JOINED = 3  # stretches make one of the next longer ones


def out_of_valleys(step: Step, experiment: Experiment, found: list[Refit]) -> list[Refit]:
    """Refits, some of which began again.

    Where the best fits of effects that stick or rattle end above the noise, they start from what
    stretches of a few cycles say, from where the screen began and the fit ended with the first
    cycles fitted first, and from where a fit by name begins. So does whatever the screen puts
    first, if its fit is nowhere near what was promised, and the first of such effects that would
    have been the best, had it kept its promise.
    """
    noise = usual(step)
    # One of the wrong sign, too: that is a wrong valley's usual mark.
    by_cost = sorted(found, key=lambda r: r.cost)
    promised = sorted(found, key=lambda r: r.screened.chi2)

    def slips(r: Refit) -> bool:
        return (r.effect.dry or r.effect.rough) and r.cost > noise

    def broke(r: Refit, times: float) -> bool:
        return r.cost > times * max(r.screened.chi2, noise)

    again = [r for r in promised[:1] if broke(r, _FAR)]
    rivals = [r for r in promised if slips(r) and broke(r, PROMISED)]
    again += [r for r in rivals if by_cost and r.screened.chi2 < by_cost[0].cost][:1]
    again += [r for r in by_cost[:_VALLEYS] if slips(r)]
    wild = [r.wild for r in step.near.fitted]
    for r in {r.label: r for r in again}.values():
        alone = Model(step.fit.model.mechanism, (r.effect,))
        ended = np.asarray(r.model.vector()), r.descent.problem.states(r.descent.unknowns)
        begins = [(r.start, r.screened.states), ended]
        for numbers, states in [*_from_stretches(step, experiment, r), *begins]:
            try:
                model, descent = refit(
                    experiment,
                    (*step.effects, silent(r.effect)),
                    np.asarray(numbers)[None],
                    np.asarray(states)[None],
                    wild,
                    staged=True,
                )
            except FitError:
                continue
            if descent.cost < r.cost:
                could = possible(step, model, descent, alone)
                new = r._replace(model=model, descent=descent, possible=could)
                found = [new if x.label == r.label else x for x in found]
                r = new
        if not r.possible or slips(r):
            found = [afresh(step, experiment, r) if x.label == r.label else x for x in found]
    return found


def near_noise(step: Step, r: Refit) -> bool:
    """Whether a law that sticks or rattles came so near the noise that it was not tried again,
    though a valley beside the right one is as near."""
    return (r.effect.dry or r.effect.rough) and r.cost <= usual(step)


def usual(step: Step) -> float:
    """Chi-square that noise does not often exceed."""
    return usual_of(step.readings)


def afresh(step: Step, experiment: Experiment, r: Refit) -> Refit:
    """The same candidate from where a fit by name begins, of which nothing is known yet, or as it
    was, if that is better."""
    alone = Model(step.fit.model.mechanism, (r.effect,))
    for start, model, descent in _by_name(step, experiment, r.effect):
        if descent.cost < r.cost:
            could = possible(step, model, descent, alone)
            r = r._replace(model=model, descent=descent, start=start, possible=could)
    return r._replace(by_name=True)


def none_lost(step: Step, experiment: Experiment, found: list[Refit]) -> list[Refit]:
    """Refits, those of laws that stick or rattle from where a fit by name begins, too: where none
    of them explains what is missing, any may have lost its way; where one does, those that promised
    much of what it brings and brought less, for in much noise wrong valleys are as near it."""
    if not found:
        return found
    lost = {r.label for r in found if (r.effect.dry or r.effect.rough) and not r.by_name}
    best = min(found, key=lambda r: r.cost)
    if best.cost <= usual(step):
        most = max(r.screened.drop for r in found)
        lost &= {r.label for r in found if r is not best and r.screened.drop > _MUCH * most}
        lost &= {r.label for r in found if _short(r, step) > worth(r.effect, step)}
    return [afresh(step, experiment, r) if r.label in lost else r for r in found]


def _short(r: Refit, step: Step) -> float:
    """By how much less chi-square fell than the screen has promised, in units of what is left."""
    return (r.screened.drop - (step.cost - r.cost)) / max(1.0, r.cost / step.readings)


def beside_a_mode(
    step: Step, experiment: Experiment, screened: Sequence[Screened], found: Sequence[Refit]
) -> Refit | None:
    """An oscillation that explains all that is missing, where no other fit comes near that, however
    near a mode it is.

    So near, a little of it mimics any effect: no other candidate may be judged beside it. But
    nothing mimics the whole of a missing effect down to the noise by chance.
    """
    noise = usual(step)
    if min([step.cost, *(r.cost for r in found)]) < _PLAIN * noise:
        return None
    for s in screened:
        if s.effect.oscillates is not None:
            for start, model, descent in _by_name(step, experiment, s.effect):
                if descent.cost <= noise:
                    return Refit(s.effect, s, model, descent, start, True, True)
    return None


def _by_name(step: Step, experiment: Experiment, effect: AbstractEffect):
    """Fits from where a fit by name begins: (numbers there, model, where it ended). One start after
    the other: that program is compiled already."""
    effects, wild = (*step.effects, silent(effect)), [x.wild for x in step.near.fitted]
    numbers, memory = begin_afresh(experiment, effects, wild)
    for i, row in enumerate(numbers):
        own = None if memory is None else memory[i : i + 1]
        with contextlib.suppress(FitError):
            yield row, *refit(experiment, effects, row[None], None, wild, memory=own)


def _from_stretches(step: Step, experiment: Experiment, r: Refit):
    """Where fits of ever longer stretches of the recordings end, each stretch begun afresh:
    (numbers, states), or nothing.

    A few cycles cannot slip, and all of them together know the numbers nearly as well as the whole
    does; from there the next longer ones cannot slip either.
    """
    wholes = [x for x in experiment.recordings if x.role == "fit"]
    if not step.fit.modes:
        return []
    cycles = max(x.duration for x in wholes) * step.fit.modes[0].frequency_hz
    level = int(math.log(max(1.0, cycles / _STRETCH), _JOINED))
    effects = (*step.effects, silent(r.effect))
    numbers, states = np.asarray(r.start)[None], None
    for many in [_JOINED**i for i in range(level, 0, -1)]:
        parts = [in_stretches(x, x.duration / many) for x in wholes]
        wild = []
        for each, whole in zip(parts, step.near.fitted, strict=True):
            edges = np.cumsum([len(p.time) for p in each])[:-1]
            wild += np.split(whole.wild, edges)
        cut = dataclasses.replace(experiment, recordings=tuple(itertools.chain(*parts)))
        try:
            model, descent = refit(cut, effects, numbers, states, wild)
        except FitError:
            return []
        numbers = np.asarray(model.vector())[None]
        # Every third stretch begins where a longer one does.
        states = np.asarray(descent.problem.states(descent.unknowns))[None, ::_JOINED]
    return [] if states is None else [(numbers[0], states[0])]
