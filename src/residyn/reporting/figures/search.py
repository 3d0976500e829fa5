"""How searches bring the objective down, simulation by simulation."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from ...fitting.history import History
from ..numbers import plain
from .style import INK, JOINTS, SOFT, WILD, blank, styled

_COLOURS = (JOINTS[0], JOINTS[1], JOINTS[2], WILD, "#e69f00", "#56b4e9", SOFT)
_DASHES = ("-", "-", "-", "-", (0, (5, 2)), (0, (5, 2)), (0, (5, 2)))
_LONG = 1000.0  # times: a fall beyond which only whole powers of ten are named


@styled
def convergence(
    histories: Sequence[History],
    names: Sequence[str],
    *,
    floor: float | None = None,
    label: str = "objective of Eq. 17 (relative error, 1)",
    against: str = "simulations",
    narrow: bool = False,
) -> Figure:
    """The best objective `against` the "simulations" or the "seconds" spent, both on logarithmic
    scales.

    A genetic algorithm's history is that of its fit (`Fit.history`), that of any method is in its
    runs of a `Race`. `floor` is an objective to draw a line at, such as that which the noise of the
    readings alone leaves.
    """
    columns = 1 if narrow else 2
    figure = blank(narrow, 2.6 + 0.2 * -(-len(names) // columns))
    ax = figure.subplots()
    values = []
    for i, (history, name) in enumerate(zip(histories, names, strict=True)):
        colour, dash = _COLOURS[i % len(_COLOURS)], _DASHES[i % len(_DASHES)]
        spent = history.simulations if against == "simulations" else history.seconds
        y = np.asarray(history.objective, float)
        x = np.full(y.shape, np.nan) if spent is None else np.asarray(spent, float)
        use = np.isfinite(y) & (y > 0) & (x > 0)
        values += [y[use].min(), y[use].max()] if use.any() else []
        # Named in the SVG, so that a page can hide it.
        line = {"color": colour, "ls": dash, "lw": 1.8, "gid": f"{against}-curve-{i}"}
        ax.step(x[use], y[use], where="post", label=name, **line)
        end = {"color": colour, "ms": 5, "clip_on": False, "gid": f"{against}-end-curve-{i}"}
        ax.plot(x[use][-1:], y[use][-1:], "o", **end)
    ax.set(xscale="log", yscale="log")
    if floor is not None:
        ax.axhline(floor, color=INK, lw=1.0, zorder=0)
        below: dict[str, Any] = {"ha": "right", "va": "top", "color": SOFT}
        at = ("axes fraction", "data")
        ax.annotate("what the noise leaves", (1.0, floor), (0, -4), at, "offset points", **below)
        values.append(floor / 1.3)
    if values:
        ax.set_ylim(min(values) / 1.25, max(values) * 1.25)
        few = max(values) > _LONG * min(values)
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0,) if few else (1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(lambda y, _: plain(y, 1))
    ax.yaxis.set_minor_formatter(NullFormatter())
    if against == "simulations":
        ax.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}".replace(",", "\u202f"))
        ax.set_xlabel("simulations of the recordings")
    else:
        ax.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        ax.set_xlabel("seconds")
    ax.set_ylabel(label)
    figure.legend(loc="outside upper left", ncols=columns)
    return figure
