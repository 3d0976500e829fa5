"""One look for all pictures: quiet axes, few colours, a unit on every scale."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

WIDE, NARROW = 8.6, 3.7
"""Widths in inches: stretched to a laptop's page or a phone, 9 point text reads as 9 or more."""

# Okabe and Ito's colours, which stay apart for every kind of colour vision. What is measured is a
# broad pale line and the model a thin dark one on top: where they part, both can be seen.
MEASURED, MODEL, RESIDUAL, WILD = "#a8a8a8", "#0072b2", "#d55e00", "#cc79a7"
HELD_OUT = "#9fcbe8"
JOINTS = (MODEL, RESIDUAL, "#009e73", "#cc79a7")
"""One colour a joint, where joints share a picture."""
BAND, SHADE, INK, SOFT, FAINT = "#d4d4d4", "#f4f4f4", "#222222", "#555555", "#777777"
DASHED = (0, (4, 3))

_STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.linewidth": 0.7,
    "legend.borderpad": 0.0,
    "legend.columnspacing": 1.6,
    "text.parse_math": False,  # names come from users: a dollar sign is a dollar sign
    **dict.fromkeys(("legend.frameon", "axes.spines.top", "axes.spines.right"), False),
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), FAINT),
    **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), INK),
}

# What a journal's printer takes: whole TrueType fonts in PDF and PostScript (Type 3 is refused by
# many), and in SVG letters drawn as paths, which look the same where the font is not installed.
_FILES: dict[Any, Any] = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "path"}

_P = ParamSpec("_P")


class _Printable(Figure):
    """A figure whose files have fonts that print, whatever the user's settings when it is saved."""

    def savefig(self, *args: Any, **named: Any) -> None:
        with mpl.rc_context(_FILES):
            super().savefig(*args, **named)


def styled(draw: Callable[_P, Figure]) -> Callable[_P, Figure]:
    """Draw in this style, whatever the user's own is, and leave the user's own as it was; files
    that are saved of it have fonts that print."""

    @functools.wraps(draw)
    def wrapped(*args: _P.args, **named: _P.kwargs) -> Figure:
        settings: dict[Any, Any] = {**mpl.rcParamsDefault, **_STYLE}
        del settings["backend"]
        with mpl.rc_context(settings):
            figure = draw(*args, **named)
        figure.__class__ = _Printable
        return figure

    return wrapped


def blank(narrow: bool, high: float) -> Figure:
    """A figure as wide as a phone's page or a laptop's, `high` inches."""
    return Figure(figsize=(NARROW if narrow else WIDE, high), layout="constrained")


def largest(values: np.ndarray) -> float:
    """Largest size among the finite values; 0 if there are none."""
    return float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))


def shortened(name: str, most: int) -> str:
    """A name in at most so many letters; of a long one, the end, where file names differ."""
    return name if len(name) <= most else "..." + name[3 - most :]
