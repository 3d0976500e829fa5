"""The missing torque beside the true one, for every torque effect of the catalogue.

    python -m benchmarks.missing_torque [--count 3] [--only LABEL...]

MuJoCo arms, 20 s at 100 Hz, noise 0.25 % of the motion's rms; the hidden torque is 1 to 10 % of the
spring's at the largest swing. Per effect: correlation of the smoothed torque with the true one at
the joints that feel it, and the share of instants at which the 95 % band holds the truth (the first
and last three apart), median and range. Springs and dampers are estimated beside the torque, so the
truth is what they lack: the hidden torque, and what their errors leave of their own. Where that
varies by less than 0.2 % of the spring's torque, or 2 % of itself, it has no correlation.
"""

import argparse

import jax
import numpy as np

from benchmarks.effects import experiment_of
from residyn.diagnosis.missing_torque import scene_of, torques_of
from residyn.diagnosis.tried import tried_alone
from residyn.filtering.law import numbers_of
from tests import rig

_ENDS = 3
_FELT = 2e-3  # of the spring's rms torque: a joint that feels less is innocent


def scores(case: rig.HiddenCase) -> list[tuple[float, float]]:
    """(correlation, coverage) of every joint that feels the hidden torque."""
    scene, effects = scene_of(experiment_of(case), [])
    model = tried_alone(scene, effects)
    (found,) = torques_of(scene, model)
    pairs = [
        (w, t) for w, t in zip(model.weights, model.trajectories, strict=True) if t is not None
    ]
    numbers = sum(w * np.asarray(t.numbers) for w, t in pairs) / sum(w for w, _ in pairs)
    names = [f"{e.label}.{n.name}" for e in effects for n in numbers_of(e)]
    values = dict(zip(names, numbers, strict=True))
    (q, v), hidden = case.motion, case.torque
    assert hidden is not None
    rows = []
    for j, joint in enumerate(("shoulder", "elbow")):
        k, c = values[f"spring:{joint}.stiffness"], values[f"damper:{joint}.damping"]
        bent = (case.arm.stiffness[j] - k) * q[:, j] + (case.arm.damping[j] - c) * v[:, j]
        truth = np.interp(found.time, case.t, hidden[:, j] + bent)[_ENDS:-_ENDS]
        felt = np.sqrt(np.mean(hidden[:, j] ** 2))
        least = _FELT * case.arm.stiffness[j] * np.sqrt(np.mean(q[:, j] ** 2))
        if felt < least:
            continue
        tau, std = found.torque[_ENDS:-_ENDS, j], found.std[_ENDS:-_ENDS, j]
        some = max(least, 0.02 * np.sqrt(np.mean(truth**2)))
        varies = truth.std() > some and tau.std() > 0
        correlation = float(np.corrcoef(tau, truth)[0, 1]) if varies else np.nan
        rows.append((correlation, float(np.mean(np.abs(tau - truth) <= 1.96 * std))))
    return rows


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=3)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--only", nargs="+", default=rig.NAMES, metavar="LABEL")
    options = parser.parse_args()
    print(
        f"{'hidden effect':31s} correlation: median (worst)   band holds the truth: median, range"
    )
    every = []
    for label in options.only:
        if label.startswith("sensor"):
            continue
        rng = np.random.default_rng([options.seed, rig.NAMES.index(label)])
        rows = []
        for _ in range(options.count):
            strength = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
            (case,) = rig.hidden_cases(rng, label, 1, strength=strength)
            rows += scores(case)
        every += rows
        if rows:
            r, held = np.array(rows).T
            seen = r[np.isfinite(r)]
            told = f"{np.median(seen):.3f} ({seen.min():.3f})" if len(seen) else "-"
            spread = f"{np.median(held):.3f}, {held.min():.3f} to {held.max():.3f}"
            print(f"{label:31s} {told:28s} {spread}", flush=True)
    r, held = np.array(every).T
    seen = r[np.isfinite(r)]
    print(
        f"{len(every)} joints: correlation at least 0.95 in {np.mean(seen >= 0.95):.0%}; the band "
        f"holds {held.mean():.1%} of all instants, 90 % or more in {np.mean(held >= 0.9):.0%}"
    )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
