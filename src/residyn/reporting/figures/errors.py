"""How far each of several models is from the noise."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ...fitting.result import Fit
from ..numbers import plain, prefixed, ratio
from .style import DASHED, HELD_OUT, INK, MODEL, NARROW, WIDE, largest, styled


@styled
def errors(fits: Sequence[Fit], names: Sequence[str], *, narrow: bool = False) -> Figure:
    """The error of several models, per joint, beside the noise of a reading.

    A bar is the rms of measured minus model. One that ends at the dashed line leaves nothing that
    the recording could still show.
    """
    joints = fits[0].experiment.joints
    units = fits[0].experiment.units or (None,) * len(joints)
    bars = 2 if any(f.check_rmse is not None for f in fits) else 1
    panel = (0.3 * bars + 0.22) * len(fits) + 0.75
    rows, columns = (len(joints), 1) if narrow else (1, len(joints))
    width = NARROW if narrow else WIDE
    figure = Figure(figsize=(width, rows * panel + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=not narrow, squeeze=False).ravel()
    for joint, ax in enumerate(axes):
        noise, check_noise = (_noise(fits[0], joint, held_out) for held_out in (False, True))
        fitted = [float(f.rmse[joint]) for f in fits]
        kinds = [("fitted recordings", MODEL, noise, fitted)]
        if bars == 2:
            held = [f.check_rmse for f in fits]
            values = [float("nan") if h is None else float(h[joint]) for h in held]
            kinds.append(("held-out recordings", HELD_OUT, check_noise, values))
        longest = max(largest(np.asarray(values)) for *_, values in kinds)
        factor, label = prefixed(units[joint], longest)
        for kind, (words, colour, own, values) in enumerate(kinds):
            place = np.arange(len(fits)) + (kind - (bars - 1) / 2) * 0.38
            ax.barh(place, np.asarray(values) / factor, 0.34, color=colour, label=words, zorder=2)
            for y, value in zip(place, values, strict=True):
                if np.isfinite(value):
                    size = f"{plain(value / factor, 2)} {label}".strip()
                    ax.annotate(
                        f"{size} = {ratio(value / own)} × noise",
                        (max(value, noise) / factor, y),
                        xytext=(5, 0),
                        textcoords="offset points",
                        va="center",
                    )
        ax.axvline(noise / factor, color=INK, lw=1.1, ls=DASHED, zorder=3, label="noise")
        ax.set_ylim(len(fits) - 0.5, -0.5)
        # Room for the words beside the longest bar.
        ax.set_xlim(0, longest / factor * (2.7 if narrow else 1.75))
        ax.xaxis.set_major_locator(MaxNLocator(4))
        ax.set_yticks(range(len(fits)), [_broken(n, 18 if narrow else 26) for n in names])
        ax.tick_params(axis="y", length=0)
        ax.set_title(joints[joint])
        ax.set_xlabel(f"rms residual ({label})" if label else "rms residual")
    handles, _ = axes[0].get_legend_handles_labels()
    handles = [*handles[1:], handles[0]]  # the line after the bars
    figure.legend(handles=handles, loc="outside upper left", ncols=2 if narrow else 3)
    return figure


def _noise(fit: Fit, joint: int, held_out: bool) -> float:
    """Sigma of a reading in the fitted or in the held-out recordings; NaN if there are none."""
    each = [r.recording for r in fit.recordings if (r.recording.role == "check") == held_out]
    return float(np.sqrt(np.mean([r.noise[joint] ** 2 for r in each]))) if each else float("nan")


def _broken(words: str, most: int) -> str:
    """A long name in lines of at most so many characters, broken at spaces and colons."""
    lines: list[str] = []
    for word in words.replace(":", ":\0").replace(" ", "\0 ").split("\0"):
        if lines and len(lines[-1]) + len(word) <= most:
            lines[-1] += word
        else:
            lines.append(word.lstrip())
    return "\n".join(lines)
