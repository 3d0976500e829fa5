"""A figure inside a page: two layouts, for a laptop's width and a phone's, as SVG in the address
itself."""

import dataclasses
import io
import re
import urllib.parse
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Picture:
    """One picture, as two data addresses."""

    alt: str
    wide: str
    narrow: str


def picture(alt: str, draw: Callable[..., Figure], *args: Any, **named: Any) -> Picture:
    """What `draw` makes of the arguments, in both layouts."""
    # Paths keep their letters: in base64 all would grow by a third.
    each = (svg(draw(*args, **named, narrow=x)) for x in (False, True))
    return Picture(
        alt, *("data:image/svg+xml," + urllib.parse.quote(x, safe="/:;,=()-.") for x in each)
    )


def svg(figure: Figure) -> str:
    """A figure as SVG that looks the same everywhere: letters are drawn, not named."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "residyn"}):
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing)
    text = re.sub(r"<!--.*?-->|\s*\n\s*(?=<)", "", buffer.getvalue(), flags=re.S)
    return _NUMBERS.sub(_short, text)


# Coordinates: of paths, and of what is repeated. A tenth of a point is as fine as any printer.
_NUMBERS = re.compile(r' (?:d|x|y)="[^"]*"')


def _short(attribute: re.Match[str]) -> str:
    words = re.sub(r"-?\d+\.\d+", lambda x: f"{float(x[0]):.1f}".removesuffix(".0"), attribute[0])
    # A line's letter may be left out after a line, and not after a curve. In an address a blank
    # takes three letters: numbers are parted by commas, and letters by nothing.
    words = re.sub(r" ?\n" if "Q" in words or "C" in words else r" ?\n(L )?", " ", words)
    words = re.sub(r"(?<=[\d.]) (?=[-\d])", ",", words)
    return " " + re.sub(r" ?([A-Za-z]) ?(?!=)", r"\1", words.strip()).replace(' "', '"')
