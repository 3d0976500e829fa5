"""Writes the examples that ship with the package beside the demo: `residyn example`.

Made with MuJoCo, which the package does not contain: the driven tests of step 1, and releases on
air bearings that drag and rub, with one off them. The pendulum is measured (`PENDULUM_NOTICE`); it
is written only where its recording is given.

Run from the repository root: python -m tests.rig.make_examples [FREE_SWING.csv]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from .arm import paper_twin
from .driven import paper_tests
from .engine import Array
from .unloaded import INERTIA, MASS, Release, releases

HERE = Path(__file__).resolve().parents[2] / "src" / "residyn" / "data"
DRAG, FRICTION = 0.3, 0.02
"""Of each bearing, N s/m and N."""
ON_AND_OFF = {
    "bearings_straight.csv": Release(0.3, (0.25, -0.30)),
    "bearings_bent.csv": Release(1.5, (0.20, 0.35)),
    "bearings_off.csv": Release(0.3, (0.20, -0.25), bearings=False),
}

DRIVEN = """\
# Step 1 of the paper: one joint of an arm on an air-bearing table is driven, the other braked. Made
# with MuJoCo by tests/rig/make_examples.py: the paper's trajectory and Table 2, friction in the
# driven joint, 0.2 mrad of noise in the angles and 0.5 % in the torque.

[arm]                       # the inertias are what is asked for
link_lengths = [0.4, 0.4]   # m
"""
BEARINGS = """\
# Step 3 of the paper: what rings on air bearings, with the bearings' drag and friction in it, and
# how it rings without them. Made with MuJoCo by tests/rig/make_examples.py, 1 mrad of noise.

[arm]                       # inertia with the bearings on
link_lengths = [0.4, 0.4]   # m
shoulder = {shoulder!r}           # I1 + m2 l1^2, kg m^2
elbow = {elbow!r}               # I2 about the elbow, kg m^2
coupling = {coupling!r}           # m2 rho2, kg m
"""
BEARING = """
[[air_bearings]]
joint = "{joint}"
mass = {mass}               # kg
inertia = {inertia}        # about its own centre, kg m^2
"""
PENDULUM = """\
# A two-link arm that hangs in gravity, measured: 10 s of a free swing, every second reading. Joints
# have no springs; what pulls them back is gravity, which a spring cannot follow at large angles.
# Data: Kaheman, Fasel, Bramburger, Strom, Kutz, Brunton, arXiv:2205.06231, MIT licence, see
# pendulum-LICENSE.txt. Inertias are their estimates.

[arm]
link_lengths = [0.1727, 0.2]   # m
shoulder = {shoulder:.6g}        # I1 + m2 l1^2, kg m^2
elbow = {elbow:.6g}          # I2 about the elbow, kg m^2
coupling = {coupling:.6g}        # m2 rho2, kg m

[[recordings]]
file = "pendulum.csv"
theta2 = 0.0                   # rad
"""


def _write(file: Path, t: Array, *columns: Array) -> None:
    names = ["t", "q1", "q2", "u1", "u2"][: 1 + sum(c.shape[1] for c in columns)]
    rows = np.column_stack(columns).tolist()
    lines = (
        f"{now:.3f}," + ",".join(f"{x:.6f}".replace("-0.000000", "0.000000") for x in row)
        for now, row in zip(t.tolist(), rows, strict=True)
    )
    file.write_text("\n".join([",".join(names), *lines, ""]), encoding="ascii")


def driven(folder: Path) -> None:
    """Tests I to III, one turn of the trajectory at 50 Hz."""
    folder.mkdir(parents=True, exist_ok=True)
    text, rng = DRIVEN, np.random.default_rng(1)
    names = ("driven_straight.csv", "driven_bent.csv", "driven_elbow.csv")
    for name, test in zip(names, paper_tests(seconds=21.0, rate=50.0), strict=True):
        seen = test.read(rng, angle_noise=2e-4)
        _write(folder / name, seen.t, seen.q, seen.u)
        text += (
            f'\n[[recordings]]\nfile = "{name}"\ntheta2 = {test.arm.theta2:.7g}\nrole = "inertia"\n'
        )
    (folder / "driven.toml").write_text(text, encoding="ascii")


def bearings(folder: Path) -> None:
    """Releases on bearings that drag and rub, and one off them that judges."""
    folder.mkdir(parents=True, exist_ok=True)
    text = BEARINGS.format(**vars(paper_twin()))
    for joint in ("elbow", "wrist"):
        text += BEARING.format(joint=joint, mass=MASS, inertia=INERTIA)
    cases = releases(list(ON_AND_OFF.values()), drag=DRAG, friction=FRICTION)
    for (name, how), case in zip(ON_AND_OFF.items(), cases, strict=True):
        _write(folder / name, case.t, case.q)
        text += f'\n[[recordings]]\nfile = "{name}"\ntheta2 = {how.theta2!r}\nnoise = 0.001\n'
        if not how.bearings:
            text += 'air_bearings = false\nrole = "check"         # never fitted: it judges\n'
    (folder / "bearings.toml").write_text(text, encoding="ascii")


def pendulum(folder: Path, measured: Path) -> None:
    """The measured free swing from 30 to 40 s, at 100 Hz."""
    folder.mkdir(parents=True, exist_ok=True)
    table = np.loadtxt(measured, delimiter=",", skiprows=1)
    table = table[(table[:, 0] >= 30) & (table[:, 0] <= 40)][::2]
    _write(folder / "pendulum.csv", table[:, 0] - table[0, 0], table[:, 1:3])
    m1, m2, a1, a2, l1, i1, i2 = 0.09384, 0.1376, 0.1086, 0.1168, 0.1727, 4.375e-4, 1.269e-3
    text = PENDULUM.format(
        shoulder=i1 + m1 * a1**2 + m2 * l1**2, elbow=i2 + m2 * a2**2, coupling=m2 * a2
    )
    (folder / "pendulum.toml").write_text(text, encoding="ascii")


def main(measured: Path | None = None) -> None:
    """Write the examples' files."""
    driven(HERE / "driven")
    bearings(HERE / "bearings")
    if measured is not None:
        pendulum(HERE / "pendulum", measured)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
