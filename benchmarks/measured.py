"""Fits of measured recordings, beside the published figures.

    python -m benchmarks.measured FOLDER

FOLDER holds `carts/` and `double_pendulum/` (see the docs for where they come from); neither is
part of this repository.
"""

import sys
from pathlib import Path

import numpy as np

import residyn
from residyn.recording import ArmTable, InertiaTable

LOAD = 0.986  # kg
SPRINGS = {"high": 712.6, "low": 175.3}  # N/m, published


def carts(folder: Path) -> None:
    """One cart on a spring, pulled by hand and let go."""
    print("| recording | rms, spring + damper | + Coulomb friction | k, N/m | c, N s/m | F, N |")
    print("|---|---|---|---|---|---|")
    viscous: dict[tuple[str, str], list[float]] = {}
    with_friction: dict[tuple[str, str], list[float]] = {}
    for path in sorted(folder.glob("*.csv")):
        spring, _, load, _ = path.stem.split("_")
        mass = 0.5685 + (LOAD if load == "loaded" else 0.0)
        time, angle, _, _ = residyn.recording.read_csv(path, 1)
        recording = residyn.Recording.from_arrays(time, angle, start="release", name=path.name)
        table = InertiaTable(("cart",), ((mass,),), ("m",))
        experiment = residyn.Experiment(table, (recording,))
        base = residyn.fit(experiment)
        mended = residyn.fit(experiment, effects=["coulomb_friction:cart"])
        k, c, level = (n.value for n in mended.numbers)
        viscous.setdefault((spring, load), []).append(base.numbers[1].value)
        with_friction.setdefault((spring, load), []).append(c)
        print(
            f"| {path.stem} | {1e3 * base.rmse[0]:.3f} mm | {1e3 * mended.rmse[0]:.3f} mm ", end=""
        )
        print(f"| {k:.1f} ({k / SPRINGS[spring] - 1:+.1%}) | {c:.3f} | {level:.4f} |", flush=True)
    for name, found in (("spring + damper", viscous), ("+ Coulomb friction", with_friction)):
        for spring in SPRINGS:
            bare, loaded = (np.mean(found[spring, load]) for load in ("bare", "loaded"))
            print(f"{name}, {spring} spring: c {bare:.3f} bare, {loaded:.3f} loaded ", end="")
            print(f"({loaded / bare - 1:+.0%})")


def double_pendulum(path: Path) -> None:
    """A two-link arm hanging in gravity, with its authors' masses and lengths."""
    m1, m2, a1, a2, l1, i1, i2 = 0.09384, 0.1376, 0.1086, 0.1168, 0.1727, 4.375e-4, 1.269e-3
    table = ArmTable((l1, 0.2), i1 + m1 * a1**2 + m2 * l1**2, i2 + m2 * a2**2, m2 * a2)
    time, angle, _, _ = residyn.recording.read_csv(path, 2)
    sets = (
        [],
        ["gravity"],
        ["gravity", "coulomb_friction"],
        ["gravity", "printed_inertia_torque"],
    )
    print("| s | " + " | ".join(" + ".join(s) or "springs, dampers alone" for s in sets) + " |")
    print("|---|" + "---|" * len(sets))
    for start, stop in ((0, 4), (8, 13), (30, 40)):
        print(f"| {start}-{stop} |", end="", flush=True)
        for effects in sets:
            recording = residyn.Recording.from_arrays(
                time, angle, start=start, stop=stop, theta2=0.0
            )
            fit = residyn.fit(residyn.Experiment(table, (recording,)), effects=effects)
            both = np.sqrt(np.mean(fit.rmse**2))
            each = ", ".join(f"{1e3 * r:.2f}" for r in fit.rmse)
            print(f" {1e3 * both:.2f} mrad ({each}) |", end="", flush=True)
        print()


if __name__ == "__main__":
    data = Path(sys.argv[1])
    carts(data / "carts")
    double_pendulum(data / "double_pendulum" / "free_swing.csv")
