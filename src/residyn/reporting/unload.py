"""All that is said of step 3: how the arm rings on its bearings and without them.

When a mode falls to 1/e, and when it has no such time, is in `procedure.unloaded`.

Viscous drag of a bearing on the elbow is exactly a damper at the shoulder. That of one on the wrist
is a damping matrix with off-diagonal terms, which turns with the elbow angle and leaves with the
bearing: recordings at other elbow angles, or without the bearings, tell it from the joints'.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from ..fitting.result import STRONG, Mode
from ..procedure.carried import NAMES, inertias
from ..procedure.result import UNITS
from ..procedure.ringdown import RingDown
from ..procedure.unloaded import BareCheck, Pose, Unloading, decay_of
from .inertia import at_odds
from .layout import Table, filled, printed, section, warned
from .names import STOPPED, spoken, upper
from .numbers import amount, measured, plain, times

_POOR = 0.05  # relative error of a predicted damping ratio beyond which it is said to be poor
_SAME = 0.02  # elbow angles whose cosines are closer than this are one
_NOT_PHYSICAL = (
    "Not physical: nothing drives the arm, so that no mode can grow or leave its rest. These "
    "recordings do not determine these numbers; see the warnings of step 3."
)


# -- the warnings ----------------------------------------------------------------------------


def warnings(found: Unloading) -> tuple[str, ...]:
    """What a careful person would want to be told about step 3, beside the fit's own warnings;
    modes that no arm has first."""
    return (
        *unphysical(found),
        *_stopped(found),
        *_step_1(found),
        *_unnamed(found),
        *_not_told_apart(found),
        *(
            f"{check.name}: no fit of it alone was found, so there is nothing to compare with"
            for check in found.check
            if check.free is None
        ),
    )


def unphysical(found: Unloading) -> tuple[str, ...]:
    """One line for each mode, with and without bearings, that no arm can have."""
    said, remedy = [], _against_growth(found)
    for pose in found.poses:
        sides = (
            ("without bearings", pose.without_bearings, pose.leaves_without),
            ("on the bearings", pose.with_bearings, pose.leaves_with),
        )
        for where, modes, leaves in sides:
            at = f"{where} (theta2 = {pose.theta2:.4g} rad)"
            if leaves:
                said.append(
                    f"the arm {at} moves away from its rest instead of ringing about it: its "
                    "stiffness there is negative, which is not physical; these recordings do not "
                    f"determine its frequency; {remedy}"
                )
            for order, mode in enumerate(modes, 1):
                if decay_of(mode) is None:
                    less = "though by less than two standard errors"
                    said.append(
                        f"mode {order} {at} grows, with a damping ratio of {_damping(mode)}: not "
                        f"physical, {'as nothing drives the arm' if mode.grows else less}; these "
                        f"recordings do not determine how it decays; {remedy}"
                    )
    return tuple(said)


def _against_growth(found: Unloading) -> str:
    """What to do about a mode that no arm has."""
    if found.fit.misses:
        size = plain(found.fit.reduced_chi2, 2)
        return (
            f"the fit misses something (chi-square {size} per degree of freedom): name the effect "
            "that it lacks (--with), or let residyn diagnose look for it"
        )
    if found.left_out:
        return what_would_tell(found)
    return "check the inertias, the bearings' masses, and the order and signs of the angles"


def what_would_tell(found: Unloading) -> str:
    """Which recordings would tell the bearings' drag from the joints' damping."""
    fitted, bearings = found.fit.experiment.fit_recordings, found.fit.experiment.bearings
    bare = not all(r.air_bearings for r in fitted)
    wrist = any(b.joint == "wrist" for b in bearings)
    one_angle = np.ptp([np.cos(r.theta2) for r in fitted if r.air_bearings]) < _SAME
    ways = [] if bare else ["without bearings (air_bearings = false)"]
    if wrist and one_angle:
        ways.append("at another elbow angle (theta2)")
    if not ways:
        return "record for longer, or with less noise"
    advice = f"to tell them apart, record the arm {' or '.join(ways)} too, and fit both"
    if wrist:
        return advice
    return (
        f"{advice} (another elbow angle would not do: drag of a bearing on the elbow is exactly a "
        "damper at the shoulder)"
    )


def _stopped(found: Unloading) -> Iterator[str]:
    over = found.over_models
    if over is not None and over.stopped is not None:
        yield (
            f"the search for models {STOPPED[over.stopped]}: the modes over all models count only "
            "the models that were tried"
        )


def _step_1(found: Unloading) -> Iterable[str]:
    if isinstance(found.step_1, str):
        yield f"the inertias are taken for exact, as step 1 cannot be done: {found.step_1}"
    elif found.step_1 is not None:
        yield from at_odds(found.step_1)


def _unnamed(found: Unloading) -> Iterator[str]:
    if found.left_out:
        return
    if all(r.air_bearings for r in found.fit.experiment.fit_recordings):
        yield (
            "only the bearings' inertia was taken off: drag and friction of theirs, if they have "
            "any, were fitted as damping of the joints and stay, so that the decay without "
            "bearings is predicted too fast; name them (--with bearing_drag, --with "
            "bearing_friction), or let residyn diagnose look for them"
        )
    else:
        yield (
            "the model has no drag or friction of the bearings, so joints are damped alike with "
            "and without them; name them (--with bearing_drag) if that leaves too much"
        )


def _not_told_apart(found: Unloading) -> Iterator[str]:
    fit, remedy = found.fit, what_would_tell(found)
    own = [i for i, n in enumerate(fit.numbers) if n.name.partition(".")[0] in found.left_out]
    for i in own:
        number = fit.numbers[i]
        if not number.determined:
            yield (
                f"these recordings cannot tell {number.name} from damping of the joints, so the "
                f"decay without bearings is not known; {remedy}"
            )
            continue
        strong = [
            f"{fit.numbers[j].name} ({r:+.2f})"
            for j, r in enumerate(fit.correlation[i])
            if j not in own and abs(r) > STRONG
        ]
        if strong and number.std > _POOR * abs(number.value):
            yield (
                f"{number.name} is known to {plain(number.percent, 2)} % only, as it is hardly told"
                f" from {', '.join(strong)}; {remedy}"
            )
    for pose in found.poses if found.left_out else ():
        for order, mode in enumerate(pose.without_bearings, 1):
            error = mode.damping_ratio_std / mode.damping_ratio if mode.damping_ratio > 0 else 0.0
            if _POOR < error < math.inf:
                yield (
                    f"damping of mode {order} without bearings (theta2 = {pose.theta2:.4g} rad) is "
                    f"known to {plain(100 * error, 2)} % only; {remedy}"
                )
                return


# -- modes in words --------------------------------------------------------------------------


def decay_words(mode: Mode) -> str:
    """ "in 12.5 s (12.3 to 12.7)"; of a mode that grows, what that is."""
    found = decay_of(mode)
    if found is None:
        return "grows: not physical"
    value = f"in {plain(found.value, 3)} s"
    if math.isnan(found.low):
        return f"{value} (error not known)"
    if math.isinf(found.high):
        return f"{value} ({plain(found.low, 3)} or more)"
    low, high = plain(found.low, 3), plain(found.high, 3)
    return value if low == high else f"{value} ({low} to {high})"


def _frequency(mode: Mode) -> str:
    return measured(mode.frequency_hz, mode.frequency_hz_std, "Hz")


def _damping(mode: Mode) -> str:
    return measured(100 * mode.damping_ratio, 100 * mode.damping_ratio_std, "%")


def modes_table(pose: Pose) -> Table:
    rows, sides = [], (pose.with_bearings, pose.without_bearings)
    if pose.leaves_with or pose.leaves_without:
        each = (pose.leaves_with, pose.leaves_without)
        rows.append(["rest", *("moves away: not physical" if x else "returns" for x in each)])
    for i in range(max(map(len, sides))):
        pair = [side[i] if i < len(side) else None for side in sides]
        told = ("frequency", _frequency), ("damping ratio", _damping), ("falls to 1/e", decay_words)
        for words, say in told:
            cells = ("does not ring" if m is None else say(m) for m in pair)
            rows.append([f"{i + 1} {words}", *cells])
    return Table(["mode", "on its bearings", "in orbit, without them"], rows)


def inertias_table(found: Unloading) -> Table:
    was, now = (np.asarray(inertias(m.mechanism)) for m in (found.model, found.unloaded))
    rows = [
        [name, plain(float(a), 5), plain(float(b), 5), unit]
        for name, unit, a, b in zip(NAMES, UNITS, was, now, strict=True)
    ]
    return Table(["inertia", "on its bearings", "without bearings", "unit"], rows, left=(0, 3))


def taken_off(found: Unloading) -> str:
    bearings = found.fit.experiment.bearings
    mass, many = sum(b.mass for b in bearings), "s" * (len(bearings) > 1)
    what = "the model names no drag or friction of theirs"
    if found.left_out:
        what = f"and of the model {spoken(found.left_out, found.fit.joints)}"
    return f"{len(bearings)} air bearing{many}, {mass:.4g} kg (Eq. 5); {what}."


def exact_words(found: Unloading) -> str:
    """Which errors are in those of the modes."""
    covariance = found.inertia_covariance
    if covariance is None:
        return "Errors are those of the fit: the inertias are taken for exact."
    stds = ", ".join(
        f"{name} {plain(float(s), 2)}"
        for name, s in zip(NAMES, np.sqrt(np.diag(covariance)), strict=True)
    )
    return f"Errors hold those of the inertias from step 1 ({stds})."


# -- in a terminal ---------------------------------------------------------------------------


def text(found: Unloading) -> str:
    lines = ["[[Taken off]]", *filled(taken_off(found), "    "), *printed(inertias_table(found))]
    for pose in found.poses:
        lines.append(f"[[Modes]]  elbow at {plain(pose.theta2, 4)} rad")
        lines += printed(modes_table(pose))
        if not pose.physical:
            lines += filled(_NOT_PHYSICAL, "    ")
    lines += filled(exact_words(found), "    ")
    if found.over_models is not None:
        lines.append(str(found.over_models))
    if found.check:
        note = "held-out recordings without bearings, predicted; the lowest mode's errors"
        lines += section("Check", note)
        for check in found.check:
            lines += filled(check_words(check, found), "    ", 8)
    return "\n".join([*lines, *warned(found.warnings, "Warnings of step 3")])


def check_words(check: BareCheck, found: Unloading) -> str:
    """A recording without bearings beside what was predicted of it."""
    fit, noise = found.fit, check.beside.recording.noise
    left = "; ".join(
        f"{joint} {amount(float(x), unit)}, {times(float(x / sigma))} x noise"
        for joint, x, unit, sigma in zip(fit.joints, check.rmse, fit.units, noise, strict=True)
    )
    words = f"{check.name}: rms {left}"
    if check.frequency_error is None or check.damping_error is None:
        return words
    seen, predicted = check.measured[0], check.predicted[0].damping_ratio
    damping = _off(check.damping_error)
    if predicted < 0:
        damping = f"predicted {plain(100 * predicted, 2)} %, not physical"
    elif not seen.damping_ratio > 0:
        damping = "measured not physical"
    return (
        f"{words}; frequency {_off(check.frequency_error)} (measured {seen.frequency_hz:.5g} Hz), "
        f"damping ratio {damping} (measured {plain(100 * seen.damping_ratio, 3)} %)"
    )


def _off(share: float) -> str:
    return f"{plain(100 * abs(share), 2)} % too {'high' if share > 0 else 'low'}"


# -- on a page -------------------------------------------------------------------------------


def verdict(found: Unloading) -> str:
    """The lowest mode without bearings, or what is not physical."""
    if not found.physical:
        return f"{upper(found.unphysical[0])}."
    if not found.without_bearings:
        return "Without its bearings the arm does not ring."
    before, mode = "", found.without_bearings[0]
    if found.with_bearings:
        on = found.with_bearings[0]
        decay = decay_of(on)
        when = "growing" if decay is None else f"{plain(decay.value, 3)} s"
        before = f" (on them: {_frequency(on)}, {when})"
    return (
        f"Without its bearings the arm rings at {_frequency(mode)}, and its lowest mode falls to "
        f"1/e {decay_words(mode)}{before}."
    )


def band(found: Unloading, sides: tuple[RingDown, RingDown]) -> str:
    words, units = [], found.fit.experiment.units
    for side, where in zip(sides, ("on the bearings", "without them"), strict=True):
        if side.low is None or side.high is None:
            words.append(f"{where} there is none, as the recordings leave a number open")
            continue
        width = float(np.max(side.high - side.low))
        size = amount(width, units[0] if units else None, 2)
        wide = f"at most {size} wide" if np.isfinite(width) else "without bound"
        words.append(f"{where} it is {wide}")
    lacks = ", and this one does lack something" if found.fit.misses else ""
    return (
        f"The band holds the motion with 95 % if the model lacks nothing{lacks}: "
        f"{', '.join(words)}. "
        "It is not drawn where it is thinner than the line."
    )
