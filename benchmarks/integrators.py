"""What integrates: fixed steps beside diffrax's solvers, on one recording of each kind.

    python -m benchmarks.integrators            the table of docs/integrators.md

Three recordings of 8 s at 50 Hz with 1 mrad of noise, made by Dopri8 at rtol = 1e-12: a smooth arm
(cubic spring), one with dry friction, and a stiff one (drag that follows the motion with a lag of
0.1 ms; 2 s of it). Seconds are those of the processor, so that other programs on the machine do not
count. "first" is the first fit of a model by an integrator, whose programs are compiled.
"""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import residyn
from residyn.fitting import FitError
from residyn.fitting.integration import checked
from residyn.fitting.problem import Problem, Unknowns, compressed, predict, ready
from residyn.physics.parameter import QUADRATIC, RATIO, Memory, param
from residyn.recordings.tables import InertiaTable

MATRIX, JOINTS, UNITS = [[1.0, 0.3], [0.3, 0.5]], ("base", "tip"), ("rad", "rad")
NOISE, REPEATS = 1e-3, 7


class LaggingDrag(residyn.JointEffect):
    """Quadratic drag that follows the motion with a lag of 0.1 ms."""

    name = "lagging_drag"
    title = "Drag with a lag"
    equation = "c z, tau z' = q' |q'| - z"
    looks_like = "quadratic drag"
    source = "first-order lag"
    memory = (Memory("z", RATIO),)

    coefficient: float = param("drag", QUADRATIC)
    lag: float = param("lag, s", RATIO, silent=None, default=1e-4, fitted=False, grid=(1.0,))

    def joint_torque(self, motion):
        return self.coefficient * motion.memory[0]

    def joint_rate(self, motion):
        return ((motion.v * jnp.abs(motion.v) - motion.memory[0]) / self.lag,)


def arm(*effects):
    """Two joints on springs and dampers, and effects."""
    model = residyn.ConstantInertia(MATRIX, JOINTS, UNITS)
    model = model + residyn.Spring("base", 20.0) + residyn.Spring("tip", 12.0)
    model = model + residyn.Damper("base", 0.15) + residyn.Damper("tip", 0.05)
    for effect in effects:
        model = model + effect
    return model


def cases():
    """Name, what made the recording, the effect that is fitted, seconds, the integrators."""
    exact = residyn.Integrator("Dopri8", rtol=1e-12, atol=1e-14)
    stiff = residyn.Integrator("Kvaerno5", rtol=1e-6, atol=1e-8)
    drag, dry = residyn.QuadraticDrag("tip", 0.4), residyn.CoulombFriction("tip", 0.1)
    cubic = residyn.CubicStiffness("tip", 30.0)
    usual = ("fixed", "Tsit5", "Dopri8")
    yield "smooth", arm(cubic), exact, "cubic_stiffness:tip", 8.0, usual
    yield "dry", arm(dry), None, "coulomb_friction:tip", 8.0, ("fixed", "StickSlip", "Tsit5")
    yield "stiff", arm(drag), exact, LaggingDrag("tip"), 2.0, ("fixed", stiff)


def cpu(function, repeats: int = REPEATS) -> float:
    """Milliseconds of the processor that one call takes, the median."""
    took = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        took.append(1e3 * (time.process_time() - began))
    return float(np.median(took))


def main() -> None:
    """Print the table."""
    residyn.set_up(cache=False)
    heads = (
        "recording",
        "integrator",
        "first fit, s",
        "warm fit, ms",
        "simulate, ms",
        "Jacobian, ms",
    )
    print(f"| {' | '.join([*heads, 'error / noise', 'off, std errors'])} |")
    print("|---" * 8 + "|")
    for name, truth, made_by, effect, seconds, integrators in cases():
        times = np.arange(round(50 * seconds)) / 50
        with jax.enable_x64(True):
            path = residyn.simulate(
                truth, times, [0.2, -0.1], integrator=made_by, steps=20 * len(times)
            )
            q = np.asarray(path.q) + NOISE * np.random.default_rng(1).standard_normal(
                (len(times), 2)
            )
        recording = residyn.Recording.from_arrays(times, q, noise=NOISE)
        experiment = residyn.Experiment(InertiaTable(JOINTS, MATRIX, UNITS), (recording,))
        base = None
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
                print(f"{checked(fit)[0]:.1e} | ", end="")
            base = base or fit
            pairs = zip(fit.numbers, base.numbers, strict=True)
            print(f"{max(abs(a.value - b.value) / b.std for a, b in pairs):.4f} |", flush=True)


def pieces(fit: residyn.Fit) -> tuple[float, float]:
    """One simulation, and one with its Jacobian."""
    with jax.enable_x64(True):
        effects = [e for e in fit.model.effects if e.name not in ("spring", "damper")]
        here = ready(fit.experiment, [r.recording for r in fit.recordings], effects)
        problem, _ = here.problem(fit.model, [r.wild for r in fit.recordings])
        y = problem.scaled(jnp.asarray(fit.model.vector()), jnp.asarray([fit.recordings[0].state]))
        jax.block_until_ready(_predicted(problem, y))
        simulate = cpu(lambda: jax.block_until_ready(_predicted(problem, y)))
        jax.block_until_ready(compressed(problem, y).factor)
        return simulate, cpu(lambda: jax.block_until_ready(compressed(problem, y).factor))


@eqx.filter_jit
def _predicted(problem: Problem, y: Unknowns):
    def one(recorded, state):
        return predict(problem, recorded, problem.numbers(y), state)

    return jax.vmap(one)(problem.recorded, problem.states(y))


if __name__ == "__main__":
    main()
