"""Step 1 of the paper: the arm's inertias from driven tests (Eq. 10 to 16).

Each test gives one composite inertia: I2 where the elbow is driven (Eq. 10), and where the
shoulder is, I1 + I2 + m2 l1^2 + 2 m2 l1 rho2 cos(theta2) (Eq. 11). Tests at two elbow angles or
more tell the part that goes with the cosine from the part that does not (Eq. 14, 15), if their
cosines differ enough (Eq. 16); least squares takes any number of them, each with its own error.
"""

import contextlib
import math
import time
from collections.abc import Iterator, Sequence

import jax
import numpy as np
from scipy.special import chdtrc

from ..diagnosis.result import Value
from ..errors import InputError
from ..fitting import FitError
from ..physics.bearings import with_bearings
from ..physics.mechanism import PlanarArm
from ..recordings.experiment import Experiment, must_be_experiment
from ..recordings.tables import ArmTable
from .driven import DrivenTest, driven_test
from .result import FRICTION, InertiaResult, Separation, TestResult
from .weak import CALIBRATED, Rows, Solved, ordinary, rows_of, solve

_ROUNDS = 20
_LEAST_APART = 1e-3  # cosines closer than this are the same, and so are two tests at them


def inertia(experiment: Experiment) -> InertiaResult:
    """Find shoulder, elbow and coupling from the recordings with `role = "inertia"`.

    Runs in float64 whatever JAX's setting. The errors hold the noise of angles and torques. They
    know nothing of errors in theta2, in link_lengths or in the torque sensor's scale, nor of angles
    read on the motor's side of a joint of stiffness k, which make inertia I driven at w rad/s look
    larger by the share I w^2 / k.

    **Arguments:**

    - `experiment`: from `residyn.load`, with an `[arm]`, whose own inertias are not used, and at
      least one recording of the elbow driven and two of the shoulder driven, at elbow angles of
      different cosine.

    **Returns:** an `InertiaResult`, kg m^2 and kg m, of the arm with its bearings on.

    **Raises:** `InputError` (a `ValueError`) if the recordings that are needed are not there;
    `TypeError` for what is no experiment; `FitError` if the numbers cannot be had from them.
    """
    must_be_experiment(experiment)
    began = time.perf_counter()
    table = experiment.inertia
    if not isinstance(table, ArmTable):
        raise InputError(
            "step 1 is for an [arm]: the mass matrix of an [inertia] table is given, not looked for"
        )
    recordings = [r for r in experiment.recordings if r.role == "inertia"]
    tests = [driven_test(r) for r in recordings]
    check_recordings(tests)
    l1 = table.link_lengths[0]
    design = np.array([_design(t, l1) for t in tests])
    bare = np.array([not r.air_bearings for r in recordings])
    bearings = bare[:, None] * _bearings(experiment)
    added = np.sum(design * bearings, axis=1)

    rows = [rows_of(t, l1) for t in tests]
    begin = [ordinary(t) for t in tests]
    plain = np.array([values[0] for values, _ in begin])
    first = np.linalg.lstsq(design, plain + added, rcond=None)[0]
    solved = _solved(tests, rows, [values for values, _ in begin], first, design, bearings)
    values, covariance, chi2 = _combined(design, added, solved)
    units = "kg m^2", *FRICTION.values()
    found = [
        TestResult(t, s, tuple(map(Value, *ls, units)))
        for t, s, ls in zip(tests, solved, begin, strict=True)
    ]
    return InertiaResult(
        experiment=experiment,
        values=values,
        covariance=covariance,
        least_squares=first,
        tests=tuple(found),
        separation=_separation(design, solved, values, l1),
        reduced_chi2=chi2,
        seconds=time.perf_counter() - began,
        problem=_problem(table.link_lengths, values),
    )


def _problem(link_lengths: tuple[float, float], values: np.ndarray) -> str | None:
    """Why no real arm has these inertias; None if one has."""
    try:
        ArmTable(link_lengths, *(float(f"{x:.5g}") for x in values))
    except InputError as error:
        return f"what was found is no arm's inertia (is every theta2 right?): {error}"
    return None


def check_recordings(tests: Sequence[DrivenTest]) -> None:
    """Three unknowns need three kinds of test.

    **Raises:** `InputError`, one line that says which are missing.
    """
    if not tests:
        raise InputError(
            'no recording has role = "inertia": step 1 needs the elbow driven once, and the '
            "shoulder driven at two elbow angles (theta2)"
        )
    cosines = np.array([math.cos(t.theta2) for t in tests if t.joint == 0])
    lacking = []
    if all(t.joint == 0 for t in tests):
        lacking.append("one with the elbow driven and the shoulder braked (for I2, Eq. 10)")
    if len(cosines) == 0:
        lacking.append("two with the shoulder driven, at different elbow angles (Eq. 11)")
    elif np.ptp(cosines) < _LEAST_APART:
        angles = " and ".join(f"{t.theta2:.4g}" for t in tests if t.joint == 0)
        lacking.append(
            f"one with the shoulder driven at another elbow angle: theta2 = {angles} rad "
            f"{'has' if len(cosines) == 1 else 'have'} one cosine only, and coupling shows in its "
            "change (Eq. 16)"
        )
    if lacking:
        raise InputError(f"step 1 lacks recordings: {'; and '.join(lacking)}")


def _design(test: DrivenTest, l1: float) -> np.ndarray:
    """(3,) of shoulder, elbow, coupling in the test's composite inertia (Eq. 14)."""
    if test.joint == 1:
        return np.array([0.0, 1.0, 0.0])
    return np.array([1.0, 1.0, 2 * l1 * math.cos(test.theta2)])


def _bearings(experiment: Experiment) -> np.ndarray:
    """(3,) what the air bearings add to shoulder, elbow, coupling (Eq. 5)."""
    table = experiment.inertia
    assert isinstance(table, ArmTable)
    with jax.enable_x64(True):
        bare = PlanarArm(table.link_lengths, 1.0, 1.0, 0.0)  # any arm: what is added is the same
        arm = with_bearings(bare, experiment.bearings)  # pyrefly: ignore[bad-argument-type]
        return np.array([float(x) for x in (arm.shoulder - 1, arm.elbow - 1, arm.coupling)])


def _solved(
    tests: Sequence[DrivenTest],
    rows: Sequence[Rows],
    begin: Sequence[np.ndarray],
    first: np.ndarray,
    design: np.ndarray,
    bearings: np.ndarray,
) -> list[Solved]:
    """Every test's numbers; the small part of each braked joint, from all tests together."""
    added, arm, solved = np.sum(design * bearings, axis=1), first, []
    for _ in range(_ROUNDS):
        parts = zip(tests, rows, begin, bearings, strict=True)
        solved = []
        for t, r, b, on in parts:
            with _doubts_told(t):
                solved.append(solve(t, r, b, arm - on))
        begin = [s.values for s in solved]
        before, (arm, covariance, _) = arm, _combined(design, added, solved)
        if (np.abs(arm - before) < 1e-3 * np.sqrt(np.diag(covariance))).all():
            return solved
    raise FitError(
        "the tests contradict each other: what the braked joints' give takes from the torques does "
        "not settle"
    )


@contextlib.contextmanager
def _doubts_told(test: DrivenTest) -> Iterator[None]:
    """Where a test's numbers cannot be had, also say what is doubtful in its recording."""
    try:
        yield
    except FitError as error:
        raise FitError("; ".join([str(error), *test.recording.warnings])) from None


def _combined(
    design: np.ndarray, added: np.ndarray, solved: Sequence[Solved]
) -> tuple[np.ndarray, np.ndarray, float | None]:
    """Eq. 14, weighted: (3,) values, (3, 3) covariance, chi-square per degree of freedom."""
    std = np.array([s.std[0] for s in solved])
    composite = np.array([s.values[0] for s in solved]) + added
    covariance = np.linalg.inv((design.T / std**2) @ design)
    values = covariance @ (design.T / std**2) @ composite
    free = len(solved) - 3
    chi2 = float(np.sum(((composite - design @ values) / std) ** 2) / free) if free else None
    if chi2 and chdtrc(free, free * chi2) < CALIBRATED:  # they differ by more than their errors
        covariance = covariance * chi2
    return values, covariance, chi2


def _separation(
    design: np.ndarray, solved: Sequence[Solved], values: np.ndarray, l1: float
) -> Separation:
    """Eq. 16 in numbers: what the elbow angles make of an error in the composite inertias."""
    shoulder = design[:, 0] > 0
    slope, composite = design[shoulder, 2], np.array([s.values[0] for s in solved])[shoulder]
    about = slope - np.mean(slope)
    weights = about / (about @ about)
    count, half = len(slope), len(slope) // 2
    best = 4 * l1 * math.sqrt(half * (count - half) / count)  # of |about|: as many at 0 and pi
    return Separation(
        cosines=tuple(float(x) for x in slope / (2 * l1)),
        amplification=float(np.linalg.norm(weights * composite) / max(abs(values[2]), 1e-300)),
        excess=float(np.linalg.norm(weights) * best),
    )
