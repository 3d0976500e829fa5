"""What the page says of a diagnosis: the verdict and the falling error, then the evidence."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import plot
from .._units import amount, plain, ratio
from ..diagnosis import Missing
from ..diagnosis.missing import summary
from ..diagnosis.printed import (
    alike,
    at_place,
    fall,
    percent,
    rung_name,
    times_noise,
    value_words,
    worth_showing,
)
from ..diagnosis.result import Candidate, Diagnosis, Rung
from ..diagnosis.words import listed
from ._failing import clearest, failing
from ._picture import picture

_MOST = 4
"""Pictures of missing torques in one place; `residyn compare` draws them all."""


def diagnosed(found: Diagnosis) -> dict[str, Any]:
    """All that the template says of it."""
    experiment, shown = found.fit.experiment, worth_showing(found)
    names = [at_place(name, found.fit.joints) for name in found.added]
    held = next((r.held_out.what for r in found.ladder if r.held_out is not None), None)
    unexplained = found.verdict == "unexplained"
    before = clearest(experiment, _evidence(found), _MOST)
    after = clearest(
        experiment, _each(found.comparison.missing_torque) if unexplained else (), _MOST
    )
    return {
        "title": _title(found),
        "verdict": found.verdict,
        "added": listed(names) if names else "",
        "words": [words.replace(" +/- ", " ±\u00a0") for words in found.words],
        "joints": found.fit.joints,
        "held_out": held,
        "falling": picture(
            "The error in times the noise, per joint, falling from rung to rung",
            plot.ladder(found),
            plot.ladder(found, narrow=True),
        ),
        "ladder": [_rung(rung) for rung in found.ladder],
        "suspects": [_suspect(c, found) for c in shown],
        "others": len(found.candidates) - len(shown),
        "chances": None
        if not shown
        else picture(
            "Bars: how likely each suspect is, and by how much chi-square falls with it",
            plot.suspects(found),
            plot.suspects(found, narrow=True),
        ),
        "evidence": before[0],
        "more_evidence": before[1],
        "still": after[0],
        "more_still": after[1],
        "remainder": _remainder(found),
        "alike": [alike(group) for group in found.lookalikes if len(group) > 1],
        "next": None if found.next_experiment is None else found.next_experiment.words,
        "left": failing(found.comparison, ()),
    }


def _title(found: Diagnosis) -> str:
    names = [at_place(name, found.fit.joints) for name in found.added]
    if found.verdict == "adequate":
        return "Nothing is missing"
    if not names:
        return "Something is missing that no effect of the catalogue explains"
    if found.verdict == "missing":
        return f"What is missing: {listed(names)}"
    return f"What is missing: {listed([*names, 'something that no effect explains'])}"


def _each(missing: Sequence[Missing]) -> list[tuple[Missing, int]]:
    return [(found, joint) for found in missing for joint in range(len(found.joints))]


def _evidence(found: Diagnosis) -> list[tuple[Missing, int]]:
    """The torque that the base model lacks, with the curve of what the ladder accepted before
    those that merely fit it well, where the accepted acts; everywhere, if it acts on no joint."""
    if not found.added:
        return []

    def rank(label: str) -> int:
        return found.added.index(label) if label in found.added else len(found.added)

    ordered = [
        each._replace(curves=tuple(sorted(each.curves, key=lambda c: rank(c.effect))))
        for each in found.missing
    ]
    acting = [
        (each, joint)
        for each, joint in _each(ordered)
        if any(c.effect in found.added and np.any(c.torque[:, joint]) for c in each.curves)
    ]
    return acting or _each(ordered)


def _remainder(found: Diagnosis) -> str:
    """How large the torque is that the last model still lacks."""
    rest = summary(found.comparison.missing_torque) or {}
    words = []
    for joint, each in rest.items():
        size = f"{plain(each['rms'], 2)} {each['unit']} rms at the {joint}"
        share = 100 * each["share_of_spring"]
        words.append(f"{size} ({plain(share, 2)} % of the spring's)" if share == share else size)
    return f"The torque that it still lacks is estimated as {listed(words)}." if words else ""


def _rung(rung: Rung) -> dict[str, Any]:
    fit, held = rung.fit, rung.held_out
    units = fit.experiment.units or (None,) * len(fit.joints)

    def cell(j: int, rmse: np.ndarray, times: float | None) -> str:
        return "" if times is None else f"{amount(float(rmse[j]), units[j])} ({ratio(times)} ×)"

    outside = fit.rmse if held is None else held.held_out.rmse
    errors = [
        (cell(j, fit.rmse, fitted), cell(j, outside, checked))
        for j, (fitted, checked) in enumerate(times_noise(rung))
    ]
    return {
        "name": rung_name(rung),
        "errors": dict(zip(fit.joints, errors, strict=True)),
        "chi2": plain(fit.reduced_chi2),
    }


def _suspect(candidate: Candidate, found: Diagnosis) -> dict[str, Any]:
    tried = candidate.chi2_drop_refit is not None
    return {
        "effect": candidate.effect,
        "accepted": candidate.effect in found.added,
        "probability": percent(candidate.probability),
        "screened": fall(candidate.chi2_drop_screened),
        "refit": fall(candidate.chi2_drop_refit) if tried else "not tried",
        "numbers": [
            (name.rpartition(".")[2], value_words(value).replace("+/-", "±"))
            for name, value in candidate.parameters.items()
            if tried
        ],
    }
