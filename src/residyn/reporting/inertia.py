"""All that is said of step 1: tests, inertias with errors, the `[arm]` table, the page."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ..diagnosis.result import Value
from ..errors import InputError
from ..procedure.carried import NAMES
from ..procedure.result import InertiaResult, TestResult
from ..procedure.weak import CALIBRATED
from ..recordings.tables import check_bearings
from .layout import Table, filled, printed, section, warned
from .names import listed, unbroken
from .numbers import measured, plain, times, with_error

_CLOSE = 20.0  # times the least error of coupling (Eq. 16) from which elbow angles are too close
_COARSE = 0.1  # relative error beyond which a number is said to be poor
_STRUCTURE = 1.2  # reduced chi-square of a test beyond which the equation lacks something
_OVERSTATED = 0.5  # and below which its noise must have been
_FRICTION = ("Coulomb friction", "viscous friction", "offset")
_SURE = 3.0  # standard errors that make a difference more than chance


# -- the warnings ----------------------------------------------------------------------------


def warnings(result: InertiaResult) -> tuple[str, ...]:
    """All warnings of step 1: the recordings', alone and together, then the result's."""
    tests, checks = result.tests, (_close, _contradiction, _bearings, at_odds)
    said = [w for t in tests for w in _recording(t)]
    driven = replace(result.experiment, recordings=tuple(t.test.recording for t in tests))
    own = [w for r in driven.recordings for w in r.warnings]
    said += [w for w in driven.warnings if w not in own]
    said += [w for t in tests for w in _of_test(t)]
    return tuple(said + [w for check in checks for w in check(result)])


def _recording(test: TestResult) -> Iterable[str]:
    """A braked joint may well stand still: that is no doubt here."""
    still = f"q{2 - test.test.joint} never moves"
    return (w for w in (*test.test.recording.warnings, *test.test.warnings) if still not in w)


def _of_test(test: TestResult) -> Iterable[str]:
    left = times(test.solved.chi2**0.5)
    if test.solved.chi2 > _STRUCTURE and test.solved.enlarged:
        yield (
            f"{test.name}: {left} times the noise is left: friction is more than Coulomb "
            "and viscous, something else turned the joint, or the noise is not white (the steps of "
            "an encoder are not); the errors allow for it as if it were chance"
        )
    elif test.solved.chi2 < _OVERSTATED:
        yield (
            f"{test.name}: only {left} times the noise is left: noise is overstated, and "
            "the errors are too large"
        )
    elif test.solved.enlarged:
        yield f"{test.name}: what is left is not white noise; the errors were enlarged for it"
    for name, number in zip(_FRICTION[:2], test.friction.values(), strict=False):
        if number and number.value < -_SURE * number.std:
            yield (
                f"{test.name}: {name} is negative, which adds energy: is the torque's sign the "
                "angle's?"
            )


def _close(result: InertiaResult) -> Iterable[str]:
    apart = result.separation
    if apart.excess > _CLOSE:
        yield (
            f"the elbow angles are close (Eq. 16): the error of coupling is {times(apart.excess)} "
            "times what 0 and pi would give; record one more test with the shoulder driven, the "
            "elbow turned further"
        )
    for name, value, std in zip(NAMES, result.values, result.std, strict=True):
        if std > _COARSE * abs(value):
            yield f"{name} is known to no better than {plain(100 * std / abs(value), 2)} %"


def _contradiction(result: InertiaResult) -> Iterable[str]:
    chi2, free = result.reduced_chi2, len(result.tests) - 3
    if chi2 is not None and chdtrc(free, free * chi2) < CALIBRATED:
        yield (
            f"the tests disagree, by {times(float(np.sqrt(chi2)))} times their errors: is every "
            "theta2 right, and did nothing change between them? the errors were enlarged for it"
        )


def _bearings(result: InertiaResult) -> Iterable[str]:
    bearings = result.experiment.bearings
    if not bearings or result.problem:
        return
    try:
        check_bearings(result.arm, bearings)
    except InputError as error:
        yield str(error)


def at_odds(result: InertiaResult) -> Iterable[str]:
    """Inertias that the experiment has already, where they differ."""
    for name, value, std in zip(NAMES, result.values, result.std, strict=True):
        given = getattr(result.experiment.inertia, name)
        if given is not None and abs(given - value) > _SURE * std:
            yield (
                f"[arm] has {name} = {given:g}; these tests say {plain(value, 5)}, "
                f"{times(abs(given - value) / std)} standard errors away"
            )


# -- in a terminal ---------------------------------------------------------------------------


def text(result: InertiaResult) -> str:
    """Everything but the `[arm]` table, in 80 columns."""
    note = "value +/- standard error [the paper's least squares, Eq. 12, 13]"
    lines = section("Tests", note)
    for test in result.tests:
        lines += _test(test, result.experiment.joints)
    lines += section("Eq. 16", "are the elbow angles far enough apart?")
    lines += filled(apart_words(result), "    ")
    lines.append("[[Inertia]]  value +/- standard error (error in %) [the paper's, Eq. 12 to 15]")
    rows = [
        [name, f"{measured(*number)} ({_percent(number)} %)", f"[{plain(x, 5)}]"]
        for name, number, x in _inertias(result)
    ]
    lines += printed(Table(["", "", ""], rows, left=(0, 1)))
    if result.reduced_chi2 is not None:
        lines += filled(agreement(result), "    ")
    return "\n".join([*lines, *warned(result.warnings)])


def _inertias(result: InertiaResult) -> Iterable[tuple[str, Value, float]]:
    numbers = result.shoulder, result.elbow, result.coupling
    return zip(NAMES, numbers, result.least_squares.tolist(), strict=True)


def _percent(number: Value) -> str:
    return plain(100 * number.std / abs(number.value), 2) if number.value else "?"


def agreement(result: InertiaResult) -> str:
    return (
        f"{len(result.tests)} tests for three unknowns: chi-square "
        f"{plain(result.reduced_chi2 or 0.0, 3)} per degree of freedom (1: they agree within "
        "errors)"
    )


def toml(result: InertiaResult) -> str:
    """The `[arm]` table, as the other commands read it; errors as comments."""
    l1, l2 = result.link_lengths
    lines = ["[arm]", f"link_lengths = [{l1!r}, {l2!r}]  # m"]
    for name, (value, std, unit), _ in _inertias(result):
        found, error = with_error(value, std)
        lines.append(f"{name} = {found}  # +/- {error} {unit}")
    return "\n".join(lines) + "\n"


def _test(test: TestResult, joints: tuple[str, ...]) -> list[str]:
    pose = "" if test.test.joint else f", elbow at {_theta2(test)} rad"
    rows = []
    numbers = test.inertia, *test.friction.values()
    each = zip(("composite inertia", *_FRICTION), numbers, (*test.least_squares, None), strict=True)
    for name, number, paper in each:
        if number is None:
            rows.append([name, "not told apart: it slid one way only", ""])
        else:
            beside = f"[{plain(paper.value, 4)}]" if paper else ""
            rows.append([name, measured(*number), beside])
    return [
        *filled(f"{test.name}: {joints[test.test.joint]} driven{pose}", "  "),
        *printed(Table(["", "", ""], rows, left=(0, 1))),
        f"    torque             noise {plain(test.test.torque_noise, 2)} N m; what is left is "
        f"{times(test.solved.chi2**0.5)} times the noise",
    ]


def _theta2(test: TestResult) -> str:
    return f"{round(test.test.theta2, 4) + 0.0:.4f}"


def apart_words(result: InertiaResult) -> str:
    """Whether the elbow angles are far enough apart (Eq. 16)."""
    apart = result.separation
    answer = "yes" if apart.excess < 4 else "barely" if apart.excess < _CLOSE else "hardly"
    cosines = ", ".join(dict.fromkeys(f"{c:.3f}" for c in apart.cosines))
    return (
        f"{answer}: cosines {cosines} differ by {apart.span:.3g} (2 at most): 1 % of error "
        f"in the composite inertias is {plain(apart.amplification, 2)} % in coupling. Elbow angles "
        f"of 0 and pi would make it {times(apart.excess)} times smaller."
    )


# -- on a page -------------------------------------------------------------------------------


def inertias_table(found: InertiaResult) -> Table:
    rows = [
        [name, _pm(number), _percent(number), plain(x, 5), number.unit]
        for name, number, x in _inertias(found)
    ]
    head = ["inertia", "value ± standard error", "error in %", "by least squares (Eq. 12 to 15)"]
    return Table([*head, "unit"], rows, left=(0, 4))


def verdict(found: InertiaResult) -> str:
    if found.problem is not None:
        return f"Not physical: {found.problem}."
    each = [f"{name} {_pm(number)} {number.unit}" for name, number, _ in _inertias(found)]
    return f"The arm on its bearings: {listed(each)}."


def _pm(number: Value) -> str:
    return unbroken(" +/- ".join(with_error(number.value, number.std)))


def tests_table(found: InertiaResult) -> Table:
    rows = []
    for t in found.tests:
        friction = ["not told apart" if n is None else _pm(n) for n in t.friction.values()][:2]
        driven = found.experiment.joints[t.test.joint], "" if t.test.joint else _theta2(t)
        rows.append([t.name, *driven, _pm(t.inertia), *friction, times(t.solved.chi2**0.5)])
    head = ["recording", "driven", "elbow at (rad)", "composite inertia (kg m²)"]
    head += ["Coulomb friction (N m)", "viscous friction (N m s/rad)", "left / noise"]
    return Table(head, rows, left=(0, 1))
