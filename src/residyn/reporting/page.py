"""A fit as one page that can be mailed: HTML with everything inside it.

The page reads from the verdict down to the details. Every picture comes in two layouts, for a
laptop's width and for a phone's; the browser picks. All words that came from a user's files are
escaped. Only a diagnosis has scripts, those of the explorer; without them, and on paper, the page
still says all.
"""

import os
from collections.abc import Sequence

import markupsafe

from ..diagnosis import Comparison
from ..diagnosis.result import Diagnosis
from ..fitting.result import Fit
from . import figures as plot
from .diagnosis import diagnosed
from .explorer.page import embedded
from .failing import failing, torques
from .fit import chapter, fall
from .picture import picture
from .template import filled, written


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
    written(path, render(fits, compared, diagnosis))


def render(
    fits: Sequence[tuple[str, Fit]],
    compared: Comparison | None = None,
    diagnosis: Diagnosis | None = None,
) -> str:
    """The page as text."""
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
    return filled(
        "report.html.j2",
        chapters=chapters,
        comparison=comparison,
        diagnosis=None if diagnosis is None else diagnosed(diagnosis),
        explorer=markupsafe.Markup("" if diagnosis is None else embedded(diagnosis)),
    )
