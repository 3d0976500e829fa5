"""How step 3 reads in a terminal of 80 columns."""

import math
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from ..fitting import Mode
from ..reporting.numbers import amount, plain, ratio, with_error
from .carried import NAMES, inertias
from .decay import decay_words

if TYPE_CHECKING:
    from .unloaded import BareCheck, Pose, Unloading

NOT_PHYSICAL = (
    "Not physical: nothing drives the arm, so that no mode can grow or leave its rest. These "
    "recordings do not determine these numbers; see the warnings of step 3."
)


def report_lines(found: "Unloading") -> list[str]:
    """Everything beside the fit's own report."""
    lines = ["[[Taken off]]", *_taken_off(found)]
    for pose in found.poses:
        lines.append(
            f"[[Modes]]  elbow at {plain(pose.theta2, 4)} rad: on its bearings -> in orbit"
        )
        lines += _modes(pose)
        if not pose.physical:
            lines += _wrapped("    ", NOT_PHYSICAL)
    lines += _wrapped("    ", exact_words(found))
    if found.over_models is not None:
        from ..reporting.over_models import over_lines

        lines += over_lines(found.over_models, found.fit.joints)
    if found.check:
        lines.append("[[Check]]  recordings without bearings, predicted; the lowest mode's errors")
        for check in found.check:
            lines += check_lines(check, found)
    if found.warnings:
        lines.append("[[Warnings of step 3]]")
        for warning in found.warnings:
            lines += _wrapped("    - ", warning)
    return lines


def _taken_off(found: "Unloading") -> list[str]:
    bearings = found.fit.experiment.bearings
    mass, many = sum(b.mass for b in bearings), "s" * (len(bearings) > 1)
    lines = _wrapped("    ", f"{len(bearings)} air bearing{many}, {mass:.4g} kg (Eq. 5)")
    rows = zip(
        NAMES,
        ("kg m^2", "kg m^2", "kg m"),
        np.asarray(inertias(found.model.mechanism)).tolist(),
        np.asarray(inertias(found.unloaded.mechanism)).tolist(),
        strict=True,
    )
    lines += [f"    {name:<9} {was:.5g} -> {now:.5g} {unit}" for name, unit, was, now in rows]
    what = ", ".join(found.left_out) or "none: the model names no drag or friction of theirs"
    return [*lines, *_wrapped("    effects   ", what)]


def _modes(pose: "Pose") -> list[str]:
    lines, sides = [], (pose.with_bearings, pose.without_bearings)
    if pose.leaves_with or pose.leaves_without:
        on, off = (
            "moves away: not physical" if leaves else "returns"
            for leaves in (pose.leaves_with, pose.leaves_without)
        )
        lines.append(f"       {'from its rest':<14} {on:<26} -> {off}")
    for i in range(max(map(len, sides))):
        pair = [side[i] if i < len(side) else None for side in sides]
        for words, what, unit in (
            ("frequency", "frequency_hz", " Hz"),
            ("damping ratio", "damping_ratio", ""),
        ):
            head = f"{i + 1}" if what == "frequency_hz" else " "
            on, off = (_value(mode, what, unit) for mode in pair)
            lines.append(f"    {head}  {words:<14} {on:<26} -> {off}".rstrip())
        on, off = ("does not ring" if mode is None else decay_words(mode) for mode in pair)
        lines.append(f"       {'falls to 1/e':<14} {on:<26} -> {off}")
    return lines


def _value(mode: Mode | None, what: str, unit: str) -> str:
    if mode is None:
        return "does not ring"
    value, std = getattr(mode, what), getattr(mode, f"{what}_std")
    if not math.isfinite(std):
        return f"{plain(value, 3)} +/- ?{unit}"
    number, error = with_error(value, std)
    return f"{number} +/- {error}{unit}"


def exact_words(found: "Unloading") -> str:
    """Which errors are in those of the modes."""
    covariance = found.inertia_covariance
    if covariance is None:
        return "Errors are those of the fit: the inertias are taken for exact."
    stds = ", ".join(
        f"{name} {plain(float(s), 2)}"
        for name, s in zip(NAMES, np.sqrt(np.diag(covariance)), strict=True)
    )
    return f"Errors hold those of the inertias from step 1 ({stds})."


def check_lines(check: "BareCheck", found: "Unloading") -> list[str]:
    """A recording without bearings beside what was predicted of it."""
    units = found.fit.experiment.units or ("",) * len(found.fit.joints)
    sizes = zip(found.fit.joints, check.rmse, units, check.beside.recording.noise, strict=True)
    left = "; ".join(
        f"{joint} {amount(float(x), unit)}, {ratio(float(x / noise))} x noise"
        for joint, x, unit, noise in sizes
    )
    lines = _wrapped("    ", f"{check.name}: rms {left}")
    if check.frequency_error is not None and check.damping_error is not None:
        measured, predicted = check.measured[0], check.predicted[0].damping_ratio
        damping = (
            _percent(check.damping_error)
            if predicted > 0 and measured.damping_ratio > 0
            else f"predicted {plain(predicted, 2)}, not physical"
            if predicted < 0
            else "measured not physical"
        )
        lines += _wrapped(
            "        ",
            f"frequency {_percent(check.frequency_error)} (measured "
            f"{measured.frequency_hz:.5g} Hz), damping ratio {damping} "
            f"(measured {measured.damping_ratio:.3g})",
        )
    return lines


def _percent(share: float) -> str:
    size = plain(100 * abs(share), 2)
    return f"{size} % too {'high' if share > 0 else 'low'}"


def _wrapped(head: str, words: str) -> list[str]:
    return textwrap.wrap(
        words, 80, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False
    )
