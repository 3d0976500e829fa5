"""The motion beside the model, and the residual under it on a scale of its own."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ...fitting.result import Fit, Mode, RecordingFit
from ..numbers import prefixed
from .style import (
    BAND,
    DASHED,
    FAINT,
    MEASURED,
    MODEL,
    NARROW,
    RESIDUAL,
    SHADE,
    WIDE,
    WILD,
    largest,
    shortened,
    styled,
)

_ZOOM_CYCLES = 10
_POINTS_PER_INCH = 160


class _Layout(NamedTuple):
    """Distances in inches: fixed, so that all panels of a page stand exactly under each other."""

    width: float
    left: float
    between: float  # of the two columns
    columns: tuple[float, ...]  # their widths
    key: int  # columns of the legend
    title: float = 0.3
    main: float = 1.25
    gap: float = 0.07
    strip: float = 0.62
    below: float = 0.16  # a joint's strip
    axis: float = 0.42  # time's numbers and label
    label: float = 0.6  # from an axis to its label

    def legend(self, entries: int) -> float:
        """Height of the legend."""
        return 0.1 + 0.19 * -(-entries // self.key)

    def height(self, joints: int) -> float:
        """Height of one recording."""
        joint = self.main + self.gap + self.strip + self.below
        return self.title + joints * joint + self.axis


_WIDE = _Layout(WIDE, 0.98, 0.62, (4.6, 2.28), key=5)
_NARROW = _Layout(NARROW, 0.95, 0.0, (2.63,), key=2, main=1.1, strip=0.6, label=0.57)


@styled
def overlay(
    fit: Fit, recordings: Sequence[RecordingFit] | None = None, *, narrow: bool = False
) -> Figure:
    """Measured against model for each recording and joint, and the residual under each.

    A wide figure has a second column with the end of the record on its own scale, where an error of
    frequency or damping has had the most time to grow. Lost samples are gaps; readings that the fit
    set aside as wild are marked, at the edge of a panel if they lie beyond it.

    **Arguments:** `recordings`: which of `fit.whole` to draw; all if not given.
    """
    shown = tuple(fit.whole if recordings is None else recordings)
    joints = len(fit.experiment.joints)
    lay = _NARROW if narrow else _WIDE
    handles = _key(any(each.wild.any() for each in shown))
    top = len(shown) * lay.height(joints)
    figure = Figure(figsize=(lay.width, lay.legend(len(handles)) + top))
    for each in shown:
        time = each.recording.time
        zoom = slice(_zoom_start(time, fit.modes), None)
        windows = (slice(None), zoom)[: len(lay.columns)]
        top -= lay.title
        for joint in range(joints):
            left = lay.left
            for width, window in zip(lay.columns, windows, strict=True):
                main = _axes(figure, left, top - lay.main, width, lay.main)
                low = top - lay.main - lay.gap - lay.strip
                strip = _axes(figure, left, low, width, lay.strip)
                strip.sharex(main)
                _draw(main, strip, fit, each, joint, window)
                main.tick_params(labelbottom=False)
                strip.tick_params(labelbottom=joint == joints - 1)
                if window is zoom:
                    main.set_ylabel("")
                    strip.set_ylabel("")
                elif len(windows) > 1:
                    for ax in (main, strip):
                        ax.axvspan(time[zoom][0], time[-1], color=SHADE, lw=0, zorder=-5)
                if joint == 0:
                    last = f"the last {time[-1] - time[zoom][0]:.2g} s, enlarged"
                    main.set_title(last if window is zoom else _heading(each, narrow))
                if joint == joints - 1:
                    strip.set_xlabel("time (s)")
                for ax in (main, strip):
                    ax.yaxis.set_label_coords(-lay.label / width, 0.5)
                left += width + lay.between
            top -= lay.main + lay.gap + lay.strip + lay.below
        top -= lay.axis
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.1 / lay.width, 1 - 0.06 / figure.get_figheight()),
        borderaxespad=0.0,
        ncols=lay.key,
    )
    return figure


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def _key(wild: bool) -> list[Any]:
    handles: list[Any] = [
        Line2D([], [], color=MEASURED, lw=2.6, label="measured"),
        Line2D([], [], color=MODEL, lw=1.2, label="model"),
        Line2D([], [], color=RESIDUAL, lw=1.2, label="residual"),
        Patch(color=BAND, label="±2σ of noise"),
    ]
    if wild:
        handles.append(Line2D([], [], color=WILD, marker="x", ls="", mew=1.4, label="wild reading"))
    return handles


def _heading(each: RecordingFit, narrow: bool) -> str:
    """Which recording this is; of a long name, the end."""
    most = 24 if narrow else 50
    role = "held out" if each.recording.role == "check" else "fitted"
    return f"{shortened(each.recording.name, most)}: {role}"


def _zoom_start(time: np.ndarray, modes: Sequence[Mode]) -> int:
    """First sample of the last quarter, or of fewer seconds where that still rings many times."""
    length = 0.25 * (time[-1] - time[0])
    ringing = [m.frequency_hz for m in modes if m.frequency_hz > 0]
    if ringing:
        length = min(length, _ZOOM_CYCLES / min(ringing))
    return int(min(np.searchsorted(time, time[-1] - length), max(0, len(time) - 8)))


def _draw(main: Axes, strip: Axes, fit: Fit, each: RecordingFit, joint: int, window: slice) -> None:
    """One joint of one recording over one window of samples."""
    units, name = fit.experiment.units, shortened(fit.experiment.joints[joint], 14)
    unit = units[joint] if units else None
    time = each.recording.time[window]
    good = np.where(each.wild, np.nan, each.recording.angle)
    alike = [j for j in range(good.shape[1]) if not units or units[j] == unit]
    factor, label = prefixed(unit, largest(good[:, alike]))
    measured = each.recording.angle[window, joint] / factor
    kept, model = good[window, joint] / factor, each.predicted[window, joint] / factor
    broad = _breadth(time, main, fit.modes)
    main.plot(*_thinned(time, kept, main), color=MEASURED, lw=2.6 * broad, zorder=2)
    main.plot(*_thinned(time, model, main), color=MODEL, lw=1.0 * broad, zorder=3)
    main.set_xlim(time[0], time[-1])
    sigma = float(np.asarray(each.recording.noise)[joint])
    low, high = _range(np.concatenate([kept, model]), 8 * sigma / factor)
    main.set_ylim(low, high)
    main.set_ylabel(f"{name}\n({label})" if label else name)
    main.yaxis.set_major_locator(MaxNLocator(4))
    main.xaxis.set_major_locator(MaxNLocator(5))

    residual = good - each.predicted
    # A third: a residual reads best in the smaller unit.
    factor, label = prefixed(unit, max(largest(residual[:, alike]), 3 * sigma) / 3)
    left, sigma = residual[window, joint] / factor, sigma / factor
    strip.axhspan(-2 * sigma, 2 * sigma, color=BAND, lw=0, zorder=0)
    strip.axhline(0, color=FAINT, lw=0.6, zorder=1)
    for edge in (-2 * sigma, 2 * sigma):  # seen through a residual that fills the band
        strip.axhline(edge, color=FAINT, lw=0.5, ls=DASHED, zorder=3)
    strip.plot(*_thinned(time, left, strip), color=RESIDUAL, lw=0.8, zorder=2)
    reach = 1.08 * max(largest(left), 3 * sigma)
    strip.set_ylim(-reach, reach)
    strip.set_ylabel(f"residual\n({label})" if label else "residual")
    strip.yaxis.set_major_locator(MaxNLocator(3, symmetric=True, min_n_ticks=3))

    for ax in (main, strip):
        ax.ticklabel_format(axis="y", style="plain", useOffset=False)

    wild = each.wild[window, joint]
    off = (each.recording.angle - each.predicted)[window, joint] / factor
    for ax, values, limits in ((main, measured, (low, high)), (strip, off, (-reach, reach))):
        inside = np.clip(values[wild], *limits)
        size = 5 if wild.sum() <= 20 else 3
        ax.plot(time[wild], inside, "x", color=WILD, ms=size, mew=1.2, zorder=4, clip_on=False)


def _range(values: np.ndarray, least: float) -> tuple[float, float]:
    """Limits of a scale; at least so far apart, or a joint at rest would show its noise alone."""
    values = values[np.isfinite(values)]
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    margin = max(0.08 * (high - low), (least - (high - low)) / 2)
    return low - margin, high + margin


def _inches(ax: Axes) -> float:
    figure = ax.get_figure(root=True)
    assert figure is not None
    return ax.get_position().width * figure.get_size_inches()[0]


def _breadth(time: np.ndarray, ax: Axes, modes: Sequence[Mode]) -> float:
    """Factor on line widths: dense ringing needs thinner lines."""
    slowest = min((m.frequency_hz for m in modes if m.frequency_hz > 0), default=0.0)
    per_inch = (time[-1] - time[0]) * slowest / _inches(ax)
    return float(np.clip(6.0 / max(per_inch, 1e-9), 0.35, 1.0))


def _thinned(time: np.ndarray, values: np.ndarray, ax: Axes) -> tuple[np.ndarray, np.ndarray]:
    """The least and greatest value of each small stretch: it looks the same and takes less ink.

    A stretch with a lost sample keeps a gap.
    """
    stretch = int(2 * len(time) / (_POINTS_PER_INCH * _inches(ax)))
    if stretch <= 2:
        return time, values
    count = len(time) // stretch
    head = count * stretch
    blocks = values[:head].reshape(count, stretch)
    lost = np.isnan(blocks)
    least = np.argmin(np.where(lost, np.inf, blocks), axis=1)
    most = np.argmax(np.where(lost, -np.inf, blocks), axis=1)
    index = np.sort(np.stack([least, most], axis=1), axis=1)
    picked = (index + stretch * np.arange(count)[:, None]).ravel()
    thin = values[picked]
    thin[1::2][lost.any(axis=1)] = np.nan
    return np.append(time[picked], time[head:]), np.append(thin, values[head:])
