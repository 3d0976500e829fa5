"""A law without a name, drawn against its variable."""

import numpy as np
from matplotlib.figure import Figure

from ...diagnosis.law import Law
from ..laws import variable
from ..names import lower, title
from .style import BAND, DASHED, FAINT, INK, JOINTS, RESIDUAL, SHADE, blank, styled


@styled
def law(found: Law, *, narrow: bool = False) -> Figure:
    """A free curve with its 95 % band over the visited range, and through it the named laws of the
    same variable, each fitted alone; below it, how often the range was visited.

    All are drawn less the line (of a stiffness or damping: less the constant) that springs and
    dampers take up.
    """
    figure = blank(narrow, 4.4 if narrow else 4.2)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(6, 1))
    x, y, band = found.grid, found.mean, 1.96 * found.std
    above.fill_between(x, y - band, y + band, color=BAND, lw=0, label="95 % band")
    above.plot(x, y, color=INK, lw=1.4, label="free curve")
    if found.formula is not None and found.found is not None:
        effect = found.found.kind()(found.joint)  # pyrefly: ignore[bad-argument-count]
        above.plot(x, found.values(effect), color=RESIDUAL, lw=1.2, label="formula")
    for (label, values), colour in zip(found.named, (JOINTS[0], *JOINTS[2:]), strict=False):
        above.plot(x, values, color=colour, lw=1.0, ls=DASHED, label=lower(title(label)))
    above.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
    size = 1.15 * float(np.max(np.abs(y) + band)) or 1.0
    above.set(ylabel=f"at the {found.joint} ({found.unit})", ylim=(-size, size))
    below.fill_between(x, 0.0, found.visits, color=SHADE, step="mid")
    below.step(x, found.visits, where="mid", color=FAINT, lw=0.7)
    below.set(xlabel=f"{variable(found)} ({found.variable_unit})", yticks=(), ylabel="visits")
    figure.legend(
        *above.get_legend_handles_labels(), loc="outside lower left", ncols=1 if narrow else 4
    )
    return figure
