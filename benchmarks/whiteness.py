"""Is the test of whiteness calibrated, and what does it notice? On MuJoCo arms.

    python -m benchmarks.whiteness clean    100 arms of nothing but springs and dampers, read in
                                            seven ways: how often does the test reject?
    python -m benchmarks.whiteness power    arms with something small hidden in one joint

A test at 1 % must reject one right model in a hundred: more would send people after effects that
are not there. Seeds are fixed; `--seed` takes others, `--count` fewer arms, `--only` one kind.
"""

import argparse
import math
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from scipy.stats import kstest

import residyn
from residyn.diagnosis.linearised_fit import predictions
from residyn.diagnosis.residuals import where
from residyn.recordings.tables import ArmTable
from tests import rig

NOISE = 5e-4
KINDS = {
    "as it is": {},
    "noise estimated": {"noise": None},
    "noise overstated twice": {"noise": 2 * NOISE},
    "lost": {"lost": True, "noise": None},
    "uneven": {"uneven": True},
    "rounded, step 3 sigma": {"step": 3 * NOISE, "noise": None},
    "rounded, no other noise": {"step": 2 * NOISE, "sigma": 0.0, "noise": None},
}
HIDDEN = ("coulomb", "cubic", "drag", "asymmetric", "drift", "offset", "periodic")
STRENGTHS = (0.001, 0.002, 0.005, 0.02)


def experiment_of(arm: rig.Arm, t: np.ndarray, q: np.ndarray, noise: float | None):
    """One recording of an arm, as a user would have it."""
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    recording = residyn.Recording.from_arrays(t, q, theta2=arm.theta2, noise=noise)
    return residyn.Experiment(table, (recording,))


def reading(
    case: rig.Case,
    rng: np.random.Generator,
    *,
    noise: float | None = NOISE,
    sigma: float = NOISE,
    step: float = 0.0,
    lost: bool = False,
    uneven: bool = False,
) -> residyn.Experiment:
    """A clean arm read by some sensor."""
    t, truth = case.t, case.truth
    if uneven:
        t = t + np.append(0.0, rng.uniform(-0.4, 0.4, len(t) - 1)) * (t[1] - t[0])
        truth, _ = rig.simulate(case.arm, t, case.q0)
    q = truth + sigma * rng.standard_normal(truth.shape)
    if step:
        q = np.round(q / step) * step
    if lost:
        q[rng.random(q.shape) < 0.1] = np.nan
        first = int(rng.integers(200, len(q) - 400))
        q[first : first + 80, 1] = np.nan
    return experiment_of(case.arm, t, q, noise)


def chances(experiment: residyn.Experiment) -> tuple[list[float], float]:
    """The p-value of each joint, and of both together."""
    fit = residyn.fit(experiment, starts=2)
    with jax.enable_x64(True):
        found = where(fit, predictions(fit, fit.unknowns)[1])
    each = list(found.white.values())
    return each, 1 - (1 - np.nanmin(each)) ** len(each)


def clean(seed: int, count: int, only: str | None) -> None:
    """Rejections of right models."""
    print("| readings | joints, p < 1 % | p < 5 % | arms, p < 1 % | uniform? (p of KS) |")
    print("|---|---|---|---|---|")
    for kind, how in KINDS.items():
        if only not in (None, kind):
            continue
        rng = np.random.default_rng([seed, 1])
        joints: list[float] = []
        arms: list[float] = []
        for index, case in enumerate(rig.clean_cases(rng, count, noise=NOISE)):
            each, both = chances(reading(case, np.random.default_rng([seed, 2, index]), **how))
            joints += each
            arms.append(both)
        p, q = np.array(joints), np.array(arms)
        uniform = kstest(p[np.isfinite(p)], "uniform").pvalue
        print(f"| {kind} | {np.sum(p < 0.01)} of {len(p)} | {np.sum(p < 0.05)} ", end="")
        print(f"| {np.sum(q < 0.01)} of {len(q)} | {uniform:.2f} |", flush=True)


def hidden_in(kind: str, share: float, case: dict[str, Any]) -> dict[str, Any]:
    """What hides in one joint: at most `share` of its spring's torque at the release."""
    arm, joint, q0 = case["arm"], case["joint"], abs(float(case["q0"][case["joint"]]))
    stiffness = arm.stiffness[joint]
    torque = share * stiffness * q0
    fast = 2 * math.pi * arm.modes()[0][0]
    laws = {
        "cubic": lambda t, q, v: -torque * (q / q0) ** 3,
        "drag": lambda t, q, v: -torque * v * abs(v) / (fast * q0) ** 2,
        "asymmetric": lambda t, q, v: -share * stiffness * max(q, 0.0),
        "drift": lambda t, q, v: -share * stiffness * q * t / 20,
        "offset": lambda t, q, v: torque,
        "periodic": lambda t, q, v: torque * math.sin(2 * math.pi * case["frequency"] * t),
    }
    if kind == "coulomb":
        return {"frictionloss": tuple(torque if i == joint else 0.0 for i in range(2))}

    def on_joint(t, q, v):
        found = np.zeros(2)
        found[joint] = laws[kind](t, q[joint], v[joint])
        return found

    return {"torque": on_joint}


def arms(seed: int, count: int) -> Iterator[dict[str, Any]]:
    """Arms and releases; the same ones for every effect and strength."""
    rng = np.random.default_rng([seed, 3])
    for index in range(count):
        arm = rig.random_arm(rng, damping_ratio=(0.003, 0.03))
        case = {"arm": arm, "q0": rig.random_release(rng), "joint": int(rng.integers(2))}
        yield {**case, "frequency": rng.uniform(0.3, 3.0), "index": index}


def power(seed: int, count: int, only: str | None) -> None:
    """Rejections of wrong models."""
    t = np.arange(2001) / 100
    print("| hidden | " + " | ".join(f"{100 * s:g} %" for s in STRENGTHS) + " |")
    print("|---|" + "---|" * len(STRENGTHS))
    for kind in HIDDEN:
        if only not in (None, kind):
            continue
        print(f"| {kind} |", end="", flush=True)
        for share in STRENGTHS:
            noticed = 0
            for case in arms(seed, count):
                q, _ = rig.simulate(case["arm"], t, case["q0"], **hidden_in(kind, share, case))
                rng = np.random.default_rng([seed, 4, case["index"]])
                q = q + NOISE * rng.standard_normal(q.shape)
                noticed += chances(experiment_of(case["arm"], t, q, NOISE))[1] < 0.01
            print(f" {noticed} of {count} |", end="", flush=True)
        print()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    jobs = {"clean": (clean, 100), "power": (power, 20)}
    parser.add_argument("what", choices=list(jobs))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int)
    parser.add_argument("--only", choices=[*KINDS, *HIDDEN])
    given = parser.parse_args()
    job, usual = jobs[given.what]
    job(given.seed, given.count or usual, given.only)
