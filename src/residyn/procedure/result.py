"""What step 1 returns: inertias with errors, each test's numbers, and an `[arm]` table."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..diagnosis.result import Value
from ..fitting import FitError
from ..recordings.experiment import Experiment
from ..recordings.tables import ArmTable
from ..runtime.json import number
from ..runtime.presentation import Result
from .carried import NAMES
from .driven import DrivenTest
from .weak import Solved

UNITS = ("kg m^2", "kg m^2", "kg m")
FRICTION = {"coulomb_friction": "N m", "viscous_friction": "N m s/rad", "offset": "N m"}
"""What a test finds beside an inertia, and the units."""


class Separation(NamedTuple):
    """Eq. 16: whether the elbow angles of the shoulder's tests are far enough apart."""

    cosines: tuple[float, ...]
    """Of the elbow's angle in each test with the shoulder driven."""
    amplification: float
    """Relative error of coupling for one relative error in all composite inertias."""
    excess: float
    """Error of coupling for one error in all composite inertias, in units of what as many tests at
    0 and pi, the best that there are, would make of it; 2 / span for two tests."""

    @property
    def span(self) -> float:
        """Between the cosines; 2 is all there is."""
        return max(self.cosines) - min(self.cosines)


@dataclass(frozen=True, eq=False)
class TestResult:
    """One driven test: Eq. 10 or 11 solved.

    `least_squares` are the inertia (kg m^2), Coulomb (N m) and viscous friction (N m s/rad) of Eq.
    12 and 13 as they stand.
    """

    __test__ = False  # no test of pytest's

    test: DrivenTest
    solved: Solved
    least_squares: tuple[Value, ...]

    @property
    def name(self) -> str:
        """The recording's."""
        return self.test.name

    @property
    def inertia(self) -> Value:
        """Composite inertia of what turns, kg m^2, as it was recorded."""
        return Value(float(self.solved.values[0]), float(self.solved.std[0]), "kg m^2")

    @property
    def friction(self) -> dict[str, Value | None]:
        """Coulomb (N m), viscous (N m s/rad) and offset (N m); None if it could not be told apart
        from Coulomb friction, as the joint slid one way only."""
        own = self.solved.values[1:].tolist(), self.solved.std[1:].tolist()
        numbers = map(Value, *own, FRICTION.values())
        return dict(zip(FRICTION, [*numbers, None][:3], strict=True))

    def to_dict(self, joints: tuple[str, ...]) -> dict[str, Any]:
        """As in the JSON."""
        ordinary = zip(("composite_inertia", *FRICTION), self.least_squares, strict=False)
        return {
            "recording": self.name,
            "joint": joints[self.test.joint],
            "theta2": self.test.theta2,
            "composite_inertia": self.inertia.to_dict(),
            **{name: n and n.to_dict() for name, n in self.friction.items()},
            "torque_noise": self.test.torque_noise,
            "reduced_chi2": number(self.solved.chi2),
            "least_squares": {name: n.to_dict() for name, n in ordinary},
        }


@dataclass(frozen=True, eq=False)
class InertiaResult(Result, about="inertia"):
    """The arm's inertias, bearings on. Print it; or `to_dict()` for the JSON."""

    experiment: Experiment
    values: np.ndarray  # (3,) shoulder and elbow in kg m^2, coupling in kg m
    covariance: np.ndarray  # (3, 3) of these
    least_squares: np.ndarray  # (3,) by Eq. 12 to 15 as they stand
    tests: tuple[TestResult, ...]
    separation: Separation
    reduced_chi2: float | None  # of more tests than unknowns; None for three
    seconds: float
    problem: str | None = None  # why no arm has these inertias

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a careful person would want to be told, one line each."""
        return self._presented("warnings")

    @property
    def std(self) -> np.ndarray:
        """(3,) standard errors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def shoulder(self) -> Value:
        """I1 + m2 l1^2, kg m^2."""
        return self._number(0)

    @property
    def elbow(self) -> Value:
        """I2 about the elbow, kg m^2."""
        return self._number(1)

    @property
    def coupling(self) -> Value:
        """m2 rho2, kg m."""
        return self._number(2)

    def _number(self, i: int) -> Value:
        return Value(float(self.values[i]), float(self.std[i]), UNITS[i])

    @property
    def link_lengths(self) -> tuple[float, float]:
        """l1, l2 in m, as given."""
        assert isinstance(self.experiment.inertia, ArmTable)
        return self.experiment.inertia.link_lengths

    def composite(self, theta2: float = 0.0) -> Value:
        """I1 + I2 + m2 l1^2 + 2 m2 l1 rho2 cos(theta2): what the shoulder turns, kg m^2."""
        row = np.array([1.0, 1.0, 2 * self.link_lengths[0] * np.cos(theta2)])
        std = float(np.sqrt(row @ self.covariance @ row))
        return Value(float(row @ self.values), std, "kg m^2")

    @property
    def arm(self) -> ArmTable:
        """The `[arm]` that was found, for an `Experiment` of step 2.

        **Raises:** `FitError` if no real arm has these inertias.
        """
        if self.problem:
            raise FitError(self.problem)
        return ArmTable(self.link_lengths, *(float(x) for x in self.values))

    def to_toml(self) -> str:
        """The `[arm]` table, as the other commands read it."""
        return self._presented("toml")

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn inertia`."""
        ordinary = zip(NAMES, UNITS, self.least_squares.tolist(), strict=True)
        apart = self.separation
        return {
            **{name: self._number(i).to_dict() for i, name in enumerate(NAMES)},
            "tests": [t.to_dict(self.experiment.joints) for t in self.tests],
            "covariance": self.covariance.tolist(),
            "least_squares": {n: {"value": number(x), "unit": unit} for n, unit, x in ordinary},
            "separation": {
                "cosines": list(apart.cosines),
                "span": apart.span,
                "amplification": number(apart.amplification),
                "excess": apart.excess,
            },
            "reduced_chi2": None if self.reduced_chi2 is None else number(self.reduced_chi2),
            "seconds": self.seconds,
            "warnings": list(self.warnings),
        }
