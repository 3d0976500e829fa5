"""How step 1 reads in a terminal of 80 columns."""

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from ..reporting.numbers import plain, ratio, with_error

if TYPE_CHECKING:
    from .result import InertiaResult, Number, TestResult

CLOSE = 20.0
"""Times the least error of coupling (Eq. 16) from which elbow angles are too close."""


def report_lines(result: "InertiaResult") -> list[str]:
    """Everything but the `[arm]` table."""
    lines = ["[[Tests]]  value +/- standard error [the paper's least squares, Eq. 12, 13]"]
    for test in result.tests:
        lines += _test(test, result.experiment.joints)
    lines += [
        "[[Eq. 16]]  are the elbow angles far enough apart?",
        *_wrapped("    ", apart_words(result)),
    ]
    lines.append("[[Inertia]]  value +/- standard error (error in %) [the paper's, Eq. 12 to 15]")
    names, units = ("shoulder", "elbow", "coupling"), ("kg m^2", "kg m^2", "kg m")
    rows = zip(names, units, result.values, result.std, result.least_squares, strict=True)
    for name, unit, value, std, ordinary in rows:
        found, error = with_error(value, std)
        percent = plain(100 * std / abs(value), 2) if value else "?"
        lines.append(
            f"    {name:<9} {f'{found} +/- {error} {unit} ({percent} %)':<44} "
            f"[{plain(ordinary, 5)}]"
        )
    if result.reduced_chi2 is not None:
        lines += _wrapped(
            "    ",
            f"{len(result.tests)} tests for three unknowns: chi-square "
            f"{plain(result.reduced_chi2, 3)} per degree of freedom (1: they agree within errors)",
        )
    if result.warnings:
        lines.append("[[Warnings]]")
        for warning in result.warnings:
            lines += _wrapped("    - ", warning)
    return lines


def arm_lines(result: "InertiaResult") -> list[str]:
    """The `[arm]` table, errors as comments."""
    l1, l2 = result.link_lengths
    lines = ["[arm]", f"link_lengths = [{l1!r}, {l2!r}]  # m"]
    names, units = ("shoulder", "elbow", "coupling"), ("kg m^2", "kg m^2", "kg m")
    for name, unit, value, std in zip(names, units, result.values, result.std, strict=True):
        found, error = with_error(float(value), float(std))
        lines.append(f"{name} = {found}  # +/- {error} {unit}")
    return lines


def _test(test: "TestResult", joints: tuple[str, ...]) -> list[str]:
    pose = "" if test.test.joint else f", elbow at {round(test.test.theta2, 4) + 0.0:.4f} rad"
    lines = _wrapped("  ", f"{test.name}: {joints[test.test.joint]} driven{pose}")
    names = ("composite inertia", "Coulomb friction", "viscous friction", "offset")
    units = ("kg m^2", "N m", "N m s/rad", "N m")
    numbers = (test.inertia, *test.friction.values())
    for row in zip(names, units, numbers, (*test.least_squares, None), strict=True):
        lines.append(_row(*row))
    noise = plain(test.test.torque_noise, 2)
    left = ratio(float(np.sqrt(test.solved.chi2)))
    lines.append(f"    {'torque':<17} noise {noise} N m; what is left is {left} times the noise")
    return lines


def _row(name: str, unit: str, number: "Number | None", ordinary: "Number | None") -> str:
    if number is None:
        return f"    {name:<17} not told apart from Coulomb friction: it slid one way only"
    value, error = with_error(*number)
    text = f"    {name:<17} {f'{value} +/- {error} {unit}':<36}"
    return f"{text} [{plain(ordinary.value, 4)}]" if ordinary else text.rstrip()


def apart_words(result: "InertiaResult") -> str:
    """Whether the elbow angles are far enough apart (Eq. 16)."""
    apart = result.separation
    verdict = "yes" if apart.excess < 4 else "barely" if apart.excess < CLOSE else "hardly"
    cosines = ", ".join(f"{c:.3f}" for c in apart.cosines)
    return (
        f"{verdict}: cosines {cosines} differ by {apart.span:.3g} (2 at most): 1 % of error "
        f"in the composite inertias is {plain(apart.amplification, 2)} % in coupling. Elbow angles "
        f"of 0 and pi would make it {ratio(apart.excess)} times smaller."
    )


def _wrapped(head: str, words: str) -> list[str]:
    return textwrap.wrap(
        words, 80, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False
    )
