"""How sure a name is: what speaks for it beside what else it might have been.

Three things can be wrong with a name. Another effect of the catalogue may explain the recording as
well: their chi-squares say how likely that is, in units of what even the best one leaves, and of
how many readings that is correlated over. Its numbers may be bought: each costs what it would gain
from noise. Or what is missing may be in no catalogue at all: then something is left, and no
certainty among the known names is certainty.
"""

import math
from collections.abc import Sequence

import numpy as np

from ..effects import AbstractEffect
from ..fitting.result import RecordingFit
from ..model import Model
from .climb import price
from .ladder import left_by, ranked, score, simpler
from .rung import Refit, Step, cost_of, numbers_of
from .verdict import LEFT

_ALIKE = 12.0  # of chi-square, in its units: closer names are not told apart
_MOST = 0.88  # probability of any name while something that is not noise is left
_FIRST_ORDER = 4.0  # of chi-square, in its units: two standard deviations of what noise brings
_SMALL = 100.0  # the same, of what is missing: first order is right to about a hundredth of it
_STRANGE = 0.1  # odds, before any look, that what is missing is in no catalogue


def correlated(fits: Sequence[RecordingFit]) -> float:
    """Over how many readings a residual is correlated: 1 for white noise."""
    longest = 1.0
    for fit in fits:
        for j in range(fit.residual.shape[1]):
            x = np.where(fit.used[:, j], fit.residual[:, j], 0.0)
            size = len(x)
            power = np.abs(np.fft.rfft(x, 2 * size)) ** 2
            r = np.fft.irfft(power)[: size // 4]
            if r[0] > 0:
                # Up to where it first crosses zero; ringing beyond is the same cycle again.
                crosses = np.flatnonzero(r <= 0)
                stop = crosses[0] if len(crosses) else len(r)
                longest = max(longest, 1.0 + 2.0 * float(np.sum(r[1:stop])) / float(r[0]))
    return longest


def temper(step: Step) -> float:
    """By how much chi-squares of a rung are to be divided before they are believed."""
    best = ranked(step)
    if not best:
        return 1.0
    fits = best[0].descent.beside([r.recording for r in step.near.fitted])
    return correlated(fits)


def chances(steps: Sequence[Step], others: Sequence[Step] = ()) -> dict[str, float]:
    """Probability of every candidate; `steps` from the base model up, the last one being the model
    that stands; `others` are where other climbs ended."""
    last = steps[-1]
    found: dict[str, float] = {}
    joined: dict[str, float] = {}
    several = 1.0 / (1.0 + one_law(steps))
    for rung, step in enumerate(steps):
        each = _among(step)
        follows = steps[rung + 1] if rung + 1 < len(steps) else None
        for label, share in each.items():
            sure = _known(step, follows or step, last.white, label)
            joins = follows and follows.effects and follows.effects[-1].label == label
            if rung == 0 or joins:
                found[label] = share * sure
            if joins:
                joined[label] = share * sure
        for effect in follows.effects if follows else ():
            if effect.label not in last.fit.model.labels:  # it was to become needless
                odds = step.readings ** (-0.5 * numbers_of(effect, last.fit.model, 1))
                found[effect.label] = min(found.get(effect.label, 1.0), odds / (1.0 + odds))
    for effect in _added(steps):
        # Who took over from a simpler law is at least as sure as that one was: it contains it.
        plain = f"{effect.extends}:{effect.place}"
        if plain not in last.fit.model.labels:
            found[effect.label] = max(found.get(effect.label, 0.0), joined.get(plain, 0.0))
        found[effect.label] = several * found.get(effect.label, 0.0)
    names = [e.label for e in _added(steps)]
    if names:
        # Who was likely at first and did not join has only what is left by those that did.
        most = 1.0 - min(found[n] for n in names)
        found = {n: p if n in names else min(p, most) for n, p in found.items()}
    return _shared(steps, others, found)


def _shared(
    steps: Sequence[Step], others: Sequence[Step], found: dict[str, float]
) -> dict[str, float]:
    """What one climb's names have, shared with those of climbs that ended nearly as well without
    them: by what each leaves and its numbers cost."""
    if not others:
        return found
    last, first = steps[-1], len(steps[0].effects)
    names = [e.label for e in _added(steps)]
    unit = temper(steps[-2]) if len(steps) > 1 else 1.0
    lead = [(price(x, first, last) - price(last, first, x)) / unit for x in others]
    odds = [math.exp(-0.5 * min(1e3, max(0.0, x))) for x in lead]
    total = 1.0 + sum(odds)
    ends = [
        (o / total, [e.label for e in x.effects[first:]]) for o, x in zip(odds, others, strict=True)
    ]
    shared = {n: p * (1.0 - sum(o for o, end in ends if n not in end)) for n, p in found.items()}
    for own, end in ends:
        # A name of another climb only is as sure there as those are here that it does without.
        gone = [found[n] for n in names if n not in end]
        for n in end:
            if n not in names and gone:
                shared[n] = max(shared.get(n, 0.0), min(gone) * own)
    return shared


def one_law(steps: Sequence[Step]) -> float:
    """Odds that what the names explain is one law that no catalogue has.

    Some law of an angle or a rate may explain as much as several names with fewer numbers. Each
    number is worth the logarithm of the number of readings, as it is between names. Beside a single
    name it is a fair rival only where first order, which is all that is known of the law, can be
    believed: where what is missing is small, and first order was right about the name.
    """
    first, last, names = steps[0], steps[-1], _added(steps)
    law = None if first.unnamed is None else first.unnamed.law
    if law is None or not names:
        return 0.0
    scale = max(1.0, last.cost / last.readings)
    explained = first.cost - last.cost
    if len(names) == 1:
        own = next((r for r in first.refits if r.label == names[0].label), None)
        if own is None or explained > _SMALL * scale:
            return 0.0
        if abs(explained - own.screened.drop) > _FIRST_ORDER * scale:
            return 0.0
        explained = own.screened.drop
    recordings = len(last.near.fitted)
    more = sum(numbers_of(e, last.fit.model, recordings) for e in names) - law.freedom
    lost = (explained - law.drop) / scale
    return _STRANGE * math.exp(min(500.0, 0.5 * (more * math.log(last.readings) - lost)))


def _added(steps: Sequence[Step]) -> list[AbstractEffect]:
    """The effects that the ladder added and that stand."""
    own = {e.label for e in steps[0].effects}
    return [e for e in steps[-1].effects if e.label not in own]


def _among(step: Step) -> dict[str, float]:
    """How a rung's candidates share what there is to share, nobody among them."""
    unit = temper(step)
    rebates = {r.label: rebate(r, step) for r in step.refits if r.possible}
    scores, last = {}, -math.inf
    most = math.log(step.readings)
    for r in sorted((r for r in step.refits if r.possible), key=lambda r: score(step, r)):
        # What it costs less never makes it likelier than one that is ranked before it.
        last = max(last, left_by(step, r) + r.numbers * most - rebates[r.label])
        scores[r.label] = last
    least = min([*(r.cost for r in step.refits), step.cost])
    scale = max(1.0, least / step.readings)
    # Who was not fitted is believed as far as the others have kept what the screen promised.
    kept = [r.cost / max(r.screened.chi2, least) for r in step.refits]
    promised = max(1.0, float(np.median(kept))) if kept else 1.0
    each = [most - rebates[r.label] / r.numbers for r in step.refits if r.possible]
    worth = float(np.median(each)) if each else most
    for s in step.screened:
        numbers = len(Model(step.fit.model.mechanism, (s.effect,)).fitted)
        if not any(r.label == s.effect.label for r in step.refits):
            chi2 = max(promised * s.chi2, least)
            scores[s.effect.label] = chi2 / scale + numbers * worth
    nobody = step.cost / scale
    best = min([*scores.values(), nobody])
    weights = {k: math.exp(-0.5 * min(1e3, (x - best) / unit)) for k, x in scores.items()}
    total = sum(weights.values()) + math.exp(-0.5 * min(1e3, (nobody - best) / unit))
    impossible = {r.label: 0.0 for r in step.refits if not r.possible}
    return {**{k: w / total for k, w in weights.items()}, **impossible}


def rebate(refit: Refit, step: Step) -> float:
    """What a candidate's numbers cost less than the logarithm of the number of readings each.

    Those that the recordings do not determine cost less: at which angle a brake slips that slipped
    once, at the release, was no lucky guess. And of a law with more to it than another one that was
    fitted, what is more costs but what noise would gain (Akaike): a friction that falls off at
    rates too small to be seen is dry friction, as far as anyone can tell.
    """
    most = math.log(step.readings)
    less = refit.numbers * most - refit.price(step.readings)
    plain = simpler(step, refit)
    return less if plain is None else max(less, (refit.numbers - plain.numbers) * (most - 2.0))


def _known(before: Step, after: Step, white: float, label: str) -> float:
    """Probability that it is in the catalogue at all."""
    if white >= LEFT:
        # What is left may still be what no name explains, too small to be sure of: the most that a
        # probability p can say for that (Sellke, Bayarri and Berger 2001).
        p = max(white, 1e-300)
        against = 1.0 / (-math.e * p * math.log(p)) if p < 1 / math.e else 1.0
        return 1.0 / (1.0 + _STRANGE * (against - 1.0))
    refit = next((r.cost for r in before.refits if r.label == label), before.cost)
    cost = min(refit, cost_of(after.fit)) if after is not before else refit
    excess = before.cost - before.readings
    explained = (before.cost - cost) / excess if excess > 0 else 0.0
    return _MOST * float(np.clip(explained, 0.0, 1.0)) ** 2


def alike(step: Step, accepted: str) -> tuple[str, ...]:
    """The names that a rung's fits cannot tell from the accepted one, which comes first."""
    unit = temper(step) * max(1.0, min(r.cost for r in step.refits) / step.readings)
    own = next(r for r in step.refits if r.label == accepted)
    others = [r for r in ranked(step) if r.label != accepted]
    close = [r.label for r in others if r.cost - own.cost < _ALIKE * unit]
    return (accepted, *close)


def together(last: Step, others: Sequence[Step], name: str) -> tuple[str, ...]:
    """The names in place of an accepted one, and maybe of more, in a climb that ended as near the
    readings."""
    now, found = last.fit.model.labels, []
    for end in others:
        instead = end.fit.model.labels
        scale = max(1.0, min(last.cost, end.cost) / last.readings)
        if name not in instead and abs(end.cost - last.cost) < _ALIKE * scale:
            found += [x for x in instead if x not in now]
    return tuple(dict.fromkeys(found))
