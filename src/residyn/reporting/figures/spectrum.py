"""At which frequencies the model leaves something."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ...fitting.result import Fit, Mode, RecordingFit
from ..numbers import plain, prefixed
from .style import DASHED, INK, MEASURED, MODEL, NARROW, RESIDUAL, WIDE, largest, shortened, styled

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
    joints = fit.experiment.joints
    units = fit.experiment.units or (None,) * len(joints)
    fitted = [r for r in fit.whole if r.recording.role != "check"]
    height = (2.1 if narrow else 2.2) * len(joints) + (1.3 if narrow else 1.0)
    figure = Figure(figsize=(NARROW if narrow else WIDE, height), layout="constrained")
    axes = list(figure.subplots(len(joints), 1, sharex=True, squeeze=False)[:, 0])
    for joint, ax in enumerate(axes):
        frequency, measured, left, floor = _spectra(fitted, joint)
        factor, label = prefixed(units[joint], np.sqrt(floor * max(largest(measured), floor)))
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
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axis.set_minor_formatter(NullFormatter())
    axes[-1].set_xlabel("frequency (Hz)")
    _mark(axes, fit.modes, narrow)
    handles, _ = axes[0].get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside upper left", ncols=2 if narrow else 3)
    figure.align_ylabels()
    return figure


def _mark(axes: Sequence[Axes], modes: Sequence[Mode], narrow: bool) -> None:
    """A line at each mode, labelled above the top panel; labels that would touch, on two rows."""
    low, high = axes[0].get_xlim()
    room = 0.5 if narrow else 0.18  # share of the width that one label takes
    ends: list[float] = []  # where the last label of each row ends
    for mode in modes:
        f = mode.frequency_hz
        if not low < f < high:
            continue
        for ax in axes:
            ax.axvline(f, color=MODEL, lw=0.9, ls=(0, (1, 2)), zorder=0)
        place = float(np.log(f / low) / np.log(high / low))
        left = float(np.clip(place - room / 2, 0.0, 1.0 - room))
        row = next((i for i, end in enumerate(ends) if left >= end), len(ends))
        ends[row : row + 1] = [left + room]
        axes[0].annotate(
            f"{plain(f, 4)} Hz, ζ = {plain(100 * mode.damping_ratio, 2)} %",
            (left + room / 2, 1.0),
            xycoords="axes fraction",
            xytext=(0, 3 + 12 * row),
            textcoords="offset points",
            ha="center",
            va="bottom",
            color=MODEL,
        )


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
