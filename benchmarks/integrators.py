"""What integrates: fixed steps beside diffrax's solvers.

    python -m benchmarks.integrators            what each costs, a table of docs/integrators.md
    python -m benchmarks.integrators exact      how exact the default's steps are, on twenty arms

Costs are of three recordings at 50 Hz with 1 mrad of noise, made by Dopri8 at rtol = 1e-12: 8 s of
a smooth arm (cubic spring) and of one with dry friction, and 2 s of a stiff one (drag that follows
the motion with a lag of 0.1 ms). Seconds are those of the processor, so that other programs on the
machine do not count. "first" is the first fit of a model by an integrator, whose programs are
compiled.

The twenty arms are those of `tests.exact`. Their true motion is Dopri8's at rtol = 1e-12, at the
fitted numbers and initial state; with dry friction, DOP853's from one reversal to the next.
"""

import sys
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import residyn
from residyn.fitting import FitError
from residyn.fitting.integration import checked
from residyn.fitting.least_squares import compressed, predict
from residyn.fitting.problem import Problem, Unknowns
from tests.exact import EXACT, IMPLICIT, LaggingDrag, error_of, recorded, twenty_arms, two_joints

REPEATS = 7


def cases():
    """Name, the model that is recorded, by what, the effect that is fitted, s, the integrators."""
    drag, dry = residyn.QuadraticDrag("tip", 0.4), residyn.CoulombFriction("tip", 0.1)
    cubic = residyn.CubicStiffness("tip", 30.0)
    usual = ("fixed", "Tsit5", "Dopri8")
    yield "smooth", two_joints(cubic), EXACT, "cubic_stiffness:tip", 8.0, usual
    yield "dry", two_joints(dry), None, "coulomb_friction:tip", 8.0, ("fixed", "StickSlip", "Tsit5")
    yield "stiff", two_joints(drag), EXACT, LaggingDrag("tip"), 2.0, ("fixed", IMPLICIT)


def cpu(function, repeats: int = REPEATS) -> float:
    """Milliseconds of the processor that one call takes, the median."""
    took = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        took.append(1e3 * (time.process_time() - began))
    return float(np.median(took))


def costs() -> None:
    """Print the table of costs."""
    heads = (
        "recording",
        "integrator",
        "first fit, s",
        "warm fit, ms",
        "simulate, ms",
        "Jacobian, ms",
    )
    print(f"| {' | '.join([*heads, 'error / noise'])} |")
    print("|---" * 7 + "|")
    for name, truth, made_by, effect, seconds, integrators in cases():
        times = np.arange(round(50 * seconds)) / 50
        experiment = recorded(truth, times, made_by, steps=20 * len(times))
        for integrator in integrators:
            how = {"effects": [effect], "starts": 1, "integrator": integrator}
            word = getattr(integrator, "name", integrator)
            began = time.process_time()
            try:
                fit = residyn.fit(experiment, **how)
            except (FitError, residyn.InputError) as error:
                print(f"| {name} | {word} | {error} |", flush=True)
                continue
            first = time.process_time() - began
            warm = cpu(lambda how=how: residyn.fit(experiment, **how))  # noqa: B023
            print(f"| {name} | {word} | {first:.1f} | {warm:.0f} | ", end="")
            print(" | ".join(f"{x:.2f}" for x in pieces(fit)), end=" | ")
            with jax.enable_x64(True):
                print(f"{checked(fit)[0]:.1e} |", flush=True)


def between(fit: residyn.Fit, other: residyn.Fit) -> float:
    """Between the numbers of two fits, in standard errors, the worst."""
    pairs = zip(fit.numbers, other.numbers, strict=True)
    return max(abs(a.value - b.value) / b.std for a, b in pairs)


def pieces(fit: residyn.Fit) -> tuple[float, float]:
    """One simulation, and one with its Jacobian."""
    with jax.enable_x64(True):
        given = fit.problem, jax.tree.map(jnp.asarray, fit.unknowns)
        found = []
        for program in (_predicted, lambda *given: compressed(*given).factor):
            jax.block_until_ready(program(*given))
            found.append(cpu(lambda: jax.block_until_ready(program(*given))))  # noqa: B023
        return found[0], found[1]


@eqx.filter_jit
def _predicted(problem: Problem, y: Unknowns):
    def one(recorded, state):
        return predict(problem, recorded, problem.numbers(y), state)

    return jax.vmap(one)(problem.recorded, problem.states(y))


def exact() -> None:
    """Print the table of twenty arms."""
    print("| arm | steps | error / noise, stated | true | stated / true | Tsit5 off | Dopri8 off |")
    print("|---|---|---|---|---|---|---|")
    for i, (experiment, effects) in enumerate(twenty_arms()):
        fit = residyn.fit(experiment, effects=effects)
        true = error_of(fit)
        cells = [f"{i + 1}, {', '.join(effects) or 'springs, dampers'}", fit.integration_steps]
        cells += [f"{fit.integration_error:.2g}", f"{true:.2g}"]
        cells.append(f"{fit.integration_error / true:.2f}")
        for solver in () if fit.model.dry else ("Tsit5", "Dopri8"):
            other = residyn.fit(experiment, effects=effects, integrator=solver)
            cells.append(f"{between(fit, other):.4f}")
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    asked = "exact" in sys.argv[1:]
    residyn.set_up(cache=asked)
    exact() if asked else costs()
