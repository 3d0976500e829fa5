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
    with mpl.rc_context({"svg.hashsalt": "residyn"}):
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing)
    text = re.sub(r"<!--.*?-->|\s*\n\s*(?=<)", "", buffer.getvalue(), flags=re.S)
    text = _LETTER.sub(lambda m: f'<use xlink:href="{m[1]}" x="{float(m[2]):.0f}"/>', text)
    return _NUMBERS.sub(_short, _FONT.sub(r"\1f", text))


# Letters of a line of text, 100 units high, by a name of their font.
_LETTER = re.compile(r'<use xlink:href="([^"]*)" transform="translate\((\S+) 0\)"/>')
_FONT = re.compile(r'( id="|"#)DejaVuSans-')
# Coordinates: of paths, and of what is repeated. A tenth of a point is as fine as any printer.
_NUMBERS = re.compile(r' (?:d|x|y)="[^"]*"')
_LINE = re.compile(r"(M|L) (\S+) (\S+)\s*|(z)\s*")


def _short(attribute: re.Match[str]) -> str:
    if _LINE.sub("", attribute[0]) == ' d=""':
        return f' d="{_lines(_LINE.findall(attribute[0]))}"'
    words = re.sub(r"-?\d+\.\d+", lambda x: f"{float(x[0]):.1f}".removesuffix(".0"), attribute[0])
    # A line's letter may be left out after a line, and not after a curve. In an address a blank
    # takes three letters: numbers are parted by commas, and letters by nothing.
    words = re.sub(r" ?\n" if "Q" in words or "C" in words else r" ?\n(L )?", " ", words)
    words = re.sub(r"(?<=[\d.]) (?=[-\d])", ",", words)
    return " " + re.sub(r" ?([A-Za-z]) ?(?!=)", r"\1", words.strip()).replace(' "', '"')


def _lines(points: list[tuple[str, str, str, str]]) -> str:
    """Straight lines through points, in tenths, each from the last one: small numbers are short."""
    found, last, at = "", "", (0, 0)
    for letter, *place, end in points:
        if end:
            found += end
            continue
        to = tuple(round(10 * float(x)) for x in place)
        step = to if letter == "M" else tuple(b - a for a, b in zip(at, to, strict=True))
        words = ",".join(re.sub(r"^(-?)0\.", r"\1.", f"{x / 10:g}") for x in step)
        words = words.replace(",-", "-")
        begins = "M" if letter == "M" else "l" if last == "M" else "" if words[0] == "-" else ","
        found, last, at = found + begins + words, letter, to
    return found
