"""One case of the hidden-effect benchmark: diagnosed, or held against what was possible.

No method can name what the readings do not show. So an *oracle*, which knows what is hidden and
fits it, says what they show: it fits springs and dampers alone, with the truth, and with its
rivals. Chi-square of these fits, and of the true motion, is all that the scores need
(`_hidden_report`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import numpy as np

import residyn
from benchmarks._fresh import memory_mb
from benchmarks._hidden_cases import Spec
from benchmarks.effects import experiment_of
from tests import rig

TINY = 1e-9
"""Less likely names are not written down."""


def about(spec: Spec) -> dict[str, Any]:
    """What every line begins with."""
    return {
        "key": spec.key,
        "what": spec.what,
        "hidden": list(spec.labels),
        "noise": spec.noise,
        "seed": spec.seed,
    }


def chi2_of(fit) -> float:
    """Squared residuals in units of the noise, all readings: MuJoCo makes no wild ones."""
    return sum(float(np.nansum((r.residual / r.recording.noise) ** 2)) for r in fit.recordings)


def ratio(off: np.ndarray) -> float:
    """Rms."""
    return float(np.sqrt(np.nanmean(np.square(off))))


def diagnosed(spec: Spec) -> dict[str, Any]:
    """The answer of `residyn.diagnose`. CPU time and memory are the whole process's."""
    case = spec.make()
    experiment = experiment_of(case)
    wall, cpu = time.perf_counter(), time.process_time()
    found = residyn.diagnose(experiment)
    took = {"seconds": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    off = (case.q - case.truth) / case.noise
    held = found.ladder[-1].held_out
    return about(spec) | {
        "values": {k: float(v) for k, v in case.numbers.items()},
        "verdict": found.verdict,
        "verdict_probability": found.verdict_probability,
        "added": list(found.added),
        "candidates": [[c.effect, c.probability] for c in found.candidates if c.probability > TINY],
        "families": [
            [f.name, f.place, f.probability, f.members]
            for f in found.families
            if f.probability > TINY
        ],
        "lookalikes": [list(group) for group in found.lookalikes],
        "intensity": found.intensity,
        "left": {r.joint: r.share_of_spring for r in found.random_torque},
        "chi2": {
            "truth": float(np.sum(off**2)),
            "base": chi2_of(found.base),
            "last": chi2_of(found.fit),
        },
        "held_out": None
        if held is None
        else {"last": ratio(held.held_out.ratio), "floor": ratio(off[len(off) * 2 // 3 :])},
        "models": found.budget.models,
        "stopped": found.budget.stopped,
        **took,
        "peak_mb": memory_mb(),
    }


def oracle(spec: Spec, rivals: Iterable[str], every: bool) -> dict[str, Any]:
    """Chi-square and count of numbers of fits by name.

    Fitted are: springs and dampers; the truth; for each hidden effect, the truth with each of
    `rivals` in its place; and of two effects each alone. `every`: all effects are rivals.
    """
    case = spec.make()
    experiment, off = experiment_of(case), (case.q - case.truth) / case.noise
    out: dict[str, Any] = {"truth": float(np.sum(off**2)), "readings": int(off.size), "fits": {}}
    known = [x for x in spec.labels if x in rig.NAMES]
    sets: list[tuple[str, ...]] = [(), tuple(sorted(known))]
    if spec.what == "pairs":
        sets += [(x,) for x in known]
    if spec.what in ("single", "pairs") or every:
        places = rig.NAMES if every else tuple(rivals)
        rests = [[y for y in known if y != x] for x in known] or [[]]
        sets += [tuple(sorted({*rest, r})) for rest in rests for r in places]
    for labels in dict.fromkeys(sets):
        name = "+".join(labels)
        try:
            fit = residyn.fit(experiment, effects=list(labels), starts=2)
            out["fits"][name] = [chi2_of(fit), len(fit.numbers) + fit.recordings[0].state.size]
        except (residyn.FitError, ValueError) as error:  # two laws of which one contains the other
            out["fits"][name] = [None, 0]
            out.setdefault("failed", {})[name] = str(error)
    return about(spec) | out
