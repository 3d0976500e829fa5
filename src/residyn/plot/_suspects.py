"""The suspects: how likely each is, and what it takes away."""

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..diagnosis.printed import at_place, percent, worth_showing
from ..diagnosis.result import Diagnosis
from ._style import BAND, DASHED, HELD_OUT, INK, MODEL, NARROW, RESIDUAL, WIDE, styled

_ROW, _MARGIN = 0.42, 0.85  # inches
_MOST = 8


@styled
def suspects(found: Diagnosis, *, narrow: bool = False) -> Figure:
    """What might be missing in the base model: probability, and the fall of chi-square.

    The thin bar is the fall as screened, to first order; the thick one is what is true once the
    whole model was fitted again. What the ladder accepted is orange.
    """
    shown = worth_showing(found, _MOST)
    names = [at_place(c.effect, found.fit.joints) for c in shown]
    panel = _ROW * max(len(shown), 1) + _MARGIN
    shape = (2, 1) if narrow else (1, 2)
    size = (NARROW, 2 * panel + 0.35) if narrow else (WIDE, panel + 0.3)
    figure = Figure(figsize=size, layout="constrained")
    likely, falls = figure.subplots(
        *shape, sharey=not narrow, width_ratios=None if narrow else (2, 3)
    )
    colours = [RESIDUAL if c.effect in found.added else MODEL for c in shown]
    place = range(len(shown))

    chances = [100 * c.probability for c in shown]
    likely.barh(place, [100.0] * len(shown), 0.5, color=BAND, alpha=0.5, zorder=1)
    likely.barh(place, chances, 0.5, color=colours, zorder=2)
    for y, chance, c in zip(place, chances, shown, strict=True):
        _at_end(likely, chance if math.isfinite(chance) else 0.0, y, percent(c.probability))
    likely.set(xlim=(0, 130), xlabel="probability (%)", title="how likely")
    likely.set_xticks([0, 50, 100])

    tried = [c.chi2_drop_refit for c in shown]
    refit = [math.nan if x is None else max(x, 0.0) for x in tried]
    screened = [max(c.chi2_drop_screened, 0.0) for c in shown]
    falls.barh(
        [y - 0.16 for y in place], refit, 0.34, color=colours, zorder=2, label="fitted again"
    )
    falls.barh(
        [y + 0.16 for y in place],
        screened,
        0.11,
        color=HELD_OUT,
        zorder=2,
    )
    for y, one, other in zip(place, refit, screened, strict=True):
        if not math.isfinite(one):
            _at_end(falls, other if math.isfinite(other) else 0.0, y, "not tried")
    total = _beyond_noise(found)
    seen = [x for x in (*refit, *screened, total) if math.isfinite(x)]
    falls.set_xlim(0, (1.6 if narrow else 1.3) * max(seen, default=1.0) or 1.0)
    falls.set(xlabel="fall of chi-square", title="what it takes away")
    falls.xaxis.set_major_locator(MaxNLocator(3 if narrow else 4))
    falls.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}".replace(",", "\u202f"))
    if total > 0:
        falls.axvline(total, color=INK, lw=1.0, ls=DASHED, zorder=3)
    for ax in (likely, falls):
        rows = [n.replace(" at the", "\nat the") for n in names] if narrow else names
        ax.set_yticks(place, rows)
        ax.tick_params(axis="y", length=0, labelsize=8 if narrow else 9)
        ax.set_ylim(len(shown) - 0.4, -0.6)
    if not narrow:
        falls.tick_params(axis="y", labelleft=False)
    keys: list[Any] = [
        Patch(color=MODEL, label="fitted again"),
        Patch(color=HELD_OUT, label="as screened"),
    ]
    if total > 0:
        keys.append(Line2D([], [], color=INK, lw=1.0, ls=DASHED, label="down to the noise"))
    figure.legend(handles=keys, loc="outside lower right", ncols=1 if narrow else 3)
    return figure


def _at_end(ax: Axes, x: float, y: int, words: str) -> None:
    ax.annotate(words, (x, y), xytext=(4, 0), textcoords="offset points", va="center")


def _beyond_noise(found: Diagnosis) -> float:
    """By how much chi-square exceeds what noise alone would leave, in the base model."""
    fit = found.base
    readings = sum(int(r.used.sum()) for r in fit.recordings if r.recording.role != "check")
    return max(0.0, (fit.reduced_chi2 - 1.0) * readings)
