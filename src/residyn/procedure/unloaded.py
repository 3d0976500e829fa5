"""What step 3 returns: modes with and without the bearings, and how the prediction did."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..fitting import Fit, Mode, RecordingFit
from ..fitting.result import rms_of
from ..physics.model import Model
from ..runtime.json import finite
from ..runtime.presentation import Result
from ..simulation.interpolation import Trajectory
from .carried import NAMES, Carried, inertias
from .over_models import OverModels
from .result import InertiaResult
from .ringdown import DRAWS, RingDown, ring_down

_DECAYS = 3.0  # decay times of the slowest mode that a picture shows
_CYCLES = 25  # but no more cycles than this, or its lines run together
_POINTS = 14  # of a cycle
_MOST = 500  # but no more of a mode than this
_NORMAL = 1.96  # standard errors on each side of a 95 % interval


class Decay(NamedTuple):
    """Time to 1/e (s), which is 1 / (2 pi f zeta), and its 95 % interval; `high` is inf where the
    interval of the rate holds zero, `low` and `high` are NaN where the recordings leave the damping
    open."""

    value: float
    low: float
    high: float


def decay_of(mode: Mode) -> Decay | None:
    """When a mode has fallen to 1/e; None for one that grows. An arm that nothing drives loses
    energy: that a mode grows is said of the fit, or of what the recordings leave open.

    The relative errors of frequency and damping ratio are added: the most that any correlation of
    the two makes of them.
    """
    rate = 2 * math.pi * mode.frequency_hz * mode.damping_ratio
    if not rate > 0:
        return None
    share = mode.frequency_hz_std / mode.frequency_hz + mode.damping_ratio_std / mode.damping_ratio
    if not math.isfinite(share):
        return Decay(1 / rate, math.nan, math.nan)
    least = rate * (1 - _NORMAL * share)
    high = 1 / least if least > 0 else math.inf
    return Decay(1 / rate, 1 / (rate * (1 + _NORMAL * share)), high)


@dataclass(frozen=True, eq=False)
class Pose:
    """One elbow angle of the fitted recordings: the arm there, on its bearings and in orbit."""

    theta2: float
    """Elbow angle at rest, rad."""
    model: Model
    """As fitted, bearings on."""
    unloaded: Model
    """Eq. 18: the bearings off, and every effect of theirs."""
    with_bearings: tuple[Mode, ...]
    """The modes that ring, lowest first."""
    without_bearings: tuple[Mode, ...]
    leaves_with: bool = False
    """Whether the model on its bearings moves away from its rest: a stiffness is negative."""
    leaves_without: bool = False

    @property
    def physical(self) -> bool:
        """Whether all of its modes are an arm's: none grows, and none moves away from rest."""
        modes = (*self.with_bearings, *self.without_bearings)
        leaves = self.leaves_with or self.leaves_without
        return not leaves and all(decay_of(mode) for mode in modes)


@dataclass(frozen=True, eq=False)
class BareCheck:
    """A recording without bearings, which was not fitted, beside what step 3 predicts of it.

    Errors are of the lowest mode, predicted / measured - 1, where measured is a fit of that
    recording alone, with the joints' own effects of the same model; None if that fit failed.
    """

    beside: RecordingFit
    predicted: tuple[Mode, ...]
    free: Fit | None

    @property
    def name(self) -> str:
        """The recording's."""
        return self.beside.recording.name

    @property
    def rmse(self) -> np.ndarray:
        """(n,) rms of measured minus predicted; of the recording only its initial state was
        fitted."""
        return rms_of([self.beside])

    @property
    def measured(self) -> tuple[Mode, ...]:
        """Modes of the fit of this recording alone."""
        return self.free.modes if self.free else ()

    @property
    def frequency_error(self) -> float | None:
        """Of the lowest natural frequency, as a share of the measured one."""
        return self._error("frequency_hz")

    @property
    def damping_error(self) -> float | None:
        """Of the lowest mode's damping ratio, as a share of the measured one."""
        return self._error("damping_ratio")

    def _error(self, what: str) -> float | None:
        if not (self.predicted and self.measured):
            return None
        measured = getattr(self.measured[0], what)
        return getattr(self.predicted[0], what) / measured - 1 if measured else None


@dataclass(frozen=True, eq=False)
class Unloading(Result, about="unload"):
    """Step 3. Print it; or `to_dict()` for the JSON.

    `poses` has the elbow angles of the fitted recordings, in their order; `with_bearings`,
    `without_bearings` and `ring_down` are about the first.
    """

    fit: Fit
    poses: tuple[Pose, ...]
    left_out: tuple[str, ...]  # effects that left with the bearings
    check: tuple[BareCheck, ...]
    inertia_covariance: np.ndarray | None  # (3, 3) from step 1; None: taken for exact
    errors: Carried  # what the numbers and the inertias do not know
    step_1: InertiaResult | str | None
    """Step 1 from the experiment's own driven tests, or why it cannot be done; None without any, or
    where its covariance was given."""
    seconds: float
    over_models: OverModels | None = None
    """The same over all models of a diagnosis, if there was one."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to bear in mind, beside the fit's own warnings; modes that no arm has first."""
        return self._presented("warnings")

    @property
    def unphysical(self) -> tuple[str, ...]:
        """Of the warnings, those of modes that no arm has."""
        return self._presented("unphysical")

    @property
    def physical(self) -> bool:
        """Whether every frequency, damping ratio and decay time is an arm's."""
        return all(pose.physical for pose in self.poses)

    @property
    def with_bearings(self) -> tuple[Mode, ...]:
        """Modes as recorded, lowest first."""
        return self.poses[0].with_bearings

    @property
    def without_bearings(self) -> tuple[Mode, ...]:
        """Modes in orbit (Eq. 18), lowest first."""
        return self.poses[0].without_bearings

    @property
    def model(self) -> Model:
        """The fitted model, bearings on."""
        return self.poses[0].model

    @property
    def unloaded(self) -> Model:
        """The model in orbit."""
        return self.poses[0].unloaded

    def ring_down(self, times: np.ndarray) -> tuple[Trajectory, Trajectory]:
        """How the arm rings at `times` (N,) s with and without bearings, let go at rest from the
        angles in which the first fitted recording begins."""
        on, off = self.ring_downs(times, draws=0)
        return on.path, off.path

    def ring_downs(
        self, times: np.ndarray | None = None, *, draws: int = DRAWS
    ) -> tuple[RingDown, RingDown]:
        """The same with the band of 95 %, from so many `draws` of the numbers and inertias; without
        `times`, until the slowest mode has fallen to 5 %, or for 25 of its cycles."""
        with jax.enable_x64(True):
            q0 = jnp.asarray(self.fit.recordings[0].state[: len(self.fit.joints)])
            times = self._times() if times is None else np.asarray(times, float)
            told = self.fit.model, self.errors, times, q0, draws
            on, off = (ring_down(m, *told) for m in (self.model, self.unloaded))
            return on, off

    def _times(self) -> np.ndarray:
        modes = (*self.with_bearings, *self.without_bearings)
        time = self.fit.recordings[0].recording.time
        if not modes:
            return np.linspace(0.0, time[-1] - time[0], 1000)
        decays = [decay_of(mode) for mode in modes]
        spans = [_DECAYS * d.value if d else np.inf for d in decays]
        end = min(_CYCLES / min(m.frequency_hz for m in modes), max(spans))
        each = [np.linspace(0.0, end, 100)]
        # As dense as each mode is fast, while it lasts.
        for mode, span in zip(modes, np.minimum(spans, end), strict=True):
            points = min(_MOST, int(_POINTS * span * mode.frequency_hz) + 2)
            each.append(np.linspace(0.0, span, points))
        return np.unique(np.concatenate(each))

    def to_dict(self) -> dict[str, Any]:
        """The JSON of `residyn unload`."""
        fit = self.fit.to_dict()
        return {
            "model": fit["model"],
            "left_out": list(self.left_out),
            "parameters": fit["parameters"],
            "reduced_chi2": fit["reduced_chi2"],
            "with_bearings": _side(self.poses[0], self.model, self.with_bearings),
            "without_bearings": _side(self.poses[0], self.unloaded, self.without_bearings),
            "poses": [
                {
                    "theta2": p.theta2,
                    "with_bearings": _told(p.with_bearings),
                    "without_bearings": _told(p.without_bearings),
                    "physical": p.physical,
                }
                for p in self.poses
            ],
            "check": [
                {
                    "recording": c.name,
                    "theta2": c.beside.recording.theta2,
                    "rmse": dict(zip(self.fit.joints, map(float, c.rmse), strict=True)),
                    "frequency_error": c.frequency_error,
                    "damping_error": c.damping_error,
                    "predicted": {"modes": _modes(c.predicted)},
                    "measured": {"modes": _modes(c.measured)},
                }
                for c in self.check
            ],
            "inertia_std": None
            if self.inertia_covariance is None
            else dict(zip(NAMES, np.sqrt(np.diag(self.inertia_covariance)).tolist(), strict=True)),
            "physical": self.physical,
            "over_models": None if self.over_models is None else self.over_models.to_dict(),
            "seconds": self.seconds,
            "warnings": [*self.fit.warnings, *self.warnings],
        }


def _side(pose: Pose, model: Model, modes: tuple[Mode, ...]) -> dict[str, Any]:
    arm = zip(NAMES, np.asarray(inertias(model.mechanism)).tolist(), strict=True)
    return {"theta2": pose.theta2, **_told(modes), "arm": dict(arm)}


def _told(modes: tuple[Mode, ...]) -> dict[str, Any]:
    """Modes, and when each has fallen to 1/e (s; None: it does not, or the number is not known)."""
    decays = [decay_of(mode) for mode in modes]
    times = [found and finite(found._asdict()) for found in decays]
    return {"modes": _modes(modes), "decay_time_s": times}


def _modes(modes: tuple[Mode, ...]) -> list[dict[str, float | None]]:
    """As in the JSON of `fit`."""
    return [finite(vars(mode)) for mode in modes]
