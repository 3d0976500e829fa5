"""How long a diagnosis takes, and how much memory.

    python -m benchmarks.diagnosis_speed [cold] [filled] [samples] [many] [--arms 20]

Twenty MuJoCo arms with twenty different things hidden, pairs among them; 20 s at 100 Hz, noise 1 %
of the amplitude. A process reads one recording, diagnoses it and ends; its wall and CPU time
include Python's imports, and all that is compiled.

`cold`     each arm in a fresh process with an empty cache.
`filled`   each in a fresh process, the cache filled by three other arms before; and, in the same
           process, the second diagnosis, of another recording of that arm ("warm").
`samples`  20 000 samples against 2000 of the same 20 s, fresh (cache filled) and warm.
`many`     a hundred diagnoses in one process: peak memory after 10, 50 and 100.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks._fresh import Took, fresh, markdown, memory_mb

SEED = 91100
NOISE = 0.01
HIDDEN = (
    ("coulomb_friction:elbow",),
    ("quadratic_drag:shoulder",),
    ("cubic_stiffness:elbow",),
    ("coulomb_friction:shoulder", "constant_torque:elbow"),
    ("dead_zone:shoulder",),
    ("hysteresis:elbow",),
    ("gravity",),
    ("periodic_disturbance:elbow", "cubic_stiffness:shoulder"),
    ("stiffness_drift:shoulder",),
    ("coupling_stiffness",),
    ("bearing_friction",),
    ("quadratic_drag:elbow", "asymmetric_stiffness:elbow"),
    ("asymmetric_damping:elbow",),
    ("sensor_delay:elbow",),
    ("wrist_flexibility",),
    ("stribeck_friction:shoulder", "sensor_offset:elbow"),
    ("brake_slip:elbow",),
    ("inertia_error:elbow",),
    ("bearing_quadratic_drag",),
    ("periodic_disturbance:shoulder",),
)
MODULE = "benchmarks.diagnosis_speed"


def recorded(
    folder: Path, index: int, turn: int = 0, rate: float = 100.0, *, seed: int = SEED
) -> str:
    """The file of one recording of an arm; `turn` is another release and noise of that arm."""
    from tests import rig

    labels, rng = HIDDEN[index % len(HIDDEN)], np.random.default_rng([seed, index])
    arm = rig.random_arm(rng)
    rng = np.random.default_rng([seed, index, turn])
    release = rig.random_release(rng)
    strength = 0.05 if len(labels) > 1 else None
    hidden = [rig.random_hidden(rng, x, arm, release, strength) for x in labels]
    case = rig.record(rng, arm, release, hidden, rate=rate, noise=0.0)
    noise = NOISE * float(np.sqrt(np.mean(np.abs(case.motion[0]).max(axis=0) ** 2)))
    q = case.truth + noise * rng.standard_normal(case.truth.shape)
    path = folder / f"{seed}_{index}_{turn}_{rate:g}.npz"
    numbers = [arm.l1, arm.l2, arm.shoulder, arm.elbow, arm.coupling, arm.theta2, noise]
    np.savez(path, t=case.t, q=q, numbers=numbers, hidden="+".join(labels))
    return str(path)


def here(paths: Sequence[str]) -> None:
    """Diagnose each recording, and print what it took."""
    import residyn
    from residyn.recordings.tables import ArmTable, Bearing

    residyn.set_up()
    for path in paths:
        data = np.load(path)
        l1, l2, shoulder, elbow, coupling, theta2, noise = (float(x) for x in data["numbers"])
        recording = residyn.Recording.from_arrays(data["t"], data["q"], theta2=theta2, noise=noise)
        bearings = [Bearing(where, 1e-9, 1e-9) for where in ("elbow", "wrist")]
        table = ArmTable((l1, l2), shoulder, elbow, coupling)
        began, cpu = time.perf_counter(), time.process_time()
        found = residyn.diagnose(residyn.Experiment(table, (recording,), bearings))
        row = {
            "seconds": time.perf_counter() - began,
            "cpu": time.process_time() - cpu,
            "peak": memory_mb(),
            "rss": memory_mb("VmRSS"),
            "said": f"{found.verdict}: {' + '.join(found.added) or '-'}",
        }
        print(json.dumps(row), flush=True)


def diagnosed(paths: Sequence[str], cache: Path) -> Took:
    """The same in a fresh process; ends the command if that fails."""
    took = fresh(MODULE, "here", given=list(paths), cache=cache)
    if took.error:
        sys.exit(f"{paths}: {took.error}")
    return took


HEAD = ["hidden", "wall, s", "CPU, s", "peak, MB", "warm, s", "said"]


def _row(name: str, took: Took) -> tuple[list[str], list[float]]:
    """A line of the table, and its numbers; what came second in the process is the warm one."""
    first, *more = took.answers
    numbers = [
        took.wall - sum(x["seconds"] for x in more),
        took.cpu - sum(x["cpu"] for x in more),
        first["peak"],
        *(x["seconds"] for x in more),
    ]
    cells = [f"{numbers[0]:.1f}", f"{numbers[1]:.1f}", f"{numbers[2]:.0f}"]
    cells.append(f"{numbers[3]:.2f}" if more else "-")
    line = [name, *cells, first["said"]]
    print("| " + " | ".join(line) + " |", flush=True)
    return line, numbers


def _summary(every: list[list[float]]) -> None:
    columns = list(zip(*every, strict=True))
    for words, how in (("**median**", np.median), ("**worst**", np.max)):
        cells = [f"{how(c):.2f}" if i == 3 else f"{how(c):.1f}" for i, c in enumerate(columns)]
        print("| " + " | ".join([words, *cells, *[""] * (5 - len(cells))]) + " |", flush=True)


def cold(folder: Path, arms: int) -> None:
    """Fresh processes, empty caches."""
    print("\n### cold\n\n" + markdown(HEAD, []))
    every = []
    for i in range(arms):
        path = recorded(folder, i)
        with tempfile.TemporaryDirectory() as cache:
            every.append(_row(_name(i), diagnosed([path], Path(cache)))[1])
    _summary(every)


def _name(index: int) -> str:
    return " + ".join(HIDDEN[index % len(HIDDEN)])


def _fill(folder: Path) -> Path:
    """A cache that three other arms have filled."""
    cache = folder / "filled"
    if not cache.exists():
        cache.mkdir()
        for i in (2, 3, 10):
            diagnosed([recorded(folder, i, seed=SEED + 1)], cache)
    return cache


def filled(folder: Path, arms: int) -> None:
    """Fresh processes, the cache filled; and warm."""
    cache = _fill(folder)
    print("\n### filled\n\n" + markdown(HEAD, []), flush=True)
    every = []
    for i in range(arms):
        both = [recorded(folder, i), recorded(folder, i, 1)]
        every.append(_row(_name(i), diagnosed(both, cache))[1])
    _summary(every)


def samples(folder: Path, arms: int) -> None:
    """Ten times the samples."""
    cache = _fill(folder)
    print("\n### samples\n\n" + markdown(["samples", *HEAD[1:]], []), flush=True)
    every = []
    for rate in (100.0, 1000.0):
        both = [recorded(folder, 0, turn, rate) for turn in (0, 1)]
        diagnosed(both[:1], cache)  # a bucket of that length is compiled
        every.append(_row(f"{20 * rate:.0f}", diagnosed(both, cache))[1])
    ratios = [b / a for a, b in zip(*every, strict=True)]
    print("| ratio | " + " | ".join(f"{x:.1f}" for x in ratios) + " | |")


def many(folder: Path, arms: int) -> None:
    """A hundred in one process."""
    paths = [recorded(folder, i % len(HIDDEN), i // len(HIDDEN)) for i in range(5 * arms)]
    took = diagnosed(paths, _fill(folder))
    marks = [n for n in (1, 10, 50, 100) if n <= len(paths)]
    rows = [
        [f"{n}", f"{took.answers[n - 1]['peak']:.0f}", f"{took.answers[n - 1]['rss']:.0f}"]
        for n in marks
    ]
    print("\n### many\n\n" + markdown(["diagnoses", "peak, MB", "then resident, MB"], rows))
    seconds = [x["seconds"] for x in took.answers[1:]]
    print(f"\nSeconds of each after the first: median {np.median(seconds):.2f}, worst ", end="")
    print(f"{max(seconds):.2f}.")


PARTS = {"cold": cold, "filled": filled, "samples": samples, "many": many}


def main() -> None:
    """The command."""
    if sys.argv[1:] == ["here"]:
        here(json.load(sys.stdin))
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[])
    parser.add_argument("--arms", type=int, default=len(HIDDEN))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        for part in options.parts or PARTS:
            PARTS[part](Path(name), options.arms)


if __name__ == "__main__":
    main()
