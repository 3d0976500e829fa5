"""Measured rigs: the tables that the field keeps, and what this package makes of the same data.

    python -m benchmarks.measured TABLE --data FOLDER

- `carts`: a cart on a spring; each run alone, springs and dampers, then with a friction
- `loads`: bare carts predicted, by what loaded ones of the same spring and both of the other tell
- `emps`: the positioning system by its official measure, beside its authors' four-parameter model
- `pendulum`: three parts of one swing fitted, with one effect after the other
- `horizon`: how long a prediction of that pendulum holds, beside its authors' model
- `bouc_wen`: the hysteretic benchmark's equations, simulated here (needs no FOLDER)

FOLDER holds `carts/`, `emps/` and `double_pendulum/` (`docs/real-recordings.md` says where they
come from); none is part of this repository. A table whose data is not there says so and is left
out.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

import residyn
from benchmarks._bouc_wen import bouc_wen
from benchmarks.measured_diagnosis import cart, carts_of, emps, force_left, pendulum
from residyn.recordings.recording import Recording
from residyn.simulation.equation import Drive

SPRINGS = {"high": 712.6, "low": 175.3}  # N/m, published
G = 9.81


def _row(*cells: Any) -> None:
    print("| " + " | ".join(str(c) for c in cells) + " |", flush=True)


def _head(*cells: str) -> None:
    _row(*cells)
    print("|" + " --- |" * len(cells))


def _with_errors(fit: residyn.Fit, names: Sequence[str] = ()) -> str:
    """The numbers whose names begin as given (all: none given)."""
    return ", ".join(
        f"{n.name} {n.value:.4g} ± {n.std:.1g}"
        for n in fit.numbers
        if not names or n.name.startswith(tuple(names))
    )


# -- carts ------------------------------------------------------------------------------------


def carts(folder: Path) -> None:
    """Each run alone."""
    _head("run", "rms, spring + damper", "+ Coulomb friction", "k, N/m", "c, N s/m", "F, N")
    viscous: dict[tuple[str, str], list[float]] = {}
    dry: dict[tuple[str, str], list[float]] = {}
    for path in sorted(folder.glob("*.csv")):
        spring, _, load, _ = path.stem.split("_")
        experiment = carts_of(cart(path))
        base = residyn.fit(experiment)
        mended = residyn.fit(experiment, effects=["coulomb_friction:cart"])
        k, c, level = (n.value for n in mended.numbers)
        viscous.setdefault((spring, load), []).append(base.numbers[1].value)
        dry.setdefault((spring, load), []).append(c)
        errors = [f"{1e3 * f.rmse[0]:.3f} mm" for f in (base, mended)]
        _row(path.stem, *errors, f"{k:.1f} ({k / SPRINGS[spring] - 1:+.1%})", f"{c:.3f}",
             f"{level:.4f}")  # fmt: skip
    print()
    for name, found in (("spring + damper", viscous), ("+ Coulomb friction", dry)):
        for spring in SPRINGS:
            bare, loaded = (np.mean(found[spring, load]) for load in ("bare", "loaded"))
            print(f"{name}, {spring} spring: c {bare:.3f} bare, {loaded:.3f} loaded ", end="")
            print(f"({loaded / bare - 1:+.0%})")


def _runs(folder: Path, spring: str, load: str, role: str = "fit", **more: Any) -> list[Recording]:
    paths = sorted(folder.glob(f"{spring}_spring_{load}_*.csv"))
    return [cart(path, role, **more) for path in paths]


def loads(folder: Path) -> None:
    """The paper's third step with carts: bare runs predicted, their initial states fitted and no
    number. With the other spring's runs, each of which has a stiffness of its own, friction that
    grows with the load is told from friction that does not."""
    _head("spring", "fitted", "model", "error fitted, mm", "bare runs, mm", "c, F, mu", "swings")
    dry, load = ["coulomb_friction"], ["coulomb_friction", "load_friction"]
    for spring, other in (("low", "high"), ("high", "low")):
        bare = _runs(folder, spring, "bare", "check")
        own = _runs(folder, spring, "loaded")
        others = [
            r for x in ("loaded", "bare") for r in _runs(folder, other, x, own=("spring:cart",))
        ]
        cases = [("loaded", own, e) for e in ([], dry, ["load_friction"])]
        cases += [(f"and the {other} spring's", [*own, *others], e) for e in (dry, load)]
        for words, runs, effects in cases:
            fit = residyn.fit(carts_of(*runs, *bare), effects=effects)
            assert fit.check_rmse is not None
            numbers = _with_errors(fit, ("damper", *effects) if effects else ("damper",))
            _row(spring, words, " + ".join(effects) or "spring, damper",
                 f"{1e3 * fit.rmse[0]:.3f}", f"{1e3 * fit.check_rmse[0]:.3f}", numbers,
                 ", ".join(f"{s:+.2f}" for s in _ends(fit)))  # fmt: skip
    print()
    _head("spring", "load", "c, N s/m", "F, N")
    for spring in SPRINGS:
        for load_ in ("bare", "loaded"):
            fit = residyn.fit(carts_of(*_runs(folder, spring, load_)), effects=dry)
            spread = _spread(fit, 3)
            c, level = (f"{fit.numbers[i].value:.3f} ± {spread[i]:.3f}" for i in (1, 2))
            _row(spring, load_, c, level)


def _spread(fit: residyn.Fit, count: int) -> np.ndarray:
    """(count,) standard errors where what is left is no noise: from the spread of the numbers over
    fits of each run alone, over the root of how many there are."""
    each = [
        [n.value for n in residyn.fit(carts_of(r.recording), effects=["coulomb_friction"]).numbers]
        for r in fit.recordings
    ]
    return np.std(each, axis=0, ddof=1)[:count] / np.sqrt(len(each))


def _ends(fit: residyn.Fit) -> list[float]:
    """By how much later than measured each predicted run comes down to a tenth, s."""
    found = []
    for r in fit.recordings:
        if r.recording.role == "check":
            seen, said = (
                _last_swing(r.recording.time, x[:, 0]) for x in (r.recording.angle, r.predicted)
            )
            found.append(said - seen)
    return found


def _last_swing(time: np.ndarray, x: np.ndarray) -> float:
    """When the swing last exceeds a tenth of the first one, s after the release."""
    about = np.abs(x - np.nanmedian(x[-len(x) // 10 :]))
    return float(time[np.flatnonzero(about > 0.1 * np.nanmax(about))[-1]] - time[0])


# -- EMPS -------------------------------------------------------------------------------------


def open_loop(model: residyn.Model, recording: Recording, first: int) -> np.ndarray:
    """(N,) the position that the drive alone asks for, from the state at the first sample, which
    least squares over the `first` samples gives."""
    assert recording.drive is not None
    t = jnp.asarray(recording.time - recording.time[0])
    drive = Drive(0.0, float(t[-1]) / (len(t) - 1), recording.drive)

    def run(q0, v0, part):
        steps = 2 * len(part)
        path = residyn.simulate(model, part, [q0], [v0], drive=drive, steps=steps)
        return path.readings[:, 0]

    measured = recording.angle[:, 0]
    # Over so short a time the state enters as in free flight.
    rest = measured[:first] - np.asarray(run(0.0, 0.0, t[:first]))
    line = np.polynomial.polynomial.polyfit(np.asarray(t[:first]), rest, 1)
    return np.asarray(run(float(line[0]), float(line[1]), t))


def emps_table(folder: Path) -> None:
    """Force residual of inverse dynamics, and the official measure: rms of the position in open
    loop over the pulses (`validation`), after 20 samples."""
    ten = emps(folder)
    full = emps(folder, every=1).recordings
    mechanism = residyn.ConstantInertia(ten.inertia.matrix, ("slide",), ("m",))
    published = mechanism + residyn.Damper("slide", 203.5) + residyn.CoulombFriction("slide", 20.39)
    published = published + residyn.ConstantTorque("slide", -3.16)
    cases: list[tuple[str, residyn.Model, str]] = [("its authors' four numbers", published, "")]
    for effects in (
        ["coulomb_friction", "constant_torque"],
        ["coulomb_friction", "constant_torque", "asymmetric_damping"],
        ["stribeck_friction", "constant_torque", "asymmetric_damping"],
    ):
        fit = residyn.fit(ten, effects=effects)
        cases.append((" + ".join(["spring, damper", *effects]), fit.model, _with_errors(fit)))
    _head("model", "force residual, identification", "validation", "open loop, identification, mm",
          "validation, mm", "numbers")  # fmt: skip
    for name, model, numbers in cases:
        forces = [f"{100 * force_left(model, r):.2f} %" for r in ten.recordings]
        errors = []
        for recording in full:
            off = open_loop(model, recording, 20) - recording.angle[:, 0]
            errors.append(f"{1e3 * np.sqrt(np.mean(off[20:] ** 2)):.2f}")
        _row(name, *forces, *errors, numbers)


# -- the double pendulum ----------------------------------------------------------------------

MODELS = (
    ["gravity"],
    ["gravity", "coulomb_friction"],
    ["gravity", "air_drag"],
    ["gravity", "air_drag", "coulomb_friction"],
)


def pendulum_table(folder: Path) -> None:
    """A two-link arm hanging in gravity, with its authors' masses and lengths."""
    _head("s", "model", "error, mrad", "each joint", "numbers")
    for start, stop in ((0, 4), (8, 13), (30, 40)):
        for effects in (*MODELS, ["gravity", "printed_inertia_torque"]):
            fit = residyn.fit(pendulum(folder / "free_swing.csv", start, stop), effects=effects)
            each = ", ".join(f"{1e3 * x:.2f}" for x in fit.rmse)
            error = f"{1e3 * np.sqrt(np.mean(fit.rmse**2)):.2f}"
            _row(f"{start} to {stop}", " + ".join(effects), error, each, _with_errors(fit))


def horizon(folder: Path, window: float = 2.0, off: float = 0.1) -> None:
    """Numbers fitted to 0 to 4 s and to 30 to 40 s together; from then on none is fitted but a
    state, by least squares over `window` s; the prediction goes on until a joint is `off` rad from
    what was measured. The authors' model is their inertias, lengths, g and two viscous joints."""
    path = folder / "free_swing.csv"
    whole = pendulum(path, 0, 80).recordings[0]
    parts = [pendulum(path, a, b) for a, b in ((0, 4), (30, 40))]
    both = residyn.Experiment(parts[0].inertia, tuple(p.recordings[0] for p in parts))
    fits = [residyn.fit(both, effects=effects) for effects in MODELS]
    mechanism = fits[0].model.mechanism
    m1, m2, a1, a2, l1 = 0.09384, 0.1376, 0.1086, 0.1168, 0.1727
    pull = residyn.Gravity((m1 * a1 + m2 * l1) * G, m2 * a2 * G, 0.0, 0.0)
    viscous = residyn.Damper("shoulder", 2.37e-4), residyn.Damper("elbow", 1e-5)
    authors = residyn.Model(mechanism, (pull, *viscous))
    models = [("authors'", authors)]
    models += [(" + ".join(e), f.model) for e, f in zip(MODELS, fits, strict=True)]
    starts = (4, 8, 12, 16, 20, 24, 40, 45, 50, 55, 60)
    _head("model", *(f"{s} s" for s in starts), "median, s")
    for name, model in models:
        ahead = [_holds(model, whole, float(s), window, off) for s in starts]
        cells = [f"{x:.1f}" if x < whole.time[-1] - s - window - 0.1 else f"> {x:.1f}"
                 for s, x in zip(starts, ahead, strict=True)]  # fmt: skip
        _row(name, *cells, f"{np.median(ahead):.1f}")


def _holds(model: residyn.Model, whole: Recording, start: float, window: float, off: float):
    """Seconds after the window from `start` s on until the prediction is off."""
    first, last = np.searchsorted(whole.time, [start, start + window])
    time, angle = whole.time[first:] - whole.time[first], whole.angle[first:]
    count = int(last - first)
    guess = [np.polynomial.polynomial.polyfit(time[:8], x[:8], 2)[:2] for x in angle.T]

    @jax.jit
    def near(state):
        path = residyn.simulate(model, time[:count], state[:2], state[2:], steps=4 * count)
        return (path.readings - angle[:count]).ravel()

    slopes: Any = jax.jit(jax.jacfwd(near))
    found = least_squares(near, np.ravel(np.transpose(guess)), jac=slopes)
    path = residyn.simulate(model, time, found.x[:2], found.x[2:], steps=2 * len(time))
    wrong = np.abs(np.asarray(path.readings) - angle).max(axis=1) > off
    wrong[:count] = False
    return float((time[np.argmax(wrong)] if wrong.any() else time[-1]) - time[count])


TABLES = {
    "carts": (carts, "carts"),
    "loads": (loads, "carts"),
    "emps": (emps_table, "emps"),
    "pendulum": (pendulum_table, "double_pendulum"),
    "horizon": (horizon, "double_pendulum"),
    "bouc_wen": (bouc_wen, None),
}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tables", nargs="+", choices=TABLES, metavar="TABLE")
    parser.add_argument("--data", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    measured = [name for name in options.tables if TABLES[name][1] is not None]
    if measured and options.data is None:
        parser.error(f"{', '.join(measured)}: --data FOLDER is needed")
    residyn.set_up()
    for name in options.tables:
        table, part = TABLES[name]
        print(f"\n{name}\n")
        if part is None:
            table()
        elif (options.data / part).is_dir():
            with jax.enable_x64(True):
                table(options.data / part)
        else:
            print(f"{options.data / part} is not there: left out", file=sys.stderr)


if __name__ == "__main__":
    main()
