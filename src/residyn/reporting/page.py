"""A result as one page that can be mailed: HTML with everything inside it.

A page reads from the verdict down to the details. Every picture comes in two layouts, for a
laptop's width and for a phone's; the browser picks. All words that came from a user's files are
escaped. Only a diagnosis has scripts, those of the explorer; without them, and on paper, the page
still says all.
"""

import os
from collections.abc import Sequence
from datetime import date
from typing import Any

import jinja2
import markupsafe

from .. import __version__
from ..diagnosis import Comparison
from ..diagnosis.result import Diagnosis
from ..files import write
from ..fitting.race import Race
from ..fitting.result import Fit
from ..procedure import InertiaResult, Unloading
from . import figures as plot
from . import inertia, race, unload
from .compare import failing, pairs, torque
from .diagnosis import diagnosed
from .explorer.page import embedded
from .fit import chapter, fall
from .names import unbroken

_NARROW = 640
"""Pixels up to which the layouts for a phone are shown."""


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
    write(path, render(fits, compared, diagnosis))


def write_page(
    path: str | os.PathLike[str], found: InertiaResult | Unloading | Race, title: str
) -> None:
    """Write step 1, step 3 or a race as one self-contained page.

    **Raises:** `InputError` if the file cannot be written.
    """
    write(path, render_page(found, title))


def render(
    fits: Sequence[tuple[str, Fit]],
    compared: Comparison | None = None,
    diagnosis: Diagnosis | None = None,
) -> str:
    """The page of fits as text."""
    chapters = [chapter(title, fit) for title, fit in fits]
    if compared is not None:
        experiment, missing = compared.fit.experiment, compared.missing_torque
        drawn = [torque(experiment, *pair) for pair in pairs(missing)]
        chapters[-1]["failing"] = failing(compared, drawn)
    comparison = None
    if len(fits) > 1 and diagnosis is None:
        words = "Error of each model in times the noise, per joint"
        names, models = [t for t, _ in fits], [f for _, f in fits]
        drawn = plot.picture(words, plot.errors, models, names)
        comparison = {"words": fall(fits), "picture": drawn}
    return _filled(
        "report.html.j2",
        chapters[-1]["title"],
        chapters=chapters,
        comparison=comparison,
        diagnosis=None if diagnosis is None else diagnosed(diagnosis),
        explorer=markupsafe.Markup("" if diagnosis is None else embedded(diagnosis)),
    )


def render_page(found: InertiaResult | Unloading | Race, title: str) -> str:
    """The page of another result as text."""
    if isinstance(found, InertiaResult):
        return _filled("inertia.html.j2", title, **inertia.page(found))
    if isinstance(found, Unloading):
        return _filled("unload.html.j2", title, **unload.page(found))
    return _filled("race.html.j2", title, **race.page(found))


def _filled(template: str, title: str, **named: Any) -> str:
    """A template of the package as text; all words in it are escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("residyn", "reporting/templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["unbroken"] = unbroken
    environment.globals.update(version=__version__, date=date.today().isoformat(), narrow=_NARROW)
    shown = {"chapters": [], "comparison": None, "diagnosis": None, **named}
    return environment.get_template(template).render(title=title, **shown)
