"""How far a model can be trusted beyond what it was fitted to.

A residual only says how well the model bends to the readings. So two more fits, of the first two
thirds and of the first third of every recording, are let run on, and their predictions are compared
with the readings that they never saw. A right model errs there too, by the noise and by what the
noise did to its numbers; that is known, and stands beside the error as `expected`.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..fitting.result import Fit, in_noise, rms_of
from ..runtime.json import finite, number
from .linearised_fit import predictions, refitted, spread

_HORIZONS = 8
LEAST = 20  # readings of each joint to fit to


class Error(NamedTuple):
    """Errors of predictions, (n,) per joint; NaN for a joint without readings there."""

    rmse: np.ndarray
    """rad or m."""
    ratio: np.ndarray
    """In times the noise."""
    expected: np.ndarray | None
    """The ratio that a right model would leave; None where it is not known."""

    def to_dict(self, joints: Sequence[str]) -> dict[str, Any]:
        """Per joint `rmse`, `ratio` and `expected`."""
        expected = np.full(len(joints), np.nan) if self.expected is None else self.expected
        rows = zip(self.rmse, self.ratio, expected, strict=True)
        each = (dict(zip(("rmse", "ratio", "expected"), row, strict=True)) for row in rows)
        return finite(dict(zip(joints, each, strict=True)))


class HeldOut(NamedTuple):
    """Errors where nothing was fitted, beside those where it was."""

    what: str
    """"check recordings" (only their initial states were fitted), or "last third" (of each
    recording, predicted from a fit of the first two thirds)."""
    held_out: Error
    fitted: Error

    def to_dict(self, joints: Sequence[str]) -> dict[str, Any]:
        """The JSON under `held_out`."""
        each = {"joints": self.held_out.to_dict(joints), "fitted": self.fitted.to_dict(joints)}
        return {"what": self.what, **each}


@dataclass(frozen=True, eq=False)
class ModelState:
    """One model on the way, fitted by least squares."""

    added: tuple[str, ...]
    """What joined it here, effects or a law without a name; nothing for the base model."""
    fit: Fit
    held_out: HeldOut | None
    """Its errors where it was not fitted; None if they could not be had."""
    log_evidence: float
    """Nats, relative to the best model with names only."""

    @property
    def times_noise(self) -> np.ndarray:
        """(n,) rms residual over the noise, per joint, where it was fitted."""
        return self.fit.ratio

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one step."""
        joints = self.fit.joints

        def each(x: np.ndarray) -> dict[str, float | None]:
            return dict(zip(joints, map(number, x), strict=True))

        held = self.held_out
        return {
            "model": list(self.fit.model.labels),
            "rmse": each(self.fit.rmse),
            "check_rmse": None if held is None else each(held.held_out.rmse),
            "reduced_chi2": number(self.fit.reduced_chi2),
            "log_evidence": number(self.log_evidence),
        }


class Ahead(NamedTuple):
    """Errors from `start` to `stop` s after the last reading that was fitted."""

    start: float
    stop: float
    error: Error


class Horizon(NamedTuple):
    """How the error grows when the first third of each recording predicts the rest."""

    seconds: float
    """Length of the fitted third (of the longest recording), s."""
    fitted: Error
    """Within that third."""
    ahead: tuple[Ahead, ...]

    def to_dict(self, joints: Sequence[str]) -> dict[str, Any]:
        """The JSON under `horizon`."""
        rows = [
            {"start": a.start, "stop": a.stop, "joints": a.error.to_dict(joints)}
            for a in self.ahead
        ]
        return {"seconds": self.seconds, "fitted": self.fitted.to_dict(joints), "ahead": rows}


class _Run(NamedTuple):
    """A fit of the first part of each recording, run on to its end; all N instants of all. NaN is
    where nothing counts."""

    since: np.ndarray  # (N,) s since the last fitted instant; not positive where fitted
    left: np.ndarray  # (N, n) measured less predicted
    ratio: np.ndarray  # (N, n) the same in times the noise
    spread: np.ndarray  # (N, n) standard errors of the predictions, in times the noise

    def error(self, low: float, high: float) -> Error:
        """Over the instants after `low` and up to `high`."""
        chosen = (self.since > low) & (self.since <= high)
        rmse, ratio, spread = (_rms(x[chosen]) for x in (self.left, self.ratio, self.spread))
        # Within the fitted part the noise and its effect are not independent.
        return Error(rmse, ratio, np.sqrt(1 + spread**2) if low >= 0 else None)


def _rms(x: np.ndarray) -> np.ndarray:
    """(n,) of the finite ones of (N, n); NaN where there is none."""
    seen = np.isfinite(x)
    count = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
    return np.sqrt(np.where(seen, x**2, 0.0).sum(axis=0) / count)


def _run(fit: Fit, share: float) -> _Run | None:
    """Fit the first `share` of each recording and run on; None if that is not possible."""
    fitted = fit.fitted
    ends = [r.recording.time[0] + share * r.recording.duration for r in fitted]
    since = [r.recording.time - end for r, end in zip(fitted, ends, strict=True)]
    for r, s in zip(fitted, since, strict=True):
        if r.used[s <= 0].sum(axis=0).min() < LEAST:
            return None
    at, settled = refitted(fit, [s <= 0 for s in since])
    predicted, slopes = predictions(fit, at)
    if not settled or not all(np.isfinite(p).all() for p in predicted):
        return None
    weights = [r.weight * (s <= 0)[:, None] for r, s in zip(fitted, since, strict=True)]
    memories = len(fitted[0].state) - 2 * len(fit.joints)
    spreads, columns = spread(slopes, weights, len(fit.numbers), memories), []
    for r, s, p, e in zip(fitted, since, predicted, spreads, strict=True):
        left, error = (np.where(r.used, x, np.nan) for x in (r.recording.angle - p, e))
        columns.append((s, left, left / r.recording.noise, error / r.recording.noise))
    return _Run(*map(np.concatenate, zip(*columns, strict=True)))


def held_out(fit: Fit) -> HeldOut | None:
    """Errors on the check recordings, or, of an experiment without any, on the last third; None if
    their motion runs away with the fit's numbers, or the fit of the rest did not settle."""
    if fit.experiment.check_recordings and not fit.held_out:
        return None
    if fit.held_out:
        each = (Error(rms_of(x), rms_of(x, in_noise), None) for x in (fit.held_out, fit.fitted))
        return HeldOut("check recordings", *each)
    run = _run(fit, 2 / 3)
    if run is None:
        return None
    return HeldOut("last third", run.error(0.0, np.inf), run.error(-np.inf, 0.0))


def horizon(fit: Fit) -> Horizon | None:
    """Growth of the error after the first third; None if its fit did not settle."""
    run = _run(fit, 1 / 3)
    if run is None:
        return None
    edges = np.linspace(0.0, run.since.max(), _HORIZONS + 1).tolist()
    rows = [Ahead(a, b, run.error(a, b)) for a, b in itertools.pairwise(edges)]
    seconds = max(r.recording.duration for r in fit.fitted) / 3
    return Horizon(seconds, run.error(-np.inf, 0.0), tuple(rows))
