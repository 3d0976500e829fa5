"""A figure inside a page: two layouts, for a laptop's width and a phone's, as SVG in the address
itself."""

import base64
import dataclasses
import io
import re
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
    wide, narrow = (svg(draw(*args, **named, narrow=x)).encode() for x in (False, True))
    address = "data:image/svg+xml;base64,"
    return Picture(alt, *(address + base64.b64encode(x).decode() for x in (wide, narrow)))


def svg(figure: Figure) -> str:
    """A figure as SVG that looks the same everywhere: letters are drawn, not named."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "residyn"}):
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing)
    # A hundredth of a point is as fine as any eye or printer.
    return re.sub(r' d="[^"]*"', lambda d: re.sub(r"(\.\d\d)\d+", r"\1", d[0]), buffer.getvalue())
