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
        figure.savefig(buffer, format="svg", metadata=nothing, dpi=150)
    return re.sub(r' d="([^"]*)"', lambda d: f' d="{_short(d[1])}"', buffer.getvalue())


def _short(path: str) -> str:
    """A path in fewer letters; a hundredth of a point is as fine as any eye or printer."""
    path = re.sub(r"(\.\d\d)\d+", r"\1", path)
    return re.sub(r" ?([A-Za-z]) ?", r"\1", re.sub(r"\s+", " ", path.strip())).replace(" ", ",")
