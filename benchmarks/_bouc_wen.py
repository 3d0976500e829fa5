"""The hysteretic benchmark (Noel and Schoukens, 2016), its equations simulated here.

    m y'' + c y' + k y + z = u,    z' = a y' - b (g |y'| z + d y' |z|)

with m = 2 kg, c = 10 N s/m, k = a = 5e4 N/m, b g = 800 1/m, b d = -1100 1/m. Estimation: one period
of a random-phase multisine (5 to 150 Hz, 50 N rms, 8192 samples at 750 Hz) from rest, noise of
8e-6 m on the readings. Test: another one, and the first `SWEEP` s of a sweep (40 N, 20 to 50 Hz at
10 Hz/min), both without noise. The numbers are fitted, then nothing is but the initial state.
Errors are rms in dB of a metre: polynomial nonlinear state-space models with 217 numbers reach
-98 dB on the benchmark's own files, as published.
"""

import numpy as np

import residyn
from residyn import JointEffect, param
from residyn.physics.motion import Scalar
from residyn.physics.parameter import STIFFNESS, Dimension, Memory
from residyn.recordings.recording import Recording
from residyn.recordings.tables import InertiaTable

M, C, K, A, GAMMA, DELTA = 2.0, 10.0, 5e4, 5e4, 800.0, -1100.0
RATE, FINE, PERIOD, NOISE, SWEEP = 750.0, 20, 8192, 8e-6, 15.0
PER_WAY = Dimension("1/rad", "1/m", lambda s: 1.0 / s.amplitude)


class BoucWen(JointEffect):
    """The benchmark's law as a user would write it, its three numbers fitted."""

    name = "bouc_wen"
    rough = True
    memory = (
        Memory("z", Dimension("N m", "N", lambda s: s.inertia * s.frequency**2 * s.amplitude)),
    )

    stiffness: Scalar = param("a", STIFFNESS, sign="positive")
    gamma: Scalar = param("b g", PER_WAY, silent=None, default=100.0, grid=(0.3,))
    delta: Scalar = param("b d", PER_WAY, silent=None, default=100.0, grid=(0.3,))

    def joint_torque(self, motion):
        return motion.memory[0]

    def joint_rate(self, motion):
        (z,), v = motion.memory, motion.v
        return (self.stiffness * v - self.gamma * abs(v) * z - self.delta * v * abs(z),)


def multisine(seed: int, factor: int) -> np.ndarray:
    """(factor * PERIOD,) N, exactly band limited."""
    rng = np.random.default_rng(seed)
    lines = np.zeros(factor * PERIOD // 2 + 1, complex)
    used = np.arange(int(np.ceil(5 * PERIOD / RATE)), int(150 * PERIOD / RATE) + 1)
    lines[used] = np.exp(2j * np.pi * rng.random(len(used)))
    u = np.fft.irfft(lines, factor * PERIOD)
    return 50.0 * u / np.sqrt(np.mean(u**2))


def sweep(factor: int) -> np.ndarray:
    """The first seconds of the benchmark's sweep, N."""
    t = np.arange(int(SWEEP * RATE * factor)) / (RATE * factor)
    return 40.0 * np.sin(2 * np.pi * (20.0 * t + 0.5 * (10.0 / 60.0) * t**2))


def response(u: np.ndarray) -> np.ndarray:
    """(len(u),) m, from rest: Runge and Kutta's fourth order over two samples of `u` at a time,
    which is given at twice the rate of the steps."""
    h = 2.0 / (RATE * 2 * FINE)

    def slope(y, v, z, force):
        return (
            v,
            (force - C * v - K * y - z) / M,
            A * v - GAMMA * abs(v) * z - DELTA * v * abs(z),
        )

    state, found = (0.0, 0.0, 0.0), []
    forces = np.append(u, u[:1]).tolist()
    for i in range(0, len(u), 2):
        found.append(state[0])
        one = slope(*state, forces[i])
        two = slope(*(x + h / 2 * k for x, k in zip(state, one, strict=True)), forces[i + 1])
        three = slope(*(x + h / 2 * k for x, k in zip(state, two, strict=True)), forces[i + 1])
        four = slope(*(x + h * k for x, k in zip(state, three, strict=True)), forces[i + 2])
        state = tuple(
            x + h / 6 * (a + 2 * b + 2 * c + d)
            for x, a, b, c, d in zip(state, one, two, three, four, strict=True)
        )
    return np.array(found)


def recording(name: str, force, role: str, noise: float, drive_factor: int = 4) -> Recording:
    """Readings at the benchmark's rate; between them only the drive, which is so known as its
    band-limited self."""
    y = response(force(2 * FINE))[:: FINE // drive_factor]
    u = force(drive_factor)
    t = np.arange(len(u)) / (RATE * drive_factor)
    seen = np.full(len(u), np.nan)
    seen[::drive_factor] = y[::drive_factor]
    seen += noise * np.random.default_rng(7).standard_normal(len(u))
    return Recording.from_arrays(t, seen, drive=u, noise=NOISE, name=name, role=role)


def experiment() -> residyn.Experiment:
    """Estimation and tests."""
    runs = (
        recording("multisine", lambda f: multisine(1, f), "fit", NOISE),
        recording("another multisine", lambda f: multisine(2, f), "check", 0.0),
        recording("sweep", sweep, "check", 0.0),
    )
    return residyn.Experiment(InertiaTable(("mass",), ((M,),), ("m",)), runs)


def bouc_wen() -> None:
    """The table: springs and dampers, then with the law; and what a diagnosis that has the law
    among its candidates says."""
    given = experiment()
    print("| model | numbers | multisine, dB | another, dB | sweep, dB | found |")
    print("|---|---|---|---|---|---|")
    for effects in ([], [BoucWen("mass")]):
        fit = residyn.fit(given, effects=effects, starts=1)
        errors = []
        for r in fit.whole:
            off = r.residual[np.isfinite(r.residual)]
            errors.append(f"{10 * np.log10(np.mean(off**2)):.1f}")
        numbers = ", ".join(f"{n.name} {n.value:.5g} ± {n.std:.1g}" for n in fit.numbers)
        told = " + ".join(["spring, damper", *(e.name for e in effects)])
        print(f"| {told} | {len(fit.numbers)} | {' | '.join(errors)} | {numbers} |", flush=True)
    residyn.adopt(BoucWen)
    print(f"\n{residyn.diagnose(given, starts=1, max_effects=1)}")
