"""The paper's tables, ours beside the paper's, on MuJoCo twins of its rig.

    python -m benchmarks.paper_tables           every table
    python -m benchmarks.paper_tables 2         Table 2: inertias from driven tests
    python -m benchmarks.paper_tables joints    stiffness, damping, frequency without bearings
    python -m benchmarks.paper_tables drag      hidden drag and friction of the bearings

A table is a function that yields its rows; `TABLES` lists them by the number or name that the
command takes. `--count` is how many seeds of the noise an error is measured over.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence

import numpy as np

import residyn
from benchmarks import _unloading
from residyn.recordings.tables import ArmTable
from tests.rig import driven
from tests.rig.arm import paper_twin

Row = Sequence[str]


def table_2(count: int) -> Iterator[Row]:
    """Inertias from tests I to III: the paper's trajectory, 0.5 % of noise in the torque.

    The twin has the friction and the brakes that give of `tests.rig.driven.paper_tests`; two turns
    of the trajectory, 42 s at 100 Hz. Errors are rms over seeds of the noise, the largest behind.
    """
    yield ("", "I1+I2+m2 l1^2+2 m2 l1 rho2", "I2", "m2 rho2")
    yield ("paper: set value", "2.9640", "0.5920", "not printed")
    yield ("paper: identified", "2.8959", "0.5790", "1.4384")
    yield ("paper: error", "2.29 %", "2.20 %", "-")
    tests = driven.paper_tests()
    arm = tests[0].arm
    truth = np.array([arm.mass_matrix()[0, 0], arm.elbow, arm.coupling])
    for noise in (1e-4, 1e-3):
        found = [_step_1(tests, seed, noise) for seed in range(count)]
        first, l1 = found[0], arm.l1
        values = (first.composite(), first.elbow, first.coupling)
        yield ("", "", "", "")
        yield (f"angles to {noise:g} rad:", "", "", "")
        yield ("twin: set value", *(f"{x:.4f}" for x in truth))
        yield ("ours: identified", *(f"{n.value:.4f} +/- {n.std:.4f}" for n in values))
        ours = np.array([[f.composite().value, f.elbow.value, f.coupling.value] for f in found])
        yield ("ours: error", *_errors(ours / truth - 1))
        pulls = np.array(
            [[(n.value - x) / n.std for n, x in zip(_of(f), truth, strict=True)] for f in found]
        )
        yield ("ours: error / std", *(f"rms {x:.2f}" for x in np.sqrt(np.mean(pulls**2, axis=0))))
        plain = np.array([f.least_squares for f in found])
        plain[:, 0] += plain[:, 1] + 2 * l1 * plain[:, 2]
        yield ("Eq. 12 to 15: error", *_errors(plain / truth - 1))


def _of(found: residyn.InertiaResult):
    return found.composite(), found.elbow, found.coupling


def _step_1(tests: list[driven.Driven], seed: int, noise: float) -> residyn.InertiaResult:
    rng = np.random.default_rng([seed, 2])
    recordings = []
    for i, test in enumerate(tests):
        read = test.read(rng, angle_noise=noise, torque_noise=5e-3)
        recordings.append(
            residyn.Recording.from_arrays(
                read.t,
                read.q,
                drive=read.u,
                theta2=read.arm.theta2,
                role="inertia",
                name=f"test {'I' * (i + 1)}",
            )
        )
    table = ArmTable((tests[0].arm.l1, tests[0].arm.l2))
    return residyn.inertia(residyn.Experiment(table, tuple(recordings)))


def _errors(off: np.ndarray) -> Row:
    rms, worst = np.sqrt(np.mean(off**2, axis=0)), np.abs(off).max(axis=0)
    return [f"{r:.3%} (at most {w:.3%})" for r, w in zip(rms, worst, strict=True)]


def joints(count: int) -> Iterator[Row]:
    """Steps 2 and 3: stiffness, damping, and the lowest frequency without bearings.

    The twin is the paper's simulated rig, one release of 20 s at 100 Hz on its bearings, 1 mrad of
    noise. "given" has the true inertias; "step 1" those that step 1 finds from the tests of table 2
    with 0.5 % of torque noise, which is the paper's whole procedure. Errors as in table 2.
    """
    yield ("", "k1, N m/rad", "k2", "c1, N m s/rad", "c2", "without bearings, Hz")
    yield ("paper: set, measured", "16.67", "16.67", "0.1", "0.1", "0.5128")
    yield ("paper: found", "16.2717", "16.1601", "0.0754", "0.1522", "0.5263")
    yield ("paper: error", "2.4 %", "3.1 %", "25 %", "52 %", "2.6 %")
    rig = _unloading.rig()
    tests = driven.paper_tests(rig)
    for words in ("given", "step 1"):
        off, pulls = [], []
        for seed in range(count):
            first = _step_1(tests, seed, 1e-4) if words == "step 1" else None
            table = first.arm if first else _unloading.table_of(rig)
            found = residyn.unload(
                _unloading.clean(seed, rig, table),
                inertia_std=first.covariance if first else None,
            )
            mode, numbers = found.without_bearings[0], list(_unloading.values(found).values())
            wrong = _unloading.errors_in_orbit(mode, rig)[0]
            off.append([*(np.array(numbers) / [*rig.stiffness, *rig.damping] - 1), wrong])
            pulls.append(wrong * mode.frequency_hz / mode.frequency_hz_std)
            if seed == 0:
                row = [f"{x:.4f}" for x in numbers]
                yield ("",) * 6
                yield (f"ours, inertias {words}: found", *row, f"{mode.frequency_hz:.4f}")
        yield ("ours: error", *_errors(np.array(off)))
        yield ("ours: error / std", *[""] * 4, f"rms {np.sqrt(np.mean(np.square(pulls))):.2f}")


def drag(count: int) -> Iterator[Row]:
    """Hidden drag (0.3 N s/m) and friction (0.02 N) of the bearings: errors in orbit.

    Recordings at two elbow angles, on bearings, fitted together; what is predicted is compared with
    the rig off its bearings, which nothing was fitted to. One seed of the noise: a diagnosis takes
    its minutes.
    """
    del count
    experiment = _unloading.dragged()
    named = residyn.diagnose(_unloading.fitted_only(experiment)).added
    yield ("fitted", "elbow, rad", "frequency", "decay rate", "rms, bare recording / noise")
    for words, effects in (("springs, dampers", ()), (f"named: {' + '.join(named)}", named)):
        found = residyn.unload(experiment, effects=effects)
        for pose, check in zip(found.poses, found.check, strict=True):
            wrong = _unloading.errors_in_orbit(pose.without_bearings[0], paper_twin(pose.theta2))
            left = check.rmse / check.beside.recording.noise
            yield (
                words,
                f"{pose.theta2:g}",
                f"{wrong[0]:+.3%}",
                f"{wrong[1]:+.1%}",
                ", ".join(f"{x:.2f}" for x in left),
            )


TABLES: dict[str, Callable[[int], Iterator[Row]]] = {"2": table_2, "joints": joints, "drag": drag}


def show(name: str, count: int) -> None:
    """Print one table in aligned columns."""
    table = TABLES[name]
    title = (table.__doc__ or "").splitlines()[0]
    rows = list(table(count))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    print(f"Table {name}. {title}\n")
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
    print(flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tables", nargs="*", help="all, if none is named")
    parser.add_argument("--count", type=int, default=20, help="seeds of the noise")
    given = parser.parse_args()
    unknown = [name for name in given.tables if name not in TABLES]
    if unknown:
        parser.error(f"there is no table {unknown[0]}; there are {', '.join(TABLES)}")
    for each in given.tables or TABLES:
        show(each, given.count)
