"""Pictures inside a page: two layouts each, as SVG in the address itself."""

import dataclasses
import io
import re
import urllib.parse

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
        figure.savefig(buffer, format="svg", metadata=nothing, dpi=150)
    return re.sub(r' d="([^"]*)"', lambda d: f' d="{_short(d[1])}"', buffer.getvalue())


def _short(path: str) -> str:
    """A path in fewer letters; a hundredth of a point is as fine as any eye or printer."""
    path = re.sub(r"(\.\d\d)\d+", r"\1", path)
    return re.sub(r" ?([A-Za-z]) ?", r"\1", re.sub(r"\s+", " ", path.strip())).replace(" ", ",")


def _address(text: str) -> str:
    # Paths keep their letters; in base64 all would grow by a third.
    return "data:image/svg+xml," + urllib.parse.quote(text, safe="/:;,=()-.")
