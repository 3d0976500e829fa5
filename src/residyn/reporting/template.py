"""From a template to a page in a file."""

import os
from datetime import date
from typing import Any

import jinja2

from .. import __version__
from ..files import write
from .numbers import amount, plain

MOST_PIXELS_NARROW = 640


def filled(template: str, **named: Any) -> str:
    """A template of the package as text; all words in it are escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("residyn", "reporting/templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["unit"] = _unit
    environment.filters["plain"] = plain
    environment.globals["amount"] = amount
    return environment.get_template(template).render(
        **named,
        version=__version__,
        date=date.today().isoformat(),
        narrow=MOST_PIXELS_NARROW,
    )


def written(path: str | os.PathLike[str], text: str) -> None:
    """Write a page.

    **Raises:** `InputError` if the file cannot be written.
    """
    write(path, text)


def _unit(unit: str) -> str:
    """A unit as one writes it: m² and not m^2; nothing for a pure number."""
    return "" if unit == "1" else unit.replace("^2", "²").replace("^3", "³")
