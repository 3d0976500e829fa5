"""A diagnosis in sentences, and as text for a terminal of 80 columns.

The sentences go from what is surest to what is open: a base model that cannot be right; the family
and its place with their joint probability; the law within the family; what else might be missing;
how far the error falls; how large the torque is that is still missing, and what it could do to
stiffness and damping. Each number is one of the result's; where the sentence says "is", the
probability is at least 90 %.
"""

import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..diagnosis.result import Value
from ..effects import CATALOGUE
from ..physics.parameter import parameters_of
from .numbers import plain, with_error
from .words import (
    SURE,
    at_place,
    listed,
    lower,
    modal,
    model_name,
    nats,
    percent,
    placed,
    share_words,
    times,
    times_noise,
    title,
    upper,
    value_words,
    worth_showing,
)

if TYPE_CHECKING:
    from ..diagnosis.result import Candidate, Diagnosis, Family, ModelState, RandomTorque
    from ..fitting.result import Fit

_WIDTH = 80
_LABEL, _PAIR, _CHI2 = 36, 16, 12
_PAIRS = (_WIDTH - _LABEL - _CHI2) // _PAIR
_ALSO = 0.01  # probability from which another family is named
_NAMED = 3  # other families that are named
_SIGNIFICANT = 2.0  # standard errors


def lines(found: "Diagnosis") -> list[str]:
    """The whole printout, a string per line."""
    return [
        *wrapped("", " ".join(found.words)),
        "",
        *models(found),
        *candidates(found),
        *lookalikes(found),
        *next_experiment(found),
        "",
        str(found.fit),
    ]


# -- the verdict ---------------------------------------------------------------------------------


def verdict_words(found: "Diagnosis") -> tuple[str, ...]:
    """The verdict in a few sentences, the surest first."""
    words = [*_stopped(found), *_unphysical(found)]
    if found.explains_nothing:
        return (*words, *_nothing_explained(found))
    words += _families(found) if found.added else [_none_named(found)]
    words += _laws(found)
    words += _others(found)
    words += _fall(found)
    words += _left(found)
    return tuple(words)


def _stopped(found: "Diagnosis") -> list[str]:
    why = {"interrupted": "was stopped by Ctrl-C", "budget": "ended when its budget was spent"}
    if found.budget.stopped is None:
        return []
    count = found.budget.models
    models = "one model" if count == 1 else f"{count} models"
    return [
        f"The search {why[found.budget.stopped]}, after {models}: what follows is the best so far, "
        "and its probabilities count only what was tried."
    ]


def _unphysical(found: "Diagnosis") -> list[str]:
    """A spring or damper whose number is below zero by more than its error."""

    def wrong(fit: "Fit") -> list[str]:
        return [
            f"{n.name} is {' +/- '.join(with_error(n.value, n.std))} {n.unit}"
            for n in fit.numbers
            if n.name.startswith(("spring:", "damper:"))
            and n.determined
            and n.value < -_SIGNIFICANT * n.std
        ]

    last, first = wrong(found.fit), wrong(found.base)
    if last:
        return [
            f"This model cannot be right: {listed(last)}, and no spring or damper has less than "
            "nothing. Check the inertias, the signs and the units before anything else."
        ]
    if first:
        return [f"Springs and dampers alone cannot be right: {listed(first)}."]
    return []


def _nothing_explained(found: "Diagnosis") -> list[str]:
    joints = found.fit.joints
    sizes = [
        f"{plain(r.rms, 2)} {r.unit} at the {r.joint}"
        + (f" ({share_words(r.share_of_spring)} of the spring's)" if _known(r) else "")
        for r in found.random_torque
    ]
    words = [
        "The model explains nothing of this motion, so no effect can be named: it lacks a torque "
        f"of {listed(sizes)}.",
        "Check the recordings first: the units (rad or m, s), whether angles are counted from "
        "where the joints rest, whether each column is the joint that it is named after, and "
        "whether the inertias are of this arm.",
    ]
    resting = _rest(found)
    if resting:
        where = listed([f"{joints[j]} {plain(x, 3)}" for j, x in resting])
        words.append(
            f"The readings keep to one side of zero (means: {where}): angles that are not counted "
            "from rest look so."
        )
    return words


def _rest(found: "Diagnosis") -> list[tuple[int, float]]:
    """Joints whose fitted readings never cross zero, and their means, rad or m."""
    fitted = [r for r in found.fit.recordings if r.recording.role != "check"]
    angles = np.concatenate([np.where(r.used, r.recording.angle, np.nan) for r in fitted])
    each = enumerate(angles.T)
    means = [(j, float(np.nanmean(x))) for j, x in each if np.nanmin(x) > 0 or np.nanmax(x) < 0]
    return means


def _families(found: "Diagnosis") -> list[str]:
    """ "Dry friction at the elbow is missing (> 99 %)." """
    joints, own = found.fit.joints, accepted(found)
    sure = found.verdict_probability
    if found.verdict == "missing" and sure >= SURE and len(own) == 1:
        (family,) = own
        if family.probability < SURE:
            first = f"{_family(family, joints)} ({percent(family.probability)})"
            return [
                f"Something is missing that the catalogue has ({percent(sure)}), most likely "
                f"{first}."
            ]
    groups: dict[str, list[Family]] = {}
    for family in own:
        groups.setdefault(modal(family.probability), []).append(family)
    told = []
    for each in groups.values():
        names = [f"{_family(f, joints)} ({percent(f.probability)})" for f in each]
        verb = modal(each[0].probability, many=len(each) > 1)
        if len(each) == 1:
            name, chance = _family(each[0], joints), percent(each[0].probability)
            told.append(f"{upper(name)} {verb} missing ({chance}).")
        else:
            told.append(f"{upper(listed(names))} {verb} missing.")
    return told


def _family(family: "Family", joints: Sequence[str]) -> str:
    return placed(family.name, family.place, joints)


def accepted(found: "Diagnosis") -> list["Family"]:
    """The families of what was added, in that order."""
    own = []
    for label in found.added:
        family = next(f for f in found.families if label in dict(f.members))
        if family not in own:
            own.append(family)
    return own


def _none_named(found: "Diagnosis") -> str:
    sure = f"({percent(found.verdict_probability)})"
    if found.verdict == "adequate":
        if found.verdict_probability >= SURE:
            return f"Nothing is missing that these recordings could show {sure}."
        return f"Probably nothing is missing {sure}."
    verb = modal(found.verdict_probability)
    return f"Something {verb} missing that {unnamed(found)} explains {sure}."


def unnamed(found: "Diagnosis") -> str:
    """What does not explain the rest: the whole catalogue, or what there was time for."""
    if found.budget.stopped is not None:
        return "no effect that was tried"
    return "no effect of the catalogue"


def _laws(found: "Diagnosis") -> Iterator[str]:
    """What the recordings say of the law within each family."""
    for family in accepted(found):
        members = dict(family.members)
        for label in (x for x in found.added if x in members):
            name, numbers = title(label), _numbers(found, label)
            told = f" ({numbers})" if numbers else ""
            further = [c for c in _members(found, family) if _extends(c.effect, label)]
            rivals = [
                f"{lower(title(x))} ({percent(p)})"
                for x, p in family.members
                if x not in found.added and p >= _ALSO
            ]
            if rivals:
                inside = "; ".join(filter(None, [percent(members[label]), numbers]))
                yield (
                    f"Within {family.name}, the law is most likely {lower(name)} ({inside}); "
                    f"{listed(rivals)} {'is' if len(rivals) == 1 else 'are'} possible too."
                )
            elif further and found.verdict != "unexplained":
                yield f"{name}{told} is enough; {listed([_would_add(c, label) for c in further])}."
            elif numbers:
                yield f"{name}: {numbers}."


def _numbers(found: "Diagnosis", label: str) -> str:
    """The numbers of an effect that was added: as fitted if nothing is left, else as they are
    beside the random torque, since a fit's errors then are too small."""
    own = [n for n in found.fit.numbers if n.name.rpartition(".")[0] == label]
    beside = found.candidate(label).parameters
    if found.verdict == "unexplained" and len(found.added) == 1 and beside:
        told = [f"{n.rpartition('.')[2]} {value_words(v)}" for n, v in beside.items()]
        fitted = ", ".join(plain(n.value) for n in own)
        return f"{', '.join(told)} ({fitted} if nothing else were missing)"
    told = []
    for n in own:
        value = value_words(Value(n.value, n.std, n.unit)) if n.determined else "not determined"
        told.append(f"{n.name.rpartition('.')[2]} {value}")
    return ", ".join(told)


def _members(found: "Diagnosis", family: "Family") -> list["Candidate"]:
    own = dict(family.members)
    return [c for c in found.candidates if c.effect in own]


def _extends(label: str, simpler: str) -> bool:
    """Whether one law is another one's with more to it, at the same place."""
    (name, _, place), (other, _, at) = label.partition(":"), simpler.partition(":")
    kind = CATALOGUE.get(name)
    return kind is not None and kind.extends == other and place == at


def _would_add(candidate: "Candidate", simpler: str) -> str:
    """ "Stribeck friction (< 1 %) would add excess 0.0008 +/- 0.0005 N m"."""
    kind = CATALOGUE[candidate.effect.partition(":")[0]]
    there = {p.name for p in parameters_of(CATALOGUE[simpler.partition(":")[0]])}
    values = {n.rpartition(".")[2]: v for n, v in candidate.parameters.items()}
    more = [
        f"{p.name} {value_words(values[p.name])}"
        for p in parameters_of(kind)
        if p.name not in there and p.silent is not None and p.name in values
    ]
    law = f"{lower(title(candidate.effect))} ({percent(candidate.probability)})"
    return f"{law} would add {listed(more)}" if more else f"{law} adds nothing"


def _others(found: "Diagnosis") -> Iterator[str]:
    """Where the rest of the probability went."""
    own = accepted(found) if found.added else []
    others = [f for f in found.families if f not in own and f.probability >= _ALSO]
    joints = found.fit.joints
    shown = [f"{_family(f, joints)} ({percent(f.probability)})" for f in others[:_NAMED]]
    if shown:
        more = len(others) - len(shown)
        shown += [f"{more} more kind{'s' * (more > 1)}"] if more else []
        yield f"Also possible: {listed(shown)}."
    for group in found.lookalikes:
        kinds = {f.name: f for f in own}
        rivals = [x for x in group[1:] if not any(x in dict(f.members) for f in kinds.values())]
        if rivals:
            names = listed([lower(at_place(x, joints)) for x in rivals])
            yield f"These recordings cannot tell {lower(at_place(group[0], joints))} from {names}."


def _fall(found: "Diagnosis") -> Iterator[str]:
    """How far the error falls where it was worst."""
    first, last = times_noise(found.ladder[0]), times_noise(found.ladder[-1])
    fitted = [x for x, _ in first]
    worst = int(np.nanargmax(fitted))
    joint = f"at the {found.fit.joints[worst]} " if len(found.fit.joints) > 1 else ""
    (before, held_before), (after, held_after) = first[worst], last[worst]
    if not found.added:
        held = "" if held_before is None else f" ({times(held_before)} times where held out)"
        if found.verdict == "adequate":
            yield f"The error {joint}is {times(before)} times the noise{held}."
        else:
            yield f"The model leaves {times(before)} times the noise {joint.strip()}{held}."
        return
    digits = next((d for d in (2, 3) if plain(before, d) != plain(after, d)), 4)
    verb = "falls" if after < before else "goes"
    pronoun = "it" if len(found.added) == 1 else "them"
    words = (
        f"With {pronoun} the error {joint}{verb} from {plain(before, digits)} to "
        f"{plain(after, digits)} times the noise"
    )
    if held_before is not None and held_after is not None:
        words += f" (held out: from {times(held_before)} to {times(held_after)})"
    share = explained_share(found)
    if found.verdict == "unexplained" and math.isfinite(share):
        words += f"; that explains {share_words(share)} of the squared error above the noise"
    yield f"{words}."


def explained_share(found: "Diagnosis") -> float:
    """Of the base model's squared error above the noise, the share that the effects took away; NaN
    where there was none."""
    before, after = (f.reduced_chi2 - 1.0 for f in (found.base, found.fit))
    return min(1.0, max(0.0, 1.0 - max(after, 0.0) / before)) if before > 0 else math.nan


def _left(found: "Diagnosis") -> Iterator[str]:
    """How large what is still missing is, and whether it matters."""
    known = [r for r in found.random_torque if math.isfinite(r.rms)]
    sure = found.verdict_probability
    if found.verdict == "unexplained":
        sizes = listed([_size(r, found) for r in known]) if known else "unknown size"
        more = f"Something more {modal(sure)} missing that {unnamed(found)} explains"
        words = f"{more} ({percent(sure)})" if found.added else "What is missing is"
        yield f"{words}{': ' if found.added else ' '}a torque of {sizes}."
        yield from _matters(found)
        return
    if sure < SURE and found.added:
        yield f"That nothing else is missing is not sure ({percent(sure)})."
    if known:
        most = max(known, key=lambda r: r.high / _spring(r) if _known(r) else r.high)
        if most.high > 0:
            where = f" at the {most.joint}" if len(found.fit.joints) > 1 else ""
            size = f"{plain(most.high, 2)} {most.unit} rms{where}"
            share = f", {share_words(most.high / _spring(most))} of the spring's torque"
            yield (
                f"What may still be missing is no more than {size}"
                f"{share if _known(most) else ''} (95 % band)."
            )


def _known(r: "RandomTorque") -> bool:
    return math.isfinite(r.share_of_spring) and r.share_of_spring > 0 and r.rms > 0


def _spring(r: "RandomTorque") -> float:
    """The rms of the spring's torque."""
    return r.rms / r.share_of_spring


def _size(r: "RandomTorque", found: "Diagnosis") -> str:
    where = f" at the {r.joint}" if len(found.fit.joints) > 1 else ""
    low, high = plain(r.low, 2), plain(r.high, 2)
    band = f"95 % band {low} to {high}" if low != high else ""
    share = f"{share_words(r.share_of_spring)} of the spring's" if _known(r) else ""
    more = "; ".join(filter(None, [band, share]))
    return f"{plain(r.rms, 2)} {r.unit} rms{where}" + (f" ({more})" if more else "")


def _matters(found: "Diagnosis") -> Iterator[str]:
    """What the missing torque could do to stiffness and damping, if all of it went with the angle
    or all of it with the rate."""
    told = []
    for j, r in enumerate(found.random_torque):
        if not _known(r):
            continue
        damper, where = _damper(found, j), f" at the {r.joint}" if len(found.fit.joints) > 1 else ""
        words = f"the stiffness{where} by {share_words(r.share_of_spring)}"
        if damper > 0:
            words += f" or the damping by {share_words(r.rms / damper)}"
        told.append(words)
    if told:
        yield f"At most, if it all went with the angle or the rate, it changes {'; '.join(told)}."


def _damper(found: "Diagnosis", joint: int) -> float:
    """Rms of a joint's damper torque along its motion, N m; 0 where it has none."""
    name = f"damper:{found.fit.joints[joint]}."
    size = sum(abs(n.value) for n in found.fit.numbers if n.name.startswith(name))
    rate = np.concatenate([m.torque.rate[:, joint] for m in found.still_missing])
    return float(size * np.sqrt(np.mean(rate**2)))


# -- the parts -----------------------------------------------------------------------------------


def models(found: "Diagnosis") -> list[str]:
    """The error of each model on the way."""
    joints = found.fit.joints
    held = next((r.held_out.what for r in found.ladder if r.held_out is not None), None)
    head = "rms residual in times the noise"
    if held is not None:
        head += f"; held out: {'the ' if held == 'last third' else ''}{held}"
    out = [f"[[Models]]  {head}"]
    if len(joints) > _PAIRS:
        return out + [line for step in found.ladder for line in _stacked(step, joints)]
    width, short, long = (_PAIR, 7, 9) if held is not None else (_PAIR // 2, _PAIR // 2, 0)
    names = "".join(f"{_cut(joint, width - 2):>{width}}" for joint in joints)
    out.append(f"{'':{_LABEL}}{names}{'chi-square':>{_CHI2}}")
    kinds = (
        f"{'fitted':>{short}}{'held out':>{long}}" if held is not None else f"{'fitted':>{width}}"
    )
    out.append(f"{'':{_LABEL}}{kinds * len(joints)}{'per reading':>{_CHI2}}")
    for step in found.ladder:
        *above, name = textwrap.wrap(
            model_name(step),
            _LABEL,
            initial_indent="    ",
            subsequent_indent="      ",
            break_on_hyphens=False,
            break_long_words=False,
        )
        if len(name) > _LABEL:
            above, name = [*above, name], ""
        cells = ""
        for fitted, checked in times_noise(step):
            cells += f"{f'{times(fitted)} x':>{short}}"
            if held is not None:
                cells += f"{'-' if checked is None else f'{times(checked)} x':>{long}}"
        out += [*above, f"{name:<{_LABEL}}{cells}{plain(step.fit.reduced_chi2):>{_CHI2}}"]
    return out


def _stacked(step: "ModelState", joints: Sequence[str]) -> list[str]:
    """A model of more joints than stand side by side."""
    chi2 = f"chi-square {plain(step.fit.reduced_chi2)} per reading"
    out = [f"    {model_name(step)}: {chi2}"]
    for joint, (fitted, checked) in zip(joints, times_noise(step), strict=True):
        held = "" if checked is None else f"{times(checked):>8} x held out"
        out.append(f"      {_cut(joint, 26):<26}{times(fitted):>6} x fitted{held}")
    return out


def candidates(found: "Diagnosis") -> list[str]:
    """What might be missing in the base model, the likeliest first."""
    if not found.candidates:
        return []
    out = wrapped(
        "[[Candidates]]  ",
        "probability of being part of the model, and log evidence (nats) of the base model with it "
        "alone, relative to the best model",
    )
    out.append(f"{'':{_LABEL}}{'probability':>14}{'log evidence':>14}")
    shown = worth_showing(found)
    for c in shown:
        first = "" if c.iterated else " (1st order)"
        cells = f"{percent(c.probability):>14}{nats(c.log_evidence):>14}{first}"
        name = f"    {c.effect}"
        if len(name) > _LABEL:
            out.append(name)
            name = ""
        out.append(f"{name:<{_LABEL}}{cells}")
        numbers = [f"{n.rpartition('.')[2]} {value_words(v)}" for n, v in c.parameters.items()]
        out += wrapped("        ", ", ".join(numbers)) if numbers else []
    rest = len(found.candidates) - len(shown)
    if rest:
        out.append(f"    and {rest} more that {'is' if rest == 1 else 'are'} less likely")
    return out


def lookalikes(found: "Diagnosis") -> list[str]:
    """Names that the recordings cannot tell apart."""
    groups = [g for g in found.lookalikes if len(g) > 1]
    if not groups:
        return []
    out = ["[[Look-alikes]]"]
    for group in groups:
        out += wrapped("    ", alike(group, found.fit.joints))
    return out


def alike(group: Sequence[str], joints: Sequence[str]) -> str:
    """A group of look-alikes in a sentence."""
    first, *others = (at_place(x, joints) for x in group)
    return f"{first} cannot be told from {listed([lower(x) for x in others])} by these recordings."


def advice(found: "Diagnosis") -> str:
    """What to record next, with effects in words; empty if nothing is advised."""
    if found.next_experiment is None:
        return ""
    return found.next_experiment.words


def next_experiment(found: "Diagnosis") -> list[str]:
    """What to record to tell look-alikes apart."""
    words = advice(found)
    return ["[[Next experiment]]", *wrapped("    ", words)] if words else []


def _cut(words: str, most: int) -> str:
    return words if len(words) <= most else f"{words[: most - 3]}..."


def wrapped(head: str, words: str) -> list[str]:
    kept = words.replace(" %", "\u00a0%").replace(" +/- ", "\u00a0+/-\u00a0")
    out = textwrap.wrap(
        kept,
        _WIDTH,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_on_hyphens=False,
    )
    return [line.replace("\u00a0", " ") for line in out]
