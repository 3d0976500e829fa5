"""residyn beside other ways to fit the same recordings, in one run.

    python -m benchmarks.rivals [--problem reference|short|long|five] [--only NAME ...]
                                [--repeats N] [--many] [--genetic]

Problems: the paper's arm at an elbow angle of 0.3 rad, simulated by MuJoCo, read at 100 Hz with
1 mrad of noise. "reference" is 20 s, "short" 5 s, "long" 60 s with a fifth of the damping, "five"
five releases of 20 s fitted at once. All methods seek the same least-squares minimum over four
numbers and every recording's four initial values. residyn and the genetic algorithm know nothing
else; every other method starts with each number 40 % off, up or down.

Methods take turns, so that a ratio of times is fair on a machine that others use too. Each turn has
noise and start directions of its own, the same for all methods. "First" is the first fit of the
process, compiling included, "warm" are the later ones. Each answer is simulated anew by one
referee. The minimum is the lowest cost that any method of the turn found; "finds it" is a cost
within a thousandth of that.
"""

import argparse
import functools
import importlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

import residyn
from residyn.recordings.tables import ArmTable

from ._rivals_problem import Answer, Missing, Problem, TooSlow, cost_of, problem

FOUND = 1.001
FLOOR = "numba, by hand"


@dataclass
class Method:
    """One way to fit, and how it did, turn by turn."""

    name: str
    fit: Callable[[Problem], Answer]
    compiles: bool = True
    """Whether its first fit costs more than the next; the others skip turn 0."""
    seconds: dict[int, float] = field(default_factory=dict)
    cost: dict[int, float] = field(default_factory=dict)
    errors: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def warm(self) -> list[int]:
        """The turns that count as warm."""
        return [i for i in self.seconds if i > 0]


def fit_residyn(given: Problem, **how) -> Answer:
    """`residyn.fit`, its report with errors and modes included."""
    arm = given.arm
    table = ArmTable((arm.l1, arm.l2), arm.shoulder, arm.elbow, arm.coupling)
    recordings = tuple(
        residyn.Recording.from_arrays(given.t, q, theta2=arm.theta2, noise=given.noise)
        for q in given.q
    )
    fit = residyn.fit(residyn.Experiment(table, recordings), **how)
    numbers = np.array([n.value for n in fit.numbers])
    return Answer(numbers, np.stack([r.state for r in fit.recordings]))


def rival(module: str, function: str = "fit") -> Callable[[Problem], Answer]:
    """A function of a helper module, imported with its first fit: what it needs may be missing."""

    def fit(given: Problem) -> Answer:
        return getattr(importlib.import_module(f".{module}", __package__), function)(given)

    return fit


def methods(many: bool) -> list[Method]:
    """All that are compared, in the table's order."""
    starts = [1, 64, *([1024] if many else [])]
    ours = [
        Method(f"residyn, {n} start{'s' * (n > 1)}", functools.partial(fit_residyn, starts=n))
        for n in starts
    ]
    return [
        Method(FLOOR, rival("_rivals_numba")),
        Method("numba, by hand, all readings at once", rival("_rivals_numba", "fit_directly")),
        *ours,
        Method(
            "residyn, 1 start, by diffeqsolve",
            functools.partial(fit_residyn, starts=1, integrator="Tsit5"),
        ),
        Method("CasADi, multiple shooting", rival("_rivals_casadi")),
        Method("CasADi, single shooting", rival("_rivals_casadi", "fit_single")),
        Method("optimistix LM on diffrax Tsit5", rival("_rivals_jax")),
        Method("mujoco.sysid", rival("_rivals_mujoco"), False),
        Method("mujoco.sysid, SciPy's optimizer", rival("_rivals_mujoco", "fit_scipy"), False),
        Method("SciPy least_squares on DOP853", rival("_rivals_scipy", "fit_scipy"), False),
        Method("lmfit on DOP853", rival("_rivals_scipy", "fit_lmfit"), False),
    ]


def take_turns(given: Problem, found: list[Method], repeats: int, patience: float) -> None:
    """Every method once a turn, until its warm fits have used up its `patience` (s).

    Turn 0 compiles. A method whose package is missing says so and drops out.
    """
    for turn in range(repeats + 1):
        data = given.again(turn)
        for method in list(found):
            spent = sum(method.seconds[i] for i in method.warm)
            if spent > patience or (turn == 0 and not method.compiles):
                continue
            began = time.perf_counter()
            print(f"turn {turn}: {method.name} ...", end="\r", file=sys.stderr, flush=True)
            try:
                answer = method.fit(data)
            except Missing as error:
                print(f"{method.name}: skipped, pip install '{error}'\n", flush=True)
                found.remove(method)
                continue
            except TooSlow:
                method.seconds[turn], method.cost[turn] = time.perf_counter() - began, np.inf
                continue
            method.seconds[turn] = time.perf_counter() - began
            method.cost[turn] = cost_of(data, answer)
            method.errors[turn] = np.abs(answer.numbers / data.numbers - 1)


def row(method: Method, floor: Method | None, best: dict[int, float]) -> str:
    """One line of the table."""
    first = f"{method.seconds[0]:.3g}" if 0 in method.seconds else ""
    warm = np.array([method.seconds[i] for i in method.warm])
    spread, ratio = "", ""
    if len(warm):
        spread = f"{np.median(warm):.3g} ({warm.min():.3g} to {warm.max():.3g})"
        both = [i for i in method.warm if floor and i in floor.warm]
        if both:
            times = np.median([method.seconds[i] / floor.seconds[i] for i in both])
            ratio = f"{times:.3g}"
    relative = np.array([method.cost[i] / best[i] for i in method.cost])
    good = [i for i in method.cost if method.cost[i] < FOUND * best[i]]
    most = relative.max()
    worst = "stopped" if np.isinf(most) else f"{most:.4f}" if most < 10 else f"{most:.3g}"
    errors = ["", ""]
    if good:
        each = np.array([method.errors[i] for i in good])
        errors = [f"{100 * np.median(each[:, s].max(1)):.2g}" for s in (slice(2), slice(2, 4))]
    counts = f"{len(good)} of {len(relative)}"
    cells = [method.name, first, spread, f"{len(warm)}", ratio, worst, counts, *errors]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Run, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--problem", choices=["reference", "short", "long", "five"], default="reference"
    )
    parser.add_argument("--only", nargs="+", help="methods whose names hold one of these words")
    parser.add_argument("--repeats", type=int, default=9, help="warm turns")
    parser.add_argument("--patience", type=float, default=30.0, help="s of warm fits per method")
    parser.add_argument(
        "--limit", type=float, default=60.0, help="s a fit, where it can be stopped"
    )
    parser.add_argument("--many", action="store_true", help="residyn from 1024 starts, too")
    parser.add_argument("--genetic", action="store_true", help="the paper's search, once, minutes")
    asked = parser.parse_args()
    found = methods(asked.many)
    if asked.only:
        words = [word.lower() for word in asked.only]
        found = [m for m in found if any(word in m.name.lower() for word in words)]
    given = replace(problem(asked.problem), limit=asked.limit)
    take_turns(given, found, asked.repeats, asked.patience)
    if asked.genetic:
        genetic = Method("residyn, genetic, 100 x 500", _genetic)
        take_turns(given, [genetic], 0, asked.patience)  # one fit: its compiling is the lesser part
        found.append(genetic)
    turns = {i for m in found for i in m.cost}
    best = {i: min(m.cost[i] for m in found if i in m.cost) for i in turns}
    floor = next((m for m in found if m.name == FLOOR), None)
    readings = given.q.size
    print(f"{asked.problem}: {readings} readings; ", end="")
    print(f"minimum / readings {np.median(list(best.values())) / readings:.3f}\n")
    print(
        "| method | first, s | warm, median (min to max), s | warm fits | times the floor ", end=""
    )
    print("| cost / minimum, worst | finds it | k off, % | c off, % |")
    print("|---|---|---|---|---|---|---|---|---|")
    for method in found:
        print(row(method, floor, best))


def _genetic(given: Problem) -> Answer:
    return fit_residyn(given, method="genetic")


if __name__ == "__main__":
    main()
