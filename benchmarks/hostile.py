"""Recordings that no braked arm made, or that something spoilt: does `diagnose` name anything?

python -m benchmarks.hostile [NAME...]      all, if none is named

Each is one recording, with frozen seeds, given to the command in a process of its own. A good
answer is a refusal in one line, "unexplained", or a name that says what was done to the recording;
no other name may have a probability above one half. Time (of the CPU) and memory are those of the
process, with programs already in the cache (a first run compiles them).
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks._fresh import markdown
from tests.rig import Arm, random_arm, random_release, simulate

SEED = 250_000
NOISE = 1e-3
SURE = 0.5
LONGEST, LARGEST = 60.0, 1e9
"""s and bytes that one diagnosis may take."""
STOP = 600.0

T = np.arange(2001) / 100


class Made(NamedTuple):
    """A recording, and the experiment file's arm."""

    time: np.ndarray
    angle: np.ndarray
    arm: Arm


def ringing(rng: np.random.Generator, arm: Arm, noise: float = NOISE) -> np.ndarray:
    """A good recording, (2001, 2) rad."""
    q, _ = simulate(arm, T, random_release(rng, (0.1, 0.3)))
    return q + noise * rng.standard_normal(q.shape)


def walk(rng: np.random.Generator) -> np.ndarray:
    """Random walks, a tenth of a radian after a second."""
    return 0.01 * np.cumsum(rng.standard_normal((len(T), 2)), axis=0)


def grows(rng: np.random.Generator, _arm: Arm) -> np.ndarray:
    """Sines that grow by e in 5 s, no modes of the arm."""
    f, phase = rng.uniform(0.4, 3.0, 2), rng.uniform(0, 6.28, 2)
    q = 5e-3 * np.exp(T / 5)[:, None] * np.cos(2 * np.pi * f * T[:, None] + phase)
    return q + NOISE * rng.standard_normal(q.shape)


def chirp(rng: np.random.Generator, _arm: Arm) -> np.ndarray:
    """Sweeps from 0.3 to 4 Hz."""
    sweep = 2 * np.pi * (0.3 * T + (4 - 0.3) * T**2 / (2 * T[-1]))
    q = np.stack([0.2 * np.cos(sweep), 0.1 * np.sin(1.3 * sweep)], axis=1)
    return q + NOISE * rng.standard_normal(q.shape)


def jumps(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """An encoder that loses count four times."""
    for at in rng.integers(200, 1900, 4):
        q[at:, int(rng.integers(2))] += rng.choice([-1, 1]) * rng.uniform(0.05, 0.2)
    return q


def steps(rng: np.random.Generator, _arm: Arm) -> np.ndarray:
    """A motor that goes from one place to the next every half second."""
    q = np.repeat(0.1 * rng.standard_normal((41, 2)), 50, axis=0)[: len(T)]
    return q + NOISE * rng.standard_normal(q.shape)


def again(rng: np.random.Generator, arm: Arm) -> np.ndarray:
    """Two releases in one recording."""
    q = np.concatenate([ringing(rng, arm)[:1000], ringing(rng, arm)[:1001]])
    return q


def strange_modes(rng: np.random.Generator, _arm: Arm) -> np.ndarray:
    """Three damped lines in each joint, none in common."""
    f = rng.uniform(0.4, 5.0, (3, 2))
    waves = np.exp(-0.1 * T[:, None, None]) * np.cos(2 * np.pi * f * T[:, None, None])
    q = 0.1 * waves.sum(axis=1)
    return q + NOISE * rng.standard_normal(q.shape)


def dropout(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """A radio that holds its last value, half of the time."""
    for j in range(2):
        held = rng.random(len(q)) < 0.5
        last = np.maximum.accumulate(np.where(held, 0, np.arange(len(q))))
        q[:, j] = q[last, j]
    return q


def jitter(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """Read at other times than those in the file, by 20 ms."""
    late = 0.02 * rng.standard_normal(len(T))
    return np.stack([np.interp(T + late, T, x) for x in q.T], axis=1)


def slow_clock(rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """A clock that loses up to a tenth, on and off."""
    own = T + 0.3 * np.sin(2 * np.pi * T / 9.0 + rng.uniform(0, 6.28))
    return np.stack([np.interp(own, T, x) for x in q.T], axis=1)


def heavier(arm: Arm, **factors: float) -> Arm:
    """The arm that the experiment file says, with other inertias than the real one."""
    values = {name: getattr(arm, name) * factor for name, factor in factors.items()}
    return Arm(**{**arm.__dict__, **values})


def spoilt(change: Callable[[np.random.Generator, np.ndarray], np.ndarray]):
    """A good recording and what became of it."""
    return lambda rng, arm: change(rng, ringing(rng, arm))


CASES: dict[str, tuple[Callable[[np.random.Generator, Arm], np.ndarray], tuple[str, ...]]] = {
    "random walks": (lambda rng, arm: walk(rng), ()),
    "a random walk on top": (lambda rng, arm: ringing(rng, arm) + 0.2 * walk(rng), ()),
    "fast drift": (lambda rng, arm: ringing(rng, arm) + 0.3 * T[:, None] * [1, -0.5], ()),
    "white noise": (lambda rng, arm: 0.05 * rng.standard_normal((len(T), 2)), ()),
    "growing oscillation": (grows, ()),
    "chirps": (chirp, ()),
    "steps": (steps, ()),
    "strange modes": (strange_modes, ()),
    "clipped": (spoilt(lambda rng, q: np.clip(q, -0.06, 0.06)), ()),
    "jumps": (spoilt(jumps), ()),
    "joints swapped": (spoilt(lambda rng, q: q[:, ::-1]), ()),
    "shoulder's sign": (spoilt(lambda rng, q: q * [-1, 1]), ("sensor_scale:shoulder",)),
    "elbow's sign": (spoilt(lambda rng, q: q * [1, -1]), ("sensor_scale:elbow",)),
    "elbow from the table": (spoilt(lambda rng, q: np.stack([q[:, 0], q.sum(axis=1)], 1)), ()),
    "two releases": (again, ()),
    "last value held": (spoilt(dropout), ()),
    "times jitter": (spoilt(jitter), ()),
    "a clock that wanders": (spoilt(slow_clock), ()),
    "coarse encoder": (spoilt(lambda rng, q: 0.05 * np.rint(q / 0.05)), ()),
    "degrees as radians": (spoilt(lambda rng, q: np.degrees(q)), ()),
    "microseconds as seconds": (ringing, ()),
    "inertia by five, shoulder": (ringing, ("inertia_error:shoulder",)),
    "inertia by five, all": (ringing, ()),
    "wild readings, a tenth": (
        spoilt(lambda rng, q: q + (rng.random(q.shape) < 0.1) * rng.standard_cauchy(q.shape)),
        (),
    ),
}


def made(name: str) -> Made:
    """The recording of this name, the same at every call."""
    rng = np.random.default_rng(SEED + list(CASES).index(name))
    arm = random_arm(rng)
    angle, time, said = CASES[name][0](rng, arm), T, arm
    if name == "microseconds as seconds":
        time = 1e6 * T
    if name == "inertia by five, shoulder":
        said = heavier(arm, shoulder=5.0)
    if name == "inertia by five, all":
        said = heavier(arm, shoulder=5.0, elbow=5.0, coupling=5.0)
    return Made(time, angle, said)


def write(folder: Path, recording: Made) -> Path:
    """The experiment's file."""
    rows = np.column_stack([recording.time, recording.angle]).tolist()
    lines = [",".join(f"{x:.9g}" for x in row) for row in rows]
    (folder / "x.csv").write_text("\n".join(["t,q1,q2", *lines, ""]))
    arm, path = recording.arm, folder / "x.toml"
    path.write_text(
        f"[arm]\nlink_lengths = [{arm.l1}, {arm.l2}]\nshoulder = {arm.shoulder}\n"
        f"elbow = {arm.elbow}\ncoupling = {arm.coupling}\n"
        f'[[recordings]]\nfile = "x.csv"\ntheta2 = {arm.theta2}\n'
    )
    return path


class Outcome(NamedTuple):
    """What became of one recording."""

    said: str
    names: dict[str, float]
    """Effects and their probabilities, of 1 % and more."""
    seconds: float
    """Of the CPU."""
    memory: float
    """Bytes."""
    wrong: str
    """What is not as it should be; empty if nothing."""


def diagnosed(name: str) -> Outcome:
    """Run the command and judge what it says."""
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        path, out, words = write(folder, made(name)), folder / "x.json", folder / "words"
        command = [sys.executable, "-m", "residyn", "diagnose", str(path), "--json", str(out)]
        began = time.perf_counter()
        with open(words, "w") as file:
            run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=file)
            # What this process and no other took: `resource` has only the largest of all.
            while (done := os.wait4(run.pid, os.WNOHANG))[0] == 0:
                if time.perf_counter() - began > STOP:
                    run.kill()
                time.sleep(0.05)
        seconds, memory = done[2].ru_utime + done[2].ru_stime, 1024.0 * done[2].ru_maxrss
        run.returncode = os.waitstatus_to_exitcode(done[1])
        line = words.read_text().strip().replace(str(folder) + os.sep, "")
        found = json.loads(out.read_text()) if out.exists() else None
    names, wrong = {}, []
    if found is not None:
        names = {c["effect"]: c["probability"] for c in found["candidates"]}
        names = {effect: p for effect, p in names.items() if p >= 0.01}
        families = {(f["name"], f["place"]): f for f in found["families"]}
        right = CASES[name][1]
        for f in families.values():
            if f["probability"] > SURE and not {m["effect"] for m in f["members"]} & set(right):
                wrong.append(f"{f['name']} ({f['place']}) {f['probability']:.0%}")
        line = f"{found['verdict']} ({found['verdict_probability']:.0%})"
        if found["channels"]:
            line += f": {found['channels']['words']}"
    elif run.returncode not in (1, 2) or line.count("\n") or "should not have" in line:
        wrong.append(f"status {run.returncode}")
    if seconds > LONGEST:
        wrong.append(f"{seconds:.0f} s")
    if memory > LARGEST:
        wrong.append(f"{memory / 1e9:.2g} GB")
    return Outcome(line, names, seconds, memory, ", ".join(wrong))


def main(names: list[str]) -> None:
    """A table, a line as each is done on standard error."""
    rows = []
    for name in names or list(CASES):
        took = diagnosed(name)
        said = took.said if len(took.said) < 90 else took.said[:87] + "..."
        named = ", ".join(f"{e} {p:.0%}" for e, p in took.names.items()) or "nothing"
        row = [
            name,
            said,
            named,
            f"{took.seconds:.0f} s",
            f"{took.memory / 1e9:.2f} GB",
            took.wrong,
        ]
        rows.append(row)
        print(" | ".join(row), file=sys.stderr, flush=True)
    print(markdown(["recording", "said", "named", "time", "memory", "wrong"], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
