"""Where a model fails, how its error grows, and the torque that it lacks."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ...diagnosis import Comparison, Curve, MissingTorque
from ...diagnosis.residuals import Part
from ..names import force, own_name, position, title
from ..numbers import plain, prefixed
from .style import BAND, DASHED, FAINT, INK, JOINTS, MODEL, RESIDUAL, blank, styled

_LOG = 4.0  # from this range on the errors ahead are on a logarithmic scale


@styled
def where(compared: Comparison, *, narrow: bool = False) -> Figure:
    """The residual in times the noise: along time, by amplitude of the swing, by frequency.

    A bar that ends at the dashed line is what noise alone would leave.
    """
    at = compared.where
    figure = blank(narrow, 8.6 if narrow else 3.3)
    time, swing, band = figure.subplots(*((3, 1) if narrow else (1, 3))).ravel()
    _bars(time, [f"{plain(p.start, 2)}-{plain(p.stop, 2)}" for p in at.time], at.time, at.joints)
    cut = any(r.recording.segment_of is not None for r in compared.fit.recordings)
    since = "segment's start" if cut else "start"
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
    time.tick_params(axis="x", labelrotation=45, labelsize=8)
    band.tick_params(axis="x", labelrotation=90, labelsize=8)
    swing.xaxis.set_major_locator(MaxNLocator(5))
    keys = time.get_legend_handles_labels()
    figure.legend(*keys, loc="outside upper left", ncols=len(at.joints))
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
    figure = blank(narrow, 3.0)
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
    ax.set_xlabel(f"time after the fitted third of {plain(found.seconds, 2)} s (s)")
    ax.set_ylabel("prediction error / noise")
    each = [a.error.ratio for a in found.ahead]
    if np.nanmax(each) > _LOG * np.nanmin(each):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(lambda x, _: plain(x, 1))
        ax.yaxis.set_minor_formatter(lambda x, _: "")
    else:
        ax.set_ylim(0, 1.08 * ax.get_ylim()[1])
    ax.set_xlim(left=0)
    figure.legend(loc="outside upper left", ncols=len(compared.fit.joints))
    return figure


# -- the missing torque ----------------------------------------------------------------------

_WORTH = 0.1  # share from which a curve is drawn
_SCATTER = 0.5  # of the torque's own, beyond which a middle line would mislead
_DOTS = 1000
_NAMED = 2  # numbers of an effect in the legend
_BINS = 14


@styled
def missing_torque(
    missing: MissingTorque,
    joint: int,
    *,
    name: str = "",
    unit: str | None = "rad",
    curves: Sequence[Curve] = (),
    link_angle: np.ndarray | None = None,
    narrow: bool = False,
) -> Figure:
    """The torque at one joint that the model lacks, with its 95 % band.

    Against angle and rate it is shown less the change of springs and dampers that goes with the
    first of `curves`: a fit without an effect has bent these to make up for it. `link_angle` (N,)
    is the absolute angle of the joint's link, rad: it takes the place of the joint's angle if the
    torque follows it more closely, as gravity does.
    """
    torque_unit, rate_unit = ("N", "m/s") if unit == "m" else ("N m", "rad/s")
    acts, of_what = force([unit]), position([unit])
    angle_unit = unit or "rad or m"
    shown = next((c for c in curves if c.share > _WORTH and np.any(c.torque[:, joint])), None)
    figure = blank(narrow, 10.0 if narrow else 5.4)
    axes = figure.subplot_mosaic("t;q;v;a" if narrow else "ttt;qva")
    t, tau = missing.time - missing.time[0], missing.torque[:, joint]
    own = None if shown is None else shown.torque[:, joint]
    _against_time(axes["t"], t, tau, missing.std[:, joint], shown, joint, f"missing {acts}")
    axes["t"].set_title(f"missing {acts} at the {name}" if name else f"missing {acts}")
    axes["t"].set(xlabel="time since the first sample (s)", ylim=_limits(tau))
    bare = tau if shown is None else tau - shown.changed[:, joint]
    angle = missing.angle[:, joint]
    if link_angle is not None and _scatter(link_angle, bare) < 0.5 * _scatter(angle, bare):
        angle, of_what = link_angle, "absolute angle of the link"
    for key, x, label in (
        ("q", angle, f"{of_what} ({angle_unit})"),
        ("v", missing.rate[:, joint], f"rate ({rate_unit})"),
    ):
        _against(axes[key], x, bare, own)
        axes[key].set(xlabel=label, ylim=_limits(bare))
    _against_amplitude(axes["a"], missing.amplitude[:, joint], bare, own)
    axes["a"].set(xlabel=f"amplitude ({angle_unit})", ylabel=f"rms {acts} ({torque_unit})")
    for key in ("t", "q", "v"):
        axes[key].set_ylabel(f"{acts} ({torque_unit})")
        axes[key].axhline(0.0, color=FAINT, lw=0.6, zorder=0)
    each = [axes[key].get_legend_handles_labels() for key in ("t", "q", "v")]
    keys = {label: handle for row in each for handle, label in zip(*row, strict=True)}
    columns = 1 if narrow else len(keys)
    figure.legend(keys.values(), keys, loc="outside lower left", ncols=columns)
    return figure


def _limits(torque: np.ndarray) -> tuple[float, float]:
    """A range that holds all but a few instants."""
    most = 1.25 * float(np.quantile(np.abs(torque), 0.997)) or 1.0
    return -most, most


def _against_time(ax: Axes, t, tau, std, shown: Curve | None, joint: int, words) -> None:
    band = 1.96 * std
    ax.fill_between(t, tau - band, tau + band, color=BAND, lw=0, label="95 % band")
    ax.plot(t, tau, color=RESIDUAL, lw=0.9, label=words)
    if shown is not None:
        whole = shown.torque[:, joint] + shown.changed[:, joint]
        ax.plot(t, whole, color=MODEL, lw=0.8, alpha=0.9, label=_words(shown))
    ax.set_xlim(t[0], t[-1])


def _words(curve: Curve) -> str:
    """An effect and its numbers: "Coulomb friction: torque 0.2 N m"."""
    numbers = [
        f"{own_name(name)} {plain(value)}{'' if unit == '1' else f' {unit}'}"
        for name, (value, unit) in curve.values.items()
    ]
    more = ", ..." if len(numbers) > _NAMED else ""
    words = f"{title(curve.effect)}: {', '.join(numbers[:_NAMED])}{more}"
    return words.replace("^2", "²").replace("^3", "³")


def _against(ax: Axes, x, tau, own) -> None:
    every = max(1, len(x) // _DOTS)
    # Dots as strokes that are hardly longer than wide: one path, a fifth of the markers' bytes.
    dots, gap = x[::every], np.full(len(x[::every]), np.nan)
    along = np.stack([dots, dots + 1e-3 * np.ptp(x), gap], axis=1).ravel()
    up = np.stack([tau[::every]] * 2 + [gap], axis=1).ravel()
    ax.plot(along, up, color=RESIDUAL, lw=1.9, alpha=0.45, solid_capstyle="round")
    if own is not None:
        ax.plot(x, own, color=MODEL, lw=0.6, alpha=0.7)
    if _scatter(x, tau) < _SCATTER:
        middle = np.array([(x[b].mean(), np.median(tau[b])) for b in _bins(x)])
        ax.plot(*middle.T, color=INK, lw=1.1, label="median along the axis")


def _bins(x) -> list[np.ndarray]:
    """Which instants lie above each segment of the axis."""
    low, high = np.quantile(x, (0.005, 0.995))
    edges = np.linspace(low, high, 2 * _BINS + 1)
    which = np.digitize(x, edges)
    return [which == b for b in range(1, len(edges)) if np.sum(which == b) > 5]


def _scatter(x, tau) -> float:
    """The share of the torque's variance that its middle above each segment leaves."""
    bins = _bins(x)
    if not bins:
        return 1.0
    left = sum(np.sum((tau[b] - np.median(tau[b])) ** 2) for b in bins)
    within = np.concatenate([tau[b] for b in bins])
    return float(left / max(np.sum((within - within.mean()) ** 2), 1e-300))


def _against_amplitude(ax: Axes, amplitude, tau, own) -> None:
    edges = np.quantile(amplitude, np.linspace(0, 1, _BINS + 1))
    which = np.digitize(amplitude, edges[1:-1])
    bins = [which == b for b in range(_BINS) if np.sum(which == b) > 5]

    def rms(x):
        return [(amplitude[b].mean(), np.sqrt(np.mean(x[b] ** 2))) for b in bins]

    ax.plot(*np.transpose(rms(tau)), "o-", color=RESIDUAL, ms=3, lw=0.9)
    if own is not None:
        ax.plot(*np.transpose(rms(own)), color=MODEL, lw=1.0)
    ax.set_ylim(0, 1.08 * ax.get_ylim()[1])
    ax.set_xlim(left=0)
    ax.xaxis.set_major_locator(MaxNLocator(5))
