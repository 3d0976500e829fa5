"""`residyn fit --each`: how many recordings of a folder it fits a second, and in how much memory.

    python -m benchmarks.folder [--count 1000] [--jobs 1 ...]
    python -m benchmarks.folder memory [--count 200]

The paper's arm, 20 s at 100 Hz, each release from another place and with another stiffness and
damping; in MuJoCo. The first fit of the command compiles or reads what all others share: its time
stands apart. `memory`: the resident memory of one process that fits experiments of 5 to 40 s, none
of which is like another, as they go by.
"""

import argparse
import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import residyn
from tests import rig

from ._fresh import memory_mb
from .process import ARM, written

SECONDS = 20.0


def folder_of(place: Path, count: int, seed: int = 5) -> None:
    """So many experiments."""
    rng = np.random.default_rng([seed, 17])
    for i in range(count):
        written(place, f"release{i:04}", _arm(rng), rng, SECONDS)


def _arm(rng: np.random.Generator) -> rig.Arm:
    each = rng.uniform(0.8, 1.25, 4)
    stiffness, damping = np.split(np.array([*ARM.stiffness, *ARM.damping]) * each, 2)
    return dataclasses.replace(ARM, stiffness=tuple(stiffness), damping=tuple(damping))


def measured(place: Path, jobs: int, cache: Path) -> tuple[float, float, float]:
    """Seconds to the first line, lines a second after it, and MB of the largest process."""
    command = [sys.executable, "-m", "residyn", "fit", "--each", str(place)]
    command += ["--jobs", str(jobs)] if jobs else []
    command += ["--json", str(cache / f"lines{jobs}-{time.time_ns()}.jsonl")]
    began, times = time.perf_counter(), []
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"XDG_CACHE_HOME": str(cache)},
        text=True,
    ) as process:
        assert process.stdout is not None
        times += [time.perf_counter() for _ in process.stdout]
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, command
    rate = (len(times) - 1) / (times[-1] - times[0])
    return times[0] - began, rate, used.ru_maxrss * 1024 / 1e6


def memory(count: int) -> None:
    """Resident memory of this process beside the number of different experiments it has fitted."""
    residyn.set_up()
    rng = np.random.default_rng([6, 17])
    print("| experiments | resident, MB |\n|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for i in range(1, count + 1):
            seconds = float(rng.uniform(5.0, 40.0))
            file = written(Path(name), f"release{i:04}", _arm(rng), rng, seconds)
            residyn.fit(residyn.load(file))
            if i in (1, 10) or i % 50 == 0:
                print(f"| {i} | {memory_mb('VmRSS'):.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="?", choices=["memory"])
    parser.add_argument("--count", type=int)
    parser.add_argument("--jobs", type=int, nargs="+", default=[1])
    given = parser.parse_args()
    if given.what == "memory":
        return memory(given.count or 200)
    with tempfile.TemporaryDirectory() as name:
        place, cache = Path(name) / "recordings", Path(name) / "cache"
        place.mkdir()
        cache.mkdir()
        folder_of(place, given.count or 1000)
        print("| cache | jobs | first, s | a second after it | MB of the largest process |")
        print("|---|---|---|---|---|")
        for words, jobs in [("empty", 0), *(("filled", j) for j in (0, *given.jobs))]:
            first, rate, mb = measured(place, jobs, cache)
            print(f"| {words} | {jobs or '-'} | {first:.1f} | {rate:.1f} | {mb:.0f} |", flush=True)


if __name__ == "__main__":
    main()
