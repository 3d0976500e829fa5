"""What the page says of one fit."""

import math
from collections.abc import Sequence
from typing import Any

from ..fitting.result import Fit
from . import figures as plot
from . import verdict as _verdict
from .numbers import plain, ratio, with_error
from .picture import picture


def chapter(title: str, fit: Fit) -> dict[str, Any]:
    """All that the template says of one fit."""
    fitted = [r for r in fit.whole if r.recording.role != "check"]
    return {
        "title": title,
        "fit": fit,
        "failing": None,
        "explained": _verdict.explained(fit),
        "verdict": _verdict.verdict(fit),
        "chi2": plain(fit.reduced_chi2, 3),
        "chi2_words": _verdict.chi2_words(fit.reduced_chi2),
        "errors": _verdict.joint_errors(fit),
        "effects": fit.model.effects,
        "numbers": [_number_row(n) for n in fit.numbers],
        "modes": [_mode_row(m) for m in fit.modes],
        "motion": [
            picture(
                f"{r.recording.name}: measured, model and what is left, against time",
                plot.overlay(fit, [r]),
                plot.overlay(fit, [r], narrow=True),
            )
            for r in fit.whole
        ],
        "spectrum": picture(
            "Amplitude spectra of the motion and of what is left, with the modes marked",
            plot.spectrum(fit),
            plot.spectrum(fit, narrow=True),
        ),
        "recordings": [r.recording.name for r in fit.whole],
        "correlations": fit.strong_correlations(),
        "readings": sum(int(r.used.sum()) for r in fitted),
        "fitted": [r.recording.name for r in fitted],
        "held_out": [r.recording.name for r in fit.whole if r.recording.role == "check"],
    }


def _number_row(number: Any) -> dict[str, str]:
    value, std = with_error(number.value, number.std)
    return {
        "name": number.name,
        "words": number.words,
        "value": value,
        "std": std if number.determined else "not determined",
        "percent": f"{plain(number.percent, 2)} %" if math.isfinite(number.percent) else "",
        "start": plain(number.start, 3),
        "unit": number.unit,
    }


def _mode_row(mode: Any) -> dict[str, Any]:
    frequency, frequency_std = with_error(mode.frequency_hz, mode.frequency_hz_std)
    ratio, ratio_std = with_error(100 * mode.damping_ratio, 100 * mode.damping_ratio_std)
    return {
        "frequency": frequency,
        "frequency_std": frequency_std,
        "ratio": ratio,
        "ratio_std": ratio_std,
        "grows": mode.grows,
        "period": plain(1 / mode.frequency_hz, 3) if mode.frequency_hz > 0 else "",
    }


def fall(fits: Sequence[tuple[str, Fit]]) -> str:
    """From the first model to the last, where the first one is worst."""
    (_, first), (_, last) = fits[0], fits[-1]
    before, after = _verdict.joint_errors(first), _verdict.joint_errors(last)
    worst = max(range(len(before)), key=lambda i: before[i].ratio)
    a, b = before[worst], after[worst]
    added = [label for label in last.model.labels if label not in first.model.labels]
    fall = f"from {ratio(a.ratio)} times the noise to {ratio(b.ratio)} times"
    if not added:
        return f"The error at the {a.joint} goes {fall}."
    return f"With {' and '.join(added)}, the error at the {a.joint} goes {fall}."
