"""Writes the demo that ships with the package: an arm with something hidden in its elbow.

The demo has to be honest: what is hidden was put there by a simulator that the package does not
contain, it shows clearly in the misfit of a spring and damper without drowning it, and the held-out
release differs enough that a model which merely bends to the first one fails on it.

Run from the repository root: python -m tests.rig.make_demo
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from .arm import paper_twin
from .engine import Array, simulate

HERE = Path(__file__).resolve().parents[2] / "src" / "residyn" / "data" / "demo"
THETA2 = 0.3
NOISE = 1e-3
ELBOW_FRICTION = 0.2
"""N m. The spring-damper fit then misses by some 7 (shoulder) and 11 (elbow) times the noise, and
over the last five seconds the elbow sticks for three quarters of the time."""
RELEASES = {
    # file: (release angles in rad, seed of the noise)
    "release.csv": ((0.25, -0.30), 20240),
    "check.csv": ((0.20, 0.35), 20241),
}

EXPERIMENT = """\
# A braked two-joint arm on an air-bearing table, let go from a static deflection, twice.
# Made with MuJoCo by tests/rig/make_demo.py: the inertias, springs and dampers of the paper's
# Table 1 rig, gaussian noise of 1 mrad, and one effect that is neither a spring nor a damper.
# Finding it is the demo; the script gives it away.

[arm]                       # inertia with the bearings on
link_lengths = [{l1!r}, {l2!r}]   # m
shoulder = {shoulder!r}           # I1 + m2 l1^2, kg m^2
elbow = {elbow!r}               # I2 about the elbow, kg m^2
coupling = {coupling!r}           # m2 rho2, kg m

[[air_bearings]]            # rides on the elbow joint
joint = "elbow"
mass = 1.9635               # kg
inertia = 0.00245437        # kg m^2

[[air_bearings]]            # carries the end of link 2
joint = "wrist"
mass = 1.9635
inertia = 0.00245437

[[recordings]]
file = "release.csv"        # 20 s at 100 Hz
theta2 = {theta2!r}                # rad
noise = {noise!r}               # rad
role = "fit"

[[recordings]]
file = "check.csv"          # another release of the same arm: never fitted, always scored
theta2 = {theta2!r}
noise = {noise!r}
role = "check"
"""


def recording(q0: tuple[float, float], seed: int) -> tuple[Array, Array]:
    """Times (s, N) and noisy angles (rad, N x 2) of one release."""
    t = np.arange(2001) / 100.0
    q, _ = simulate(paper_twin(THETA2), t, q0, frictionloss=(0.0, ELBOW_FRICTION))
    return t, q + NOISE * np.random.default_rng(seed).standard_normal(q.shape)


def main(folder: Path = HERE) -> None:
    """Write the demo's three files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (q0, seed) in RELEASES.items():
        t, q = recording(q0, seed)
        rows = (f"{now:.2f},{q1:.9f},{q2:.9f}" for now, (q1, q2) in zip(t, q, strict=True))
        (folder / name).write_text("\n".join(["t,q1,q2", *rows]) + "\n", encoding="ascii")
    arm = vars(paper_twin(THETA2))
    text = EXPERIMENT.format(**arm, noise=NOISE)
    (folder / "experiment.toml").write_text(text, encoding="ascii")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
