"""Whom to suspect: all candidates are screened, those that deserve it are fitted.

The screen costs one simulation for all of them and is right to first order, along a motion that is
known but for noise. A fit takes as long as a fit and is right, if it ends in the right valley. So
few are fitted at first; only as long as none of them explains what is missing, more are, and those
that may have lost their way begin again.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from ..effects import AbstractEffect
from ..fitting.problem import posed
from ..recording import Experiment
from .curves import likeliest
from .linear import Near, steadied
from .missing_torque import MissingTorque
from .path import Path
from .refits import beginning_at, extending, refits
from .rung import Refit, Step, worth
from .screen import Screened, glance, left_over, screen, sharpened
from .valleys import beside_a_mode, none_lost, usual
from .verdict import LEFT

_REFITS = 6  # candidates that are fitted
_LATER = 4  # the same, beside a model that has an effect already: each takes longer
_CLOSE = 1.25  # a candidate this many times worse than the best, screened, is not fitted
_ROUGHLY = 3.0  # the same where not even the best one comes near the noise
_SHARE = 0.2  # but is, if it explains as much as the best but for this share
_FEWEST = 3
_DRAWN = 3  # that draw the missing torque best, fitted where none promises to come near the noise
_AS_GOOD = 0.9  # of what the best one explains: whose motion may be that of others, not fitted yet
_HALF = 0.5  # of the best promise: fitted where none of the first fits comes to the noise
_PAUSES = 50  # of a motion without a mode: a rest that long is one
_NEAR = 2.0  # times the noise: a fit as good as this knows the motion
_ROUNDS = 2  # of twins: of the best, and of a twin that ended below it
_GLANCE = 0.6  # of what a newcomer must bring: less, and it is not even screened


class _View(NamedTuple):
    """From where candidates are looked at."""

    near: Near
    paths: Sequence[Path]
    led: bool
    """Whether the model is led along the paths; else they are its own."""

    @classmethod
    def of(cls, step: Step, missing: Sequence[MissingTorque]) -> "_View":
        """Near the noise along the fit's own motion: it has no noise in it; but not along that of
        an arm without springs, which has found some other way to be near."""
        longest = max(r.recording.duration for r in step.near.fitted)
        period = 1.0 / step.fit.modes[0].frequency_hz if step.fit.modes else longest / _PAUSES
        near = steadied(step.near)
        springless = _springs(near) != _springs(step.near) and not step.effects
        led = step.cost > _NEAR * step.readings or springless
        near = near if led else step.near
        paths = [
            Path.of(m, int(near.problem.steps), period, None if led else r.predicted)
            for m, r in zip(missing, step.near.fitted, strict=True)
        ]
        return cls(near, paths, led)

    def sharper(self, some: Sequence[Screened]) -> list[Screened]:
        """Candidates with their shapes between the grid's values."""
        return sharpened(self.near, self.paths, some, self.led)


def _springs(near: Near) -> list[float]:
    fitted = zip(near.fit.model.fitted, near.fit.model.vector(), strict=True)
    return [float(x) for n, x in fitted if n.name.startswith("spring:")]


def search(
    step: Step,
    experiment: Experiment,
    missing: Sequence[MissingTorque],
    candidates: Sequence[AbstractEffect],
    say: Callable[[str], None],
) -> Step:
    """Screen all candidates beside a model, and fit those that deserve it."""
    there, first = set(step.fit.model.labels), step.tried is None
    some = [c for c in candidates if c.label not in there]
    if not first and _nothing_to_see(step, some):
        return step
    say(f"screening {len(some)} effects")
    view = _View.of(step, missing)
    alone, found, kept = screen(view.near, view.paths, some, view.led, any_shape=first)
    step = step.seen_with(kept) if first else step
    tried = _promising(step, found, alone, view.led, _REFITS if first else _LATER)
    if first and tried and tried[0].chi2 > _NEAR * step.readings:
        # No small change of the motion as it was explains it; the missing torque still may.
        models = [posed(step.fit.model, m) for m in step.near.ready.mechanisms]
        also = likeliest(models, missing, some, _DRAWN) - {s.effect.label for s in tried}
        tried += [s for s in found if s.effect.label in also]
    tried = view.sharper(tried)
    names = ", ".join(s.effect.label for s in tried)
    say(f"fitting {names}" if names else "nothing worth fitting")
    fitted = refits(step, experiment, tried)
    # Later on the best of them is in the model, and what is left is small.
    if first and tried:
        lost = _unexplained(step, fitted)
        more = view.sharper(_next_best(step, found, tried)) if lost else []
        if more:
            say(f"fitting {', '.join(s.effect.label for s in more)}, too")
            fitted, tried = [*fitted, *refits(step, experiment, more)], [*tried, *more]
        fitted = none_lost(step, experiment, fitted)
        sounds = beside_a_mode(step, experiment, found, fitted)
        if sounds is not None:
            fitted = [sounds, *(r for r in fitted if r.label != sounds.label)]
    fitted, kin = _with_twins(step, experiment, view, found, fitted, say)
    tried = [*tried, *kin]
    fitted = extending(step, experiment, fitted)
    finer = {s.effect.label: s for s in tried}
    found = sorted((finer.get(s.effect.label, s) for s in found), key=lambda s: s.chi2)
    return step._replace(alone=alone, seen=kept, screened=tuple(found), refits=tuple(fitted))


def seen_afresh(step: Step, missing: Sequence[MissingTorque]) -> Step:
    """The step, looked at with torques of any shape along its own motion, if those along a measured
    one are all that says something is left: what noise has led knows that noise."""
    if step.unnamed is None or step.tried is None or not step.tried.led:
        return step
    if step.white >= LEFT or step._replace(unnamed=None).white < LEFT:
        return step
    view = _View.of(step, missing)
    if view.led:
        return step
    _, _, seen = screen(view.near, view.paths, [], view.led, any_shape=True)
    return step._replace(unnamed=left_over(step.near, step.slopes, seen))


def _nothing_to_see(step: Step, candidates: Sequence[AbstractEffect]) -> bool:
    """Whether the first rung's answers, as directions to look into, promise nothing any more."""
    assert step.tried is not None
    drops, unit = glance(step.near, step.slopes, step.tried), max(1.0, step.cost / step.readings)
    return all(drops.get(c.label, 0.0) <= _GLANCE * worth(c, step) * unit for c in candidates)


def _promising(
    step: Step, found: Sequence[Screened], alone: float, led: bool, most: int
) -> list[Screened]:
    """Those that are fitted first, the best one first."""
    tried = [s for s in found if s.drop > (0.5 if led else 0.8) * worth(s.effect, step)]
    if not tried:
        return []
    best, noise = tried[0].chi2, float(step.readings)
    enough = (_CLOSE if best < _NEAR * noise else _ROUGHLY) * max(best, noise)
    # Where noise is small, the best of a grid's shapes is not near it, and yet near the truth.
    enough = max(enough, best + _SHARE * (alone - best))
    return [s for i, s in enumerate(tried) if i < _FEWEST or s.chi2 < enough][:most]


def _unexplained(step: Step, fitted: Sequence[Refit]) -> bool:
    """Whether no fit came down to the noise."""
    return min([step.cost, *(r.cost for r in fitted)]) > usual(step)


def _next_best(step: Step, found: Sequence[Screened], tried: Sequence[Screened]) -> list[Screened]:
    """Those that promise some of what the best one does. The screen is right to first order only:
    what it puts further down may explain the rest."""
    told, most = {s.effect.label for s in tried}, max(s.drop for s in found)
    left = [s for s in found if s.effect.label not in told]
    return [s for s in left if s.drop > max(_HALF * most, worth(s.effect, step))][:_REFITS]


def _with_twins(
    step: Step,
    experiment: Experiment,
    view: _View,
    found: Sequence[Screened],
    fitted: list[Refit],
    say: Callable[[str], None],
) -> tuple[list[Refit], list[Screened]]:
    """Fits, with those of whatever may be the same motion as the best of them, and of the best once
    more where such a twin has ended below it; and how the twins began."""
    tried: list[Screened] = []
    begun: set[tuple[str, float]] = set()
    for round_ in range(_ROUNDS):
        pairs = _kin(step, found, fitted)
        if round_:  # a twin of a twin may be of another kind
            ended = {r.label for r in fitted}
            pairs = [(s, r) for s, r in pairs if s.effect.label in ended]
        pairs = [(s, r) for s, r in pairs if (s.effect.label, r.cost) not in begun]
        if not pairs:
            break
        say(f"fitting what may be the same motion: {', '.join(s.effect.label for s, _ in pairs)}")
        begun |= {(s.effect.label, r.cost) for s, r in pairs}
        sharp = view.sharper([s for s, _ in pairs])
        kin = [beginning_at(step, r, s) for s, (_, r) in zip(sharp, pairs, strict=True)]
        fitted, tried = _better(fitted, refits(step, experiment, kin)), [*tried, *kin]
    return fitted, tried


def _kin(
    step: Step, found: Sequence[Screened], fitted: Sequence[Refit]
) -> list[tuple[Screened, Refit]]:
    """Those whose motion may be the same as that of one of the best, and that one, from whose end
    they are to be fitted: what the screen says of them it says along another motion. Not fitted
    again are those that ended where that one did."""
    ended = {r.label: r.cost for r in fitted}
    most = max((step.cost - r.cost for r in fitted), default=0.0)
    best = [r for r in sorted(fitted, key=lambda r: r.cost) if r.possible]
    best = [r for r in best if step.cost - r.cost > max(worth(r.effect, step), _AS_GOOD * most)]
    pairs = []
    for s in found:
        twin = next((r for r in best if resemble(s.effect, r.effect)), None)
        if twin is None:
            continue
        near = twin.cost + worth(s.effect, step) * max(1.0, twin.cost / step.readings)
        if ended.get(s.effect.label, math.inf) > near:
            pairs.append((s, twin))
    return pairs


def _better(found: Sequence[Refit], more: Sequence[Refit]) -> list[Refit]:
    """Fits of different candidates, of those fitted twice the better one."""
    each = {r.label: r for r in found}
    for r in more:
        if r.label not in each or r.cost < each[r.label].cost:
            each[r.label] = r
    return list(each.values())


def resemble(one: AbstractEffect, other: AbstractEffect) -> bool:
    """Whether two effects act at the same place and their motion can be the same."""
    told = [(a.extends, *a.resembles) for a in (one, other)]
    return one.place == other.place and (other.name in told[0] or one.name in told[1])
