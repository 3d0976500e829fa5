"""Where a model fails, and how its error grows: the tables of a comparison as pictures."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...diagnosis import Comparison
from ...diagnosis.residuals import Part
from ..numbers import plain, prefixed
from .style import DASHED, INK, JOINTS, NARROW, WIDE, styled

_LOG = 4.0  # from this range on the errors ahead are on a logarithmic scale


@styled
def where(compared: Comparison, *, narrow: bool = False) -> Figure:
    """The residual in times the noise: along time, by amplitude of the swing, by frequency.

    A bar that ends at the dashed line is what noise alone would leave.
    """
    at = compared.where
    shape = (3, 1) if narrow else (1, 3)
    figure = Figure(figsize=(NARROW, 8.6) if narrow else (WIDE, 3.3), layout="constrained")
    time, swing, band = figure.subplots(*shape).ravel()
    _bars(time, [f"{plain(p.start, 2)}-{plain(p.stop, 2)}" for p in at.time], at.time, at.joints)
    cut = any(r.recording.segment_of is not None for r in compared.fit.recordings)
    since = "stretch's start" if cut else "start"
    time.set(xlabel=f"time since the {since} (s)", title="when")
    _by_swing(swing, compared)
    swing.set(title="at which swing")
    names = [p.name for p in at.frequency]
    names = [
        name if name and names.count(name) == 1 else f"{plain(p.start, 2)}-{plain(p.stop, 2)} Hz"
        for name, p in zip(names, at.frequency, strict=True)
    ]
    _bars(band, names, at.frequency, at.joints)
    band.set(xlabel="band of frequencies", title="at which frequency")
    if max((c.ratio for p in at.frequency for c in p.cells if c.ratio == c.ratio), default=0) > 20:
        band.set_yscale("log")
        band.yaxis.set_major_formatter(lambda x, _: plain(x, 1))
    for ax in (time, swing, band):
        ax.axhline(1.0, color=INK, lw=1.0, ls=DASHED, zorder=3)
        ax.set_ylabel("residual / noise")
        ax.tick_params(axis="x", labelrotation=90 if ax is band else 45, labelsize=8)
    handles, labels = time.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    return figure


def _bars(ax: Axes, names: Sequence[str], parts: Sequence[Part], joints: Sequence[str]) -> None:
    width = 0.8 / len(joints)
    for j, joint in enumerate(joints):
        place = np.arange(len(parts)) + (j - (len(joints) - 1) / 2) * width
        heights = [p.cells[j].ratio for p in parts]
        ax.bar(place, heights, 0.92 * width, color=JOINTS[j % len(JOINTS)], label=joint)
    ax.set_xticks(range(len(parts)), names)


def _by_swing(ax: Axes, compared: Comparison) -> None:
    """Lines, as every joint has ranges of its own."""
    at = compared.where
    largest = max((p.stop for parts in at.amplitude for p in parts), default=1.0)
    same = len(set(at.units)) == 1
    size, unit = prefixed(at.units[0] or None, largest) if same else (1.0, "rad or m")
    for j, (joint, parts) in enumerate(zip(at.joints, at.amplitude, strict=True)):
        middle = [0.5 * (p.start + p.stop) / size for p in parts]
        height = [p.whole.ratio for p in parts]
        ax.plot(middle, height, "o-", color=JOINTS[j % len(JOINTS)], label=joint)
    ax.set_xlim(left=0)
    ax.set_ylim(0, 1.08 * ax.get_ylim()[1])
    ax.set_xlabel(f"amplitude of the swing ({unit})" if unit else "amplitude of the swing")


@styled
def horizon(compared: Comparison, *, narrow: bool = False) -> Figure:
    """How the error grows while the first third of each recording predicts the rest.

    Thin dashed lines: what a right model would leave, given the noise in the third it knew.
    """
    found = compared.horizon
    if found is None:
        raise ValueError("this comparison has no horizon: the fit of the first third did not end")
    figure = Figure(figsize=(NARROW if narrow else WIDE, 3.0), layout="constrained")
    ax = figure.subplots()
    ahead = np.array([0.5 * (a.start + a.stop) for a in found.ahead])
    for j, joint in enumerate(compared.fit.joints):
        colour = JOINTS[j % len(JOINTS)]
        ratio = [a.error.ratio[j] for a in found.ahead]
        ax.plot(ahead, ratio, "o-", color=colour, ms=4, label=joint)
        ax.plot([0.0], [found.fitted.ratio[j]], "s", color=colour, ms=5, clip_on=False)
        if all(a.error.expected is not None for a in found.ahead):
            right = [a.error.expected[j] for a in found.ahead if a.error.expected is not None]
            ax.plot(ahead, right, color=colour, lw=0.9, ls=DASHED)
    ax.axhline(1.0, color=INK, lw=0.8, zorder=0)
    ax.set(
        xlabel=f"time after the fitted third of {plain(found.seconds, 2)} s (s)",
        ylabel="prediction error / noise",
    )
    each = [a.error.ratio for a in found.ahead]
    if np.nanmax(each) > _LOG * np.nanmin(each):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(lambda x, _: plain(x, 1))
        ax.yaxis.set_minor_formatter(lambda x, _: "")
    else:
        ax.set_ylim(0, 1.08 * ax.get_ylim()[1])
    ax.set_xlim(left=0)
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))
    return figure
