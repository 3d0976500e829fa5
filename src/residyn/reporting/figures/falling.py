"""The error falling, model by model, in times the noise of a reading."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from ...diagnosis.result import Diagnosis
from ...fitting.result import Fit
from .. import laws
from ..fit import joint_errors
from ..names import HELD_OUT, listed
from ..numbers import amount, plain, times
from ..tried import times_noise, unnamed, untried
from .style import BAND, DASHED, FAINT, INK, JOINTS, SOFT, blank, shortened, styled

_LOG = 4.0  # from this fall on the scale is logarithmic
_PANEL, _AXIS = 2.2, 0.5  # inches: height of the panel, room for the numbers of its axis
_STRIP = 0.13  # of the scale lies below the least error: room for the name of the noise
_MOST_NAMES = 4  # that have room under the axis
_LINE = 0.155  # inches from one line of words to the next
_ALIKE = 1.1  # times: errors that differ by less are one number to the reader
_BESIDE = 0.12  # inches from a dot to its words


class _Line(NamedTuple):
    """The errors of all models at one joint, in times the noise."""

    joint: int
    held: bool
    values: list[float]

    @property
    def colour(self) -> str:
        return JOINTS[self.joint % len(JOINTS)]

    @property
    def kind(self) -> str:
        return HELD_OUT if self.held else "fitted"

    @property
    def style(self) -> dict[str, Any]:
        """Of line and dots, beside their colour."""
        wide = {"ls": DASHED, "lw": 1.3} if self.held else {"ls": "-", "lw": 2.0}
        return {**wide, "marker": "o", "ms": 6.5, "mew": 1.5, "zorder": 4 if self.held else 3}


@styled
def ladder(found: Diagnosis, *, narrow: bool = False) -> Figure:
    """The error of each model on the way in times the noise, per joint: what was fitted (solid)
    and what was held out (hollow).

    At the line of the noise nothing is left that the recordings could still show.
    """
    names, models = zip(*laws.models(found), strict=True)
    each = [times_noise(step) for step in models]
    end = ""
    if len(each) == 1 and found.verdict == "unexplained":
        end = f"{unnamed(found)}\nbrings it down to the noise"
        end = "no effect was tried yet" if untried(found) else end
    if found.channels is not None:
        end = "the columns are to be put right first"
    return _falling(found.fit, names, each, narrow, end, found.verdict != "unexplained")


@styled
def errors(fits: Sequence[Fit], names: Sequence[str], *, narrow: bool = False) -> Figure:
    """The error of several models of the same recordings, drawn like `ladder`."""
    each = [[(e.ratio, e.check_ratio) for e in joint_errors(fit)] for fit in fits]
    return _falling(fits[0], names, each, narrow)


def _falling(
    fit: Fit,
    names: Sequence[str],
    each: Sequence[Sequence[tuple[float, float | None]]],
    narrow: bool,
    end_words: str = "",
    explained: bool = True,
) -> Figure:
    joints, count = fit.joints, len(names)
    sizes = np.array(each, float)  # of models, joints, and where: fitted or held out (None: NaN)
    seen = [(j, k) for j, k in np.ndindex(*sizes.shape[1:]) if np.isfinite(sizes[:, j, k]).any()]
    lines = [_Line(j, k == 1, sizes[:, j, k].tolist()) for j, k in seen]
    beneath = narrow or count > _MOST_NAMES  # there is no room for names under their dots
    below = ["\n".join(textwrap.wrap(n.replace(" + ", " +\u00a0"), 26)) for n in names]
    rows = []
    for i, name in enumerate(names):
        rows += textwrap.wrap(f"{i}  {name}", 44 if narrow else 108, subsequent_indent=" " * 5)
    under = len(rows) + 1 if beneath else max(name.count("\n") + 1 for name in below)
    head = 0.7 + (_LINE + 0.04) * max(2, len(joints)) if narrow else 0.45
    figure = blank(narrow, _PANEL + head + _LINE * under)
    width = figure.get_figwidth()
    ax = figure.subplots()
    before, after = (0.72, 0.86) if narrow else (1.95, 0.9)  # inches, for numbers beside dots
    step = (count - 1) / (width - _AXIS - before - after) or 1.0  # models an inch
    end = count - 1 + after * step if count > 1 else width - _AXIS - before
    ax.set_xlim(-before * step, end)
    _scale(ax, [value for line in lines for value in line.values])
    _floor(ax, 0.5 * (count - 1) if count > 1 else 0.5 * end, fit, explained and not narrow)
    for line in lines:
        inside = "white" if line.held else line.colour
        ax.plot(line.values, color=line.colour, mfc=inside, clip_on=False, **line.style)
    ax.set_xticks(range(count), [str(i) for i in range(count)] if beneath else below)
    ax.tick_params(axis="x", length=0, pad=4)
    ax.set_title("error in times the noise of a reading", fontweight="normal", fontsize=9)
    if beneath:
        ax.set_xlabel("\n".join(rows), loc="left", multialignment="left")
    _beside(ax, 0, -1, _first(lines, joints, narrow))
    if count > 1:
        _beside(ax, count - 1, 1, _gathered([(x.values[-1], x.joint) for x in lines]))
    elif end_words:
        ax.text(0.65, 0.6, end_words, transform=ax.transAxes, ha="center", va="center", color=SOFT)
    if narrow:
        _key(figure, lines, joints)
    return figure


def _scale(ax: Axes, values: Sequence[float]) -> None:
    """Logarithmic where the fall is large."""
    seen = [v for v in values if math.isfinite(v) and v > 0] or [1.0]
    least, most = min(*seen, 1.0), max(*seen, 1.0)
    if most > _LOG * least:
        ax.set_yscale("log")
        top = 1.25 * most
        ax.set_ylim(least * (top / least) ** -_STRIP, top)
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if most < 300 else (1.0,)))
        ax.yaxis.set_major_formatter(lambda y, _: plain(y, 1))
        ax.yaxis.set_minor_formatter(lambda y, _: "")
    else:
        ax.set_ylim(0, 1.25 * most)


def _floor(ax: Axes, x: float, fit: Fit, explained: bool) -> None:
    """The noise, in its own unit, of each joint if they differ: nothing that is right lies far from
    it."""
    each = [amount(float(n), unit, 2) for n, unit in zip(fit.noise, fit.units, strict=True)]
    size = listed(list(dict.fromkeys(each)))
    ax.axhspan(0.0 if ax.get_yscale() == "linear" else 1e-9, 1.0, color=BAND, alpha=0.55, lw=0)
    ax.axhline(1.0, color=INK, lw=1.0, zorder=1)
    words = f"the noise, {size}" + (": nothing is left to explain" if explained else "")
    below: dict[str, Any] = {"ha": "center", "va": "top", "color": SOFT}
    ax.annotate(words, (x, 1.0), (0, -5), textcoords="offset points", **below)


# -- numbers beside the dots: none on another, none on the noise's line ------------------------


def _first(
    lines: Sequence[_Line], joints: Sequence[str], narrow: bool
) -> list[tuple[float, str, str]]:
    """What stands beside the first dots."""
    dots = _gathered([(x.values[0], x.joint) for x in lines])
    if len(dots) == 1 < len(lines):
        value, words, colour = dots[0]
        return [(value, words if narrow else f"all: {words}", colour)]
    labels = []
    for line in lines:
        words = f"{times(line.values[0])} ×"
        if not narrow:
            name = f"{shortened(joints[line.joint], 14)}, " if len(joints) > 1 else ""
            words = f"{name}{line.kind}: {words}"
        labels.append((line.values[0], words, line.colour))
    return labels


def _gathered(values: Sequence[tuple[float, int]]) -> list[tuple[float, str, str]]:
    """Labels for errors, one for all that lie on each other."""
    groups: list[list[tuple[float, int]]] = []
    for value, joint in sorted((v, j) for v, j in values if math.isfinite(v)):
        if groups and value < _ALIKE * groups[-1][0][0]:
            groups[-1].append((value, joint))
        else:
            groups.append([(value, joint)])
    labels = []
    for group in groups:
        (least, joint), (most, _) = group[0], group[-1]
        low, high = times(least), times(most)
        colour = JOINTS[joint % len(JOINTS)] if {j for _, j in group} == {joint} else INK
        words = f"{low} ×" if low == high else f"{low}-{high} ×"
        labels.append((math.sqrt(least * most), words, colour))
    return labels


def _height(ax: Axes, value: float) -> float:
    """Inches of a value above the foot of the axes."""
    (low, high), scale = ax.get_ylim(), math.log if ax.get_yscale() == "log" else float
    return _PANEL * (scale(value) - scale(low)) / (scale(high) - scale(low))


def _beside(ax: Axes, x: float, side: int, labels: Sequence[tuple[float, str, str]]) -> None:
    """Words beside dots, to the left (-1) or right (1), pushed apart where they would overlap."""
    shown = sorted((v, words, colour) for v, words, colour in labels if math.isfinite(v))
    places, floor = [_height(ax, v) for v, *_ in shown], _height(ax, 1.0)
    below, above = -math.inf, _PANEL + _LINE
    for i, place in enumerate(places):
        if abs(place - floor) < 0.6 * _LINE:  # the line of the noise would strike them out
            place = floor + 0.6 * _LINE
        places[i] = below = max(place, below + _LINE)
    for i, place in reversed([*enumerate(places)]):
        places[i] = above = min(place, above - _LINE)
    for place, (value, words, colour) in zip(places, shown, strict=True):
        offset = side * _BESIDE * 72, (place - _height(ax, value)) * 72
        style: dict[str, Any] = {"va": "center", "color": colour, "fontweight": "bold"}
        style["ha"] = "left" if side > 0 else "right"
        ax.annotate(words, (x, value), offset, textcoords="offset points", **style)


def _key(figure: Figure, lines: Sequence[_Line], joints: Sequence[str]) -> None:
    """What colours and dots mean, where there is no room for words beside them."""
    colours = {shortened(joints[x.joint], 14): x.colour for x in lines}
    kinds = {x.kind: x.style for x in lines}
    left = [Line2D([], [], color=colour, lw=2.5, label=name) for name, colour in colours.items()]
    right = [
        Line2D([], [], color=FAINT, mfc="white" if name == HELD_OUT else FAINT, label=name, **style)
        for name, style in kinds.items()
    ]
    left += [Line2D([], [], ls="", label="")] * (len(right) - len(left))
    figure.legend(handles=[*left, *right], loc="outside upper left", ncols=2, labelspacing=0.35)
