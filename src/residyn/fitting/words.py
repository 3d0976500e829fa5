"""What a careful person would want to be told about a fit, one line each."""

from collections.abc import Sequence

import numpy as np

from .covariance import in_words
from .integration import TENTH
from .result import NEGATIVE, Fit, RecordingFit

_SMALL = 0.85  # and below which the noise must have been overstated
_STILL = 2.0  # times the noise: a joint that moves less than this hardly moves
_NAMED = 3  # wild readings whose times are given


def warnings_for(fit: Fit, open_groups: Sequence[tuple[int, ...]]) -> tuple[str, ...]:
    """All warnings of a fit: the recordings' own, then the fit's."""
    return (
        *_unphysical(fit),
        *fit.experiment.warnings,
        *in_words(fit.model, open_groups),
        *_still(fit),
        *_wild(fit.recordings),
        *_signs(fit),
        *_misfit(fit),
        *_integration(fit),
        *_search(fit),
    )


def _still(fit: Fit) -> list[str]:
    fitted = [r for r in fit.recordings if r.recording.role != "check"]
    moved = np.max([np.nanstd(r.recording.angle, axis=0) for r in fitted], axis=0)
    return [
        f"{joint} hardly moves (rms no more than {_STILL:g} times the noise): "
        "these recordings say little about its numbers, whatever their errors"
        for joint, size, noise in zip(fit.joints, moved, fit.noise, strict=True)
        if size < _STILL * noise
    ]


def _wild(recordings: Sequence[RecordingFit]) -> list[str]:
    said = []
    for beside in recordings:
        rows = np.flatnonzero(beside.wild.any(axis=1))
        if len(rows):
            times = ", ".join(f"{beside.recording.time[i]:.6g}" for i in rows[:_NAMED])
            more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
            count = int(beside.wild.sum())
            said.append(
                f"{beside.recording.name}: {count} wild reading{'s' * (count > 1)} set aside "
                f"(at {times} s{more})"
            )
    return said


def _unphysical(fit: Fit) -> list[str]:
    """Said first: whatever else is read from such a fit rests on a base that no arm has."""
    return [
        f"{n.name} = {n.value:.3g} +/- {n.std:.2g} {n.unit} is negative beyond its error, which no "
        "braked arm has: the recordings are not of an arm that rings down, an input is wrong "
        "(inertia, the order or sign of the angles, their rest), or the model lacks an effect"
        for n in fit.unphysical
    ]


def _signs(fit: Fit) -> list[str]:
    said, sure = [], {n.name for n in fit.unphysical}
    for number in fit.numbers:
        if number.sign != "positive" or number.value >= 0 or not number.determined:
            continue
        if number.name not in sure:
            beyond = -number.value > NEGATIVE * number.std
            said.append(
                f"{number.name} is negative, which physics does not allow"
                + (
                    ": the model lacks something, or an input is wrong"
                    if beyond
                    else ", but no more than its error: these data cannot tell it from zero"
                )
            )
    return said


def _misfit(fit: Fit) -> list[str]:
    units = fit.experiment.units
    if fit.misses:
        worst = int(np.argmax(fit.rmse / fit.noise))
        unit = f" {units[worst]}" if units else ""
        return [
            f"the residual at {fit.joints[worst]} is {fit.rmse[worst] / fit.noise[worst]:.3g} "
            f"times the noise ({fit.noise[worst]:.3g}{unit}): the model misses something, and the "
            "errors above, which assume white noise, are too small"
        ]
    if fit.reduced_chi2 < _SMALL:
        return [
            f"chi-square is {fit.reduced_chi2:.3g}, below what the stated noise allows: "
            "the noise is overstated, and the errors above are too large"
        ]
    return []


def _integration(fit: Fit) -> list[str]:
    if not fit.integration_error > TENTH:
        return []
    chosen = fit.experiment.integrator
    if chosen is not None and chosen.adapts:
        what = "give it smaller tolerances (rtol, atol), or Kvaerno5 where an effect is stiff"
    elif fit.model.dry or fit.model.follows:
        what = "a recording that is cut shorter (stop) lets less of it add up"
    else:
        what = (
            "--integrator Tsit5 chooses its steps itself, and Kvaerno5 those of an effect that is "
            "much faster than the arm"
        )
    return [
        f"the integration is not exact enough: its error is {fit.integration_error:.2g} of the "
        f"noise, where a tenth is hardly seen in the numbers; {what}"
    ]


def _search(fit: Fit) -> list[str]:
    said = []
    if not fit.converged:
        said.append("the fit did not settle: treat the numbers as rough")
    if fit.starts > 1 and fit.agreeing_starts < max(2, fit.starts // 3):
        said.append(
            f"only {fit.agreeing_starts} of {fit.starts} starts led here: "
            "there may be a better minimum; try more starts"
        )
    return said
