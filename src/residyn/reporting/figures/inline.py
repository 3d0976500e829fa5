"""A figure inside a page: SVG in the address itself."""

import io
import re
import urllib.parse
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure


def image(draw: Callable[..., Figure], *args: Any, **named: Any) -> str:
    """What `draw` makes of the arguments, as a data address."""
    # Paths keep their letters: in base64 all would grow by a third.
    code = urllib.parse.quote(svg(draw(*args, **named)), safe="/:;,=()-.")
    return f"data:image/svg+xml,{code}"


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
