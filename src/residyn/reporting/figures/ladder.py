"""The error falling, model by model."""

import math
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from ...diagnosis.result import Diagnosis
from ..numbers import amount, plain, ratio
from ..words import at_place, listed, lower, model_name, times_noise
from .labels import LINE, beside, gathered
from .style import BAND, DASHED, FAINT, INK, JOINTS, NARROW, SOFT, WIDE, shortened, styled

_LOG = 4.0  # from this fall on the scale is logarithmic
_PANEL, _AXIS = 2.2, 0.42  # inches: height of the panel, room for the numbers of its axis
_STRIP = 0.13  # of the scale lies below the least error: room for the name of the noise
_ABREAST = 4  # models whose names have room under the axis
_Line = tuple[int, bool, list[float]]


@styled
def ladder(found: Diagnosis, *, narrow: bool = False) -> Figure:
    """The error of each model on the way in times the noise, per joint: what was fitted (solid)
    and what was held out (hollow).

    At the line of the noise nothing is left that the recordings could still show.
    """
    joints, count = found.fit.joints, len(found.ladder)
    lines = _lines(found)
    beneath = narrow or count > _ABREAST  # there is no room for names under their dots
    names = [_name(found, i, beneath) for i in range(count)]
    rows = [row for i, name in enumerate(names) for row in _item(i, name, narrow)]
    foot = 0.36 + LINE * len(rows) if beneath else 0.18 + LINE * max(map(_rows, names))
    head = 0.36 + (LINE + 0.04) * _key_rows(lines) if narrow else 0.36
    width, high = NARROW if narrow else WIDE, head + _PANEL + foot
    figure = Figure(figsize=(width, high))
    across = width - _AXIS - 0.1
    ax = figure.add_axes((_AXIS / width, foot / high, across / width, _PANEL / high))
    before, after = (0.72, 0.86) if narrow else (1.95, 0.9)
    each = (count - 1) / (across - before - after) or 1.0  # models an inch
    end = count - 1 + after * each if count > 1 else across - before
    ax.set_xlim(-before * each, end)
    _scale(ax, [value for _, _, values in lines for value in values])
    _floor(ax, 0.5 * (count - 1) if count > 1 else 0.5 * end, _noise(found), narrow)
    for line in lines:
        _draw(ax, *line)
    ax.set_xticks(range(count), [str(i) for i in range(count)] if beneath else names)
    ax.tick_params(axis="x", length=0, pad=4)
    ax.text(
        0.08 / width,
        (foot + _PANEL + 0.14) / high,
        "error in times the noise of a reading",
        transform=figure.transFigure,
    )
    beside(ax, 0, -1, _first(ax, lines, joints, narrow))
    if count > 1:
        beside(ax, count - 1, 1, gathered([(v[-1], joint) for joint, _, v in lines]))
    elif found.verdict == "unexplained":
        end = "no effect of the catalogue\nbrings it down to the noise"
        ax.text(0.65, 0.6, end, transform=ax.transAxes, ha="center", va="center", color=SOFT)
    if narrow:
        _key(figure, lines, joints)
    for i, row in enumerate(rows if beneath else []):
        figure.text(0.1 / width, (0.06 + LINE * (len(rows) - 1 - i)) / high, row)
    return figure


def _lines(found: Diagnosis) -> list[_Line]:
    """(joint, whether held out, error of each model); joints without a number are left out."""
    each = [times_noise(step) for step in found.ladder]
    lines = []
    for joint in range(len(found.fit.joints)):
        for held in (False, True):
            values = [step[joint][held] for step in each]
            values = [math.nan if v is None else v for v in values]
            if np.isfinite(values).any():
                lines.append((joint, held, values))
    return lines


def _name(found: Diagnosis, i: int, beneath: bool) -> str:
    """A model's name; under its dot, with the place on a line of its own."""
    step, joints = found.ladder[i], found.fit.joints
    if step.added is None:
        name = model_name(step)
        return name if beneath else name.replace(" + ", "\n+ ")
    name = f"+ {lower(at_place(step.added, joints))}"
    if step.dropped:
        name += f"\nwithout {listed([lower(at_place(x, joints)) for x in step.dropped])}"
    return name.replace("\n", ", ") if beneath else name.replace(" at the", "\nat the")


def _rows(name: str) -> int:
    return name.count("\n") + 1


def _item(i: int, name: str, narrow: bool) -> list[str]:
    """A model in the list beneath the picture."""
    most = 46 if narrow else 110
    return textwrap.wrap(name, most, initial_indent=f"{i}  ", subsequent_indent=" " * 5)


def _draw(ax: Axes, joint: int, held: bool, values: Sequence[float]) -> None:
    colour = JOINTS[joint % len(JOINTS)]
    ax.plot(
        range(len(values)),
        values,
        "o",
        color=colour,
        ls=DASHED if held else "-",
        lw=1.3 if held else 2.0,
        ms=6.5,
        mfc="white" if held else colour,
        mew=1.5,
        zorder=4 if held else 3,
        clip_on=False,
    )


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


def _noise(found: Diagnosis) -> str:
    """The noise of a reading in its own unit: "1.0 mrad", of each joint if they differ."""
    units = found.fit.experiment.units or (None,) * len(found.fit.joints)
    each = [amount(float(n), unit, 2) for n, unit in zip(found.fit.noise, units, strict=True)]
    return listed(list(dict.fromkeys(each)))


def _floor(ax: Axes, x: float, size: str, narrow: bool) -> None:
    """The noise: nothing that is right comes to lie far from it."""
    foot = 0.0 if ax.get_yscale() == "linear" else 1e-9
    ax.axhspan(foot, 1.0, color=BAND, alpha=0.55, lw=0, zorder=0)
    ax.axhline(1.0, color=INK, lw=1.0, zorder=1)
    ax.annotate(
        f"the noise, {size}" + ("" if narrow else ": nothing is left to explain"),
        (x, 1.0),
        xytext=(0, -5),
        textcoords="offset points",
        ha="center",
        va="top",
        color=SOFT,
    )


def _first(
    ax: Axes, lines: Sequence[_Line], joints: Sequence[str], narrow: bool
) -> list[tuple[float, str, str]]:
    """What stands beside the first dots."""
    dots = gathered([(values[0], joint) for joint, _, values in lines])
    if len(dots) == 1 < len(lines):
        value, words, colour = dots[0]
        return [(value, words if narrow else f"all: {words}", colour)]
    labels = []
    for joint, held, values in lines:
        words = f"{ratio(values[0])} ×"
        if not narrow:
            name = f"{shortened(joints[joint], 14)}, " if len(joints) > 1 else ""
            words = f"{name}{'held out' if held else 'fitted'}: {words}"
        labels.append((values[0], words, JOINTS[joint % len(JOINTS)]))
    return labels


def _key_rows(lines: Sequence[_Line]) -> int:
    return max(len({joint for joint, _, _ in lines}), 1 + any(held for _, held, _ in lines))


def _key(figure: Figure, lines: Sequence[_Line], joints: Sequence[str]) -> None:
    """What colours and dots mean, where there is no room for words beside them."""
    shown = sorted({joint for joint, _, _ in lines})
    handles = [
        Line2D([], [], color=JOINTS[j % len(JOINTS)], lw=2.5, label=shortened(joints[j], 14))
        for j in shown
    ]
    handles += [Line2D([], [], ls="", label="")] * (_key_rows(lines) - len(shown))
    style = {"color": FAINT, "marker": "o", "mew": 1.5}
    handles.append(Line2D([], [], mfc=FAINT, lw=1.8, label="fitted", **style))
    if any(held for _, held, _ in lines):
        handles.append(Line2D([], [], mfc="white", ls=DASHED, lw=1.2, label="held out", **style))
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.02, 1 - 0.06 / figure.get_figheight()),
        ncols=2,
        borderaxespad=0.0,
        labelspacing=0.35,
    )
