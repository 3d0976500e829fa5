"""A fit in a sentence: how far the model is from the motion, in units that mean something.

The unit is the noise of one reading: a model that leaves as much as the noise has explained all
that the recording can show, and one that leaves ten times as much has not, however well the curves
seem to lie on each other.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..fitting.result import Fit, RecordingFit
from .numbers import plain, ratio

EXPLAINED = 1.2
"""Reduced chi-square up to which what is left counts as noise."""
_OVERSTATED = 0.8


class JointError(NamedTuple):
    """Errors at one joint, rad or m; `check` and `check_noise` None without held-out recordings."""

    joint: str
    unit: str | None
    rmse: float
    noise: float
    motion: float
    check: float | None
    check_noise: float | None

    @property
    def ratio(self) -> float:
        """Error in units of the noise."""
        return self.rmse / self.noise

    @property
    def check_ratio(self) -> float | None:
        """Held-out error in units of the noise."""
        if self.check is None or self.check_noise is None:
            return None
        return self.check / self.check_noise

    @property
    def share(self) -> float:
        """Error as a share of the rms motion."""
        return self.rmse / self.motion if self.motion > 0 else float("nan")


def joint_errors(fit: Fit) -> list[JointError]:
    """The errors of a fit, joint by joint."""
    fitted = [r for r in fit.whole if r.recording.role != "check"]
    held_out = [r for r in fit.whole if r.recording.role == "check"]
    noise, motion = _noise(fitted), _motion(fitted)
    check, check_noise = fit.check_rmse, _noise(held_out) if held_out else None
    return [
        JointError(
            joint=joint,
            unit=fit.experiment.units[i] if fit.experiment.units else None,
            rmse=float(fit.rmse[i]),
            noise=float(noise[i]),
            motion=float(motion[i]),
            check=None if check is None else float(check[i]),
            check_noise=None if check_noise is None else float(check_noise[i]),
        )
        for i, joint in enumerate(fit.experiment.joints)
    ]


def _noise(fits: Sequence[RecordingFit]) -> np.ndarray:
    return np.sqrt(np.mean([np.square(f.recording.noise) for f in fits], axis=0))


def _motion(fits: Sequence[RecordingFit]) -> np.ndarray:
    parts = []
    for f in fits:
        angle = np.where(f.used, f.recording.angle, np.nan)
        parts.append(angle - np.nanmean(angle, axis=0))
    return np.sqrt(np.nanmean(np.concatenate(parts) ** 2, axis=0))


def verdict(fit: Fit) -> str:
    """How good the fit is, in a sentence or two."""
    errors = joint_errors(fit)
    if explained(fit):
        words = f"The model explains the motion down to the noise: it leaves {_each(errors)}."
    else:
        words = f"The model misses something: it leaves {_each(errors, shares=True)}."
    held_out = [e.check_ratio for e in errors if e.check_ratio is not None]
    if held_out:
        ratios = _listed([ratio(r) for r in held_out])
        words += f" On the held-out recordings, which it was not fitted to: {ratios} times."
    return words


def explained(fit: Fit) -> bool:
    """Whether what is left is no larger than the noise."""
    return bool(fit.reduced_chi2 <= EXPLAINED)


def chi2_words(chi2: float) -> str:
    """What a reduced chi-square says."""
    if not np.isfinite(chi2):
        return "it could not be computed"
    if chi2 < _OVERSTATED:
        return "less is left than the stated noise would leave: the noise is overstated"
    if chi2 <= EXPLAINED:
        return "what is left is as large as the noise alone would leave"
    if chi2 <= 2:
        return "a little more is left than the noise alone would leave"
    return "much more is left than the noise alone would leave: something is missing in the model"


def _each(errors: Sequence[JointError], shares: bool = False) -> str:
    words = []
    for error in errors:
        noise, motion = ("", "") if words else (" the noise", " of the motion")
        part = f"{ratio(error.ratio)} times{noise} at the {error.joint}"
        if shares:
            part += f" ({plain(100 * error.share, 2)} %{motion})"
        words.append(part)
    return _listed(words)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
