"""The motion beside the model, and at which frequencies something is left."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from ...fitting.result import Fit, Mode, RecordingFit
from ..names import HELD_OUT
from ..numbers import plain, prefixed
from .style import (
    BAND,
    DASHED,
    FAINT,
    INK,
    MEASURED,
    MODEL,
    RESIDUAL,
    SHADE,
    WILD,
    blank,
    largest,
    shortened,
    styled,
)

_ZOOM_CYCLES = 10
_POINTS_PER_INCH = 110
_PANEL, _HEAD, _KEY = 2.0, 0.75, 0.35
"""Inches: the height of a joint, of a recording's title and time axis, and of the legend."""


@styled
def overlay(
    fit: Fit, recordings: Sequence[RecordingFit] | None = None, *, narrow: bool = False
) -> Figure:
    """Measured against model for each recording and joint, and the residual under each.

    A wide figure has a second column with the end of the record on its own scale, where an error of
    frequency or damping has had the most time to grow. Lost samples are gaps; readings that the fit
    set aside as outliers are marked, at the edge of a panel if they lie beyond it.

    **Arguments:** `recordings`: which of `fit.whole` to draw; all if not given.
    """
    shown, joints = tuple(fit.whole if recordings is None else recordings), len(fit.joints)
    columns = (2.6,) if narrow else (4.7, 2.3)  # their widths, about, in inches
    figure = blank(narrow, _KEY * (1 + narrow) + len(shown) * (_HEAD + _PANEL * joints))
    figure.set_layout_engine("constrained", hspace=0.0)
    heights = (2, 1) * joints * len(shown)
    sizes: dict[str, Any] = {"height_ratios": heights, "width_ratios": columns}
    axes = figure.subplots(len(heights), len(columns), squeeze=False, **sizes)
    for k, each in enumerate(shown):
        rows, time = axes[2 * joints * k :][: 2 * joints], each.recording.time
        begin = _zoom_start(time, fit.modes)
        for joint in range(joints):
            for column, (start, inches) in enumerate(zip((0, begin), columns, strict=False)):
                main, strip = rows[2 * joint :][:2, column]
                _draw(main, strip, fit, each, joint, slice(start, None), inches)
                main.tick_params(labelbottom=False)
                strip.tick_params(labelbottom=joint == joints - 1)
                if column == 1:
                    main.set_ylabel("")
                    strip.set_ylabel("")
                elif not narrow:
                    for ax in (main, strip):
                        ax.axvspan(time[begin], time[-1], color=SHADE, lw=0, zorder=-5)
        for ax in rows[-1]:
            ax.set_xlabel("time (s)")
        role = HELD_OUT if each.recording.role == "check" else "fitted"
        rows[0, 0].set_title(f"{shortened(each.recording.name, 24 if narrow else 50)}: {role}")
        if not narrow:
            rows[0, 1].set_title(f"the last {time[-1] - time[begin]:.2g} s, enlarged")
    figure.align_ylabels(axes[:, 0])
    lines = (("measured", MEASURED, 2.6), ("model", MODEL, 1.2), ("residual", RESIDUAL, 1.2))
    keys: list[Artist] = [Line2D([], [], color=c, lw=lw, label=words) for words, c, lw in lines]
    keys.append(Patch(color=BAND, label="±2σ of noise"))
    if any(each.wild.any() for each in shown):
        keys.append(Line2D([], [], color=WILD, marker="x", ls="", mew=1.4, label="outlier"))
    figure.legend(handles=keys, loc="outside upper left", ncols=2 if narrow else 5)
    return figure


def _zoom_start(time: np.ndarray, modes: Sequence[Mode]) -> int:
    """First sample of the last quarter, or of fewer seconds where that still rings many times."""
    length = 0.25 * (time[-1] - time[0])
    ringing = [m.frequency_hz for m in modes if m.frequency_hz > 0]
    if ringing:
        length = min(length, _ZOOM_CYCLES / min(ringing))
    return int(min(np.searchsorted(time, time[-1] - length), max(0, len(time) - 8)))


def _draw(
    main: Axes, strip: Axes, fit: Fit, each: RecordingFit, joint: int, window: slice, inches: float
) -> None:
    """One joint of one recording over one window of samples, in panels so many inches wide."""
    unit, name = fit.units[joint], shortened(fit.joints[joint], 14)
    time = each.recording.time[window]
    good = np.where(each.wild, np.nan, each.recording.angle)
    alike = [j for j, other in enumerate(fit.units) if other == unit]
    factor, label = prefixed(unit, largest(good[:, alike]))
    measured = each.recording.angle[window, joint] / factor
    kept, model = good[window, joint] / factor, each.predicted[window, joint] / factor
    broad = _breadth(time, inches, fit.modes)
    main.plot(*thinned(time, kept, inches), color=MEASURED, lw=2.6 * broad, zorder=2)
    main.plot(*thinned(time, model, inches), color=MODEL, lw=1.0 * broad, zorder=3)
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
    strip.plot(*thinned(time, left, inches), color=RESIDUAL, lw=0.8, zorder=2)
    reach = 1.08 * max(largest(left), 3 * sigma)
    strip.set_ylim(-reach, reach)
    strip.set_ylabel(f"residual\n({label})" if label else "residual")
    strip.yaxis.set_major_locator(MaxNLocator(3, symmetric=True, min_n_ticks=3))

    wild, off = each.wild[window, joint], each.residual[window, joint] / factor
    for ax, values, limits in ((main, measured, (low, high)), (strip, off, (-reach, reach))):
        ax.set_xlim(time[0], time[-1])
        ax.ticklabel_format(axis="y", style="plain", useOffset=False)
        if wild.any():
            inside, size = np.clip(values[wild], *limits), 5 if wild.sum() <= 20 else 3
            ax.plot(time[wild], inside, "x", color=WILD, ms=size, mew=1.2, zorder=4, clip_on=False)


def _range(values: np.ndarray, least: float) -> tuple[float, float]:
    """Limits of a scale; at least so far apart, or a joint at rest would show its noise alone."""
    values = values[np.isfinite(values)]
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    margin = max(0.08 * (high - low), (least - (high - low)) / 2)
    return low - margin, high + margin


def _breadth(time: np.ndarray, inches: float, modes: Sequence[Mode]) -> float:
    """Factor on line widths: dense ringing needs thinner lines."""
    slowest = min((m.frequency_hz for m in modes if m.frequency_hz > 0), default=0.0)
    per_inch = (time[-1] - time[0]) * slowest / inches
    return float(np.clip(6.0 / max(per_inch, 1e-9), 0.35, 1.0))


def thinned(time: np.ndarray, values: np.ndarray, inches: float) -> tuple[np.ndarray, np.ndarray]:
    """The least and greatest value of each small segment, on a picture so many inches wide: it
    looks the same and takes less ink. A segment with a lost sample keeps a gap.
    """
    segment = int(2 * len(time) / (_POINTS_PER_INCH * inches))
    if segment <= 2:
        return time, values
    count = len(time) // segment
    head = count * segment
    blocks = values[:head].reshape(count, segment)
    lost = np.isnan(blocks)
    least = np.argmin(np.where(lost, np.inf, blocks), axis=1)
    most = np.argmax(np.where(lost, -np.inf, blocks), axis=1)
    index = np.sort(np.stack([least, most], axis=1), axis=1)
    picked = (index + segment * np.arange(count)[:, None]).ravel()
    thin = values[picked]
    thin[1::2][lost.any(axis=1)] = np.nan
    return np.append(time[picked], time[head:]), np.append(thin, values[head:])


# -- its spectrum ----------------------------------------------------------------------------

_BINS_PER_DECADE = 60
_RISE = 0.1
"""Share of the record over which the window opens. Free motion is strongest at its beginning: a
symmetric window would hide the modes that die early, and none would smear its jump over all
frequencies."""


@styled
def spectrum(fit: Fit, *, narrow: bool = False) -> Figure:
    """Amplitude spectrum of the fitted recordings and of the residual, the model's modes marked.

    What stands above the noise is motion that the model does not have: at a mode, its frequency or
    damping is off; at three or five times a mode, a torque is missing that is not linear.
    """
    joints = fit.joints
    fitted = [r for r in fit.whole if r.recording.role != "check"]
    figure = blank(narrow, 2.1 * len(joints) + 1.6 if narrow else 2.2 * len(joints) + 1.0)
    axes = list(figure.subplots(len(joints), 1, sharex=True, squeeze=False)[:, 0])
    for joint, ax in enumerate(axes):
        frequency, measured, left, floor = _spectra(fitted, joint)
        factor, label = prefixed(fit.units[joint], np.sqrt(floor * max(largest(measured), floor)))
        ax.plot(frequency, measured / factor, color=MEASURED, lw=2.2, label="measured")
        ax.plot(frequency, left / factor, color=RESIDUAL, lw=1.0, label="residual")
        ax.axhline(floor / factor, color=INK, lw=0.9, ls=DASHED, label="noise alone")
        ax.set_xscale("log")
        ax.set_yscale("log")
        top = max(largest(measured), largest(left), 3 * floor)
        ax.set_ylim(0.15 * floor / factor, 2.5 * top / factor)
        ax.set_xlim(frequency[0], frequency[-1])
        name = shortened(joints[joint], 24)
        ax.set_ylabel(f"{name}\namplitude ({label})" if label else name)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(LogLocator(numticks=8))
            axis.set_major_formatter(lambda x, _: f"{x:g}")
            axis.set_minor_formatter(NullFormatter())
    axes[-1].set_xlabel("frequency (Hz)")
    handles = [*axes[0].get_legend_handles_labels()[0], *_marked(axes, fit.modes)]
    figure.legend(handles=handles, loc="outside upper left", ncols=1 if narrow else 3)
    figure.align_ylabels()
    return figure


def _marked(axes: Sequence[Axes], modes: Sequence[Mode]) -> list[Line2D]:
    """A numbered line at each mode, and what the legend says of it."""
    low, high = axes[0].get_xlim()
    keys, dots = [], {"color": MODEL, "lw": 0.9, "ls": (0, (1, 2))}
    for i, mode in enumerate(modes, 1):
        f = mode.frequency_hz
        if low < f < high:
            for ax in axes:
                ax.axvline(f, zorder=0, **dots)
            axes[0].text(f, 1.02, str(i), transform=axes[0].get_xaxis_transform(), ha="center")
            words = f"mode {i}: {plain(f, 4)} Hz, ζ = {plain(100 * mode.damping_ratio, 2)} %"
            keys.append(Line2D([], [], label=words, **dots))
    return keys


def _spectra(
    fitted: Sequence[RecordingFit], joint: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Frequencies, rms over the recordings of measured and residual, and the noise's level."""
    parts = []
    for each in fitted:
        r, use = each.recording, each.used[:, joint]
        if np.count_nonzero(use) < 8:
            continue
        dt = float(np.median(np.diff(r.time)))
        grid = np.arange(r.time[0], r.time[-1] + 1e-9 * dt, dt)
        window = _window(len(grid))
        columns = [
            _amplitude(np.interp(grid, r.time[use], values[use, joint]), window)
            for values in (r.angle, each.residual)
        ]
        noise = float(np.asarray(r.noise)[joint])
        floor = 2 * noise * np.sqrt((window**2).sum()) / window.sum()
        parts.append((np.fft.rfftfreq(2 * len(grid), dt), *columns, floor))
    if not parts:  # a joint that was never seen
        return np.array([0.1, 1.0]), np.full(2, np.nan), np.full(2, np.nan), 1.0
    common = max((p[0] for p in parts), key=len)

    def together(column: int) -> np.ndarray:
        power = [np.interp(common, p[0], p[column] ** 2, right=np.nan) for p in parts]
        return np.sqrt(np.nanmean(power, axis=0))

    # Below one period of the record there is no frequency to speak of.
    frequency = common[2:]
    (middle, measured), (_, left) = (_binned(frequency, together(c)[2:]) for c in (1, 2))
    return middle, measured, left, float(np.sqrt(np.mean([p[3] ** 2 for p in parts])))


def _window(count: int) -> np.ndarray:
    """Opens quickly and closes slowly, both along half a cosine."""
    x = (np.arange(count) + 0.5) / count
    up = 0.5 - 0.5 * np.cos(np.pi * np.minimum(x / _RISE, 1.0))
    down = 0.5 + 0.5 * np.cos(np.pi * np.clip((x - _RISE) / (1 - _RISE), 0.0, 1.0))
    return up * down


def _amplitude(values: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Amplitude of a steady sine at each frequency, twice as finely as the length gives."""
    centred = values - np.average(values, weights=window)
    return 2 * np.abs(np.fft.rfft(centred * window, 2 * len(values))) / window.sum()


def _binned(frequency: np.ndarray, amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rms in narrow bins of equal width on a log scale: noise then draws a line, not a blot."""
    place = np.floor(np.log10(frequency) * _BINS_PER_DECADE).astype(int)
    place -= place[0]
    count = np.bincount(place)
    full = count > 0
    power = np.bincount(place, amplitude**2)[full] / count[full]
    return np.bincount(place, frequency)[full] / count[full], np.sqrt(power)
