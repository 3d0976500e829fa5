"""`residyn fit --each` killed at random, again and again: no line is lost, none is there twice.

python -m benchmarks.kills [KILLS]            200 kills of the writing: fits are had once, and then
                                              come from an executor that knows them, so that most
                                              kills fall between two bytes and not into a fit
python -m benchmarks.kills command [KILLS]    of the whole command, from its start to its end
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import numpy as np

EXPERIMENTS = 12
SIGNALS = [signal.SIGKILL, signal.SIGTERM, signal.SIGINT]


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


class Known:
    """An executor that has all results already; each comes after a millisecond."""

    def __init__(self, told: dict[str, dict]):
        self.told = told

    def submit(self, function: Callable, name: str, *given) -> Future:
        from residyn.fitting import Each

        time.sleep(1e-3)
        found = Future()
        found.set_result(Each(name, None, self.told[name]))
        return found


def main(*words: str) -> None:
    """Kill, look at what is there, go on; begin anew once all is done."""
    whole_command = words[:1] == ("command",)
    kills = int(words[-1]) if words[whole_command:] else 200
    chance, done, rounds, lost, cut = random.Random(0), 0, 0, 0, 0
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name), Path(name) / "all.jsonl"
        folder_of(folder)
        files = sorted(map(str, folder.glob("*.toml")))
        command = [sys.executable, "-m", "residyn", "fit", "--each", name]
        command += ["--starts", "1", "--json", str(out)]
        for _ in range(1 + whole_command):  # the first one compiles
            out.unlink(missing_ok=True)
            begin = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            whole = time.perf_counter() - begin
        known = Known({told["name"]: told for told in map(json.loads, out.open())})
        out.unlink()
        if not whole_command:
            whole = 5e-3 * EXPERIMENTS
            from residyn.fitting import fit_many  # nothing is computed here: a fork may live
        before: list[str] = []
        while done < kills:
            if whole_command:
                run = subprocess.Popen(
                    command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                ).pid
            elif (run := os.fork()) == 0:
                signal.signal(signal.SIGINT, signal.SIG_DFL)
                for _ in fit_many(files, starts=1, out=out, executor=known):
                    pass
                os._exit(0)
            time.sleep(chance.uniform(0.0, whole))
            if os.waitpid(run, os.WNOHANG)[0] == 0:
                os.kill(run, chance.choice(SIGNALS))
                os.waitpid(run, 0)
                done += 1
            text = out.read_text() if out.exists() else ""
            *lines, rest = text.split("\n")
            cut += bool(rest)
            names = [json.loads(line)["name"] for line in lines]
            assert len(set(names)) == len(names), f"a line is there twice: {names}"
            lost += len(set(before) - set(lines))
            before = lines
            if len(names) == EXPERIMENTS:
                rounds, before = rounds + 1, []
                out.unlink()
        left = len(list(folder.iterdir())) - 2 * EXPERIMENTS - out.exists()
    print(f"{done} kills, {rounds} times all {EXPERIMENTS} done, {lost} finished lines lost,")
    print(f"{cut} times a line was cut, {left} files left behind")


if __name__ == "__main__":
    main(*sys.argv[1:])
