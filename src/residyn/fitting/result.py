"""What a fit returns: values with errors, in the units of the parameters' declarations, what the
data cannot determine, which readings were set aside, how many starts agreed and why the search
stopped. What is said of all this is in `residyn.reporting.fit`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc

from ..errors import extra, quote
from ..physics.effect import BASE
from ..physics.model import Model
from ..recordings.experiment import Experiment
from ..recordings.recording import Recording
from ..recordings.segments import by_recording
from ..runtime.json import finite, number
from ..runtime.presentation import TableResult
from .history import History
from .linalg import Spread
from .problem import Problem, Ready, Unknowns

STRONG = 0.9
"""Correlations beyond this are named."""
STRUCTURE = 1.2
"""Reduced chi-square beyond which the residual is more than noise."""
NEGATIVE = 2.0
"""Standard errors below zero that make a sign more than chance."""


class FitError(RuntimeError):
    """The numbers could not be had: one line that says why."""


@dataclass(frozen=True)
class Number:
    """One fitted number. `std`, which grows with the residual, is inf where the data cannot
    determine it; `acts` tells whether it enters an equation of the mechanism."""

    name: str
    words: str
    value: float
    std: float
    start: float
    unit: str
    sign: str
    determined: bool
    acts: bool = True

    @property
    def negative(self) -> bool:
        """Whether it is below zero beyond its error, and physics allows no such value."""
        return self.sign == "positive" and -self.value > NEGATIVE * self.std

    @property
    def percent(self) -> float:
        """Standard error in % of the value."""
        return 100 * self.std / abs(self.value) if self.value else float("inf")


@dataclass(frozen=True)
class Mode:
    """One mode of the linearised model: natural frequency (Hz), damping ratio, their errors."""

    frequency_hz: float
    frequency_hz_std: float
    damping_ratio: float
    damping_ratio_std: float

    @property
    def grows(self) -> bool:
        """Whether its damping is negative beyond its error, which no braked arm's is."""
        return -self.damping_ratio > NEGATIVE * self.damping_ratio_std


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """One recording beside the model: arrays (N, n) in the units of its readings."""

    recording: Recording
    predicted: np.ndarray
    wild: np.ndarray  # readings set aside as wild
    state: np.ndarray  # fitted (q0, v0, z0)

    @property
    def residual(self) -> np.ndarray:
        """Measured minus predicted; NaN where the sample was lost."""
        return self.recording.angle - self.predicted

    @property
    def used(self) -> np.ndarray:
        """Readings that count."""
        return np.isfinite(self.recording.angle) & ~self.wild

    @property
    def left(self) -> np.ndarray:
        """`residual`, 0 where nothing counts."""
        return np.where(self.used, self.residual, 0.0)

    @property
    def weight(self) -> np.ndarray:
        """1/sigma of each reading, 0 where it does not count."""
        return np.where(self.used, 1.0 / self.recording.noise, 0.0)

    @property
    def rmse(self) -> np.ndarray:
        """(n,) rms residual; NaN at a joint without readings."""
        return rms_of([self])

    @property
    def ratio(self) -> np.ndarray:
        """(n,) rms of residual / noise."""
        return rms_of([self], in_noise)


@dataclass(frozen=True, eq=False)
class Fit(TableResult, about="fit"):
    """A fitted model beside its recordings. Print it; `to_dict()` is the JSON, `to_latex()` and
    `to_csv()` are tables for a paper."""

    experiment: Experiment
    model: Model
    numbers: tuple[Number, ...]
    spread: Spread
    """How well the numbers are determined: also what the data say of undetermined ones together."""
    recordings: tuple[RecordingFit, ...]  # fitted ones, then held-out ones
    reduced_chi2: float
    modes: tuple[Mode, ...]
    starts: int
    agreeing_starts: int
    converged: bool
    reason: str
    steps: int
    seconds: float
    ready: Ready
    """The model on the bodies of each fitted recording, and the resolution of its motion."""
    problem: Problem
    """The least-squares problem that was solved, in float64."""
    unknowns: Unknowns
    """Its minimum."""
    infinite_slopes: tuple[str, ...] = ()
    """Effects with an infinite slope at rest, where there are no modes then."""
    integration_error: float = float("nan")
    """Of the predicted readings, in times the noise: see `fitting.integration`."""
    integration_steps: int = 0
    integration_checked: tuple[float, str] | None = None
    """The same against a reference, and its name, if that was asked for."""
    shortened: tuple[int, float] | None = None
    """The usual number of integration steps and their error, if the fit went on with more."""
    short_of_minimum: tuple[str, float] | None = None
    """The number that is farthest from its least-squares value, and by how many standard errors,
    where a search ended short of the minimum."""
    history: History | None = None  # of a search on Eq. 17: how that fell
    needed: tuple[str, ...] = ()
    """Those of `unseen` without which chi-square rises by more than chance: that they act is seen,
    by what they remember or by strength and shape together, but not how strong they are."""
    coloured_noise: bool = False
    """Whether a diagnosis has found that the residual is noise, and that this is not white."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a careful person would want to be told, one line each."""
        return self._presented("warnings")

    @property
    def whole(self) -> tuple[RecordingFit, ...]:
        """`recordings`, with segments of one recording put together again: what one draws."""
        found = []
        for recording, which in by_recording([r.recording for r in self.recordings]):
            parts = [self.recordings[i] for i in which]
            predicted = np.concatenate([p.predicted for p in parts])
            wild = np.concatenate([p.wild for p in parts])
            found.append(RecordingFit(recording, predicted, wild, parts[0].state))
        return tuple(found)

    @property
    def fitted(self) -> tuple[RecordingFit, ...]:
        """Those of `recordings` that the numbers were fitted to."""
        return tuple(r for r in self.recordings if r.recording.role != "check")

    @property
    def held_out(self) -> tuple[RecordingFit, ...]:
        """The others."""
        return tuple(r for r in self.recordings if r.recording.role == "check")

    @property
    def posed_as(self) -> Recording:
        """The fitted recording whose bodies, pose and own numbers `modes` and `model` have."""
        return by_recording([r.recording for r in self.fitted])[0][0]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.experiment.joints

    @property
    def units(self) -> tuple[str, ...]:
        """Of the readings: rad, m/s, ..., "" where it is not known."""
        return self.experiment.reading_units

    @property
    def covariance(self) -> np.ndarray:
        """(P, P) of the numbers, NaN where undetermined."""
        known = np.isfinite(self.spread.std)
        return np.where(known & known[:, None], self.spread.covariance, np.nan)

    @property
    def open_groups(self) -> tuple[tuple[int, ...], ...]:
        """Indices of numbers of which the data determine only combinations, or, alone, nothing."""
        return self.spread.groups

    @property
    def own_numbers(self) -> tuple[Number, ...]:
        """Those of `numbers` that enter an equation of the mechanism."""
        return tuple(n for n in self.numbers if n.acts)

    @property
    def correlation(self) -> np.ndarray:
        """(P, P) correlations of the numbers."""
        covariance = self.covariance
        spread = np.sqrt(np.diag(covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            return covariance / spread / spread[:, None]

    @property
    def unseen(self) -> tuple[str, ...]:
        """Effects whose strengths are together within two standard errors of none, and which have a
        shape (a gap, a frequency): where nothing acts no shape can be told (Davies, Biometrika 64,
        1977). Of several strengths the data may see a sum only: that one counts then."""
        found, each = [], list(enumerate(zip(self.numbers, self.model.fitted, strict=True)))
        for index, effect in enumerate(self.model.effects):
            own = [(i, n, m.meaning.silent) for i, (n, m) in each if m.effect == index]
            strengths = [(i, n.value - silent) for i, n, silent in own if silent is not None]
            if not 0 < len(strengths) < len(own):
                continue
            which, off = zip(*strengths, strict=True)
            square, ways = self.spread.distance(np.array(off), which)
            if not ways or by_chance(square, ways):
                found.append(effect.label)
        return tuple(found)

    @property
    def stands(self) -> bool:
        """Whether the numbers can be had: the search settled, or did not only along the shape of an
        effect that is not seen, with a residual that is noise."""
        return self.converged or (bool(self.unseen) and not self.misses)

    @property
    def misses(self) -> bool:
        """Whether the residual is more than noise: noise that is not white may be larger than what
        the differences of neighbouring readings say."""
        return self.reduced_chi2 > STRUCTURE and not self.coloured_noise

    @property
    def unphysical(self) -> tuple[Number, ...]:
        """Stiffness and damping of springs and dampers that are negative beyond their error: a base
        model that no braked arm has."""
        return tuple(n for n in self.numbers if n.name.partition(":")[0] in BASE and n.negative)

    @property
    def rmse(self) -> np.ndarray:
        """(n,) rms residual of the fitted recordings per joint, wild readings apart."""
        return rms_of(self.fitted)

    @property
    def check_rmse(self) -> np.ndarray | None:
        """(n,) rms residual of the held-out recordings; None if there are none."""
        return rms_of(self.held_out) if self.held_out else None

    @property
    def ratio(self) -> np.ndarray:
        """(n,) rms of residual / noise over the readings of the fitted recordings."""
        return rms_of(self.fitted, in_noise)

    @property
    def check_ratio(self) -> np.ndarray | None:
        """(n,) the same of the held-out recordings; None if there are none."""
        return rms_of(self.held_out, in_noise) if self.held_out else None

    @property
    def objective(self) -> float:
        """Eq. 17 over the fitted recordings: |predicted - measured| / |measured| of every joint's
        series of readings, one recording after the other, summed over the joints."""
        angles = [np.where(r.used, r.recording.angle, 0.0) for r in self.fitted]
        size = sum((x**2).sum(axis=0) for x in angles)
        off = sum((r.left**2).sum(axis=0) for r in self.fitted)
        return float(np.sum(np.sqrt(off / np.where(size > 0, size, 1.0))))

    @property
    def noise(self) -> np.ndarray:
        """(n,) standard deviation of one reading, rms over those of the fitted recordings."""
        return rms_of(self.fitted, lambda r: np.where(r.used, r.recording.noise, 0.0))

    @property
    def integrator(self) -> str:
        """The name of what integrated."""
        chosen = self.experiment.integrator
        return "fixed" if chosen is None else chosen.name

    def strong_correlations(self) -> list[tuple[str, str, float]]:
        """Pairs of numbers that this data hardly tells apart."""
        names, r = [n.name for n in self.numbers], self.correlation
        pairs = np.argwhere(np.triu(np.abs(r) > STRONG, 1))
        found = [(names[i], names[j], float(r[i, j])) for i, j in pairs]
        return sorted(found, key=lambda row: -abs(row[2]))

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn fit`."""
        per_joint = lambda x: dict(zip(self.joints, map(number, x), strict=True))  # noqa: E731
        return {
            "model": list(self.model.labels),
            "parameters": {
                n.name: {"value": number(n.value), "std": number(n.std), "unit": n.unit}
                for n in self.own_numbers
            },
            "rmse": per_joint(self.rmse),
            "noise": per_joint(self.noise),
            "ratio": per_joint(self.ratio),
            "reduced_chi2": number(self.reduced_chi2),
            "check_rmse": None if self.check_rmse is None else per_joint(self.check_rmse),
            "recordings": [
                {
                    "name": r.recording.name,
                    "role": r.recording.role,
                    "readings": int(r.used.sum()),
                    "rmse": per_joint(r.rmse),
                    "ratio": per_joint(r.ratio),
                }
                for r in self.whole
            ],
            "modes": [finite(vars(m)) for m in self.modes],
            "modes_of": {
                "recording": self.posed_as.name,
                "theta2": self.posed_as.theta2,
                "air_bearings": self.posed_as.air_bearings,
                "extra_mass": self.posed_as.extra_mass,
                "load": self.posed_as.load,
            },
            "objective": number(self.objective),
            "integrator": self.integrator,
            "integration_error": number(self.integration_error),
            "integration_error_checked": (
                None if self.integration_checked is None else number(self.integration_checked[0])
            ),
            "starts": self.starts,
            "agreeing_starts": self.agreeing_starts,
            "converged": self.converged,
            "stands": self.stands,
            "unphysical": [n.name for n in self.unphysical],
            "seconds": number(self.seconds),
            "warnings": list(self.warnings),
        }

    def to_arviz(self, draws: int = 1000, seed: int = 0) -> Any:
        """Draws from the Gaussian of values and covariance, as ArviZ reads them (extra `bayes`):
        one chain; numbers that the data cannot determine are left out.

        **Raises:** `MissingExtra` without ArviZ; `ValueError` if nothing is determined.
        """
        arviz = extra("arviz", "to_arviz needs ArviZ: pip install 'residyn[bayes]'")
        drawn = gaussian(self.numbers, self.covariance, draws, seed)
        posterior = {name: x[None] for name, x in drawn.items()}
        if int(arviz.__version__.partition(".")[0]) < 1:
            return arviz.from_dict(posterior=posterior)
        return arviz.from_dict({"posterior": posterior})


def gaussian(
    numbers: Sequence[Number], covariance: np.ndarray, draws: int, seed: int
) -> dict[str, np.ndarray]:
    """(draws,) of each number that the data determines, by name, for tools that read posteriors.

    Near the minimum chi-square is a parabola, so that with flat priors the posterior is the
    Gaussian of the fit's values and covariance (Laplace's approximation). A number whose error is
    not far below its size can leave the sign that physics allows; then sample `Embedded.chi2`
    instead.

    **Arguments:** `numbers` (P,) and `covariance` (P, P) of a `Fit`.

    **Raises:** `ValueError` if it determines none, or for less than one draw.
    """
    if draws < 1:
        raise ValueError(f"draws = {draws}: at least one is needed")
    known = [i for i, n in enumerate(numbers) if n.determined]
    if not known:
        raise ValueError("the data determines none of the numbers: there is nothing to draw from")
    centre = np.array([numbers[i].value for i in known])
    std = np.array([numbers[i].std for i in known])
    # As correlations: numbers of unlike units differ by many powers of ten.
    correlation = covariance[np.ix_(known, known)] / std / std[:, None]
    random = np.random.default_rng(seed)
    unit = random.multivariate_normal(np.zeros(len(known)), correlation, draws, method="eigh")
    return {
        numbers[i].name: c + s * u for i, c, s, u in zip(known, centre, std, unit.T, strict=True)
    }


def by_chance(square: float, ways: int) -> bool:
    """Whether a chi-square with so many degrees of freedom is as probable by chance as one number
    within its errors."""
    return bool(chdtrc(ways, square) > chdtrc(1, NEGATIVE**2))


def must_be_fit(given: Any) -> None:
    """**Raises:** `TypeError` for what is no fit, such as an experiment."""
    if not isinstance(given, Fit):
        raise TypeError(f"{quote(given)} is no fit: residyn.fit makes one of an experiment")


def rms_of(
    fits: Sequence[RecordingFit],
    what: Callable[[RecordingFit], np.ndarray] = lambda fit: fit.left,
) -> np.ndarray:
    """(n,) rms residual of the readings that count, or rms of `what` (N, n), 0 elsewhere."""
    total = sum((what(f) ** 2).sum(axis=0) for f in fits)
    count = sum(f.used.sum(axis=0) for f in fits)
    return np.sqrt(total / np.where(count, count, np.nan))


def in_noise(fit: RecordingFit) -> np.ndarray:
    """(N, n) residual in times the noise, 0 where nothing counts: `what` of `rms_of`."""
    return fit.weight * fit.left
