"""The candidates: how probable each is, and how far its evidence is behind the best model's."""

import math

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, NullLocator

from ...diagnosis.evidence import INDISTINGUISHABLE
from ...diagnosis.result import Diagnosis
from ..names import at_place, base_name
from ..numbers import nats, percent
from ..tried import worth_showing
from .style import BAND, DASHED, HELD_OUT, INK, MODEL, RESIDUAL, blank, styled

_ROW, _MARGIN = 0.36, 0.85  # inches
_LINEAR = 3.0  # nats up to which the scale is linear
_ROOM = 2.0  # of the longest bar, beyond its end, for its number


@styled
def candidates(found: Diagnosis, *, narrow: bool = False) -> Figure:
    """What might be missing in the base model: probability, and log evidence.

    A bar of the second panel is how many nats the base model with this candidate alone is behind
    the best model of all (of the base model without any, in the last row). Up to the dashed line
    two models cannot be told apart. What was added is orange.
    """
    shown = worth_showing(found)
    joints, base = found.fit.joints, found.ladder[0]
    names = [at_place(c.effect, joints, comma=True) for c in shown]
    rows = len(shown) + 1
    panel = _ROW * rows + _MARGIN
    shape = (2, 1) if narrow else (1, 2)
    figure = blank(narrow, 2 * panel + 0.45 if narrow else panel + 0.3)
    widths = None if narrow else (2, 3)
    likely, behind = figure.subplots(*shape, sharey=not narrow, width_ratios=widths)
    fills = [RESIDUAL if c.effect in found.added else MODEL for c in shown]
    place = range(len(shown))

    percents = [100 * c.probability for c in shown]
    likely.barh(place, [100.0] * len(shown), 0.5, color=BAND, alpha=0.5, zorder=1)
    likely.barh(place, percents, 0.5, color=fills, zorder=2)
    for y, share, c in zip(place, percents, shown, strict=True):
        _at_end(likely, share, y, percent(c.probability))
    likely.set(xlim=(0, 130), xlabel="probability (%)", title="how probable")
    likely.set_xticks([0, 50, 100])

    lag = [max(0.0, -x.log_evidence) for x in (*shown, base)]
    own = [c if s.iterated else HELD_OUT for c, s in zip(fills, shown, strict=True)]
    behind.set_xscale("symlog", linthresh=_LINEAR, linscale=0.7)
    behind.barh(range(rows), lag, 0.5, color=[*own, BAND], zorder=2)
    for y, x in enumerate(lag):
        _at_end(behind, x, y, nats(x))
    most = max([x for x in lag if math.isfinite(x)] + [_LINEAR])
    behind.set_xlim(0, most * (1 + _ROOM))
    ticks = [x for x in (0, 3, 10, 100, 1e3, 1e4, 1e5, 1e6) if x <= most * (1 + _ROOM)]
    behind.xaxis.set_major_locator(FixedLocator(ticks))
    behind.xaxis.set_minor_locator(NullLocator())
    behind.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}".replace(",", "\u202f"))
    behind.axvline(INDISTINGUISHABLE, color=INK, lw=1.0, ls=DASHED, zorder=3)
    behind.set(xlabel="nats behind the best model", title="log evidence")
    for ax in (likely, behind):
        words = [*names, f"none: {base_name(base.fit)}"]
        if narrow:
            words = [n.replace(", ", ",\n").replace(": ", ":\n") for n in words]
        ax.set_yticks(range(rows), words)
        ax.tick_params(axis="y", length=0, labelsize=8 if narrow else 9)
        ax.set_ylim(rows - 0.4, -0.6)
    if not narrow:
        behind.tick_params(axis="y", labelleft=False)
    colours = {RESIDUAL: "added", MODEL: "tried", HELD_OUT: "to first order only"}
    if not found.added:
        del colours[RESIDUAL]
    if all(c.iterated for c in shown):
        del colours[HELD_OUT]
    keys: list[Artist] = [Patch(color=colour, label=words) for colour, words in colours.items()]
    keys.append(Line2D([], [], color=INK, lw=1.0, ls=DASHED, label="odds of 20 to 1"))
    figure.legend(handles=keys, loc="outside lower right", ncols=2 if narrow else 4)
    return figure


def _at_end(ax: Axes, x: float, y: int, words: str) -> None:
    x = x if math.isfinite(x) else 0.0
    over = {"fc": "white", "ec": "none", "pad": 1.0} if x > 0 else None  # the dashed line
    ax.annotate(words, (x, y), xytext=(4, 0), textcoords="offset points", va="center", bbox=over)
