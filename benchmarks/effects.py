"""Every effect of the catalogue, hidden in MuJoCo recordings and fitted by name.

    python -m benchmarks.effects            one case of each effect at each place
    python -m benchmarks.effects --count 5  five of each
    python -m benchmarks.effects cost       what an effect adds to a simulation's time

20 s at 100 Hz, noise 0.25 % of the motion's rms, strength drawn at random. The table has the
reduced chi-square of the fit without and with the effect (1: down to the noise), the worst error
among all fitted numbers in units of its standard error, and that of the two stiffnesses in %.
"""

import argparse
import time

import jax
import numpy as np

import residyn
from residyn.effects import effects_named
from residyn.recordings.tables import ArmTable, Bearing
from residyn.simulation.simulate import march, steps_for
from tests import rig


def experiment_of(case: rig.HiddenCase) -> residyn.Experiment:
    """The case as a user would have it, its bearings (whose mass is in the inertias) included."""
    arm = case.arm
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    recording = residyn.Recording.from_arrays(case.t, case.q, theta2=arm.theta2, noise=case.noise)
    bearings = [Bearing(where, 1e-9, 1e-9) for where in case.bearings]
    return residyn.Experiment(table, (recording,), bearings)


def fits(labels: list[str], count: int, seed: int) -> None:
    """The table of fits."""
    print(
        f"{'hidden effect':31s} chi2 without     with   worst error   stiffness    starts    time"
    )
    for label in labels:
        cases = rig.hidden_cases(
            np.random.default_rng([seed, rig.NAMES.index(label)]), label, count
        )
        for case in cases:
            experiment = experiment_of(case)
            base = residyn.fit(experiment)
            began = time.perf_counter()
            fit = residyn.fit(experiment, effects=[label])
            seconds = time.perf_counter() - began
            truth = case.numbers | {
                f"{kind}:{joint}.{name}": value
                for kind, name, values in (
                    ("spring", "stiffness", case.arm.stiffness),
                    ("damper", "damping", case.arm.damping),
                )
                for joint, value in zip(fit.joints, values, strict=True)
            }
            off = [
                abs(n.value - truth[n.name]) / n.std
                for n in fit.numbers
                if n.determined and n.name in truth
            ]
            stiffness = [
                abs(n.value / truth[n.name] - 1) for n in fit.numbers if n.name.startswith("spring")
            ]
            print(
                f"{label:31s} {base.reduced_chi2:12.4g} {fit.reduced_chi2:8.3f} {max(off):7.1f} std"
                f"   {100 * max(stiffness):9.3f} %  {fit.agreeing_starts}/{fit.starts}"
                f"   {seconds:5.1f} s",
                flush=True,
            )


def cost() -> None:
    """Simulations of 20 s of one arm, compiled, each effect beside springs and dampers alone."""
    with jax.enable_x64(True):
        arm = residyn.PlanarArm([0.4, 0.4], 1.1662, 0.579, 1.4384, 0.3, bearings=[1, 1])
        base = residyn.Model(arm)
        for joint in arm.joints:
            base = base + residyn.Spring(joint, 16.67) + residyn.Damper(joint, 0.1)
        runs = {}
        for name, kind in residyn.CATALOGUE.items():
            if name in ("spring", "damper"):
                continue
            places = kind.places(arm)
            (effect,) = effects_named(f"{name}:{places[-1]}" if places else name, arm)
            runs[name] = _run(base + jax.tree.map(lambda x: x + 0.05, effect))
        alone = _run(base)
        times = {name: [] for name in ["", *runs]}
        for _ in range(15):
            for name, run in [("", alone), *runs.items()]:
                began = time.perf_counter()
                run()
                times[name].append(time.perf_counter() - began)
        base_time = float(np.median(times.pop("")))
        print(f"springs and dampers alone: {1e3 * base_time:.2f} ms")
        for name, each in times.items():
            print(
                f"{name:24s} {1e3 * np.median(each):6.2f} ms {np.median(each) / base_time:5.2f} x"
            )


def _run(model: residyn.Model):
    steps = steps_for(model, 20.0)
    q0 = np.array([0.2, -0.1])
    program = jax.jit(lambda m: march(m, 0.0, 20.0, q0, 0 * q0, steps=steps).ends)
    program(model).block_until_ready()
    return lambda: program(model).block_until_ready()


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", nargs="?", default="fits", choices=["fits", "cost"])
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[], metavar="LABEL")
    options = parser.parse_args()
    if options.what == "cost":
        cost()
        return
    known = [label for label in rig.NAMES if label.partition(":")[0] in residyn.CATALOGUE]
    fits(options.only or known, options.count, options.seed)


if __name__ == "__main__":
    main()
