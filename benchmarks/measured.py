"""Fits of measured recordings, beside the published figures.

    python -m benchmarks.measured FOLDER            fits
    python -m benchmarks.measured FOLDER predict    loaded carts fitted, bare ones predicted

FOLDER holds `carts/` and `double_pendulum/` (see the docs for where they come from); neither is
part of this repository.
"""

import sys
from pathlib import Path

import numpy as np

import residyn
from benchmarks.measured_diagnosis import cart, carts_of
from residyn.recordings.tables import ArmTable

SPRINGS = {"high": 712.6, "low": 175.3}  # N/m, published


def carts(folder: Path) -> None:
    """One cart on a spring, pulled by hand and let go."""
    print("| recording | rms, spring + damper | + Coulomb friction | k, N/m | c, N s/m | F, N |")
    print("|---|---|---|---|---|---|")
    viscous: dict[tuple[str, str], list[float]] = {}
    with_friction: dict[tuple[str, str], list[float]] = {}
    for path in sorted(folder.glob("*.csv")):
        spring, _, load, _ = path.stem.split("_")
        experiment = carts_of(cart(path))
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


def predict(folder: Path) -> None:
    """The paper's third step with carts: the loaded runs fitted, the load taken off, the bare runs
    predicted from their first readings."""
    for spring in ("low", "high"):
        loaded = [cart(p) for p in sorted(folder.glob(f"{spring}_spring_loaded_*.csv"))]
        bare = [cart(p, "check") for p in sorted(folder.glob(f"{spring}_spring_bare_*.csv"))]
        for effects in ([], ["coulomb_friction"], ["coulomb_friction", "hysteresis"]):
            fit = residyn.fit(carts_of(*loaded, *bare), effects=effects)
            swings = []
            for r in fit.recordings:
                if r.recording.role == "check":
                    ends = [
                        _last_swing(r.recording.time, x[:, 0])
                        for x in (r.recording.angle, r.predicted)
                    ]
                    swings.append(ends[1] - ends[0])
            assert fit.check_rmse is not None
            print(
                f"| {spring} | {' + '.join(['spring, damper', *effects])} "
                f"| {1e3 * fit.rmse[0]:.3f} | {1e3 * fit.check_rmse[0]:.3f} "
                f"| {', '.join(f'{s:+.2f}' for s in swings)} |",
                flush=True,
            )


def _last_swing(time: np.ndarray, x: np.ndarray) -> float:
    """When the swing last exceeds a tenth of the first one, s after the release."""
    about = np.abs(x - np.nanmedian(x[-len(x) // 10 :]))
    return float(time[np.flatnonzero(about > 0.1 * np.nanmax(about))[-1]] - time[0])


if __name__ == "__main__":
    data = Path(sys.argv[1])
    if sys.argv[2:] == ["predict"]:
        predict(data / "carts")
        sys.exit()
    carts(data / "carts")
    double_pendulum(data / "double_pendulum" / "free_swing.csv")
