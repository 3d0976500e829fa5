"""How long a fit takes, beside SciPy, in one run.

    python -m benchmarks.speed
    python -m benchmarks.speed evaluations      one evaluation of the model and its derivatives
    python -m benchmarks.speed parts            what a warm fit spends its time on
    python -m benchmarks.speed many [BATCH...]  fits a second of a bootstrap, so many side by side
    python -m benchmarks.speed starts           one warm fit from 1 to 1024 starts
    python -m benchmarks.speed programs         what a first fit and a first diagnosis compile
    python -m benchmarks.speed scaling          how a fit grows with its data; a picture

The reference problem: the paper's arm at an elbow angle of 0.3 rad, 20 s at 100 Hz, 1 mrad of
noise, four numbers and four initial states. "Warm" is the second and later fits of a process, each
of a recording of which nothing is known yet; "first" compiles. SciPy starts 40 % off; its time says
nothing where it ends in a wrong valley.
"""

import dataclasses
import functools
import os
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import residyn
from residyn.fitting import conclusion, initial_guess, lanes
from residyn.fitting.least_squares import compressed
from residyn.fitting.problem import Ready, ready
from residyn.recordings.recording import Recording
from residyn.recordings.tables import ArmTable
from tests import rig

from .fit_quality import experiment_of, scipy_fit

REPEATS = 15
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "scaling.svg"


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


PARTS = {
    "closed-form start": (initial_guess, "closed_form"),
    "outliers": (Recording, "outliers"),
    "the problem's arrays": (Ready, "problem"),
    "Levenberg-Marquardt, and the integration's error": (lanes, "one_start"),
    "covariance": (conclusion, "spread_of"),
    "modes": (conclusion, "modes_of"),
}


def unseen(experiment):
    """The same experiment, its recordings without what earlier fits have found in them."""
    again = tuple(dataclasses.replace(r) for r in experiment.recordings)
    return dataclasses.replace(experiment, recordings=again)


def parts(experiment) -> None:
    """CPU milliseconds of a warm fit from one start, part by part, medians."""
    took: dict[str, list[float]] = {name: [0.0] for name in (*PARTS, "all")}

    def timed(name, call):
        if isinstance(call, functools.cached_property):
            made = functools.cached_property(timed(name, call.func))
            made.__set_name__(Recording, call.func.__name__)
            return made

        def one(*given, **more):
            began = time.process_time()
            try:
                return jax.block_until_ready(call(*given, **more))
            finally:
                took[name][-1] += 1e3 * (time.process_time() - began)

        return one

    residyn.fit(experiment, starts=1)
    for name, (where, what) in PARTS.items():
        setattr(where, what, timed(name, vars(where)[what]))
    whole = timed("all", residyn.fit)
    for _ in range(2 * REPEATS):
        whole(unseen(experiment), starts=1)
        for each in took.values():
            each.append(0.0)
    print("| part | CPU, ms | share |")
    print("|---|---|---|")
    total = np.median(took["all"][:-1])
    for name, each in took.items():
        ms = np.median(each[:-1])
        print(f"| {name} | {ms:.1f} | {100 * ms / total:.0f} % |")


REASONS = {
    "_inertia": "the diagonal of the mass matrix: scales of the unknowns",
    "_equations": "Eq. 1 in weak form: where the starts come from",
    "_linearised": "state matrices: paces of the starts, steps, modes of the fit",
    "one_descent": "every descent: starts, horizons, wild readings, held-out recordings, the "
    "integration error, what the covariance is made of",
    "_stretches": "a model as a linear system along a motion: every step of the diagnosis",
    "smooth": "the filter and the smoother along a motion",
    "evidences": "the evidence of a model under every intensity of the random torque",
    "columns": "how every law of the catalogue moves the readings",
    "gram": "the filter on those columns: the evidence of every law added",
    "look": "readings, slopes and residuals of the model that is kept, in full",
    "_along": "angles, rates and times along the motion: what free curves are of",
}
_SMALL = 0.05  # s


def programs(experiment) -> None:
    """What a first fit compiles, and what a first diagnosis compiles besides; nothing is cached."""
    residyn.set_up(cache=False)
    compiled: list[tuple[str, float]] = []

    def listen(event: str, duration_secs: float, **more: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            name = str(more.get("fun_name"))
            compiled.append((name.removeprefix("jit(").removesuffix(")"), duration_secs))

    jax.monitoring.register_event_duration_secs_listener(listen)
    print("| first | program | times | compiles, s | what for |")
    print("|---|---|---|---|---|")
    for what, call in (("fit", residyn.fit), ("diagnosis after it", residyn.diagnose)):
        compiled.clear()
        call(experiment)
        each: dict[str, list[float]] = {}
        for name, seconds in compiled:
            small = name not in REASONS and seconds < _SMALL
            each.setdefault("single operations" if small else name, []).append(seconds)
        for name, took in sorted(each.items(), key=lambda item: -sum(item[1])):
            reason = REASONS.get(name, "run by itself, outside the programs above")
            print(f"| {what} | {name} | {len(took)} | {sum(took):.2f} | {reason} |", flush=True)


def many(experiment, batches: list[int | None]) -> None:
    """Fits a second of a bootstrap, `batches` side by side on each device; None is the default."""
    fit = residyn.fit(experiment, starts=1)
    draws = 10_000
    print("| device | fits | side by side | first, s | warm, s | fits a second | settled |")
    print("|---|---|---|---|---|---|---|")
    for batch in batches:
        took = []
        for _ in range(2):
            began = time.perf_counter()
            found = residyn.bootstrap(fit, draws, batch=batch)
            took.append(time.perf_counter() - began)
        width = "default" if batch is None else batch
        row = f"{width} | {took[0]:.1f} | {took[1]:.1f} | {draws / took[1]:.0f}"
        print(f"| {_device()} | {draws} | {row} | {found.converged.sum()} |", flush=True)


def more_starts(experiment) -> None:
    """Warm fits from more and more starts."""
    print("| device | starts | first, s | warm, median (min to max), s | over one start |")
    print("|---|---|---|---|---|")
    one = np.nan
    for count in GROWN["starts"]:
        took = []
        for _ in range(6):
            again = unseen(experiment)
            began = time.perf_counter()
            residyn.fit(again, starts=count)
            took.append(time.perf_counter() - began)
        warm = float(np.median(took[1:]))
        one = warm if count == 1 else one
        spread = f"{warm:.3f} ({min(took[1:]):.3f} to {max(took[1:]):.3f})"
        row = f"{count} | {took[0]:.1f} | {spread} | {warm / one:.1f}"
        print(f"| {_device()} | {row} |", flush=True)


def _device() -> str:
    """What the fits run on."""
    device = jax.devices()[0]
    return f"{len(os.sched_getaffinity(0))} cores" if device.platform == "cpu" else str(device)


GROWN: dict[str, tuple[int, ...]] = {
    "samples": (500, 2000, 8000, 50_000),
    "recordings": (1, 10, 100, 1000),
    "starts": (1, 6, 64, 1024),
}


def scaling() -> None:
    """How a warm fit grows with samples, recordings and starts: a table and a picture."""
    print("| what | number | warm, s | over the one before |")
    print("|---|---|---|---|")
    found: dict[str, list[float]] = {what: [] for what in GROWN}
    for what, sizes in GROWN.items():
        for size in sizes:
            experiment = _grown(what, size)
            seconds = []
            for _ in range(4):
                again = unseen(experiment)
                began = time.perf_counter()
                residyn.fit(again, starts=size if what == "starts" else 1)
                seconds.append(time.perf_counter() - began)
                if seconds[-1] > 30:
                    break
            warm = float(np.median(seconds[1:] or seconds))
            more = f"{warm / found[what][-1]:.1f}" if found[what] else ""
            print(f"| {what} | {size} | {warm:.3f} | {more} |", flush=True)
            found[what].append(warm)
    _drawn(found)


def _drawn(found: dict[str, list[float]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    words = {
        "samples": "samples in 20 s",
        "recordings": "recordings of 2000 samples",
        "starts": "starts",
    }
    figure, all_axes = plt.subplots(1, 3, figsize=(9.0, 3.0), sharey=True, layout="constrained")
    for axes, (what, seconds) in zip(all_axes, found.items(), strict=True):
        sizes = np.array(GROWN[what], float)
        even = seconds[-2] * sizes / sizes[-2]
        axes.loglog(sizes, even, color="0.7", lw=1, zorder=0, label="in proportion")
        axes.loglog(sizes, seconds, "o-", color="C0", ms=5, label="measured")
        axes.set_xlabel(words[what])
        axes.spines[["top", "right"]].set_visible(False)
    all_axes[0].set_ylabel("one warm fit, s")
    all_axes[0].legend(frameon=False, loc="upper left")
    figure.savefig(PICTURE)
    plt.close(figure)


def _grown(what: str, size: int):
    """The reference problem: more samples in the same 20 s, or more releases; else as it is."""
    arm, rng, noise = rig.paper_twin(0.3), np.random.default_rng(0), 1e-3
    count = size if what == "samples" else 2000
    t = np.arange(count) * 20.0 / count
    releases = size if what == "recordings" else 1
    recordings = []
    truth, _ = rig.simulate(arm, t, np.array([0.2, -0.1]))
    for _ in range(releases):  # the same release, each with noise of its own
        q = truth + noise * rng.standard_normal(truth.shape)
        recordings.append(residyn.Recording.from_arrays(t, q, theta2=arm.theta2, noise=noise))
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    return residyn.Experiment(table, tuple(recordings))


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(0)
    arm, t, q0 = rig.paper_twin(0.3), np.arange(2000) * 0.01, np.array([0.2, -0.1])
    truth, _ = rig.simulate(arm, t, q0)
    noise = 1e-3
    q = truth + noise * rng.standard_normal(truth.shape)
    case = rig.Case(arm, q0, (0.0, 0.0), noise, t, q, truth)
    experiment = experiment_of(case, noise)
    words = sys.argv[1:]
    if words:
        some = {
            "evaluations": evaluations,
            "parts": parts,
            "programs": programs,
            "many": lambda e: many(e, [int(w) for w in words[1:]] or [None]),
            "starts": more_starts,
            "scaling": lambda _: scaling(),
        }
        some[words[0]](experiment)
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
            again = unseen(experiment)
            began = time.perf_counter()
            fit = residyn.fit(again, starts=starts, effects=effects)
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
