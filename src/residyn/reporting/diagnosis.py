"""All that is said of a diagnosis: sentences, the printout, the page, tables for a paper.

The sentences go from what is surest to what is open: a base model that cannot be right; the family
and its place with their joint probability; the law within the family; what else might be missing;
how far the error falls; how large the torque is that is still missing, and what it could do to
stiffness and damping. Each number is one of the result's; where the sentence says "is", the
probability is at least 90 %.
"""

import itertools
import math
from collections.abc import Iterator, Mapping

import numpy as np

from ..diagnosis.diagnose import values_of
from ..diagnosis.missing_torque import Curve, Missing
from ..diagnosis.result import (
    Candidate,
    Diagnosis,
    Family,
    RandomTorque,
    Value,
)
from ..effects import catalogue
from ..fitting.result import Fit
from ..physics.parameter import parameters_of
from . import laws, layout
from .compare import clearest, pairs
from .fit import residuals
from .layout import NUMBERS, Table, filled, printed, section, separated
from .names import (
    HELD_OUT,
    STOPPED,
    SURE,
    an,
    at,
    at_place,
    base_name,
    counted,
    error_change,
    force,
    listed,
    lower,
    modal,
    own_name,
    placed,
    position,
    spoken,
    the,
    title,
    unbroken,
    upper,
    when_held_out,
)
from .numbers import amount, measured, nats, percent, plain, share, times
from .tried import times_noise, unnamed, untried, worth_showing

_ALSO = 0.01  # probability from which another family is named
_NAMED = 3  # other families that are named
_FAMILIES, _SHOWN = 5, 0.005  # families on a page, and the probability from which one has a line


_SMOOTHED = (
    "Of readings that were filtered or interpolated the noise is larger than it seems: say it in "
    "the experiment file (noise)."
)


# -- the verdict ---------------------------------------------------------------------------------


def sentences(found: Diagnosis) -> tuple[str, ...]:
    """The verdict in a few sentences, the surest first."""
    if found.channels is not None:
        parts = [_channels]
    elif found.explains_nothing:
        parts = [_unphysical, _nothing_explained]
    else:
        named = [_families, _laws] if found.added else [_families, _none_named]
        named = [_none_named, _families, _laws] if _first_unexplained(found) else named
        named = [_none_named, _standing_in] if _stand_in(found) else named
        left = _left if found.coloured is None else _coloured
        named += [_hum, laws.sentences, _others]
        parts = [_unphysical, *named, _unphysical_base, _fall, laws.fall, _noise, left]
    return tuple(words for part in (_stopped, *parts) for words in part(found))


def _stopped(found: Diagnosis) -> Iterator[str]:
    if found.budget.stopped is not None:
        count = found.budget.models
        yield (
            f"The search {STOPPED[found.budget.stopped]}, after "
            f"{'one model' if count == 1 else f'{count} models'}: what follows is the best so far, "
            "and its probabilities count only what was tried."
        )


def _unphysical(found: Diagnosis) -> Iterator[str]:
    """A spring or damper whose number is below zero by more than its error."""
    if found.fit.unphysical:
        yield (
            f"This model cannot be right: {_below_zero(found.fit)}, and no arm has a negative "
            "stiffness or damping. Check the inertias, the signs and the units before anything "
            "else."
        )


def _unphysical_base(found: Diagnosis) -> Iterator[str]:
    if found.base.unphysical and not found.fit.unphysical:
        yield f"Springs and dampers alone cannot be right: {_below_zero(found.base)}."


def _below_zero(fit: Fit) -> str:
    return listed([f"{n.name} is {measured(n.value, n.std, n.unit)}" for n in fit.unphysical])


def _channels(found: Diagnosis) -> Iterator[str]:
    error = found.channels
    assert error is not None
    so = (
        "explain all readings to within the noise, and as they stand they do not"
        if error.complete
        else "alone explain more than any model of the readings as they stand"
    )
    yield (
        f"It seems that {error.words} ({percent(error.probability)}): read so, springs and dampers "
        f"{so}."
    )
    yield (
        "No effect is named before that is settled. Put the columns right in the recordings, or "
        "with the keys columns and units of the experiment file, and diagnose again."
    )


def _nothing_explained(found: Diagnosis) -> Iterator[str]:
    sizes = [
        f"{plain(r.rms, 2)} {r.unit} at {the(r.joint)}"
        + (f" ({share(r.share_of_spring)} of the restoring {force([r.unit])})" if _known(r) else "")
        for r in found.random_torque
    ]
    acts, reads = force(found.fit.experiment.units), position(found.fit.experiment.units)
    yield (
        "The model does not explain this motion, so no effect can be named: beside its springs it "
        f"needs a {acts} as large as theirs or larger: {listed(sizes)}."
    )
    yield (
        f"Check the recordings first: the units (rad or m, s), whether {reads}s are counted from "
        "where the joints rest, whether each column is the joint that it is named after, and "
        f"whether the inertias are of this arm. {_SMOOTHED}"
    )


def _families(found: Diagnosis) -> Iterator[str]:
    """ "Dry friction at the elbow is missing (> 99 %)." """
    own, sure = told_first(found), found.verdict_probability
    if found.verdict == "missing" and sure >= SURE > own[0].probability and len(own) == 1:
        yield (
            f"Something is missing that the catalogue has ({percent(sure)}), most likely "
            f"{_likely(own[0], found)}."
        )
        return
    surest_first = sorted(own, key=lambda f: -f.probability)
    for verb, each in itertools.groupby(surest_first, lambda f: modal(f.probability)):
        first, *more = each
        if more:
            names = listed([_likely(f, found) for f in (first, *more)])
            yield f"{upper(names)} {verb.replace('is', 'are')} missing."
        else:
            words = f"{upper(_family(first, found))} {verb} missing ({percent(first.probability)})"
            unnamed_law = first.unnamed > 0.5 * first.probability
            yield words + (", of a law that the catalogue does not have." if unnamed_law else ".")


def _stand_in(found: Diagnosis) -> bool:
    """Whether what was added is next to never at work: it fits with wrong signs only."""
    return bool(found.added) and max(f.probability for f in told_first(found)) < _ALSO


def _first_unexplained(found: Diagnosis) -> bool:
    """Whether it is surer that something has no name than what was added is at work."""
    unexplained = found.verdict == "unexplained" and found.coloured is None and not _instead(found)
    sure = max((f.probability for f in told_first(found)), default=1.0)
    return unexplained and bool(found.added) and sure < min(SURE, found.verdict_probability)


def _standing_in(found: Diagnosis) -> Iterator[str]:
    own = accepted(found)
    yield (
        f"{upper(listed([_family(f, found) for f in own]))} "
        f"{'takes' if len(own) == 1 else 'take'} up a part of it, but cannot be its cause "
        f"({percent(max(f.probability for f in own))}): numbers that must be positive are negative."
    )


def _family(family: Family, found: Diagnosis, comma: bool = False) -> str:
    """In a sentence, or with a `comma` in a table."""
    words = placed(family.name, family.place, found.fit.joints, comma)
    return words if comma else an(words)


def _likely(family: Family, found: Diagnosis) -> str:
    return f"{_family(family, found)} ({percent(family.probability)})"


def accepted(found: Diagnosis) -> list[Family]:
    """The families of what was added, in that order."""
    each = (next(f for f in found.families if x in dict(f.members)) for x in found.added)
    return list(dict.fromkeys(each))


def told_first(found: Diagnosis) -> list[Family]:
    """The families of what was added, after the kinds whose law has no name and which are as
    probable; without anything added, more probable than not."""
    own = accepted(found)
    least = max((f.probability for f in own), default=0.5)
    more = (f for f in found.families if f not in own and f.unnamed > 0 and f.probability >= least)
    return [*more, *own]


def _none_named(found: Diagnosis) -> Iterator[str]:
    said = not _stand_in(found) and any(f.probability >= SURE for f in told_first(found))
    if found.verdict == "unexplained" and said and found.coloured is None:
        return
    sure = f"({percent(found.verdict_probability)})"
    something = f"Something {modal(found.verdict_probability)} missing"
    if found.verdict == "adequate" and found.verdict_probability >= SURE:
        yield f"Nothing is missing that these recordings could show {sure}."
    elif found.verdict == "adequate":
        yield f"Probably nothing is missing {sure}."
    elif found.coloured is not None:
        yield f"No effect of the catalogue explains all of these readings {sure}."
    elif untried(found):
        yield f"{something} {sure}; no effect was tried yet."
    else:
        yield f"{something} that {unnamed(found)} explains {sure}."


def _laws(found: Diagnosis) -> Iterator[str]:
    titles = [title(x) for x in found.added]
    for family in accepted(found):
        members = dict(family.members)
        for label in (x for x in found.added if x in members):
            name, numbers = title(label), _numbers(found, label)
            if titles.count(name) > 1:
                name = at_place(label, found.fit.joints)
            further = [
                c for c in found.candidates if c.effect in members and _extends(c.effect, label)
            ]
            rivals = [
                f"{an(title(x))} ({percent(p)})"
                for x, p in family.members
                if x not in found.added and p >= _ALSO
            ]
            if rivals:
                inside = "; ".join(filter(None, [percent(members[label]), numbers]))
                kind = f"Among {family.name}s" if counted(family.name) else f"Within {family.name}"
                yield (
                    f"{kind}, the law is most likely {an(name)} ({inside}); "
                    f"{listed(rivals)} {'is' if len(rivals) == 1 else 'are'} possible too."
                )
            elif further and found.verdict != "unexplained":
                told = f" ({numbers})" if numbers else ""
                more = listed([_would_add(c, label, found) for c in further])
                yield f"{upper(an(name))}{told} is enough; {more}."
            elif numbers:
                yield f"{name}: {numbers}."


def _hum(found: Diagnosis) -> Iterator[str]:
    """What else a disturbance may be: in a linear rig the two have the same readings."""
    if any(e.oscillates for e in found.fit.model.effects if e.label in found.added):
        yield (
            "A sensor whose zero swings at the frequency of the disturbance, as hum in its cable "
            "makes it, moves the readings in the same way."
        )


def _numbers(found: Diagnosis, label: str) -> str:
    """The numbers of an effect that was added: as fitted if nothing is left,
    else as they are beside the torque that is."""
    fit = found.fit
    own = [n for n in fit.own_numbers if n.name.partition(".")[0] == label]
    if found.verdict == "unexplained" and not _instead(found):
        beside = found.parameters
        return _values({n.name: beside[n.name] for n in own if n.name in beside})
    return ", ".join(
        f"{own_name(n.name)} "
        + (measured(n.value, n.std, n.unit) if n.determined else "not determined")
        for n in own
    )


def _values(parameters: Mapping[str, Value]) -> str:
    """ "torque 0.2003 +/- 0.0012 N m", and other numbers."""
    each = parameters.items()
    return ", ".join(f"{own_name(n)} {measured(v.value, v.std, v.unit)}" for n, v in each)


def _extends(label: str, simpler: str) -> bool:
    """Whether one law is another one's with more to it, at the same place."""
    (name, _, place), (other, _, at) = label.partition(":"), simpler.partition(":")
    kind = catalogue().get(name)
    return kind is not None and kind.extends == other and place == at


def _would_add(candidate: Candidate, simpler: str, found: Diagnosis) -> str:
    """ "Stribeck friction (< 1 %) would add excess 0.0008 +/- 0.0005 N m": in the place of the
    simpler law, beside all else that was added; without a number where that was not iterated."""
    law = f"{an(title(candidate.effect))} ({percent(candidate.probability)})"
    added = frozenset(found.added) - {simpler} | {candidate.effect}
    model = found.search and found.search.tried.get(added)
    if not (found.search and model):
        return f"{law} is not needed"
    values = values_of(found.search.scene, model.posterior)
    kind, there = (catalogue()[x.partition(":")[0]] for x in (candidate.effect, simpler))
    new = {p.name for p in parameters_of(kind) if p.silent is not None}
    new -= {p.name for p in parameters_of(there)}
    own = {n: v for n, v in values.items() if n.partition(".")[0] == candidate.effect}
    more = [_values({n: v}) for n, v in own.items() if own_name(n) in new]
    return f"{law} would add {listed(more)}" if more else f"{law} adds nothing"


def _others(found: Diagnosis) -> Iterator[str]:
    """Where the rest of the probability went."""
    own = told_first(found)
    others = [f for f in found.families if f not in own and f.probability >= _ALSO]
    others.sort(key=lambda f: -f.probability)
    shown = [_likely(f, found) for f in others[:_NAMED]]
    if shown:
        more = len(others) - len(shown)
        shown += [f"{more} more kind{'s' * (more > 1)}"] if more else []
        # More probable than that what was added is not needed: most of it lies beside that.
        sure = min((f.probability for f in own), default=0.0)
        if sure >= SURE and all(f.probability > 1.0 - sure for f in others):
            beside = listed([_family(f, found) for f in own])
            verb = "is" if len(shown) == 1 else "are"
            yield f"Beside {beside}, {listed(shown)} {verb} possible too."
        else:
            yield f"Also possible: {listed(shown)}."
    for group in found.lookalikes:
        rivals = [x for x in group[1:] if not any(x in dict(f.members) for f in own)]
        if rivals:
            one, others = (spoken(x, found.fit.joints) for x in (group[:1], rivals))
            yield f"These recordings cannot tell {one} from {others}."


def _fall(found: Diagnosis) -> Iterator[str]:
    """How far the error falls where it was worst."""
    first, last = times_noise(found.ladder[0]), times_noise(found.ladder[-1])
    worst = int(np.nanargmax([x for x, _ in first]))
    joint = at(found.fit.joints[worst], found.fit.joints)
    before, held_before = first[worst]
    ahead = found.ladder[-1].held_out
    expected = None if ahead is None else ahead.held_out.expected
    right = ""  # what the noise in the fitted readings does to a prediction, where it shows
    if expected is not None and times(expected[worst]) != times(1.0):
        right = f"; {times(expected[worst])} is expected of a right model"
    if not found.added:
        held = "" if held_before is None else f" ({times(held_before)} times {HELD_OUT}{right})"
        yield f"The error{joint} is {times(before)} times the noise{held}."
        return
    words = (
        f"With {spoken(found.added, found.fit.joints)} the error{joint} "
        f"{error_change(first[worst], last[worst], right)}"
    )
    part = explained_share(found)
    if found.verdict == "unexplained" and math.isfinite(part):
        words += f"; that explains {percent(part)} of the squared error above the noise"
    yield f"{words}."


def _instead(found: Diagnosis) -> bool:
    """Whether what has no name may be in the place of what was added, which is not likely to be at
    work and leaves only noise, and not beside it."""
    nothing_left = all(r.low == 0 for r in found.random_torque if math.isfinite(r.rms))
    unexplained = found.verdict == "unexplained" and found.coloured is None
    doubted = [c for c in found.candidates if c.effect in found.added and c.probability < 0.5]
    return unexplained and bool(doubted) and nothing_left


def explained_share(found: Diagnosis) -> float:
    """Of the base model's squared error above the noise, the share that the effects took away; NaN
    where there was none."""
    before, after = (f.reduced_chi2 - 1.0 for f in (found.base, found.fit))
    return min(1.0, max(0.0, 1.0 - max(after, 0.0) / before)) if before > 0 else math.nan


def _left(found: Diagnosis) -> Iterator[str]:
    """How large what is still missing is, and whether it matters."""
    known = [r for r in found.random_torque if math.isfinite(r.rms)]
    sure = found.verdict_probability
    if found.verdict == "unexplained" and not _instead(found):
        sizes = listed([_size(r, found) for r in known]) if known else "unknown size"
        beyond = f"missing that {unnamed(found)} explains ({percent(sure)}):"
        more = found.added and not _first_unexplained(found)
        first = f"Something more {modal(sure)} {beyond}" if more else "What is missing is"
        if _stand_in(found):  # of which it has been said that no effect explains it
            first = f"What is missing beside {spoken(found.added, found.fit.joints)} is"
        if found.laws:  # of which the model that lacks so much has none
            law = "that law" if len(found.laws) == 1 else "such a law"
            first = f"Without {law}, {lower(first)}"
        yield f"{first} a {force(found.fit.experiment.units)} of {sizes}."
        yield from _matters(found)
        return
    if _instead(found):
        effects = spoken(found.added, found.fit.joints)
        yield (
            f"Beside {effects} only noise is left; but a law that {unnamed(found)} has may be "
            f"there instead ({percent(sure)})."
        )
    elif sure < SURE and found.added:
        yield f"That it is this and nothing else is not sure ({percent(sure)})."
    if known:
        most = max(known, key=lambda r: r.high / _restoring(r) if _known(r) else r.high)
        if most.high > 0:
            size = f"{plain(most.high, 2)} {most.unit} rms{at(most.joint, found.fit.joints)}"
            if _known(most):
                size += f", {share(most.high / _restoring(most))} of the restoring "
                size += force([most.unit])
            yield f"What may still be missing is no more than {size} (95 % band)."


def _coloured(found: Diagnosis) -> Iterator[str]:
    """What is in the readings and in no torque."""
    left = found.coloured
    assert left is not None
    line = "" if left.frequency_hz is None else f", most of all at {plain(left.frequency_hz, 4)} Hz"
    yield (
        f"What is left{at(left.joint, found.fit.joints)} is {times(left.ratio)} times the noise, "
        f"and not white{line}; no {force(found.fit.experiment.units)} that changes as the arm "
        "moves explains it. Look at the "
        f"sensor, at what carries it, and for hum in its cable. {_SMOOTHED}"
    )


def _noise(found: Diagnosis) -> Iterator[str]:
    """Noise that is not white, and what of the report supposes that it is."""
    noise = found.coloured_noise
    if noise is None:
        return
    each = listed([
        f"{plain(rms, 2)} {unit} rms{at(joint, found.fit.joints)}"
        for joint, (rms, unit) in noise.rms.items()
    ])  # fmt: skip
    yield (
        f"The noise of the readings is not white: of {each}, a part is correlated over about "
        f"{plain(noise.correlation_time, 2)} s. That may be the sensors', or small forces that no "
        "effect of the catalogue explains, as of a floor that shakes. The probabilities count it; "
        "the standard errors of the fit do not, and are too small."
    )


def _known(r: RandomTorque) -> bool:
    return math.isfinite(r.share_of_spring) and r.share_of_spring > 0 and r.rms > 0


def _restoring(r: RandomTorque) -> float:
    """The rms of the restoring torque."""
    return r.rms / r.share_of_spring


def _size(r: RandomTorque, found: Diagnosis) -> str:
    low, high = plain(r.low, 2), plain(r.high, 2)
    more = [f"95 % band {low} to {high}"] if low != high else []
    more += [f"{share(r.share_of_spring)} of the restoring {force([r.unit])}"] if _known(r) else []
    size = f"{plain(r.rms, 2)} {r.unit} rms{at(r.joint, found.fit.joints)}"
    return f"{size} ({'; '.join(more)})" if more else size


def _matters(found: Diagnosis) -> Iterator[str]:
    """What the missing torque could do to stiffness and damping, if all of it went with the angle
    or all of it with the rate; nothing of numbers that did not settle, nor where it is known to go
    with time."""
    told = []
    law = found.laws[0] if found.laws else None
    with_time = law and law.probability > 0.5 and (law.variable, law.factor) == ("time", "")
    if with_time or not found.fit.stands:
        return
    for j, r in enumerate(found.random_torque):
        if not _known(r):
            continue
        words = f"the stiffness{at(r.joint, found.fit.joints)} by {share(r.share_of_spring)}"
        if (damper := _damper(found, j)) > 0:
            words += f" or the damping by {share(r.rms / damper)}"
        told.append(words)
    if told:
        reads = position(found.fit.experiment.units)
        yield f"At most, if it all went with the {reads} or the rate, it changes {'; '.join(told)}."


def _damper(found: Diagnosis, joint: int) -> float:
    """Rms of a joint's damper torque along its motion, N m; 0 where it has none."""
    name = f"damper:{found.fit.joints[joint]}."
    size = sum(abs(n.value) for n in found.fit.numbers if n.name.startswith(name))
    rate = np.concatenate([m.torque.rate[:, joint] for m in found.still_missing])
    return float(size * np.sqrt(np.mean(rate**2)))


# -- in a terminal ---------------------------------------------------------------------------


def text(found: Diagnosis) -> str:
    parts = models, candidates, laws.text, lookalikes, next_experiment
    lines = [line for part in parts for line in part(found)]
    lines += ["", *filled(laws.beside_fit(found))]
    return "\n".join([*filled(" ".join(found.words)), "", *lines, str(found.fit)])


def models(found: Diagnosis) -> list[str]:
    """The error of each model on the way; more joints than stand side by side, below each other."""
    joints, held, table = found.fit.joints, held_out(found), models_table(found, sizes=False)
    if len(joints) > 2:
        kinds, rows = _kinds(found), []
        for name, *cells, chi2 in table.rows:
            for j, joint in enumerate(joints):
                own = cells[len(kinds) * j :][: len(kinds)]
                rows.append(["" if j else name, joint, *own, chi2])
        table = Table(["model", "joint", *kinds, table.head[-1]], rows, left=(0, 1))
    note = "rms residual in times the noise" + (f"; {HELD_OUT}: {held}" if held else "")
    return [*section("Models", note), *printed(table)]


def held_out(found: Diagnosis) -> str | None:
    each = [r.held_out for r in found.models]
    what = next((held.what for held in each if held is not None), None)
    return what and when_held_out(what) + ("; -: that fit did not settle" if None in each else "")


def _kinds(found: Diagnosis) -> list[str]:
    return ["fitted", HELD_OUT] if held_out(found) else ["fitted"]


def candidates(found: Diagnosis) -> list[str]:
    """What might be missing in the base model, the likeliest first."""
    if not found.candidates:
        return []
    note = (
        "probability of being part of the model, and log evidence (nats) of the base model with it "
        "alone, relative to the best model with names"
    )
    shown, rows = worth_showing(found), []
    for c in shown:
        name = at_place(c.effect, found.fit.joints, comma=True)
        lines = [name, *filled(_values(c.parameters), "  ", width=NUMBERS)]
        order = "" if c.iterated else " (1st order)"
        rows.append(["\n".join(lines), percent(c.probability), nats(c.log_evidence) + order])
    out = [*section("Candidates", note), *printed(Table(["", "probability", "log evidence"], rows))]
    rest = len(found.candidates) - len(shown)
    if rest:
        out.append(f"    and {rest} more that {'is' if rest == 1 else 'are'} less likely")
    return out + filled(", ".join(c.effect for c in shown), "    names for --with: ", 6)


def lookalikes(found: Diagnosis) -> list[str]:
    """Names that the recordings cannot tell apart."""
    groups = [line for words in alike(found) for line in filled(words, "    ")]
    return ["[[Look-alikes]]", *groups] if groups else []


def alike(found: Diagnosis) -> Iterator[str]:
    """A sentence for each group of look-alikes."""
    joints = found.fit.joints
    for group in found.lookalikes:
        if len(group) > 1:
            one, rivals = (spoken(x, joints) for x in (group[:1], group[1:]))
            yield f"{upper(one)} cannot be told from {rivals} by these recordings."


def next_experiment(found: Diagnosis) -> list[str]:
    advice = found.next_experiment
    return [] if advice is None else ["[[Next experiment]]", *filled(advice.words, "    ")]


# -- on a page -------------------------------------------------------------------------------


def torques_lacked(found: Diagnosis) -> list[tuple[Missing, int]]:
    """What the last model lacks, (recording, joint) each, where something was left unexplained."""
    return clearest(pairs(found.still_missing)) if found.verdict == "unexplained" else []


def title_of(found: Diagnosis) -> str:
    """The headline."""
    if found.channels is not None:
        return "The columns of the recordings are not what the file says"
    if found.explains_nothing:
        return "The model does not explain this motion"
    if found.verdict == "adequate":
        return "Nothing is missing"
    if untried(found):
        return "Something is missing; no effect was tried yet"
    if not told_first(found) or _stand_in(found) or _first_unexplained(found):
        return f"Something is missing that {unnamed(found)} explains"
    words = [_family(f, found) for f in told_first(found)]
    other = f"something that {unnamed(found)} explains"
    if _instead(found):
        return f"What is missing: {listed(words)}, or {other}"
    words += [other] if found.verdict == "unexplained" else []
    return f"What is missing: {listed(words)}"


def torques_first_lacked(found: Diagnosis) -> list[tuple[Missing, int]]:
    """The torque that the base model lacks, with the curves of what was added before their rivals',
    those that draw most of it first; where what was added acts, or everywhere if on no joint."""
    if not found.added:
        return []

    def rank(curve: Curve) -> tuple[bool, float]:
        return curve.effect not in found.added, -curve.share

    ordered = [each._replace(curves=tuple(sorted(each.curves, key=rank))) for each in found.missing]
    acting = [
        (each, joint)
        for each, joint in pairs(ordered)
        if any(c.effect in found.added and np.any(c.torque[:, joint]) for c in each.curves)
    ]
    return clearest(acting or pairs(ordered))


def models_table(found: Diagnosis, sizes: bool = True) -> Table:
    """The error of each model on the way at each joint, where it was fitted and held out: its size
    and how many times the noise it is, or that alone; and its chi-square."""
    kinds, rows = _kinds(found), []
    for name, step in laws.models(found, comma=True):
        held, cells = step.held_out, []
        rms = step.fit.rmse, step.fit.rmse if held is None else held.held_out.rmse
        for j, ratios in enumerate(times_noise(step)):
            for x, ratio, _ in zip(rms, ratios, kinds, strict=False):
                words = "-" if ratio is None else f"{times(ratio)} x"
                if sizes and ratio is not None:
                    words = f"{amount(float(x[j]), found.fit.units[j])} ({times(ratio)} ×)"
                cells.append(words)
        rows.append([name, *cells, plain(step.fit.reduced_chi2)])
    head = [f"{joint}\n{kind}" for joint in found.fit.joints for kind in kinds]
    return Table(["model", *head, "reduced\nchi-square"], rows)


def families_table(found: Diagnosis) -> Table:
    """The likeliest kinds of law, each at its place."""
    rows = []
    for f in found.families[:_FAMILIES]:
        if f.probability >= _SHOWN:
            laws = [f"{lower(title(x))} {percent(p)}" for x, p in f.members]
            laws += [f"without a name {percent(f.unnamed)}"] if f.unnamed >= _SHOWN else []
            name = upper(_family(f, found, comma=True))
            rows.append([name, percent(f.probability), ", ".join(laws)])
    return Table(["kind of law and place", "probability", "laws"], rows, left=(0, 2))


def candidates_table(found: Diagnosis) -> Table:
    rows, shown = [], worth_showing(found)
    for c in shown:
        name = at_place(c.effect, found.fit.joints, comma=True)
        name += " (added)" if c.effect in found.added else ""
        evidence = nats(c.log_evidence) + ("" if c.iterated else " (first order)")
        numbers = unbroken(_values(c.parameters))
        rows.append([name, percent(c.probability), evidence, numbers, c.effect])
    marked = [i for i, c in enumerate(shown) if c.effect in found.added]
    head = ["effect", "probability", "log evidence (nats)", "its numbers, alone in the model"]
    return Table([*head, "name for --with"], rows, left=(0, 3, 4), marked=marked)


def remainder_table(found: Diagnosis) -> Table:
    """How large the torque is that the last model still lacks, per joint."""
    rows = []
    for r in found.random_torque:
        part = share(r.share_of_spring) if math.isfinite(r.share_of_spring) else ""
        band = f"{plain(r.low, 2)} to {plain(r.high, 2)} {r.unit}"
        rows.append([r.joint, f"{plain(r.rms, 2)} {r.unit}", band, part])
    acts = force(found.fit.experiment.units)
    return Table(["joint", "rms", "95 % band", f"share of the restoring {acts}"], rows)


# -- for a paper -----------------------------------------------------------------------------


def latex(found: Diagnosis) -> str:
    """Two tables: the models on the way, and the candidates that are worth a line."""
    rows = []
    for c in worth_showing(found):
        name = at_place(c.effect, found.fit.joints, comma=True)
        first = [name, percent(c.probability), nats(c.log_evidence)]
        each = [_values({n: v}) for n, v in c.parameters.items()] or [""]
        rows += [[*(["", "", ""] if i else first), words] for i, words in enumerate(each)]
    head = ["effect", "probability", "log evidence", "value"]
    tables = models_table(found), Table(head, rows, left=(0, 3))
    return "\n".join(map(layout.latex, tables))


def csv(found: Diagnosis) -> str:
    """One line for each number: which table and which line of it, name, value, std, unit."""
    rows: list[tuple[object, ...]] = []
    for step in found.models:
        own = "ladder", f"+ {' + '.join(step.added)}" if step.added else base_name(step.fit)
        for name, joint, x, u in residuals(step.fit):
            if name != "check_rmse":
                rows.append((*own, f"{name}:{joint}", x, None, u))
        if step.held_out is not None:
            sizes = step.held_out.held_out.rmse
            each = zip(found.fit.joints, sizes, found.fit.units, strict=True)
            rows += [(*own, f"check_rmse:{joint}", x, None, u) for joint, x, u in each]
        rows.append((*own, "reduced_chi2", step.fit.reduced_chi2, None, "1"))
        rows.append((*own, "log_evidence", step.log_evidence, None, "1"))
    for c in found.candidates:
        own = "candidate", c.effect
        rows.append((*own, "probability", c.probability, None, "1"))
        rows.append((*own, "log_evidence", c.log_evidence, None, "1"))
        rows += [(*own, name, v.value, v.std, v.unit) for name, v in c.parameters.items()]
    return separated(("table", "model", "name", "value", "std", "unit"), rows)
