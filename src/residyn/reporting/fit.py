"""All that is said of one fit: in a terminal, on a page, in tables for a paper, as warnings.

The unit of errors is the noise of one reading. A model that leaves as much as the noise has
explained all that the recording can show; one that leaves ten times as much has not, however well
the curves seem to lie on each other.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..effects.inertia import InertiaError
from ..fitting.integration import too_coarse
from ..fitting.result import STRONG, STRUCTURE, Fit, RecordingFit
from ..recordings.polynomial_spectrum import grid_step
from ..recordings.segments import by_recording
from . import layout
from .layout import Table, filled, printed, section, separated, warned
from .names import HELD_OUT, at_place, base_name, force, listed, lower, position, spoken, the
from .numbers import amount, measured, plain, prefixed, share, times, with_error

_OVERSTATED = 0.85  # reduced chi-square below which the noise must have been overstated
_STILL = 2.0  # times the noise: a joint that moves less than this hardly moves
_NAMED = 3  # outliers whose times are given


# -- the sentences ---------------------------------------------------------------------------


class JointError(NamedTuple):
    """Errors at one joint, rms, in `unit`; None where nothing was held out."""

    joint: str
    unit: str
    rmse: float
    noise: float
    ratio: float  # rms of each reading's error in times its own noise
    share: float  # error as a share of the motion's standard deviation
    check: float | None
    check_ratio: float | None


def joint_errors(fit: Fit) -> list[JointError]:
    """The errors of a fit, joint by joint."""
    fitted = [r for r in fit.whole if r.recording.role != "check"]
    angles = [np.where(r.used, r.recording.angle, np.nan) for r in fitted]
    centred = [angle - np.nanmean(angle, axis=0) for angle in angles]
    motion = np.sqrt(np.nanmean(np.concatenate(centred) ** 2, axis=0))
    share = fit.rmse / np.where(motion > 0, motion, np.nan)
    check = check_ratio = np.full(len(motion), None)
    if fit.check_rmse is not None and fit.check_ratio is not None:
        check, check_ratio = fit.check_rmse, fit.check_ratio
    own = fit.rmse, fit.noise, fit.ratio, share, check, check_ratio
    each = zip(fit.joints, fit.units, *(x.tolist() for x in own), strict=True)
    return [JointError(*row) for row in each]


def explained(fit: Fit) -> bool:
    """Whether what is left is no larger than the noise."""
    return not fit.misses


def verdict(fit: Fit) -> tuple[str, ...]:
    errors, good = joint_errors(fit), explained(fit)
    left = []
    for error in errors:
        noise, motion = ("", "") if left else (" the noise", " of the motion")
        words = f"{times(error.ratio)} times{noise} at {the(error.joint)}"
        left.append(words if good else f"{words} ({share(error.share)}{motion})")
    noise = "noise that is not white" if fit.coloured_noise else "the noise"
    what = f"explains the motion down to {noise}" if good else "misses something"
    words = f"The model {what}: it leaves {listed(left)}."
    ratios = [times(e.check_ratio) for e in errors if e.check_ratio is not None]
    return (words, f"On the held-out recordings: {listed(ratios)} times.") if ratios else (words,)


def chi2_words(chi2: float, coloured: bool = False) -> str:
    """`coloured`: what is left is known to be noise that is not white."""
    if chi2 < _OVERSTATED:
        return (
            "less is left than the noise alone would leave: the noise is overstated, or rounded "
            "readings repeat each other"
        )
    if chi2 <= STRUCTURE:
        return "what is left is as large as the noise alone would leave"
    if coloured:
        return "more is left than white noise would leave: this noise is not white"
    if chi2 <= 2:
        return "a little more is left than the noise alone would leave"
    return "much more is left than the noise alone would leave: something is missing in the model"


# -- the warnings ----------------------------------------------------------------------------


def warnings(fit: Fit) -> tuple[str, ...]:
    """What a careful person would want to be told: the recordings' own warnings, then the fit's."""
    checks = _open, _no_modes, _still, _outliers, _signs, _misfit, _integration, _search
    said = (words for check in checks for words in check(fit))
    return (*_unphysical(fit), *fit.experiment.warnings, *said)


def _unphysical(fit: Fit) -> Iterable[str]:
    """Said first: whatever else is read from such a fit rests on a base that no arm has."""
    return (
        f"{n.name} = {n.value:.3g} +/- {n.std:.2g} {n.unit} is negative beyond its error, which no "
        "braked arm has: the recordings are not of an arm that rings down, an input is wrong "
        f"(inertia, order or sign of the {position(fit.experiment.units)}s, their rest), or the "
        "model lacks an effect"
        for n in fit.unphysical
    )


def _open(fit: Fit) -> Iterator[str]:
    for group in fit.open_groups:
        members = [fit.numbers[i].name for i in group if fit.numbers[i].acts]
        if not members:
            continue  # of a joint that this mechanism does not have
        if any(m.startswith("inertia_error") for m in members):
            yield (
                "inertia and stiffness cannot both be found from free motion: scaling all "
                "inertias, stiffnesses and dampings alike leaves it unchanged (Eq. 9); these data "
                f"determine only ratios of {', '.join(members)}: measure the inertias first, "
                f"with a known drive {force(fit.experiment.units)}"
            )
        elif len(members) == 1:
            yield (
                f"{members[0]} is not determined: changing it leaves these recordings unchanged, "
                "or changes them as another initial state would"
            )
        else:
            free = fit.spread.ways(group)
            left = len(members) - free
            combinations = "a combination" if left == 1 else f"{left} combinations"
            ways = "" if free == 1 else f" in {free} independent ways"
            yield (
                f"these recordings determine only {combinations} of {', '.join(members)}: "
                f"changing them together{ways} leaves the motion unchanged"
            )


def _no_modes(fit: Fit) -> Iterator[str]:
    if fit.infinite_slopes:
        yield (
            f"there are no modes: at rest the slope of {listed(fit.infinite_slopes)} is infinite, "
            "so that the model is not linear there, however small the swing"
        )


def _still(fit: Fit) -> Iterator[str]:
    each = [np.nanstd(r.recording.angle, axis=0) / r.recording.noise for r in fit.fitted]
    for joint, size in zip(fit.joints, np.max(each, axis=0), strict=True):
        if size < _STILL:
            yield (
                f"{joint} hardly moves (rms no more than {_STILL:g} times the noise): "
                "these recordings say little about its numbers, whatever their errors"
            )


def _outliers(fit: Fit) -> Iterator[str]:
    for beside in fit.recordings:
        rows = np.flatnonzero(beside.wild.any(axis=1))
        if len(rows):
            at = ", ".join(f"{beside.recording.time[i]:.6g}" for i in rows[:_NAMED])
            more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
            count = int(beside.wild.sum())
            yield (
                f"{beside.recording.name}: {count} outlier{'s' * (count > 1)} set aside "
                f"(at {at} s{more})"
            )


def _signs(fit: Fit) -> Iterator[str]:
    sure = {n.name for n in fit.unphysical}
    for n in fit.numbers:
        if n.sign == "positive" and n.value < 0 and n.determined and n.name not in sure:
            so = ", but by less than two errors: these data cannot tell it from zero"
            if n.negative:
                so = ": the model lacks something, or an input is wrong"
            yield f"{n.name} is negative, which physics does not allow{so}"


def _misfit(fit: Fit) -> Iterator[str]:
    if fit.reduced_chi2 > STRUCTURE:
        worst = max(joint_errors(fit), key=lambda e: e.ratio)
        noise = f"{worst.noise:.3g} {worst.unit}".strip()
        if fit.misses:
            so = "the model misses something, and the errors above"
        else:
            so = "it is noise that is not white, and the errors above"
        yield (
            f"the residual at {worst.joint} is {worst.ratio:.3g} times the noise ({noise}): {so}, "
            "which assume white noise, are too small"
        )
    elif fit.reduced_chi2 < _OVERSTATED:
        below = f"chi-square is {fit.reduced_chi2:.3g}, below what the"
        if all(r.recording.noise_given for r in fit.fitted):
            rounded = "; or readings repeat each other within a step of the sensor, and the errors"
            yield (
                f"{below} stated noise allows: that noise is too large, and so are the errors above"
                f"{f'{rounded} may be too small' if _rounded(fit) else ''}"
            )
        else:
            yield (
                f"{below} estimated noise allows, as where readings repeat each other within a "
                "step of the sensor: the errors above, which assume white noise, may be too small"
            )


def _rounded(fit: Fit) -> bool:
    """Whether a step of a sensor is larger than the noise, so that readings may repeat."""
    runs = [r.recording for r in fit.fitted]
    each = (pair for r in runs for pair in zip(r.angle.T, r.noise, strict=True))
    return any(grid_step(q[np.isfinite(q)]) > noise for q, noise in each)


def _integration(fit: Fit) -> Iterator[str]:
    if fit.shortened is not None:
        steps, error = fit.shortened
        left = f"left an error of {error:.2g} times the noise"
        if not too_coarse(error, fit.reduced_chi2):
            left = "left standard errors wrong by more than a tenth"
        more = f"the fit went on with {fit.integration_steps}"
        yield f"the usual {steps} integration steps {left}: {more}"
    if not too_coarse(fit.integration_error, fit.reduced_chi2):
        return
    chosen = fit.experiment.integrator
    if chosen is not None and chosen.adapts:
        what = "give it smaller tolerances (rtol, atol), or Kvaerno5 where an effect is stiff"
    elif fit.model.dry or fit.model.follows:
        what = "a recording that is cut shorter (stop) lets less of it add up"
    else:
        what = (
            'solver = "Tsit5" under [integrator] chooses its steps itself, and "Kvaerno5" those of '
            "an effect that is much faster than the arm"
        )
    yield (
        f"the integration is not exact enough: its error is {fit.integration_error:.2g} of the "
        f"noise, where a tenth is hardly seen in the numbers; {what}"
    )


def _search(fit: Fit) -> Iterator[str]:
    if not fit.stands:
        yield "the fit did not settle: treat the numbers as rough"
    for label in fit.unseen if fit.stands else ():
        if label in fit.needed:
            yield (
                f"without {label} more is left than chance explains, but these recordings do not "
                "tell how strong it is: its strength is within two errors of none; the other "
                "numbers hold"
            )
        else:
            yield (
                f"{label} is not seen in these recordings: its strength is within two errors of "
                "none, and of what does not act no shape can be told; the other numbers hold"
            )
    if not fit.unseen and fit.starts > 1 and fit.agreeing_starts < max(2, fit.starts // 3):
        yield (
            f"only {fit.agreeing_starts} of {fit.starts} starts led here: "
            "there may be a better minimum; try more starts"
        )
    if fit.short_of_minimum is not None:
        name, errors = fit.short_of_minimum
        yield (
            "the search ended short of the least-squares minimum: from here it is about "
            f"{errors:.2g} standard errors away in {name}, which the errors above do not hold; "
            "--method levenberg goes there"
        )


# -- in a terminal ---------------------------------------------------------------------------


def text(fit: Fit) -> str:
    lines = [
        *filled(base_name(fit, comma=True), "[[Model]]  "),
        "[[Fit]]",
        *filled(f"{names(fit.fitted)} ({readings(fit)} readings)", "    recordings  "),
        *([f"    starts      {fit.agreeing_starts} of {fit.starts} agree"] * (fit.starts > 1)),
        *filled(fit.reason, "    stopped     "),
        f"    chi-square  {fit.reduced_chi2:.4g} per degree of freedom (1: noise alone)",
    ]
    for e in joint_errors(fit):
        line = f"{e.joint}: {e.rmse:.4g} {e.unit}, {e.ratio:.3g} x noise"
        held = "" if e.check is None else f"; {HELD_OUT}: {e.check:.4g} {e.unit}"
        lines += filled(line + held, "    rms         ")
    lines += filled(_integrated(fit), "    integrated  ")
    lines += [line for words in _inertias(fit) for line in filled(words, "    inertia     ")]
    if len(fit.whole) > 1:
        lines += [
            "[[Recordings]]  rms residual in times the noise",
            *printed(recordings_table(fit)),
        ]
    lines.append("[[Parameters]]  value +/- standard error (error in %)")
    width = max([30, *(len(n.name) for n in fit.own_numbers)])
    for n in fit.own_numbers:
        unit = "" if n.unit == "1" else f" {n.unit}"
        error = f"{n.std:.3g} ({plain(n.percent, 2)} %)" if n.determined else "not determined"
        head = f"  {n.name:<{width}} {n.value:10.6g} "
        lines += filled(f"+/- {error}{unit}", head, width + 3)
    lines += filled(
        ", ".join(f"{n.name} {n.start:.4g}" for n in fit.own_numbers), "  started from "
    )
    if fit.modes:
        lines += section("Modes", f"natural frequency, damping ratio{modes_of(fit)}")
    for i, m in enumerate(fit.modes, 1):
        frequency = _known(m.frequency_hz, m.frequency_hz_std, 6)
        damping = _known(100 * m.damping_ratio, 100 * m.damping_ratio_std, 4)
        grows = "  grows: not physical" if m.grows else ""
        lines.append(f"    {i}  {frequency} Hz   {damping} %{grows}")
    strong = fit.strong_correlations()
    if strong:
        lines += section("Correlations", f"beyond {STRONG}")
        lines += [f"    {a} with {b}: {r:+.3f}" for a, b, r in strong]
    return "\n".join([*lines, *warned(fit.warnings)])


def names(fits: Sequence[RecordingFit]) -> str:
    """Names of recordings, with segments of one recording put together."""
    return ", ".join(r.name for r, _ in by_recording([f.recording for f in fits]))


def modes_of(fit: Fit) -> str:
    """Whose the modes are, ", as in one.csv (theta2 = 0.3 rad)", where recordings differ in what
    modes depend on; else empty."""
    each = [r for r, _ in by_recording([f.recording for f in fit.recordings])]
    first, said = fit.posed_as, []
    for key, unit in (("theta2", "rad"), ("extra_mass", "kg"), ("load", "N")):
        if len({getattr(r, key) for r in each}) > 1:
            said.append(f"{key} = {getattr(first, key):.4g} {unit}")
    if fit.experiment.bearings and len({r.air_bearings for r in each}) > 1:
        said.append("on the bearings" if first.air_bearings else "without bearings")
    if len({fit.experiment.run_of(r) for r in each}) > 1:
        said.append("with its own numbers")
    return f", as in {first.name} ({', '.join(said)})" if said else ""


def readings(fit: Fit) -> int:
    """How many readings the numbers were fitted to."""
    return sum(int(r.used.sum()) for r in fit.fitted)


def _known(x: float, std: float, digits: int) -> str:
    return f"{x:.{digits}g} " + (f"+/- {std:.2g}" if np.isfinite(std) else "(not determined)")


def _integrated(fit: Fit) -> str:
    chosen, how = fit.experiment.integrator, f"{fit.integration_steps} steps"
    if chosen is not None:
        how = f"by {chosen.name}" if chosen.adapts else f"{how} of {chosen.name}"
    words = f"{how}; error {fit.integration_error:.2g} of the noise"
    if fit.integration_checked is not None:
        words += " ({:.2g} against {})".format(*fit.integration_checked)
    return words


def _inertias(fit: Fit) -> Iterator[str]:
    """The inertias that the model has instead of those that the experiment gives."""
    for effect in fit.model.effects:
        if isinstance(effect, InertiaError):
            unit = "kg m" if effect.part == "coupling" else "kg m^2"
            given = float(getattr(fit.model.mechanism, effect.part))
            true = given * (1 + float(effect.share))
            yield f"{effect.part} {true:.5g} {unit} by {effect.label}; {given:.5g} is given"


# -- on a page -------------------------------------------------------------------------------


def errors_table(fit: Fit) -> Table:
    errors = joint_errors(fit)
    head = ["joint", "error (rms)", "noise of a reading", "error / noise", "error / motion"]
    if errors[0].check is not None:
        head += ["held-out error", "held-out / noise"]
    rows = []
    for e in errors:
        sizes = amount(e.rmse, e.unit), amount(e.noise, e.unit), plain(e.ratio), share(e.share)
        rows.append([e.joint, *sizes])
        if e.check is not None and e.check_ratio is not None:
            rows[-1] += [amount(e.check, e.unit), plain(e.check_ratio)]
    return Table(head, rows)


def recordings_table(fit: Fit) -> Table:
    """Errors by recording: which one the model does not explain."""
    rows = [
        [
            r.recording.name + f" ({HELD_OUT})" * (r.recording.role == "check"),
            str(int(r.used.sum())),
            *(f"{times(x)} x" if math.isfinite(x) else "-" for x in r.ratio),
        ]
        for r in fit.whole
    ]
    return Table(["recording", "readings", *fit.joints], rows)


def numbers_table(fit: Fit) -> Table:
    head = ["number", "value", "standard error", "error in %", "start", "unit", "meaning"]
    rows = []
    for n in fit.own_numbers:
        value, std = with_error(n.value, n.std)
        off = f"{plain(n.percent, 2)} %" if math.isfinite(n.percent) else ""
        error = std if n.determined else "not determined"
        unit = "" if n.unit == "1" else n.unit
        rows.append([n.name, value, error, off, plain(n.start, 3), unit, n.words])
    return Table(head, rows, left=(0, 5, 6))


def modes_table(fit: Fit) -> Table:
    head = ["", "frequency (Hz)", "standard error (Hz)", "period (s)", "damping ratio (%)"]
    rows = []
    for i, m in enumerate(fit.modes, 1):
        name = f"mode {i}" + (" (grows: not physical)" if m.grows else "")
        period = plain(1 / m.frequency_hz, 3) if m.frequency_hz > 0 else ""
        damping = with_error(100 * m.damping_ratio, 100 * m.damping_ratio_std)
        rows.append([name, *with_error(m.frequency_hz, m.frequency_hz_std), period, *damping])
    return Table([*head, "standard error (%)"], rows)


def fall(first: Fit, last: Fit) -> str:
    """From the first model to the last, where the first one is worst."""
    before, after = joint_errors(first), joint_errors(last)
    worst = max(range(len(before)), key=lambda i: before[i].ratio)
    new = [x for x in last.model.labels if x not in first.model.labels]
    a, b = before[worst], after[worst]
    return (
        f"With {spoken(new, last.joints) if new else 'the last'}, the error at {the(a.joint)} goes "
        f"from {times(a.ratio)} times the noise to {times(b.ratio)} times."
    )


# -- for a paper -----------------------------------------------------------------------------


def latex(fit: Fit) -> str:
    """Numbers with errors, modes, residuals."""
    numbers, modes, left = [], [], []
    for n in fit.own_numbers:
        error = measured(n.value, n.std) if n.determined else "not determined"
        where = lower(at_place(n.name.partition(".")[0], fit.joints, comma=True))
        numbers.append([where, n.words, error, n.unit])
    for i, m in enumerate(fit.modes, 1):
        frequency = measured(m.frequency_hz, m.frequency_hz_std)
        damping = measured(m.damping_ratio, m.damping_ratio_std)
        modes.append([f"mode {i}", "natural frequency", frequency, "Hz"])
        modes.append([f"mode {i}", "damping ratio", damping, "1"])
    what = {"rmse": "rms residual", "check_rmse": f"rms residual, {HELD_OUT}"}
    for name, joint, size, own in residuals(fit):
        if name in what:
            factor, short = prefixed(own, size)
            left.append([joint, what[name], plain(size / factor), short])
    left.append(["all", "reduced chi-square", plain(fit.reduced_chi2), "1"])
    head = ["where", "quantity", "value", "unit"]
    return layout.latex(*(Table(head, rows, left=(0, 1, 3)) for rows in (numbers, modes, left)))


def csv(fit: Fit) -> str:
    """One line for each number: name, value, std, unit."""
    rows: list[Sequence[object]] = [(n.name, n.value, n.std, n.unit) for n in fit.own_numbers]
    for i, m in enumerate(fit.modes, 1):
        rows.append((f"mode{i}.frequency", m.frequency_hz, m.frequency_hz_std, "Hz"))
        rows.append((f"mode{i}.damping_ratio", m.damping_ratio, m.damping_ratio_std, "1"))
    rows += [(f"{name}:{joint}", x, None, unit) for name, joint, x, unit in residuals(fit)]
    rows.append(("reduced_chi2", fit.reduced_chi2, None, "1"))
    return separated(("name", "value", "std", "unit"), rows)


def residuals(fit: Fit) -> list[tuple[str, str, float, str]]:
    """(name, joint, value, unit) of every rms residual, and of the noise."""
    each = [("rmse", fit.rmse), ("check_rmse", fit.check_rmse), ("noise", fit.noise)]
    return [
        (name, joint, float(x), u)
        for name, sizes in each
        if sizes is not None
        for joint, u, x in zip(fit.joints, fit.units, sizes, strict=True)
    ]
