"""What the page says of a diagnosis: the verdict and the falling error, then the evidence."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..diagnosis import Curve, Missing
from ..diagnosis.result import Candidate, Diagnosis, Family, ModelState
from . import figures as plot
from .diagnosis_text import accepted, advice, alike, unnamed
from .failing import clearest, failing
from .numbers import amount, plain
from .picture import picture
from .plan import outcomes
from .words import (
    at_place,
    listed,
    lower,
    model_name,
    nats,
    percent,
    placed,
    times,
    times_noise,
    title,
    unbroken,
    upper,
    value_words,
    worth_showing,
)

_MOST = 4
"""Pictures of missing torques in one place; `residyn compare` draws them all."""
_FAMILIES = 5
_SHOWN = 0.005  # probability from which a family has a line


def diagnosed(found: Diagnosis) -> dict[str, Any]:
    """All that the template says of it."""
    experiment, shown = found.fit.experiment, worth_showing(found)
    names = [lower(at_place(name, found.fit.joints)) for name in found.added]
    held = next((r.held_out.what for r in found.ladder if r.held_out is not None), None)
    unexplained = found.verdict == "unexplained"
    before = clearest(experiment, _evidence(found), _MOST)
    after = clearest(experiment, _each(found.still_missing) if unexplained else (), _MOST)
    families = [f for f in found.families if f.probability >= _SHOWN][:_FAMILIES]
    return {
        "title": _title(found),
        "verdict": found.verdict,
        "probability": percent(found.verdict_probability),
        "added": listed(names) if names else "",
        "words": [unbroken(words) for words in found.words],
        "joints": found.fit.joints,
        "held_out": held,
        "falling": picture(
            "The error in times the noise, per joint, of each model on the way",
            plot.ladder(found),
            plot.ladder(found, narrow=True),
        ),
        "models": [_model(step) for step in found.ladder],
        "families": [_family(f, found.fit.joints) for f in families],
        "candidates": [_candidate(c, found) for c in shown],
        "others": len(found.candidates) - len(shown),
        "chances": None
        if not shown
        else picture(
            "Bars: how probable each candidate is, and how far its evidence is behind the best",
            plot.candidates(found),
            plot.candidates(found, narrow=True),
        ),
        "evidence": before[0],
        "more_evidence": before[1],
        "still": after[0],
        "more_still": after[1],
        "remainder": [_remainder(r) for r in found.random_torque],
        "alike": [alike(group, found.fit.joints) for group in found.lookalikes if len(group) > 1],
        "next": advice(found),
        "outcomes": None if found.next_experiment is None else outcomes(found.next_experiment),
        "left": failing(found.comparison, ()),
        "budget": found.budget,
    }


def _title(found: Diagnosis) -> str:
    if found.explains_nothing:
        return "The model explains nothing of this motion"
    if found.verdict == "adequate":
        return "Nothing is missing"
    if not found.added:
        return f"Something is missing that {unnamed(found)} explains"
    words = [placed(f.name, f.place, found.fit.joints) for f in accepted(found)]
    if found.verdict == "unexplained":
        words.append(f"something that {unnamed(found)} explains")
    return f"What is missing: {listed(words)}"


def _each(missing: Sequence[Missing]) -> list[tuple[Missing, int]]:
    return [(found, joint) for found in missing for joint in range(len(found.joints))]


def _evidence(found: Diagnosis) -> list[tuple[Missing, int]]:
    """The torque that the base model lacks, with the curves of what was added before their rivals',
    those that draw most of it first; where what was added acts, or everywhere if on no joint."""
    if not found.added:
        return []

    def rank(curve: Curve) -> tuple[bool, float]:
        return curve.effect not in found.added, -curve.share

    ordered = [each._replace(curves=tuple(sorted(each.curves, key=rank))) for each in found.missing]
    acting = [
        (each, joint)
        for each, joint in _each(ordered)
        if any(c.effect in found.added and np.any(c.torque[:, joint]) for c in each.curves)
    ]
    return acting or _each(ordered)


def _remainder(r) -> dict[str, str]:
    """How large the torque is that the last model still lacks, at one joint."""
    share = 100 * r.share_of_spring
    return {
        "joint": r.joint,
        "rms": f"{plain(r.rms, 2)} {r.unit}",
        "band": f"{plain(r.low, 2)} to {plain(r.high, 2)} {r.unit}",
        "share": f"{plain(share, 2)} %" if share == share else "",
    }


def _model(step: ModelState) -> dict[str, Any]:
    fit, held = step.fit, step.held_out
    units = fit.experiment.units or (None,) * len(fit.joints)

    def cell(j: int, rmse: np.ndarray, ratio: float | None) -> str:
        return "" if ratio is None else f"{amount(float(rmse[j]), units[j])} ({times(ratio)} ×)"

    outside = fit.rmse if held is None else held.held_out.rmse
    errors = [
        (cell(j, fit.rmse, fitted), cell(j, outside, checked))
        for j, (fitted, checked) in enumerate(times_noise(step))
    ]
    return {
        "name": model_name(step),
        "errors": dict(zip(fit.joints, errors, strict=True)),
        "chi2": plain(fit.reduced_chi2),
        "log_evidence": nats(step.log_evidence),
    }


def _family(family: Family, joints: Sequence[str]) -> dict[str, str]:
    members = [f"{lower(title(x))} {percent(p)}" for x, p in family.members]
    return {
        "name": upper(placed(family.name, family.place, joints)),
        "probability": percent(family.probability),
        "members": ", ".join(members),
    }


def _candidate(candidate: Candidate, found: Diagnosis) -> dict[str, Any]:
    return {
        "effect": candidate.effect,
        "title": at_place(candidate.effect, found.fit.joints),
        "accepted": candidate.effect in found.added,
        "probability": percent(candidate.probability),
        "log_evidence": nats(candidate.log_evidence)
        + ("" if candidate.iterated else " (first order)"),
        "numbers": [
            (name.rpartition(".")[2], value_words(value).replace("+/-", "±"))
            for name, value in candidate.parameters.items()
        ],
    }
