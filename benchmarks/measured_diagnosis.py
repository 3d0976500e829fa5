"""What `diagnose` says of measured recordings, each in a fresh process.

    python -m benchmarks.measured_diagnosis FOLDER [NAME...] [--empty]

FOLDER holds `carts/`, `double_pendulum/`, `emps/`, `air_track/` (see the docs for where they come
from); none is part of this repository, and what is absent is skipped. NAME is the beginning of a
row's name: `high_spring`, `pendulum`, `air`, `emps`; all if not given. A row is of one recording
(`three`: of a cart's three runs together). `--empty` gives each process an empty cache.

Errors are rms over all joints, of springs and dampers alone and of the last model: fitted, and on
readings that were not (the last third, predicted from a fit of the rest, or EMPS' other file).
"Left" is the random torque of the last model, as a share of the spring's torque; EMPS has no spring
worth the name.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import residyn
from benchmarks._fresh import fresh, markdown, memory_mb
from residyn.recordings.tables import ArmTable, InertiaTable

BARE, LOAD = 0.5685, 0.986  # kg
SLIDE = 95.11  # kg
SMOOTH = 3  # samples to either side
MODULE = "benchmarks.measured_diagnosis"


def cart(path: Path, role: str = "fit", own: Sequence[str] = ()) -> residyn.Recording:
    """A run, from its release on; its weight is what presses the wheels."""
    load = LOAD if "loaded" in path.stem else 0.0
    time, angle, _, _ = residyn.recording.read_csv(path, 1)
    return residyn.Recording.from_arrays(
        time,
        angle,
        start="release",
        name=path.stem,
        extra_mass=load,
        load=9.81 * (BARE + load),
        role=role,
        own=own,
    )


def carts_of(*recordings: residyn.Recording) -> residyn.Experiment:
    """Runs of the cart, whatever it carries."""
    return residyn.Experiment(InertiaTable(("cart",), ((BARE,),), ("m",)), recordings)


def pendulum(path: Path, start: float, stop: float) -> residyn.Experiment:
    """A two-link arm hanging in gravity, with its authors' masses and lengths."""
    m1, m2, a1, a2, l1, i1, i2 = 0.09384, 0.1376, 0.1086, 0.1168, 0.1727, 4.375e-4, 1.269e-3
    table = ArmTable((l1, 0.2), i1 + m1 * a1**2 + m2 * l1**2, i2 + m2 * a2**2, m2 * a2)
    time, angle, _, _ = residyn.recording.read_csv(path, 2)
    recording = residyn.Recording.from_arrays(time, angle, start=start, stop=stop, theta2=0.0)
    return residyn.Experiment(table, (recording,))


def air(path: Path) -> residyn.Experiment:
    """A mass between two springs on an air track, from video: the control."""
    time, angle, _, _ = residyn.recording.read_csv(path, 1)
    recording = residyn.Recording.from_arrays(time, angle, start="release")
    return residyn.Experiment(InertiaTable(("mass",), ((1.0,),), ("m",)), (recording,))


def emps(folder: Path, every: int = 10) -> residyn.Experiment:
    """A driven slide, means of ten readings. Its mass is known, its friction is not."""
    recordings = []
    for name, role in (("identification", "fit"), ("validation", "check")):
        time, angle, drive, _ = residyn.recording.read_csv(folder / f"{name}.csv", 1)
        assert drive is not None
        whole = len(time) // every * every
        time, angle, drive = (
            x[:whole].reshape(-1, every, *x.shape[1:]).mean(axis=1) for x in (time, angle, drive)
        )
        recordings.append(
            residyn.Recording.from_arrays(time, angle, drive=drive, name=name, role=role)
        )
    return residyn.Experiment(InertiaTable(("slide",), ((SLIDE,),), ("m",)), tuple(recordings))


def force_left(model: residyn.Model, recording: residyn.Recording) -> float:
    """EMPS' force residual as its authors give it: mass times acceleration and all torques less the
    drive, all through one smooth window; rms over the drive's."""
    import jax
    import jax.numpy as jnp

    from residyn.physics.motion import Motion

    assert recording.drive is not None
    dt = float(np.median(np.diff(recording.time)))
    window = np.hanning(2 * SMOOTH + 3)[1:-1]
    window /= window.sum()
    with jax.enable_x64(True):
        q = recording.angle[:, 0]
        rate = np.gradient(q, dt)
        motion = Motion.at(0.0, (jnp.asarray(q),), (jnp.asarray(rate),), ())
        felt = np.asarray(model.torque(motion)[0]) - recording.drive[:, 0]
    inside = slice(2 * SMOOTH, -2 * SMOOTH)
    left = np.convolve(SLIDE * np.gradient(rate, dt) + felt, window, "same")[inside]
    drive = np.convolve(recording.drive[:, 0], window, "same")[inside]
    return float(np.sqrt(np.mean(left**2) / np.mean(drive**2)))


def experiments(folder: Path) -> dict[str, Any]:
    """How to make each experiment of what the folder holds."""
    found: dict[str, Any] = {}
    paths = sorted((folder / "carts").glob("*.csv"))
    for path in paths:
        found[path.stem] = lambda path=path: carts_of(cart(path))
    for kind in dict.fromkeys(p.stem[:-2] for p in paths):
        runs = [p for p in paths if p.stem[:-2] == kind]
        found[f"three {kind}"] = lambda runs=runs: carts_of(*map(cart, runs))
    swing = folder / "double_pendulum" / "free_swing.csv"
    if swing.exists():
        for a, b in ((0, 4), (8, 13), (30, 40)):
            found[f"pendulum, {a} to {b} s"] = lambda a=a, b=b: pendulum(swing, a, b)
    for path in sorted((folder / "air_track").glob("*.csv")):
        found[f"air track, {path.stem}"] = lambda path=path: air(path)
    if (folder / "emps" / "identification.csv").exists():
        found["emps"] = lambda: emps(folder / "emps")
    return found


def here(folder: Path, name: str) -> dict[str, Any]:
    """One experiment, diagnosed."""
    residyn.set_up()
    experiment = experiments(folder)[name]()
    found = residyn.diagnose(experiment)

    def rms(x: np.ndarray) -> float:
        return float(np.sqrt(np.mean(np.square(x))))

    ends = (found.ladder[0], found.ladder[-1])
    family = found.families[0]
    return {
        "verdict": found.verdict,
        "probability": found.verdict_probability,
        "family": [family.name, family.place, family.probability],
        "names": [[x, found.candidate(x).probability] for x in found.added],
        "lookalikes": [list(g) for g in found.lookalikes],
        "fitted": [rms(r.fit.rmse) for r in ends],
        "held": [None if r.held_out is None else rms(r.held_out.held_out.rmse) for r in ends],
        "left": [r.share_of_spring for r in found.random_torque],
        "numbers": [
            f"{n} = {v.value:.4g} ± {v.std:.2g} {v.unit}" for n, v in found.parameters.items()
        ],
        "forces": [
            [100 * force_left(r.fit.model, x) for x in experiment.recordings]
            for r in (found.ladder if name == "emps" else ())
        ],
        "seconds": found.seconds,
        "peak": memory_mb(),
    }


HEAD = ["recording", "verdict", "first family", "names", "error fitted, 1e-3", "held out, 1e-3"]
HEAD += ["left", "wall, s", "CPU, s", "peak, MB"]


def told(name: str, row: dict[str, Any], wall: float, cpu: float) -> list[str]:
    """One line of the table."""
    kind, place, p = row["family"]
    groups = {g[0]: g[1:] for g in row["lookalikes"]}
    names = [
        f"{x} ({100 * q:.0f} %{', or ' + ', '.join(groups[x]) if x in groups else ''})"
        for x, q in row["names"]
    ]

    def arrow(pair: list[float | None]) -> str:
        return " to ".join("-" if x is None else f"{1e3 * x:.3f}" for x in pair)

    return [
        name,
        f"{row['verdict']} ({100 * row['probability']:.0f} %)",
        f"{kind}{f' at the {place}' if place else ''} ({100 * p:.0f} %)",
        ", ".join(names) or "nothing",
        arrow(row["fitted"]),
        arrow(row["held"]),
        ", ".join(f"{100 * x:.2g} %" for x in row["left"]),
        f"{wall:.1f}",
        f"{cpu:.1f}",
        f"{row['peak']:.0f}",
    ]


def main() -> None:
    """The command."""
    if sys.argv[1:2] == ["here"]:
        print(json.dumps(here(Path(sys.argv[2]), sys.argv[3])))
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", default=[], metavar="NAME")
    parser.add_argument("--empty", action="store_true", help="an empty cache for each")
    options = parser.parse_args()
    rows = {}
    print(markdown(HEAD, []), flush=True)
    for name in experiments(options.folder):
        if options.names and not name.startswith(tuple(options.names)):
            continue
        with tempfile.TemporaryDirectory() as cache:
            where = Path(cache) if options.empty else None
            took = fresh(MODULE, "here", str(options.folder), name, cache=where)
        if took.error:
            line = [name, took.error, *["-"] * (len(HEAD) - 5), f"{took.wall:.1f}"]
            line += [f"{took.cpu:.1f}", "-"]
        else:
            rows[name] = took.answers[0]
            line = told(name, took.answers[0], took.wall, took.cpu)
        print("| " + " | ".join(line) + " |", flush=True)
    for name, row in rows.items():
        print(f"\n{name}: {', '.join(row['numbers'])}")
        for forces in row["forces"]:
            print(f"    force residual: {', '.join(f'{x:.2f} %' for x in forces)}")


if __name__ == "__main__":
    main()
