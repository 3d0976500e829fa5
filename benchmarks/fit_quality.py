"""How good a fit is, on MuJoCo arms whose truth is known.

    python -m benchmarks.fit_quality clean      50 arms, 20 s, noise 5e-4 rad: accuracy, chi-square
    python -m benchmarks.fit_quality minimum    200 arms, hard ones: is the global minimum found?
    python -m benchmarks.fit_quality missing    400 arms with an effect not fitted: lowest minimum?
    python -m benchmarks.fit_quality named      400 arms with an effect, fitted by name: the same
    python -m benchmarks.fit_quality coverage   400 recordings: do 95 % intervals hold the truth?

Every fit runs with the default settings and no start value. Seeds are fixed; `--seed` takes others,
`--count` fewer arms (for `missing` and `named`: so many tuning seeds, 80 arms each; `--skip` leaves
out the first). Each line of a table is printed as it comes.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import residyn
from benchmarks._hidden_cases import specs
from benchmarks.effects import experiment_of as on_bearings
from residyn.fitting.lanes import alone
from residyn.fitting.multistart import descending
from residyn.fitting.problem import ready
from residyn.recordings.tables import ArmTable
from tests import rig

SCIPY_EVERY = 25
LOWER = 2e-3  # share of chi-square by which another end must be lower


def experiment_of(case: rig.Case, noise: float | None = None) -> residyn.Experiment:
    """The case as a user would have it: inertias, pose, readings, their noise (None: estimate)."""
    arm = case.arm
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    recording = residyn.Recording.from_arrays(case.t, case.q, theta2=arm.theta2, noise=noise)
    return residyn.Experiment(table, (recording,))


def truth_of(case: rig.Case) -> np.ndarray:
    """k1, k2, c1, c2, in the order of `Fit.numbers`."""
    return np.array([*case.arm.stiffness, *case.arm.damping])


def errors(fit: residyn.Fit, truth: np.ndarray) -> np.ndarray:
    """Relative errors of the four numbers."""
    return np.array([n.value for n in fit.numbers]) / truth - 1


def clean(seed: int, count: int) -> None:
    """Accuracy, with the noise given and with the noise estimated.

    Some arms' recordings hold too little of one damping (a joint that hardly moves): no method can
    do better than the Cramer-Rao bound, so the worst error is also given in units of it.
    """
    rng = np.random.default_rng([seed, 1])
    rows = []
    for case in rig.clean_cases(rng, count, noise=5e-4):
        for noise in (case.noise, None):
            fit = residyn.fit(experiment_of(case, noise))
            off = np.abs(errors(fit, truth_of(case)))
            bound = np.array([n.std for n in fit.numbers]) / truth_of(case)
            row = [off[:2].max(), off[2:].max(), bound[2:].max(), (off / bound).max()]
            rows.append([*row, fit.reduced_chi2, fit.agreeing_starts])
        print(f"{len(rows) // 2:3d}  k {rows[-2][0]:.3%}  c {rows[-2][1]:.3%} ", end="")
        print(f"(bound {rows[-2][2]:.2%})  chi2 {rows[-2][4]:.3f}, ", end="")
        print(f"{rows[-1][4]:.3f} with noise estimated", flush=True)
    table = np.array(rows).reshape(count, 2, 6)
    for i, name in enumerate(("noise given", "noise estimated")):
        k, c, bound, sigmas, chi2, agree = table[:, i].T
        can = bound < 0.01  # 3 % is then at least three standard errors
        inside = np.sum((chi2 > 0.9) & (chi2 < 1.1))
        print(f"{name}: k within 0.5 %: {np.sum(k < 0.005)}/{count} (worst {k.max():.3%})")
        print(f"  c within 3 %: {np.sum(c < 0.03)}/{count}; where the bound is below 1 %: ", end="")
        print(f"{np.sum(c[can] < 0.03)}/{can.sum()}; worst of all {sigmas.max():.1f} bounds")
        print(f"  reduced chi-square {chi2.min():.3f} to {chi2.max():.3f} ", end="")
        print(f"({inside}/{count} in 0.9 to 1.1); fewest agreeing starts {agree.min():.0f} of 6")


def hard_case(rng: np.random.Generator) -> rig.Case:
    """Noise to 5 % of the amplitude, 5 to 60 s, amplitude to 1 rad, damping 0.002 to 0.1."""
    amplitude = float(np.exp(rng.uniform(np.log(0.05), 0.0)))
    return next(
        rig.clean_cases(
            rng,
            1,
            amplitude=(0.3 * amplitude, amplitude),
            noise=amplitude * float(np.exp(rng.uniform(np.log(0.001), np.log(0.05)))),
            damping_ratio=(0.002, 0.1),
            seconds=float(np.exp(rng.uniform(np.log(5), np.log(60)))),
        )
    )


def minimum(seed: int, count: int, skip: int = 0) -> None:
    """The true motion leaves the noise alone: a fit that leaves more is in a wrong valley."""
    rng = np.random.default_rng([seed, 2])
    ours, theirs, tried, seconds = 0, 0, 0, np.zeros(2)
    for index in range(count):
        case = hard_case(rng)
        if index < skip:
            continue
        noise_cost = np.sum((case.q - case.truth) ** 2)
        began = time.perf_counter()
        fit = residyn.fit(experiment_of(case, case.noise))
        middle = time.perf_counter()
        cost = np.sum(fit.recordings[0].residual ** 2)
        found = cost <= noise_cost
        ours += found
        seconds[0] += middle - began
        if index % SCIPY_EVERY == 0:  # minutes each on a long record
            start = np.random.default_rng([seed, 4, index])
            theirs += scipy_fit(case, start) <= noise_cost * (1 + 1e-3)
            tried += 1
            seconds[1] += time.perf_counter() - middle
        print(f"{index + 1:3d}  residyn {ours}  scipy {theirs}/{tried}  ", end="")
        print(f"{case.t[-1]:5.1f} s, noise {case.noise / np.abs(case.q0).max():.3f}, ", end="")
        print(f"agreeing {fit.agreeing_starts}", "" if found else "  MISSED", flush=True)
    count -= skip
    print(f"global minimum found: residyn {ours}/{count} (closed-form start, defaults); ", end="")
    print(f"SciPy from 40 % off {theirs}/{tried}")
    print(f"mean seconds a fit, compiling included: {seconds[0] / count:.2f}; ", end="")
    print(f"SciPy {seconds[1] / tried:.1f}")


def missing(seed: int, count: int, skip: int = 0) -> None:
    """Springs and dampers fitted where something else is at work, too, at 5 % and 1 % noise: does
    the fit end as low as a descent from the true springs and dampers?"""
    del seed  # the hidden effects have their own
    worse, total = 0, 0
    for spec in specs(["single"], (0.05, 0.01), count=count, skip=skip):
        case = spec.make()
        experiment = experiment_of(case, case.noise)
        try:
            fit = residyn.fit(experiment)
            cost = sum(np.nansum((r.residual / r.recording.noise) ** 2) for r in fit.recordings)
        except residyn.FitError:
            cost = np.inf
        wild = [np.zeros(case.q.shape, bool)]
        with jax.enable_x64(True):
            here = ready(experiment, experiment.fit_recordings, ())
            truth = here.model.with_vector(jnp.asarray(truth_of(case)))
            nearby = alone(descending(here, truth, truth_of(case)[None], wild))
        total += 1
        if cost > (1 + LOWER) * nearby.cost:
            worse += 1
            ratio = cost / nearby.cost
            print(f"{spec.key}: {ratio:.4g} times what is left from the true springs", flush=True)
    print(f"{total - worse} of {total} end as low")


def named(seed: int, count: int, skip: int = 0) -> None:
    """The hidden effect fitted by name: does the fit leave no more than the true motion does?"""
    del seed
    worse, total = 0, 0
    for spec in specs(["single"], (0.05, 0.01), count=count, skip=skip):
        case = spec.make()
        truth = np.sum(((case.q - case.truth) / case.noise) ** 2)
        try:
            fit = residyn.fit(on_bearings(case), effects=list(spec.labels))
            cost = sum(np.nansum((r.residual / r.recording.noise) ** 2) for r in fit.recordings)
            agreeing = fit.agreeing_starts
        except residyn.FitError:
            cost, agreeing = np.inf, 0
        total += 1
        if cost > (1 + LOWER) * truth:
            worse += 1
            print(
                f"{spec.key}: {cost / truth:.4g} times the noise, {agreeing} agreeing", flush=True
            )
    print(f"{total - worse} of {total} leave no more than the noise")


def scipy_fit(case: rig.Case, rng: np.random.Generator) -> float:
    """least_squares on solve_ivp(DOP853), started 40 % off, initial angles as read."""
    truth = truth_of(case)
    start = truth * np.where(rng.random(4) < 0.5, 0.6, 1.4)
    arm = case.arm
    s = arm.l1 * arm.coupling

    def rates(t, y, k1, k2, c1, c2):
        q1, q2, v1, v2 = y
        cross, bend = s * np.cos(arm.theta2 + q2), s * np.sin(arm.theta2 + q2)
        a, b, d = arm.shoulder + arm.elbow + 2 * cross, arm.elbow + cross, arm.elbow
        f1 = bend * (2 * v1 * v2 + v2 * v2) - k1 * q1 - c1 * v1
        f2 = -bend * v1 * v1 - k2 * q2 - c2 * v2
        det = a * d - b * b
        return [v1, v2, (d * f1 - b * f2) / det, (a * f2 - b * f1) / det]

    def residual(z):
        numbers, state = z[:4] * truth, z[4:]
        ends = (case.t[0], case.t[-1])
        out = solve_ivp(
            rates, ends, state, "DOP853", case.t, args=tuple(numbers), rtol=1e-7, atol=1e-9
        )
        full = out.y.shape[1] == len(case.t)
        return (out.y[:2].T - case.q).ravel() if full else np.full(case.q.size, 1e3)

    first = np.concatenate([start / truth, case.q[0], [0.0, 0.0]])
    out = least_squares(residual, first, x_scale=np.r_[np.ones(4), 0.1 * np.ones(4)], max_nfev=40)
    return 2 * out.cost


def coverage(seed: int, count: int) -> None:
    """Share of the 95 % intervals that hold the truth, noise given and noise estimated."""
    rng = np.random.default_rng([seed, 3])
    hits = {True: [], False: []}
    for index, case in enumerate(rig.clean_cases(rng, count, seconds=10.0)):
        for given in (True, False):
            fit = residyn.fit(experiment_of(case, case.noise if given else None), starts=2)
            std = np.array([n.std for n in fit.numbers])
            hits[given].append(np.abs(errors(fit, 1.0) + 1 - truth_of(case)) < 1.96 * std)
        if (index + 1) % 20 == 0:
            print(
                f"{index + 1:3d}  {np.mean(hits[True]):.3f}  {np.mean(hits[False]):.3f}", flush=True
            )
    for given, rows in hits.items():
        pairs = zip(["k1", "k2", "c1", "c2"], np.mean(rows, 0), strict=True)
        each = "  ".join(f"{name} {share:.1%}" for name, share in pairs)
        print(f"noise {'given' if given else 'estimated'}: {np.mean(rows):.1%} of all ({each})")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    jobs = {"clean": (clean, 50), "minimum": (minimum, 200), "coverage": (coverage, 400)}
    jobs |= {"missing": (missing, 5), "named": (named, 5)}
    parser.add_argument("what", choices=list(jobs))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int)
    parser.add_argument(
        "--skip", type=int, default=0, help="of the arms or seeds, the first so many"
    )
    given = parser.parse_args()
    job, usual = jobs[given.what]
    more = {"skip": given.skip} if given.what in ("minimum", "missing", "named") else {}
    job(given.seed, given.count or usual, **more)
