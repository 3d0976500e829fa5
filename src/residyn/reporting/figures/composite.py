"""Composite inertias against the elbow angle's cosine: Eq. 14 is a straight line."""

import numpy as np
from matplotlib.figure import Figure

from ...procedure import InertiaResult
from .style import FAINT, INK, MEASURED, MODEL, NARROW, WIDE, styled


@styled
def composite_inertia(found: InertiaResult, *, narrow: bool = False) -> Figure:
    """What each test of the shoulder turned, bearings on, and the line of the inertias (Eq. 14).

    Its slope is 2 l1 coupling. Grey bars are two standard errors to each side; the band is that of
    the line.
    """
    figure = Figure(figsize=(NARROW if narrow else WIDE, 2.8), layout="constrained")
    ax = figure.subplots()
    cosines = np.linspace(-1.0, 1.0, 60)
    line = [found.composite(float(np.arccos(c))) for c in cosines]
    value, std = (np.array(x) for x in zip(*line, strict=True))
    ax.fill_between(
        cosines,
        (value - 2 * std),
        (value + 2 * std),
        color=MODEL,
        alpha=0.3,
        lw=0,
    )
    ax.plot(cosines, value, color=MODEL, lw=1.2, label="Eq. 14")
    shoulder = [t for t in found.tests if t.test.joint == 0 and t.test.recording.air_bearings]
    at = [float(np.cos(t.test.theta2)) for t in shoulder]
    seen = [t.inertia.value for t in shoulder]
    ax.errorbar(
        at,
        seen,
        yerr=[2 * t.inertia.std for t in shoulder],
        fmt="o",
        ms=5,
        color=INK,
        ecolor=MEASURED,
        elinewidth=2.6,
        label="tests, ±2 standard errors",
        zorder=3,
    )
    ax.axvline(0, color=FAINT, lw=0.6, zorder=0)
    ax.set_xlim(-1.08, 1.08)
    ax.set_xlabel("cosine of the elbow angle")
    ax.set_ylabel("inertia about\nthe shoulder (kg m²)")
    figure.legend(loc="outside upper left", ncols=1 if narrow else 2)
    return figure
