"""From an experiment to the name of what is missing: look, screen, fit, climb, and say how sure."""

import time
from collections.abc import Callable, Sequence

import jax
import numpy as np

from ..effects import AbstractEffect
from ..fitting import DEFAULT_STARTS, fit
from ..model import Model
from ..recording import Experiment
from .chances import alike, chances, one_law, together
from .climb import Climbed, climb
from .comparison import Comparison
from .horizon import horizon
from .ladder import ranked
from .missing import Missing, along_each, missing_of, with_curves
from .next_experiment import advise
from .result import Candidate, Diagnosis, NextExperiment, Rung, Value
from .rung import Step, cost_of, extends, stand
from .verdict import LEFT, verdict_on, words_for

MOST_EFFECTS = 3
"""How many effects the ladder adds unless it is told otherwise."""

_DRAWN = 2  # suspects that did not join, whose curves are drawn


def diagnose(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    max_effects: int = MOST_EFFECTS,
    starts: int = DEFAULT_STARTS,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Which physical effect is missing from springs and dampers, how sure that is, what else it
    might be, and how far the error falls with it.

    Effects join the model one by one, as long as each is sure and matters, in the readings that
    were fitted and in those that were not. Runs in float64 whatever JAX's setting.

    **Arguments:**

    - `experiment`: from `residyn.load`, or made of arrays.
    - `effects`: what is in the model from the start, beside springs and dampers: `name`,
      `name:joint`, or an effect.
    - `max_effects`: how many the ladder may add, at least 0.
    - `starts`: how many starts the first fit tries, at least 1.
    - `progress`: called with a few words as each phase begins.

    **Returns:** a `Diagnosis`: print it, or `to_dict()`.

    **Raises:** `FitError` if no start led to finite numbers; `ValueError` for an effect that does
    not exist or does not go with this experiment, or a negative `max_effects`.
    """
    if max_effects < 0:
        raise ValueError(f"max_effects = {max_effects}: it cannot be negative")
    began, say = time.perf_counter(), progress or (lambda words: None)
    base = fit(experiment, effects=effects, starts=starts, progress=say)
    experiment = base.experiment  # in stretches, if need be
    with jax.enable_x64(True):
        say("looking where the residual is")
        own = tuple(e for e in base.model.effects if e.name not in ("spring", "damper"))
        first = stand(base, own)
        say("following the missing torque")
        missing = missing_of(base, ())
        climbed = climb(experiment, first, along_each(base, missing), max_effects, say)
        say("weighing the names")
        return _concluded(experiment, climbed, missing, began, say)


def _concluded(
    experiment: Experiment,
    climbed: Climbed,
    missing: tuple[Missing, ...],
    began: float,
    say: Callable[[str], None],
) -> Diagnosis:
    steps = climbed.steps
    first, last = steps[0], steps[-1]
    rungs = _rungs(steps)
    kept = [r.added for r in rungs[1:] if r.added in last.fit.model.labels]
    seen, instead = first.unnamed, ""
    if seen is not None and seen.law is not None and last.white >= LEFT and len(kept) > 1:
        instead = seen.law.words if one_law(steps) > 1.0 else ""
    verdict = verdict_on(last, bool(kept), bool(instead))
    sure = chances(steps, climbed.others)
    candidates = _candidates(first, sure)
    groups, advice = [], None
    for step, rung in zip(steps, rungs[1:], strict=False):
        if rung.added not in kept or rung.added is None:
            continue
        group = alike(step, rung.added)
        both = together(last, climbed.others, rung.added)
        if len(group) > 1 or both:
            groups.append((*group, *(x for x in both if x not in group)))
        if len(group) > 1 and advice is None:
            say("looking for the experiment that would tell them apart")
            advice = _advice(step, experiment, group)
    shown = [r.effect for step in steps for r in step.refits if r.label in kept]
    shown += [r.effect for r in ranked(first) if r.label not in kept][:_DRAWN]
    missing = with_curves(first.fit, missing, shown)
    left = missing if last is first else missing_of(last.fit) if verdict == "unexplained" else ()
    compared = Comparison(last.fit, last.where, last.held_out, horizon(last.near), left)
    told = [(k, sure.get(k, 0.0)) for k in kept]
    words = words_for(verdict, first.fit, last, told, groups, instead)
    return Diagnosis(
        verdict=verdict,
        ladder=rungs,
        candidates=candidates,
        lookalikes=tuple(groups),
        next_experiment=advice,
        missing=missing,
        comparison=compared,
        words=words,
        seconds=time.perf_counter() - began,
    )


def _rungs(steps: Sequence[Step]) -> tuple[Rung, ...]:
    found, before = [], None
    for step in steps:
        labels = [e.label for e in step.effects]
        added = None if before is None else labels[-1]
        dropped = tuple(x for x in before or () if x not in labels)
        found.append(Rung(added, dropped, step.fit, step.held_out, step.white))
        before = labels
    return tuple(found)


def _candidates(first: Step, sure: dict[str, float]) -> tuple[Candidate, ...]:
    """Everything that was screened beside the base model; numbers as refitted where they were."""
    found = []
    before = cost_of(first.fit)
    refits = {r.label: r for r in first.refits}
    for s in first.screened:
        label = s.effect.label
        refit = refits.get(label)
        alone = Model(first.fit.model.mechanism, (s.effect,))
        values = np.asarray(alone.vector())
        spread = np.full(len(values), np.nan)
        if refit is not None:
            values = np.asarray(refit.model.vector())[-len(values) :]
            spread = refit.std[-len(values) :]
        units = first.fit.model.mechanism.units
        numbers = {
            n.name: Value(
                float(x), float(e), n.meaning.dimension.unit(units[n.joint or 0] if units else None)
            )
            for n, x, e in zip(alone.fitted, values, spread, strict=True)
        }
        found.append(
            Candidate(
                label,
                sure.get(label, 0.0),
                max(0.0, s.drop),
                None if refit is None else before - refit.cost,
                numbers,
            )
        )

    def order(c: Candidate):
        drop = c.chi2_drop_screened if c.chi2_drop_refit is None else c.chi2_drop_refit
        return (-round(c.probability, 6), c.chi2_drop_refit is None, -drop)

    return tuple(sorted(found, key=order))


def _advice(step: Step, experiment: Experiment, group: tuple[str, ...]) -> NextExperiment | None:
    by_name = {r.label: r for r in step.refits}
    rivals = [by_name[name] for name in group]
    # A law that contains the other one can always mimic it: no experiment tells, but by its value.
    others = [r for r in rivals[1:] if not extends(r, rivals[0])]
    return advise(step, experiment, rivals[0], others[0]) if others else None
