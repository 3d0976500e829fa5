"""One case of the hidden-effect benchmark: diagnosed, and held against what was possible.

No method can name what the readings do not show. So an *oracle*, which knows the hidden effect and
fits it, says which cases count: those where the effect brings chi-square down by more than
`SURE + 2 x` (its numbers). The oracle's fit is not always needed. The true motion itself is one
point of the true model, and the best fit can only be closer to the readings, by about one for each
number fitted: where the truth is already `SURE + 2 x` better than the base model, the case counts,
and where it lacks more than `ROOM`, it cannot. Only between the two is there a fit. This also keeps
a case that the oracle's own search lost from being struck off.
"""

from __future__ import annotations

import math
import time
import traceback
from typing import Any

import numpy as np

import residyn
from benchmarks._hidden_cases import Spec, named_row
from benchmarks.effects import experiment_of
from residyn.effects import effects_named
from tests import rig

SURE = 25.0
"""Fall of chi-square that leaves no doubt, beyond 2 for every number that was added."""
ROOM = 60.0
"""More than a fit of a dozen numbers gains on the truth by following the noise."""


def refit(experiment, effects, start=None):
    """A fit of springs, dampers and `effects`. `start` (a fit nearby) is for quicker ones."""
    return residyn.fit(experiment, effects=list(effects), starts=2)


def diagnose(experiment):
    """What the benchmark is about."""
    return residyn.diagnose(experiment)


def chi2_of(fit) -> float:
    """Squared residuals in units of the noise, all readings: MuJoCo makes no wild ones."""
    return sum(
        float(np.nansum((r.residual / r.recording.noise) ** 2))
        for r in fit.recordings
        if r.recording.role != "check"
    )


def numbers_of(fit) -> int:
    """How many numbers were fitted, the memories' initial values included."""
    return len(fit.numbers) + sum(r.state.size for r in fit.recordings)


def limit(extra: int) -> float:
    """How far chi-square must fall for `extra` numbers."""
    return SURE + 2.0 * extra


def oracle(case: rig.HiddenCase, experiment, labels, base, chi2_truth: float) -> dict[str, Any]:
    """Could anyone tell `labels` (all of them) from `base`? The numbers behind the answer."""
    extra = 1
    if labels and labels[0] in rig.NAMES:
        model = base.model
        for label in labels:
            for effect in effects_named(label, model.mechanism):
                model = model + effect
        extra = len(model.fitted) + len(model.memory) - len(base.numbers)
    needed, chi2_base = limit(extra), chi2_of(base)
    gain = chi2_base - chi2_truth
    out = {"extra": extra, "limit": needed, "gain": gain, "fitted": None}
    if labels and labels[0] in rig.NAMES and needed - ROOM < gain <= needed:
        out["fitted"] = chi2_of(refit(experiment, labels, base))
        gain = chi2_base - min(out["fitted"], chi2_truth)
    return out | {"tellable": gain > needed}


def run_case(spec: Spec) -> dict[str, Any]:
    """The line of the results' file; with `error` in place of what could not be had."""
    row: dict[str, Any] = {
        "key": spec.key,
        "what": spec.what,
        "hidden": list(spec.labels),
        "noise": spec.noise,
        "seed": spec.seed,
    }
    step = "rig"
    try:
        case = spec.make()
        step = "diagnose"
        experiment = experiment_of(case)
        began = time.perf_counter()
        found = diagnose(experiment)
        row |= _told(case, found) | {"seconds": time.perf_counter() - began}
        step = "oracle"
        began = time.perf_counter()
        row |= _judged(spec, case, experiment, found.ladder[0].fit, row)
        return row | {"seconds_oracle": time.perf_counter() - began}
    except Exception:
        return row | {"error": step, "trace": traceback.format_exc()}


def _told(case: rig.HiddenCase, found) -> dict[str, Any]:
    """What the diagnosis said, and what it leaves beside what the truth leaves."""
    base, last = found.ladder[0].fit, found.ladder[-1].fit
    off = (case.q - case.truth) / case.noise
    told = found.to_dict()
    return {
        "values": {k: float(v) for k, v in case.numbers.items()},
        "readings": int(off.size),
        "verdict": told["verdict"],
        "added": list(told["added"]),
        "lookalikes": told["lookalikes"],
        "candidates": [
            [c["effect"], c["probability"], c["chi2_drop_screened"], c["chi2_drop_refit"]]
            for c in told["candidates"]
        ],
        "ladder": told["ladder"],
        "chi2": {"truth": float(np.sum(off**2)), "base": chi2_of(base), "last": chi2_of(last)},
        "held_out": _held_out(case, found.ladder),
    }


def _judged(spec: Spec, case: rig.HiddenCase, experiment, base, row) -> dict[str, Any]:
    """What the oracle says; of a wrong name, whether it explains the readings as well."""
    truth, added = row["chi2"]["truth"], row["added"]
    seen = oracle(case, experiment, spec.labels, base, truth)
    best = min(truth, seen["fitted"] or np.inf)
    out: dict[str, Any] = {"oracle": seen}
    if spec.what == "pairs" and seen["tellable"]:
        # Each can be told given the other, if neither alone does as well as both.
        alone = {x: chi2_of(refit(experiment, [x], base)) for x in spec.labels}
        seen["alone"] = alone
        seen["tellable"] = all(chi2 - best > seen["limit"] for chi2 in alone.values())
    if spec.what == "single" and added and added[0] != spec.labels[0]:
        right = seen["fitted"] or chi2_of(refit(experiment, spec.labels, base))
        wrong = chi2_of(refit(experiment, added[:1], base))
        out["wrong_over_right"] = wrong - min(right, truth)
    return out


def _held_out(case: rig.HiddenCase, ladder) -> dict[str, Any] | None:
    """rms error over the last third, all joints together, in times the noise: of the base model
    and of the last one; what that very noise amounts to there; what a right model would leave."""
    held = [rung.held_out for rung in ladder]
    if held[-1] is None:
        return None

    def whole(x) -> float:
        return float(np.sqrt(np.mean(np.square(x))))

    late = case.t > 2 / 3 * case.t[-1]
    error, expected = held[-1].held_out, held[-1].held_out.expected
    return {
        "base": None if held[0] is None else whole(held[0].held_out.ratio),
        "last": whole(error.ratio),
        "floor": whole(((case.q - case.truth) / case.noise)[late]),
        "expected": None if expected is None else whole(expected),
    }


def bic(spec: Spec) -> dict[str, Any]:
    """The plain rival: fit every effect of the catalogue beside springs and dampers, and take the
    least `chi-square + (numbers) ln (readings)`, the base model included."""
    case = spec.make()
    experiment = experiment_of(case)
    began, scores = time.perf_counter(), {}
    for label in (None, *rig.NAMES):
        try:
            fit = refit(experiment, [label] if label else [])
        except Exception:
            continue  # this candidate cannot be had; the others can
        scores[label] = chi2_of(fit) + numbers_of(fit) * math.log(case.q.size)
    best = min(scores, key=lambda label: scores[label])
    return named_row(spec, "bic", [best] if best else [], time.perf_counter() - began)
