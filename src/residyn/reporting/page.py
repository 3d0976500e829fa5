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

import markupsafe

from .. import __version__
from ..diagnosis import Comparison
from ..diagnosis.result import Diagnosis
from ..files import write
from ..fitting.race import Race
from ..fitting.result import Fit
from ..procedure import InertiaResult, Unloading
from . import compare, fit, laws, names, over_models, tried
from . import figures as plot
from .explorer.page import embedded, environment
from .numbers import plain
from .plan import outcomes

_NARROW = 640  # pixels up to which the layouts for a phone are shown


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
    # Of columns that are not what the file says no model is worth exploring.
    explorer = ""
    if diagnosis is not None and diagnosis.channels is None:
        explorer = markupsafe.Markup(embedded(diagnosis))
    return _filled(
        "report.html.j2",
        "fit" if diagnosis is None else "diagnosis",
        # Where the explorer runs it stands for all that print and pages without scripts show; on a
        # screen one layout of that will do.
        narrow=None if explorer else _NARROW,
        title=fits[-1][0],
        models=fits,
        compared=compared,
        explorer=explorer,
        about=None if diagnosis is None else diagnosis.reporting,
        found=diagnosis,
    )


def render_page(found: InertiaResult | Unloading | Race, title: str) -> str:
    """The page of another result as text."""
    named = {"title": title, "about": found.reporting, "found": found}
    return _filled(f"{found.about}.html.j2", found.about, **named)


def _filled(template: str, kind: str, **named: Any) -> str:
    """A template of the package as text. It asks the modules that write about a result, as they are
    named here, for its words, tables and pictures."""
    pages = environment("reporting/templates")
    pages.filters.update(unbroken=names.unbroken, plain=plain)
    modules = {"compare": compare, "fits": fit, "laws": laws, "names": names, "plot": plot}
    given = {"models": (), "compared": None, "phone": _NARROW, "narrow": _NARROW, "kind": kind}
    pages.globals.update(  # pyrefly: ignore[no-matching-overload]
        modules | given | named,
        over_models=over_models,
        tried=tried,
        outcomes=outcomes,
        image=plot.image,
        version=__version__,
        date=date.today().isoformat(),
    )
    return pages.get_template(template).render()
