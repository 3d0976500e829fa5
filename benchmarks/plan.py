"""What to measure next, and what happens in orbit: how right `plan`, `unload` and the atlas are.

    python -m benchmarks.plan campaigns --count 40        releases until the name is sure
    python -m benchmarks.plan orbit --count 200           bands of frequency and damping in orbit
    python -m benchmarks.plan atlas --count 40            are the stated strengths right?

Random MuJoCo arms with something hidden (`tests/rig`); nothing of the rig shares code with the
package. Each command prints a line a case as it goes, and its table at the end; `--seconds` begins
no case after that long, so that a partial run is a fair sample, and `--skip` goes on from another
case. Seeds: `SEED`, then the case's number.

`campaigns`: one small release (2 to 5 % of the spring's torque, noise 10 % of the amplitude, 8 s)
of an effect that has look-alikes, of which the diagnosis is not sure (the right kind of law at the
right place has less than 95 %). Then releases are added, up to `MOST`: planned (`residyn.plan`), at
random (uniform within the same limits), or the largest. Counted is how many it takes until the
right kind and place has 95 %.

`orbit`: an arm on bearings with drag or friction, or with an effect at a joint that looks like it;
diagnosed from one release on the bearings. Does the 95 % band of frequency and damping ratio of
each mode without bearings hold the truth, over all models in play, and of the likeliest alone?

`atlas`: an arm with springs and dampers is looked at (`residyn.detectable`); then an effect is
hidden in it at the stated strength, and at three times that, released again, and diagnosed. Is it
named, alone or among look-alikes?
"""

import argparse
import dataclasses
import math
import time
from collections.abc import Iterator

import numpy as np

import residyn
from benchmarks._unloading import ON, table_of
from residyn.diagnosis.evidence import INDISTINGUISHABLE
from residyn.physics.modal import modes
from residyn.procedure.unload import _bare
from residyn.recordings.limits import Limits
from tests.rig.arm import Arm, paper_twin
from tests.rig.cases import log_uniform, random_arm, random_release
from tests.rig.hidden import BEARINGS, Hidden, random_hidden, record
from tests.rig.unloaded import off_bearings

SEED = 2028
MOST = 5
"""Releases that are added at most."""
SURE = 0.95
ALIKE = (
    "coulomb_friction", "quadratic_drag", "cubic_stiffness", "asymmetric_stiffness", "dead_zone",
    "hysteresis",
)  # fmt: skip
AT_BEARINGS = ("bearing_drag", "bearing_friction", "bearing_quadratic_drag")
AT_JOINTS = ("coulomb_friction", "quadratic_drag", "coupling_damping", "asymmetric_damping")
SMALL = ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "constant_torque",
         "stiffness_drift", "hysteresis")  # fmt: skip


def measured(case, name: str, **where) -> residyn.Recording:
    """A recording of the rig as the package takes it."""
    return residyn.Recording.from_arrays(
        case.t, case.q, noise=case.noise, theta2=case.arm.theta2, name=name, **where
    )


def timed(count: int, skip: int, seconds: float) -> Iterator[int]:
    """The numbers of the cases, until the time is over."""
    began = time.perf_counter()
    for i in range(skip, skip + count):
        if time.perf_counter() - began > seconds:
            print(f"stopped after {i - skip} cases of {count}", flush=True)
            return
        yield i


# -- campaigns ---------------------------------------------------------------------------------


def campaigns(count: int, skip: int, seconds: float) -> None:
    """Releases until the right kind of law at the right place has 95 %."""
    needed: dict[str, list[int]] = {"planned": [], "random": [], "largest": []}
    for i in timed(count, skip, seconds):
        rng = np.random.default_rng([SEED, i])
        arm = random_arm(rng)
        q0 = random_release(rng, (0.03, 0.1))
        label = f"{ALIKE[i % len(ALIKE)]}:{('shoulder', 'elbow')[(i // len(ALIKE)) % 2]}"
        hidden = random_hidden(rng, label, arm, q0, log_uniform(rng, 0.02, 0.05), seconds=8.0)
        first = record(rng, arm, q0, [hidden], seconds=8.0, noise_share=0.1)
        limits = Limits(angle=0.3, theta2=(-1.5, 1.5), duration=8.0)
        begin = residyn.Experiment(table_of(arm), (measured(first, "0"),), limits=limits)
        found = residyn.diagnose(begin, max_effects=1)
        if right(found, label) >= SURE:
            print(f"{i} {label}: sure after one release", flush=True)
            continue
        for way in needed:
            rng_of_way = np.random.default_rng([SEED, i, 1])
            many = campaign(way, begin, found, label, hidden, first, rng_of_way)
            needed[way].append(many)
        print(f"{i} {label}: { ({w: n[-1] for w, n in needed.items()}) }", flush=True)
    print(f"cases: {len(needed['planned'])} ({MOST + 1}: not sure after {MOST})")
    for way, each in needed.items():
        print(f"{way:<8} median {np.median(each) if each else math.nan:g}, mean "
              f"{np.mean(each) if each else math.nan:.2f}, {sorted(each)}")  # fmt: skip


def right(found: residyn.Diagnosis, label: str) -> float:
    """Probability of the right kind of law at the right place."""
    return max(f.probability for f in found.families if label in dict(f.members))


def campaign(way, experiment, found, label, hidden, first, rng) -> int:
    """How many releases it takes."""
    for many in range(1, MOST + 1):
        theta2, q0 = next_release(way, experiment, found, rng)
        arm = dataclasses.replace(first.arm, theta2=theta2)
        made = record(rng, arm, q0, [hidden], seconds=8.0, noise=first.noise)
        recordings = (*experiment.recordings, measured(made, str(many)))
        experiment = dataclasses.replace(experiment, recordings=recordings)
        found = residyn.diagnose(experiment, max_effects=1)
        if right(found, label) >= SURE:
            return many
    return MOST + 1


def next_release(way, experiment, found, rng) -> tuple[float, list[float]]:
    """Elbow angle at rest and angles at release, rad."""
    limits = experiment.limits
    present = experiment.recordings[0].theta2
    if way == "planned":
        plan = residyn.plan(found, tests=1)
        if plan.tests:
            test = plan.tests[0]
            return float(test.theta2 or 0.0), list(test.release.values())
    if way == "largest":
        return present, [limits.angle, limits.angle]
    angles = rng.uniform(-limits.angle, limits.angle, 2)
    return float(rng.uniform(*limits.theta2)), angles.tolist()


# -- orbit -------------------------------------------------------------------------------------


def orbit(count: int, skip: int, seconds: float) -> None:
    """Coverage of the 95 % bands without bearings."""
    held: dict[str, list[bool]] = {}
    for i in timed(count, skip, seconds):
        rng = np.random.default_rng([SEED, 2, i])
        arm = dataclasses.replace(paper_twin(), theta2=float(rng.uniform(-1.5, 1.5)))
        arm = dataclasses.replace(
            arm,
            stiffness=tuple(log_uniform(rng, 0.5, 2.0) * k for k in arm.stiffness),
            damping=tuple(log_uniform(rng, 0.3, 3.0) * c for c in arm.damping),
        )
        q0 = random_release(rng, (0.1, 0.4))
        if i % 2:
            label = AT_JOINTS[(i // 2) % len(AT_JOINTS)]
            places = label != "coupling_damping"
            label = f"{label}:{('shoulder', 'elbow')[(i // 8) % 2]}" if places else label
        else:
            label = AT_BEARINGS[(i // 2) % len(AT_BEARINGS)]
        hidden = random_hidden(rng, label, arm, q0)
        case = record(rng, arm, q0, [hidden], noise_share=0.01, bearings=BEARINGS)
        on = residyn.Experiment(table_of(arm), (measured(case, "on"),), ON)
        found = residyn.diagnose(on)
        over = residyn.unload(on, diagnosis=found)
        assert over.over_models is not None
        truth = true_modes(on, arm, hidden)
        mixed, single = over.over_models.poses[0][1], over.without_bearings
        line = []
        for j, expected in enumerate(truth):
            for k, name in enumerate(("frequency", "damping")):
                for way, each in (("models", mixed), ("single", single)):
                    inside = j < len(each) and holds(each[j], k, expected[k])
                    held.setdefault(f"{name}, {way}", []).append(inside)
                    line.append(f"{'+' if inside else '-'}")
        print(f"{i} {label}: {''.join(line)}", flush=True)
    for name, each in sorted(held.items()):
        print(f"{name:<20} {100 * np.mean(each):5.1f} % of {len(each)}")


def true_modes(on: residyn.Experiment, arm: Arm, hidden: Hidden) -> list[tuple[float, float]]:
    """Frequency and damping ratio of each mode of the arm that was made, without bearings; an
    effect of the joints that is linear at rest stays."""
    if not hidden.label.startswith(("coupling_damping", "asymmetric_damping")):
        return list(zip(*(x.tolist() for x in off_bearings(arm).modes()), strict=True))
    recording = on.recordings[0]
    model = residyn.fitting.model_for(
        residyn.fitting.mechanism_of(on, recording), [hidden.label]
    ).with_values(
        {f"{hidden.label}.{k}": v for k, v in hidden.values.items()}
        | {f"spring:{j}.stiffness": k for j, k in zip(on.joints, arm.stiffness, strict=True)}
        | {f"damper:{j}.damping": c for j, c in zip(on.joints, arm.damping, strict=True)}
    )
    found = modes(_bare(on, model, recording))
    return list(zip(np.asarray(found.frequency_hz).tolist(),
                    np.asarray(found.damping_ratio).tolist(), strict=True))  # fmt: skip


def holds(mode, k: int, expected: float) -> bool:
    """Whether a 95 % band holds a value."""
    name = ("frequency_hz", "damping_ratio")[k]
    value = getattr(mode, name)
    if isinstance(value, float):
        return abs(value - expected) <= 1.96 * getattr(mode, f"{name}_std")
    return value.low <= expected <= value.high


# -- the atlas ---------------------------------------------------------------------------------


def atlas(count: int, skip: int, seconds: float) -> None:
    """Share of recordings in which an effect is named at the stated strength, and at three times
    that."""
    named: dict[float, list[bool]] = {1.0: [], 3.0: []}
    for i in timed(count, skip, seconds):
        rng = np.random.default_rng([SEED, 3, i])
        arm, q0 = random_arm(rng), random_release(rng, (0.1, 0.3))
        clean = record(rng, arm, q0, [], noise_share=0.02, seconds=10.0)
        table = table_of(arm)
        known = residyn.detectable(residyn.Experiment(table, (measured(clean, "clean"),)))
        label = f"{SMALL[i % len(SMALL)]}:{('shoulder', 'elbow')[(i // len(SMALL)) % 2]}"
        told = next(e for e in known.effects if e.effect == label)
        if told.shows is None:
            print(f"{i} {label}: at no strength", flush=True)
            continue
        line = []
        for times, each in named.items():
            values = {told.number: times * told.shows, **told.shape}
            case = record(rng, arm, q0, [Hidden(label, values)], noise=clean.noise, seconds=10.0)
            recordings = (measured(case, "made"),)
            found = residyn.diagnose(residyn.Experiment(table, recordings), max_effects=1)
            each.append(among(found, label))
            line.append(f"{times:g} x: {'named' if each[-1] else '-'}")
        print(f"{i} {label} at {told.shows:.3g} {told.unit}: {', '.join(line)}", flush=True)
    for times, each in named.items():
        print(f"at {times:g} x the stated strength: {sum(each)} of {len(each)}")


def among(found: residyn.Diagnosis, label: str) -> bool:
    """Whether an effect is named, alone or among look-alikes."""
    candidate = found.candidate(label)
    alike = any(label in group for group in found.lookalikes)
    near = candidate.log_evidence > -INDISTINGUISHABLE
    return bool(found.added) and (label in found.added or (alike and near))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="How right plan, unload and the atlas are.")
    parser.add_argument("what", choices=("campaigns", "orbit", "atlas"))
    parser.add_argument("--count", type=int, default=4)
    parser.add_argument("--skip", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=math.inf)
    asked = parser.parse_args()
    residyn.set_up()
    {"campaigns": campaigns, "orbit": orbit, "atlas": atlas}[asked.what](
        asked.count, asked.skip, asked.seconds
    )


if __name__ == "__main__":
    main()
