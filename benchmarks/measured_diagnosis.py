"""What `diagnose` says of measured recordings.

    python -m benchmarks.measured_diagnosis FOLDER [WHAT]...

FOLDER holds `carts/`, `double_pendulum/`, `emps/`, `air_track/` (see the docs for where they come
from); none is part of this repository. WHAT is `carts`, `others`, `predict`, `pendulum`, `air` or
`emps`; all if not given.

`predict` is the paper's third step with carts: fit the loaded runs, take the load off, predict the
bare ones from their first readings, with viscous damping alone and with the friction named.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import residyn
from residyn.motion import Motion
from residyn.recording import ArmTable, InertiaTable

BARE, LOAD = 0.5685, 0.986  # kg
SLIDE = 95.11  # kg
SMOOTH = 3  # samples to either side


def cart(path: Path, role: str = "fit") -> residyn.Recording:
    """A run, from its release on."""
    load = LOAD if "loaded" in path.stem else 0.0
    time, angle, _, _ = residyn.recording.read_csv(path, 1)
    return residyn.Recording.from_arrays(
        time, angle, start="release", name=path.stem, extra_mass=load, role=role
    )


def cart_experiment(*recordings: residyn.Recording) -> residyn.Experiment:
    """Runs of the cart, whatever it carries."""
    return residyn.Experiment(InertiaTable(("cart",), ((BARE,),), ("m",)), recordings)


def told(name: str, found: residyn.Diagnosis) -> None:
    """One row of the table."""
    rms = " to ".join(f"{1e3 * float(np.sqrt(np.mean(r.fit.rmse**2))):.3f}" for r in found.ladder)
    sure = ", ".join(f"{n} ({100 * found.candidate(n).probability:.0f} %)" for n in found.added)
    alike = "; ".join(" = ".join(g) for g in found.lookalikes)
    print(f"| {name} | {found.verdict} | {sure} | {rms} | {alike} |", flush=True)


def carts(folder: Path) -> None:
    """Each run by itself."""
    for path in sorted((folder / "carts").glob("*_1.csv")):
        told(path.stem, residyn.diagnose(cart_experiment(cart(path))))


def predict(folder: Path) -> None:
    """Loaded runs fitted, bare ones predicted."""
    for spring in ("low", "high"):
        loaded = [cart(p) for p in sorted((folder / "carts").glob(f"{spring}_spring_loaded_*.csv"))]
        bare = [
            cart(p, "check") for p in sorted((folder / "carts").glob(f"{spring}_spring_bare_*.csv"))
        ]
        for effects in ([], ["coulomb_friction"], ["coulomb_friction", "hysteresis"]):
            fit = residyn.fit(cart_experiment(*loaded, *bare), effects=effects)
            swings = []
            for r in fit.recordings:
                if r.recording.role == "check":
                    ends = [_last_swing(r.recording.time, x[:, 0])
                            for x in (r.recording.angle, r.predicted)]  # fmt: skip
                    swings.append(ends[1] - ends[0])
            assert fit.check_rmse is not None
            print(
                f"| {spring} | {' + '.join(['spring, damper', *effects])} "
                f"| {1e3 * fit.rmse[0]:.3f} | {1e3 * fit.check_rmse[0]:.3f} "
                f"| {', '.join(f'{s:+.2f}' for s in swings)} |",
                flush=True,
            )


def others(folder: Path) -> None:
    """Fitted by name to the first run of each kind; the other two predicted from their states."""
    for path in sorted((folder / "carts").glob("*_1.csv")):
        kind = path.stem.removesuffix("_1")
        runs = [cart(folder / "carts" / f"{kind}_{i}.csv", "check") for i in (2, 3)]
        for effects in (["coulomb_friction"], ["coulomb_friction", "hysteresis"]):
            fit = residyn.fit(cart_experiment(cart(path), *runs), effects=effects)
            assert fit.check_rmse is not None
            print(
                f"| {kind} | {' + '.join(effects)} | {1e3 * fit.rmse[0]:.3f} "
                f"| {1e3 * fit.check_rmse[0]:.3f} | {_numbers(fit)} |",
                flush=True,
            )


def _numbers(fit: residyn.Fit) -> str:
    return ", ".join(f"{n.name} {n.value:.4g} {n.unit}" for n in fit.numbers)


def _last_swing(time: np.ndarray, x: np.ndarray) -> float:
    """When the swing last exceeds a tenth of the first one, s after the release."""
    about = np.abs(x - np.nanmedian(x[-len(x) // 10 :]))
    return float(time[np.flatnonzero(about > 0.1 * np.nanmax(about))[-1]] - time[0])


def pendulum(folder: Path) -> None:
    """A two-link arm hanging in gravity, with its authors' masses and lengths."""
    m1, m2, a1, a2, l1, i1, i2 = 0.09384, 0.1376, 0.1086, 0.1168, 0.1727, 4.375e-4, 1.269e-3
    table = ArmTable((l1, 0.2), i1 + m1 * a1**2 + m2 * l1**2, i2 + m2 * a2**2, m2 * a2)
    time, angle, _, _ = residyn.recording.read_csv(folder / "double_pendulum" / "free_swing.csv", 2)
    for start, stop in ((30, 40), (8, 13)):
        recording = residyn.Recording.from_arrays(time, angle, start=start, stop=stop, theta2=0.0)
        found = residyn.diagnose(residyn.Experiment(table, (recording,)))
        told(f"{start}-{stop} s", found)
        print(f"    {_numbers(found.fit)}", flush=True)


def air(folder: Path) -> None:
    """A mass between two springs on an air track: the control."""
    for path in sorted((folder / "air_track").glob("*.csv")):
        time, angle, _, _ = residyn.recording.read_csv(path, 1)
        recording = residyn.Recording.from_arrays(time, angle, start="release")
        table = InertiaTable(("mass",), ((1.0,),), ("m",))
        told(path.stem, residyn.diagnose(residyn.Experiment(table, (recording,))))


def emps(folder: Path, every: int = 10) -> None:
    """A driven slide; means of ten readings. Its mass is known, its friction is not.

    Beside the numbers stands the force residual, as its authors give it: what inverse dynamics with
    the model's numbers leaves of the drive, rms over the drive's, in both files.
    """
    table = InertiaTable(("slide",), ((SLIDE,),), ("m",))
    recordings = []
    for name, role in (("identification", "fit"), ("validation", "check")):
        time, angle, drive, _ = residyn.recording.read_csv(folder / "emps" / f"{name}.csv", 1)
        assert drive is not None
        whole = len(time) // every * every
        time, angle, drive = (
            x[:whole].reshape(-1, every, *x.shape[1:]).mean(axis=1) for x in (time, angle, drive)
        )
        recordings.append(
            residyn.Recording.from_arrays(time, angle, drive=drive, name=name, role=role)
        )
    found = residyn.diagnose(residyn.Experiment(table, tuple(recordings)))
    told("emps", found)
    for rung in found.ladder:
        left = ", ".join(f"{100 * _force_left(rung.fit, r):.2f} %" for r in recordings)
        print(f"    force residual with {', '.join(rung.fit.model.labels)}: {left}")
    for n in found.fit.numbers:
        print(f"    {n.name} = {n.value:.5g} +/- {n.std:.2g} {n.unit}")


def _force_left(fit: residyn.Fit, recording: residyn.Recording) -> float:
    """Mass times acceleration and all torques less the drive, all through one smooth window."""
    assert recording.drive is not None
    dt = float(np.median(np.diff(recording.time)))
    window = np.hanning(2 * SMOOTH + 3)[1:-1]
    window /= window.sum()
    with jax.enable_x64(True):
        q = recording.angle[:, 0]
        rate = np.gradient(q, dt)
        motion = Motion.at(0.0, (jnp.asarray(q),), (jnp.asarray(rate),), ())
        felt = np.asarray(fit.model.torque(motion)[0]) - recording.drive[:, 0]
    inside = slice(2 * SMOOTH, -2 * SMOOTH)
    left = np.convolve(SLIDE * np.gradient(rate, dt) + felt, window, "same")[inside]
    drive = np.convolve(recording.drive[:, 0], window, "same")[inside]
    return float(np.sqrt(np.mean(left**2) / np.mean(drive**2)))


TABLES = {
    "carts": carts,
    "others": others,
    "predict": predict,
    "pendulum": pendulum,
    "air": air,
    "emps": emps,
}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("what", nargs="*", choices=[*TABLES, []], default=[])
    options = parser.parse_args()
    for name in options.what or TABLES:
        print(f"\n{name}\n")
        TABLES[name](options.folder)
        jax.clear_caches()  # so many programs in one process exhaust its memory maps


if __name__ == "__main__":
    main()
