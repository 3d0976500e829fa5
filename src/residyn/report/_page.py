"""A fit as one page that can be mailed: HTML with everything inside it.

The page reads from the verdict down to the details. Every picture comes in two layouts, for a
laptop's width and for a phone's; the browser picks. All words that came from a user's files are
escaped. Only a diagnosis has scripts, those of the explorer; without them, and on paper, the page
still says all.
"""

import os
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import jinja2
import markupsafe

from .. import __version__, plot
from .._input import InputError
from .._units import amount, plain
from ..diagnosis import Comparison
from ..diagnosis.result import Diagnosis
from ..explorer.page import embedded
from ..fitting.result import Fit
from ._diagnosis import diagnosed
from ._failing import failing, torques
from ._fit import chapter, fall
from ._picture import picture

MOST_PIXELS_NARROW = 640


def write_report(
    path: str | os.PathLike[str],
    fits: Sequence[tuple[str, Fit]],
    compared: Comparison | None = None,
    diagnosis: Diagnosis | None = None,
) -> None:
    """Write one or several fits of the same recordings as one self-contained page.

    **Arguments:** `fits`: (title, fit) each, the simplest model first; `compared`: where the last
    of them fails, if that is to be told; `diagnosis`: what is missing in the first of them, which
    the page then begins with.

    **Raises:** `InputError` if the file cannot be written.
    """
    text = render(fits, compared, diagnosis)
    try:
        Path(path).write_text(text, encoding="utf-8")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{os.fspath(path)}: cannot be written ({why})") from None


def render(
    fits: Sequence[tuple[str, Fit]],
    compared: Comparison | None = None,
    diagnosis: Diagnosis | None = None,
) -> str:
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
    chapters = [chapter(title, fit) for title, fit in fits]
    if compared is not None:
        drawn = torques(compared.fit.experiment, compared.missing_torque)
        chapters[-1]["failing"] = failing(compared, drawn)
    comparison = None
    if len(fits) > 1 and diagnosis is None:
        names, models = [t for t, _ in fits], [f for _, f in fits]
        comparison = {
            "words": fall(fits),
            "picture": picture(
                "Bars: error of each model beside the noise, per joint",
                plot.errors(models, names),
                plot.errors(models, names, narrow=True),
            ),
        }
    return environment.get_template("report.html.j2").render(
        chapters=chapters,
        comparison=comparison,
        diagnosis=None if diagnosis is None else diagnosed(diagnosis),
        explorer=markupsafe.Markup("" if diagnosis is None else embedded(diagnosis)),
        version=__version__,
        date=date.today().isoformat(),
        narrow=MOST_PIXELS_NARROW,
    )


def _unit(unit: str) -> str:
    """A unit as one writes it: m² and not m^2; nothing for a pure number."""
    return "" if unit == "1" else unit.replace("^2", "²").replace("^3", "³")
