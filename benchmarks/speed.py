"""How long a fit takes, beside SciPy, in one run.

    python -m benchmarks.speed
    python -m benchmarks.speed evaluations

The reference problem: the paper's arm at an elbow angle of 0.3 rad, 20 s at 100 Hz, 1 mrad of
noise, four numbers and four initial states. "Warm" is the second and later fits of a process;
"first" compiles. SciPy starts 40 % off; its time says nothing where it ends in a wrong valley.
"""

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

import residyn
from residyn.fitting.problem import compressed
from residyn.fitting.setup import ready
from tests import rig

from .fit_quality import experiment_of, scipy_fit

REPEATS = 15


def evaluations(experiment) -> None:
    """Milliseconds of one evaluation, the model and its derivatives; XLA's flags as they are."""
    print("| model | steps | compiles, s | ms |")
    print("|---|---|---|---|")
    laws = ("coulomb_friction:elbow", "brake_slip:shoulder", "hysteresis:shoulder")
    with jax.enable_x64(True):
        for effects in ([], *([x] for x in laws)):
            here = ready(experiment, experiment.fit_recordings, effects)
            model = here.model.with_vector(jnp.asarray(here.typical()))
            wild = [np.zeros(r.angle.shape, bool) for r in here.recordings]
            problem, states = here.problem(model, wild)
            y = problem.scaled(model.vector(), jnp.asarray(states))
            took = []
            for _ in range(2 * REPEATS):
                began = time.perf_counter()
                jax.block_until_ready(compressed(problem, y, problem.steps).factor)
                took.append(time.perf_counter() - began)
            name = ", ".join(["springs, dampers", *effects])
            ms = 1e3 * float(np.median(took[1:]))
            print(f"| {name} | {int(problem.steps)} | {took[0]:.1f} | {ms:.2f} |", flush=True)


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(0)
    arm, t, q0 = rig.paper_twin(0.3), np.arange(2000) * 0.01, np.array([0.2, -0.1])
    truth, _ = rig.simulate(arm, t, q0)
    noise = 1e-3
    q = truth + noise * rng.standard_normal(truth.shape)
    case = rig.Case(arm, q0, (0.0, 0.0), noise, t, q, truth)
    experiment = experiment_of(case, noise)
    if sys.argv[1:] == ["evaluations"]:
        evaluations(experiment)
        return
    floor = np.sum((q - truth) ** 2)
    print("| fit | first, s | warm, median (min to max), s | cost / noise |")
    print("|---|---|---|---|")
    for starts, effects in ((1, []), (6, []), (6, ["coulomb_friction:elbow"]), (64, [])):
        began = time.perf_counter()
        fit = residyn.fit(experiment, starts=starts, effects=effects)
        first = time.perf_counter() - began
        warm = []
        for _ in range(REPEATS):
            began = time.perf_counter()
            fit = residyn.fit(experiment, starts=starts, effects=effects)
            warm.append(time.perf_counter() - began)
        cost = np.sum(fit.recordings[0].residual ** 2) / floor
        name = f"residyn, {starts} starts" + "".join(f", {e}" for e in effects)
        spread = f"{np.median(warm):.3f} ({min(warm):.3f} to {max(warm):.3f})"
        print(f"| {name} | {first:.1f} | {spread} | {cost:.4f} |", flush=True)
    seconds, costs = [], []
    for _ in range(3):
        began = time.perf_counter()
        costs.append(scipy_fit(case, rng) / floor)
        seconds.append(time.perf_counter() - began)
    spread = f"{np.median(seconds):.1f} ({min(seconds):.1f} to {max(seconds):.1f})"
    print(f"| SciPy least_squares + DOP853 | | {spread} | {min(costs):.4g} to {max(costs):.4g} |")


if __name__ == "__main__":
    main()
