"""`residyn fit --each` killed at random, again and again: no line is lost, none is there twice.

python -m benchmarks.kills [KILLS]      200 kills
"""

import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

EXPERIMENTS = 12


def folder_of(path: Path) -> None:
    """Experiments of a cart on a spring, each with its own stiffness."""
    t = np.arange(300) / 50
    for i in range(EXPERIMENTS):
        q = 0.1 * np.exp(-0.1 * t) * np.cos((4 + 0.2 * i) * t)
        q = q + 1e-3 * np.random.default_rng(i).standard_normal(len(t))
        rows = "\n".join(f"{a:.3f},{b:.9f}" for a, b in zip(t, q, strict=True))
        (path / f"{i:02d}.csv").write_text(f"t,q1\n{rows}\n")
        (path / f"{i:02d}.toml").write_text(
            '[inertia]\njoints = ["cart"]\nunits = ["m"]\nmatrix = [[2.0]]\n'
            f'[[recordings]]\nfile = "{i:02d}.csv"\nnoise = 1e-3\n'
        )


def main(kills: int = 200) -> None:
    """Kill, look at what is there, go on; begin anew once all is done."""
    chance, done, rounds, lost = random.Random(0), 0, 0, 0
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name), Path(name) / "all.jsonl"
        folder_of(folder)
        command = [sys.executable, "-m", "residyn", "fit", "--each", name]
        command += ["--starts", "1", "--json", str(out)]
        whole = 0.0
        for _ in range(2):  # the first one compiles
            out.unlink(missing_ok=True)
            begin = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            whole = time.perf_counter() - begin
        out.unlink()
        before: list[str] = []
        while done < kills:
            run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                run.wait(chance.uniform(0.0, whole))
            except subprocess.TimeoutExpired:
                run.send_signal(chance.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
                run.wait()
                done += 1
            text = out.read_text() if out.exists() else ""
            lines = [line for line in text.split("\n")[:-1] if line]
            names = [json.loads(line)["name"] for line in lines]
            assert len(set(names)) == len(names), f"a line is there twice: {names}"
            lost += len(set(before) - set(lines))
            before = lines
            print(f"{done} kills, {len(names)} lines, {lost} lost", file=sys.stderr, flush=True)
            if len(names) == EXPERIMENTS:
                rounds, before = rounds + 1, []
                out.unlink()
    print(f"{done} kills, {rounds} times all {EXPERIMENTS} done, {lost} finished lines lost")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
