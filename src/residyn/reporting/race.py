"""A race as one page: the table, and curves that can be switched on and off.

The pictures are part of the page and not images in it, so that a style sheet can hide a curve:
unchecking a method hides whatever carries its mark. The page has no scripts.
"""

import os

from ..fitting.race import Race
from ..fitting.race_tables import HEAD, cells
from . import figures as plot
from .picture import svg
from .template import filled, written


def write_race(path: str | os.PathLike[str], race: Race, title: str) -> None:
    """Write a race as one self-contained page.

    **Raises:** `InputError` if the file cannot be written.
    """
    written(path, render_race(race, title))


def render_race(race: Race, title: str) -> str:
    """The page as text."""
    drawn = [each for each in race.methods if len(each.median.history.objective)]
    names = [each.title for each in drawn]
    histories = [each.median.history for each in drawn]
    pictures = [
        (words, _inline(plot.convergence(histories, names, against=against)))
        for against, words in (
            ("simulations", "Objective against simulations"),
            ("seconds", "Objective against seconds"),
        )
        if drawn
    ]
    return filled(
        "race.html.j2",
        title=title,
        race=race,
        head=HEAD,
        rows=[(each, [each.title, *cells(race, each)]) for each in race.methods],
        names=names,
        pictures=pictures,
    )


def _inline(figure) -> str:
    """A picture as an element of a page."""
    text = svg(figure)
    return text[text.index("<svg") :]
