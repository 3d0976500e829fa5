"""Step 1: composite inertias on the line of Eq. 14. Step 3: the same release with and without air
bearings."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ...procedure import InertiaResult, Unloading
from ...procedure.ringdown import RingDown
from ..numbers import prefixed
from .style import FAINT, INK, MEASURED, MODEL, RESIDUAL, blank, largest, shortened, styled


@styled
def composite_inertia(found: InertiaResult, *, narrow: bool = False) -> Figure:
    """What each test of the shoulder turned, bearings on, and the line of the inertias (Eq. 14).

    Its slope is 2 l1 coupling. Grey bars are two standard errors to each side; the band is that of
    the line.
    """
    figure = blank(narrow, 2.8)
    ax = figure.subplots()
    cosines = np.linspace(-1.0, 1.0, 60)
    line = [found.composite(float(np.arccos(c))) for c in cosines]
    value, std = np.array([(x.value, x.std) for x in line]).T
    ax.fill_between(cosines, value - 2 * std, value + 2 * std, color=MODEL, alpha=0.3, lw=0)
    ax.plot(cosines, value, color=MODEL, lw=1.2, label="Eq. 14")
    shoulder = [t for t in found.tests if t.test.joint == 0 and t.test.recording.air_bearings]
    at = [np.cos(t.test.theta2) for t in shoulder]
    seen, bars = [t.inertia.value for t in shoulder], [2 * t.inertia.std for t in shoulder]
    style = {"fmt": "o", "ms": 5, "color": INK, "ecolor": MEASURED, "elinewidth": 2.6, "zorder": 3}
    ax.errorbar(at, seen, yerr=bars, label="tests, ±2 standard errors", **style)
    ax.axvline(0, color=FAINT, lw=0.6, zorder=0)
    ax.set(xlim=(-1.08, 1.08), xlabel="cosine of the elbow angle")
    ax.set_ylabel("inertia about\nthe shoulder (kg m²)")
    figure.legend(loc="outside upper left", ncols=1 if narrow else 2)
    return figure


_THIN = 0.01  # share of the scale below which a band is no broader than its line, and is not drawn
_SIDES = (("on its bearings", MODEL), ("without bearings", RESIDUAL))


@styled
def ring_down(
    found: Unloading, sides: tuple[RingDown, RingDown] | None = None, *, narrow: bool = False
) -> Figure:
    """How the arm rings after the release of the first fitted recording, on its air bearings and
    without them, each with the band that holds it with 95 %, per joint.

    No band is drawn where the recordings leave a number open, or where it is thinner than the line.

    **Arguments:** `sides`: of `found.ring_downs()`, if they are there already.
    """
    sides = sides or found.ring_downs()
    times = np.asarray(sides[0].path.t)
    joints, units = found.fit.joints, found.fit.experiment.units
    figure = blank(narrow, 0.62 + 1.75 * len(joints))
    axes = figure.subplots(len(joints), 1, sharex=True, squeeze=False).ravel()
    for joint, ax in enumerate(axes):
        most = largest(np.concatenate([np.asarray(side.path.q)[:, joint] for side in sides]))
        factor, label = prefixed(units[joint] if units else None, most)
        reach = 1.15 * most / factor or 1.0
        ax.set_ylim(-reach, reach)
        ax.axhline(0, color=FAINT, lw=0.6, zorder=0)
        for side, (_, colour) in zip(sides, _SIDES, strict=True):
            _draw(ax, times, side, joint, factor, colour)
        ax.set_xlim(times[0], times[-1])
        ax.set_ylabel(f"angle ({label})" if label else "angle")
        ax.yaxis.set_major_locator(MaxNLocator(4))
        ax.set_title(shortened(joints[joint], 30))
    axes[-1].set_xlabel("time after the release (s)")
    handles: list = [Line2D([], [], color=colour, lw=1.4, label=words) for words, colour in _SIDES]
    if any(ax.collections for ax in axes):
        handles.append(Patch(color=FAINT, alpha=0.5, lw=0, label="95 % band"))
    figure.legend(handles=handles, loc="outside upper left", ncols=2 if narrow else 3)
    return figure


def _draw(ax: Axes, times: np.ndarray, side: RingDown, joint: int, factor: float, colour: str):
    if side.low is not None and side.high is not None:
        low, high = side.low[:, joint] / factor, side.high[:, joint] / factor
        if np.max(high - low) > _THIN * np.ptp(ax.get_ylim()):
            ax.fill_between(times, low, high, color=colour, alpha=0.3, lw=0, zorder=1)
    ax.plot(times, np.asarray(side.path.q)[:, joint] / factor, color=colour, lw=1.0, zorder=2)
