"""`residyn fit` as people run it, a whole process each time, beside a script on SciPy.

    python -m benchmarks.process [--repeats 3]

In each turn a fresh cache folder: the first command ever; the second, on a recording of another
length; the same two without any cache; SciPy's script on both recordings, from numbers 40 % off;
and `residyn --help`. Python's own byte code is there already.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests import rig

ARM = rig.paper_twin(0.3)
LENGTHS = (20.0, 27.0)
NOISE = 1e-3
SCRIPT = Path(__file__).with_name("_scipy_script.py")
TRUTH = np.array([*ARM.stiffness, *ARM.damping])


def written(
    folder: Path, name: str, arm: rig.Arm, rng: np.random.Generator, seconds: float
) -> Path:
    """An experiment's TOML file, its CSV file beside it: a release of an arm."""
    release = np.array([0.2, -0.1]) * rng.uniform(0.7, 1.3, 2)
    case = rig.record(rng, arm, release, [], seconds=seconds, rate=100.0, noise=NOISE)
    csv = folder / f"{name}.csv"
    rows = np.column_stack([case.t, case.q])
    np.savetxt(csv, rows, delimiter=",", header="t,q1,q2", comments="")
    toml = csv.with_suffix(".toml")
    toml.write_text(
        f"[arm]\nlink_lengths = [{arm.l1}, {arm.l2}]\nshoulder = {arm.shoulder}\n"
        f"elbow = {arm.elbow}\ncoupling = {arm.coupling}\n\n"
        f'[[recordings]]\nfile = "{csv.name}"\ntheta2 = {arm.theta2}\nnoise = {NOISE}\n'
    )
    return toml


def recorded(folder: Path, seed: int) -> list[Path]:
    """Two experiments of different lengths."""
    rng = np.random.default_rng([seed, 11])
    return [written(folder, f"release{i}", ARM, rng, s) for i, s in enumerate(LENGTHS)]


def timed(command: list[str], cache: Path) -> float:
    """Seconds of a whole process that must succeed."""
    began = time.perf_counter()
    subprocess.run(
        command,
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"XDG_CACHE_HOME": str(cache)},
    )
    return time.perf_counter() - began


def turn(seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds of each process, and the largest error of k in percent of those that fit."""
    took: dict[str, float] = {}
    off: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = folder / "cache"
        cache.mkdir()
        files = recorded(folder, seed)
        fit = [sys.executable, "-m", "residyn", "fit"]
        out = folder / "fit.json"
        for words, file, more in (
            ("first ever", files[0], []),
            ("second, another length", files[1], []),
            ("first, no cache", files[0], ["--no-cache"]),
        ):
            took[f"residyn fit, {words}"] = timed(
                [*fit, str(file), "--json", str(out), *more], cache
            )
            told = json.loads(out.read_text())["parameters"]
            values = [told[f"spring:{j}.stiffness"]["value"] for j in ("shoulder", "elbow")]
            off[f"residyn fit, {words}"] = _off(values)
        rng = np.random.default_rng([seed, 12])
        start = TRUTH * np.where(rng.random(4) < 0.5, 0.6, 1.4)
        given = [ARM.theta2, ARM.shoulder, ARM.elbow, ARM.l1 * ARM.coupling, *start]
        for i, words in enumerate(("first", "second, another length")):
            csv = files[i].with_suffix(".csv")
            command = [sys.executable, str(SCRIPT), str(csv), *(str(float(x)) for x in given)]
            began = time.perf_counter()
            told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            took[f"SciPy's script, {words}"] = time.perf_counter() - began
            off[f"SciPy's script, {words}"] = _off([float(x) for x in told.split()[:2]])
        took["residyn --help"] = timed([sys.executable, "-m", "residyn", "--help"], cache)
    return took, off


def _off(stiffness: list[float]) -> float:
    return float(100 * np.max(np.abs(np.array(stiffness) / TRUTH[:2] - 1)))


def main() -> None:
    """The table."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--repeats", type=int, default=3)
    turns = [turn(seed) for seed in range(given.parse_args().repeats)]
    print("| process | median (min to max), s | k off, worst, % |\n|---|---|---|")
    for name in turns[0][0]:
        took = [t[name] for t, _ in turns]
        off = [o[name] for _, o in turns if name in o]
        worst = f"{max(off):.2g}" if off else ""
        print(f"| {name} | {np.median(took):.2f} ({min(took):.2f} to {max(took):.2f}) | {worst} |")
    for ours, theirs, words in (
        ("residyn fit, first ever", "SciPy's script, first", "first ever over SciPy"),
        ("residyn fit, second, another length", "SciPy's script, second, another length",
         "second over SciPy"),
    ):  # fmt: skip
        ratios = [t[ours] / t[theirs] for t, _ in turns]
        print(f"{words}: {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


if __name__ == "__main__":
    main()
