"""Pictures inside a page: two layouts each, as SVG in the address itself."""

import base64
import dataclasses
import io
import re

import matplotlib as mpl
from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Picture:
    """One picture, as two data addresses."""

    alt: str
    wide: str
    narrow: str


def picture(alt: str, wide: Figure, narrow: Figure) -> Picture:
    return Picture(alt, _address(svg(wide)), _address(svg(narrow)))


def svg(figure: Figure) -> str:
    """A figure as SVG that looks the same everywhere: letters are drawn, not named."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "residyn"}):
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing)
    # A hundredth of a point is as fine as any eye or printer.
    return re.sub(r' d="[^"]*"', lambda d: re.sub(r"(\.\d\d)\d+", r"\1", d[0]), buffer.getvalue())


def _address(text: str) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(text.encode()).decode()
