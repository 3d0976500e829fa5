"""A fit as one page that can be mailed: HTML with everything inside it, and no scripts.

The page reads from the verdict down to the details. Every picture comes in two layouts, for a
laptop's width and for a phone's; the browser picks. All words that came from a user's files are
escaped.
"""

import base64
import dataclasses
import io
import math
import os
import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
from matplotlib.figure import Figure

from . import __version__, _verdict, plot
from ._input import InputError
from ._units import amount, plain, ratio, with_error
from .diagnosis import Comparison
from .fitting.result import Fit

MOST_PIXELS_NARROW = 640


@dataclasses.dataclass(frozen=True)
class Picture:
    """One picture, as two data addresses."""

    alt: str
    wide: str
    narrow: str


def write_report(
    path: str | os.PathLike[str],
    fits: Sequence[tuple[str, Fit]],
    compared: Comparison | None = None,
) -> None:
    """Write one or several fits of the same recordings as one self-contained page.

    **Arguments:** `fits`: (title, fit) each, the simplest model first; `compared`: where the last
    of them fails, if that is to be told.

    **Raises:** `InputError` if the file cannot be written.
    """
    text = render(fits, compared)
    try:
        Path(path).write_text(text, encoding="utf-8")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{os.fspath(path)}: cannot be written ({why})") from None


def render(fits: Sequence[tuple[str, Fit]], compared: Comparison | None = None) -> str:
    """The page as text."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("residyn", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["unit"] = _unit
    environment.filters["plain"] = plain
    environment.globals["amount"] = amount
    chapters = [_chapter(title, fit) for title, fit in fits]
    chapters[-1]["failing"] = None if compared is None else _failing(compared)
    comparison = None
    if len(fits) > 1:
        names, models = [t for t, _ in fits], [f for _, f in fits]
        comparison = {
            "words": _fall(fits),
            "picture": _picture(
                "Bars: error of each model beside the noise, per joint",
                plot.errors(models, names),
                plot.errors(models, names, narrow=True),
            ),
        }
    return environment.get_template("report.html.j2").render(
        chapters=chapters,
        comparison=comparison,
        version=__version__,
        date=date.today().isoformat(),
        narrow=MOST_PIXELS_NARROW,
    )


def _chapter(title: str, fit: Fit) -> dict[str, Any]:
    """All that the template says of one fit."""
    fitted = [r for r in fit.recordings if r.recording.role != "check"]
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
            _picture(
                f"{r.recording.name}: measured, model and what is left, against time",
                plot.overlay(fit, [r]),
                plot.overlay(fit, [r], narrow=True),
            )
            for r in fit.recordings
        ],
        "spectrum": _picture(
            "Amplitude spectra of the motion and of what is left, with the modes marked",
            plot.spectrum(fit),
            plot.spectrum(fit, narrow=True),
        ),
        "recordings": [r.recording.name for r in fit.recordings],
        "correlations": fit.strong_correlations(),
        "readings": sum(int(r.used.sum()) for r in fitted),
        "fitted": [r.recording.name for r in fitted],
        "held_out": [r.recording.name for r in fit.recordings if r.recording.role == "check"],
    }


def _failing(compared: Comparison) -> dict[str, Any]:
    """All that the template says of where a fit fails."""
    torques = []
    for found in compared.missing_torque:
        for joint, name in enumerate(compared.fit.joints):
            unit = compared.fit.experiment.units
            words = {
                "name": name,
                "unit": unit[joint] if unit else None,
                "curves": found.curves_at(joint),
                "link_angle": None if found.link_angle is None else found.link_angle[:, joint],
            }
            torques.append(
                {
                    "words": found.words(joint),
                    "picture": _picture(
                        f"Missing torque at the {name} in {found.recording}",
                        plot.missing_torque(found.torque, joint, **words),
                        plot.missing_torque(found.torque, joint, **words, narrow=True),
                    ),
                }
            )
    ahead = compared.horizon
    return {
        "explained": compared.explained,
        "words": compared.words,
        "where": _picture(
            "Bars: the residual in times the noise, by time, by amplitude and by frequency",
            plot.where(compared),
            plot.where(compared, narrow=True),
        ),
        "horizon": None
        if ahead is None
        else _picture(
            "The prediction's error in times the noise against time ahead",
            plot.horizon(compared),
            plot.horizon(compared, narrow=True),
        ),
        "torques": torques,
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


def _mode_row(mode: Any) -> dict[str, str]:
    frequency, frequency_std = with_error(mode.frequency_hz, mode.frequency_hz_std)
    ratio, ratio_std = with_error(100 * mode.damping_ratio, 100 * mode.damping_ratio_std)
    return {
        "frequency": frequency,
        "frequency_std": frequency_std,
        "ratio": ratio,
        "ratio_std": ratio_std,
        "period": plain(1 / mode.frequency_hz, 3) if mode.frequency_hz > 0 else "",
    }


def _fall(fits: Sequence[tuple[str, Fit]]) -> str:
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


def _unit(unit: str) -> str:
    """A unit as one writes it: m² and not m^2; nothing for a pure number."""
    return "" if unit == "1" else unit.replace("^2", "²").replace("^3", "³")


def _picture(alt: str, wide: Figure, narrow: Figure) -> Picture:
    return Picture(alt, _address(svg(wide)), _address(svg(narrow)))


def svg(figure: Figure) -> str:
    """A figure as SVG that looks the same everywhere: letters are drawn, not named."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "residyn"}):
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing)
    # A hundredth of a point is as fine as any eye or printer.
    return re.sub(r' d="[^"]*"', lambda d: re.sub(r"(\.\d\d)\d+", r"\1", d[0]), buffer.getvalue())


def _address(text: str) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(text.encode()).decode()
