"""What to measure next, and what happens in orbit: how right `plan`, `unload` and the atlas are.

    python -m benchmarks.plan run --seeds report --campaigns 40 --orbit 200 --atlas 40 --out FILE
    python -m benchmarks.plan report FILE

Random MuJoCo arms with something hidden (`tests/rig`); nothing of the rig shares code with the
package. Every case is a line of JSON. What the file holds already is not done again, and
`--seconds` begins no case after that long: cases are taken in turn, so that a partial run is a fair
sample. Everything random about a case follows from its seed and number; the seed `report` is
frozen, and whatever was tuned was tuned on `tuning`.

A case is weighed by the search of a diagnosis alone: the models that were tried, simulated exactly
where they are in play, and their evidences, which is all that `plan`, `unload --diagnose` and the
atlas speak of. Laws without a name are left out.

`campaigns`: one release of an effect that has look-alikes, at the strength at which the atlas says
that half of such releases would name it: so one release seldom is enough, on whatever arm (8 s,
noise 10 % of the amplitude). Where the right kind of law at the right place has less than 95 %,
releases are added, up to `MOST`: planned (as `residyn.plan` does, after each release), at random
(uniform within the same limits, as the first was), or the largest. Counted is how many it takes
until the right kind and place has 95 %. The rig may swing the joints to `ANGLE` and turn the elbow.

`orbit`: an arm on bearings with drag or friction, or with an effect at a joint that looks like it;
one release on the bearings. Does the 95 % band of frequency and damping ratio of each mode without
bearings hold the truth, over all models in play, of the likeliest alone, and over all models if one
says that the bearings drag?

`atlas`: an arm with springs and dampers is looked at (`residyn.detectable`); then an effect is
hidden in it at the stated strength, and at three times that, released again, and diagnosed. Is it
named, alone or among look-alikes?
"""

import argparse
import dataclasses
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.special import log_softmax

import residyn
from benchmarks._fresh import markdown
from benchmarks._unloading import ON, table_of
from residyn.diagnosis.candidate_tests import Rival, best_tests, in_play
from residyn.diagnosis.detectable import Detectable
from residyn.diagnosis.diagnose import MOST_EFFECTS, Fits, Posterior
from residyn.diagnosis.missing_torque import scene_of
from residyn.diagnosis.search import Search
from residyn.physics.modal import modes
from residyn.procedure.over_models import (
    Bare,
    errors_of,
    modes_over,
    with_and_without_drag,
)
from residyn.procedure.unload import bare as without_bearings
from residyn.recordings.limits import Limits
from tests.rig.arm import Arm, paper_twin
from tests.rig.cases import log_uniform, random_arm, random_release
from tests.rig.hidden import BEARINGS, Hidden, HiddenCase, random_hidden, record
from tests.rig.unloaded import off_bearings

SEEDS = {"tuning": 28_001, "report": 20_261_124}
RATE = 50.0
"""Hz, of all recordings: ten readings of the fastest cycle."""
AT: Any = {"seconds": 8.0, "rate": RATE}
"""How releases of campaigns and of the atlas are recorded."""
MOST = 5
"""Releases that are added at most."""
SURE = 0.95
ANGLE = 0.1
"""rad: the largest release that a campaign's rig allows, the first included."""
ALIKE = (
    "coulomb_friction", "quadratic_drag", "cubic_stiffness", "asymmetric_stiffness", "dead_zone",
    "hysteresis",
)  # fmt: skip
AT_BEARINGS = ("bearing_drag", "bearing_friction", "bearing_quadratic_drag")
AT_JOINTS = ("coulomb_friction", "quadratic_drag", "coupling_damping", "asymmetric_damping")
SMALL = ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "constant_torque",
         "stiffness_drift", "hysteresis")  # fmt: skip
WAYS = ("planned", "random", "largest")
BANDS = {
    "models": "over all models",
    "likeliest": "the likeliest alone",
    "drag given": "over all models, `--with bearing_drag`",
}


def measured(case, name: str, **where) -> residyn.Recording:
    """A recording of the rig as the package takes it."""
    return residyn.Recording.from_arrays(
        case.t, case.q, noise=case.noise, theta2=case.arm.theta2, name=name, **where
    )


def weighed(experiment: residyn.Experiment, most: int = 1, effects=()) -> Posterior:
    """The models that a search tries, and their probabilities; all have springs, dampers and
    `effects`."""
    scene, base = scene_of(experiment, effects)
    search = Search(scene, base)
    search.exact = Fits(experiment, scene, starts=1).simulated
    search.run(most)
    return Posterior(search)


def placed(names: tuple[str, ...], i: int) -> str:
    """The i-th label: the names in turn, at the shoulder, then at the elbow."""
    return f"{names[i % len(names)]}:{('shoulder', 'elbow')[(i // len(names)) % 2]}"


# -- campaigns ---------------------------------------------------------------------------------


def campaign(seed: int, i: int) -> dict[str, Any]:
    """Releases until the right kind of law at the right place has 95 %, each way."""
    rng = np.random.default_rng([seed, i])
    arm, label = random_arm(rng), placed(ALIKE, i)
    limits = Limits(angle=ANGLE, theta2=(-1.5, 1.5), duration=8.0)
    q0 = rng.uniform(-ANGLE, ANGLE, 2)
    clean = record(rng, arm, q0, [], noise_share=0.1, **AT)
    known = atlas_of(arm, clean, label)
    if known.shows is None:
        return {"label": label}
    hidden = Hidden(label, {known.number: known.shows, **known.shape})
    first = record(rng, arm, q0, [hidden], noise=clean.noise, **AT)
    begin = residyn.Experiment(table_of(arm), (measured(first, "0"),), limits=limits)
    found = weighed(begin)
    told: dict[str, Any] = {"label": label, "first": right(found, label)}
    if told["first"] >= SURE:
        return told
    for way in WAYS:
        rng = np.random.default_rng([seed, i, 1])
        now, experiment, path = found, begin, []
        while len(path) < MOST and (not path or path[-1] < SURE):
            theta2, release = next_release(way, experiment, now, rng)
            posed = dataclasses.replace(arm, theta2=theta2)
            made = record(rng, posed, release, [hidden], noise=first.noise, **AT)
            runs = (*experiment.recordings, measured(made, str(len(path) + 1)))
            experiment = dataclasses.replace(experiment, recordings=runs)
            now = weighed(experiment)
            path.append(right(now, label))
        told[way] = path
    return told


def right(found: Posterior, label: str) -> float:
    """Probability of the right kind of law at the right place."""
    return max(f.probability for f in found.families() if label in dict(f.members))


def next_release(way, experiment, found: Posterior, rng) -> tuple[float, list[float]]:
    """Elbow angle at rest and angles at release, rad."""
    limits, present = experiment.limits, experiment.recordings[0].theta2
    if way == "planned":
        models, p, _ = in_play(found.models, log_softmax(found.log_tried))
        test = best_tests(experiment, found.search.scene, models, p)[0][0]
        assert test.theta2 is not None
        return test.theta2, list(test.release.values())
    if way == "largest":
        return present, [limits.angle, limits.angle]
    angles = rng.uniform(-limits.angle, limits.angle, 2)
    return float(rng.uniform(*limits.theta2)), angles.tolist()


def needed(path: list[float]) -> int:
    """How many releases it took; `MOST` + 1 where so many were not enough."""
    return len(path) if path[-1] >= SURE else MOST + 1


def campaigns_table(rows: list[dict[str, Any]]) -> str:
    """Median and mean number of releases, each way."""
    rows = [r for r in rows if "first" in r]  # of an effect that shows at some strength
    open_ = [r for r in rows if "planned" in r]
    table = []
    for way in WAYS:
        each = [needed(r[way]) for r in open_]
        counts = [str(each.count(k)) for k in range(1, MOST + 2)]
        table.append([way, f"{np.median(each):g}", f"{np.mean(each):.2f}", *counts])
    head = ["releases", "median", "mean", *(str(k) for k in range(1, MOST + 1)), "more"]
    sure = f"{len(rows)} arms, of which {len(rows) - len(open_)} were sure after one release"
    return f"{sure}; the other {len(open_)}:\n\n{markdown(head, table)}"


# -- orbit -------------------------------------------------------------------------------------


def orbit(seed: int, i: int) -> dict[str, Any]:
    """The 95 % bands without bearings, and the truth."""
    rng = np.random.default_rng([seed, 2, i])
    twin = paper_twin()
    arm = dataclasses.replace(
        twin,
        theta2=float(rng.uniform(-1.5, 1.5)),
        stiffness=tuple(log_uniform(rng, 0.5, 2.0) * k for k in twin.stiffness),
        damping=tuple(log_uniform(rng, 0.3, 3.0) * c for c in twin.damping),
    )
    q0 = random_release(rng, (0.1, 0.4))
    label = AT_BEARINGS[(i // 2) % len(AT_BEARINGS)]
    if i % 2:
        label = placed(AT_JOINTS, i // 2)
        label = label.partition(":")[0] if label.startswith("coupling_damping") else label
    hidden = random_hidden(rng, label, arm, q0)
    case = record(rng, arm, q0, [hidden], rate=RATE, noise_share=0.01, bearings=BEARINGS)
    on = residyn.Experiment(table_of(arm), (measured(case, "on"),), ON)
    row: dict[str, Any] = {"label": label, "truth": true_modes(on, arm, hidden)}
    row |= bands(on, "models", "likeliest") | bands(on, "drag given", None, ["bearing_drag"])
    return row


def bands(on: residyn.Experiment, way: str, alone: str | None, effects=()) -> dict[str, Any]:
    """95 % bands of each mode's frequency and damping ratio without bearings."""
    found = weighed(on, MOST_EFFECTS, effects)
    models, p, _ = with_and_without_drag(found.search)
    bare = []
    for rival in (Rival.of(found.search.scene, m) for m in models):
        off = without_bearings(on, rival.model, on.recordings[0])
        bare.append(Bare(off, rival.model, errors_of(found.search.scene, rival, None)))
    told = {f"{way} in play": [[list(m.added), float(x)] for m, x in zip(models, p, strict=True)]}
    for name, known in ((way, modes_over(bare, p)), (alone, modes_over(bare[:1], np.ones(1)))):
        if name is not None:
            told[name] = [
                [[x.low, x.high] for x in (m.frequency_hz, m.damping_ratio)] for m in known
            ]
    return told


def true_modes(on: residyn.Experiment, arm: Arm, hidden: Hidden) -> list[list[float]]:
    """Frequency and damping ratio of each mode of the arm that was made, without bearings; an
    effect of the joints that is linear at rest stays."""
    if not hidden.label.startswith(("coupling_damping", "asymmetric_damping")):
        return [list(x) for x in zip(*(x.tolist() for x in off_bearings(arm).modes()), strict=True)]
    recording = on.recordings[0]
    model = residyn.fitting.model_for(
        residyn.fitting.mechanism_of(on, recording), [hidden.label]
    ).with_values(
        {f"{hidden.label}.{k}": v for k, v in hidden.values.items()}
        | {f"spring:{j}.stiffness": k for j, k in zip(on.joints, arm.stiffness, strict=True)}
        | {f"damper:{j}.damping": c for j, c in zip(on.joints, arm.damping, strict=True)}
    )
    found = modes(without_bearings(on, model, recording))
    return np.stack([found.frequency_hz, found.damping_ratio], axis=1).tolist()


def orbit_table(rows: list[dict[str, Any]]) -> str:
    """How often a band holds the truth, and how wide it is."""
    table = []
    for k, name in enumerate(("frequency", "damping ratio")):
        for way, words in BANDS.items():
            held, widths = [], []
            for r in rows:
                for j, expected in enumerate(r["truth"]):
                    low, high = r[way][j][k] if j < len(r[way]) else (math.inf, -math.inf)
                    held.append(low <= expected[k] <= high)
                    widths.append(abs(high - low) / expected[k])
            share = f"{100 * np.mean(held):.0f} % of {len(held)}"
            table.append([name, words, share, f"{100 * np.median(widths):.2g} %"])
    head = ["95 % band of", "", "holds the truth", "median width"]
    return f"{len(rows)} arms\n\n{markdown(head, table)}"


# -- the atlas ---------------------------------------------------------------------------------


def atlas_of(arm: Arm, clean: HiddenCase, label: str) -> Detectable:
    """From which strength an effect shows in a release of an arm without it."""
    known = residyn.detectable(residyn.Experiment(table_of(arm), (measured(clean, "clean"),)))
    return next(e for e in known.effects if e.effect == label)


def atlas(seed: int, i: int) -> dict[str, Any]:
    """Whether an effect is named at the stated strength, and at three times that."""
    rng = np.random.default_rng([seed, 3, i])
    arm, q0, label = random_arm(rng), random_release(rng, (0.1, 0.3)), placed(SMALL, i)
    clean = record(rng, arm, q0, [], noise_share=0.02, **AT)
    told = atlas_of(arm, clean, label)
    row: dict[str, Any] = {"label": label, "shows": told.shows, "share": told.share}
    for times in (1, 3):
        if told.shows is None:
            break
        hidden = Hidden(label, {told.number: times * told.shows, **told.shape})
        case = record(rng, arm, q0, [hidden], noise=clean.noise, **AT)
        runs = (measured(case, "made"),)
        found = weighed(residyn.Experiment(table_of(arm), runs))
        alike = [label for group in found.lookalikes() for label in group]
        row[f"at {times}"] = label in (*found.best.added, *alike)
        row[f"best at {times}"] = list(found.best.added)
    return row


def atlas_table(rows: list[dict[str, Any]]) -> str:
    """In how many recordings the effect was named."""
    known = [r for r in rows if r["shows"] is not None]
    table = []
    for name in SMALL:
        own = [r for r in known if r["label"].startswith(name)]
        table.append([name, *(f"{sum(r[f'at {k}'] for r in own)} of {len(own)}" for k in (1, 3))])
    table.append(["all", *(f"{sum(r[f'at {k}'] for r in known)} of {len(known)}" for k in (1, 3))])
    return markdown(["effect", "named at the stated strength", "at three times that"], table)


# -- the command -------------------------------------------------------------------------------

CASES: dict[str, Callable[[int, int], dict[str, Any]]] = {
    "campaigns": campaign, "orbit": orbit, "atlas": atlas,
}  # fmt: skip
TABLES = {"campaigns": campaigns_table, "orbit": orbit_table, "atlas": atlas_table}


def rows_of(file: Path) -> list[dict[str, Any]]:
    """What a file holds."""
    return [json.loads(x) for x in file.read_text().splitlines()] if file.exists() else []


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description="How right plan, unload and the atlas are.")
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run")
    run.add_argument("--seeds", choices=list(SEEDS), default="tuning")
    for name in CASES:
        run.add_argument(f"--{name}", type=int, default=0, metavar="N", help="cases")
    run.add_argument("--seconds", type=float, default=float("inf"))
    run.add_argument("--out", type=Path, required=True, help="JSON lines")
    commands.add_parser("report").add_argument("file", type=Path)
    asked = parser.parse_args()
    rows = rows_of(asked.out if asked.command == "run" else asked.file)
    if asked.command == "report":
        for name, table in TABLES.items():
            own = [r for r in rows if r["what"] == name and "error" not in r]
            failed = sum(r["what"] == name for r in rows) - len(own)
            if failed:
                print(f"{name}: {failed} cases have no answer")
            if own:
                print(f"{name}: {table(own)}\n")
        return
    residyn.set_up()
    seed, began = SEEDS[asked.seeds], time.perf_counter()
    done = {(r["what"], r["case"]) for r in rows if r["seed"] == seed}
    counts = {name: getattr(asked, name) for name in CASES}
    # In turn: the first quarter of each kind is done before the second of any.
    todo = sorted((i / n, name, i) for name, n in counts.items() for i in range(n))
    for _, name, i in todo:
        if (name, i) in done or time.perf_counter() - began > asked.seconds:
            continue
        start = time.process_time()
        with jax.enable_x64(True):
            try:
                row = CASES[name](seed, i)
            except residyn.FitError as error:
                row = {"error": str(error)}
        about = {"what": name, "seed": seed, "case": i}
        line = json.dumps(about | row | {"cpu": round(time.process_time() - start, 1)})
        with asked.out.open("a") as file:
            file.write(line + "\n")
        print(line, flush=True)


if __name__ == "__main__":
    main()
