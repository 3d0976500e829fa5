"""What a careful person would want to be told about step 1, one line each."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc

from ..errors import InputError
from ..recordings.tables import ArmTable, check_bearings
from ..reporting.numbers import plain, ratio
from .printed import CLOSE
from .weak import CALIBRATED

if TYPE_CHECKING:
    from .result import InertiaResult, TestResult

_COARSE = 0.1
"""Relative error beyond which a number is said to be poor."""
_STRUCTURE = 1.2
"""Reduced chi-square of a test beyond which the equation lacks something."""
_OVERSTATED = 0.5
"""And below which its noise must have been."""
_SURE = 3.0
"""Standard errors that make a difference more than chance."""
_NAMES = ("shoulder", "elbow", "coupling")


def problem_with(result: "InertiaResult") -> str | None:
    """Why no real arm has these inertias; None if one has."""
    try:
        ArmTable(result.link_lengths, *(float(f"{x:.5g}") for x in result.values))
    except InputError as error:
        return f"what was found is no arm's inertia (is every theta2 right?): {error}"
    return None


def warnings_for(result: "InertiaResult") -> tuple[str, ...]:
    """All warnings of step 1: the recordings' own, then the result's."""
    own = [w for t in result.tests for w in (*_recording(t), *t.test.warnings)]
    return (
        *own,
        *(line for t in result.tests for line in _test(t)),
        *_close(result),
        *_contradiction(result),
        *_bearings(result),
        *_given(result),
    )


def _recording(test: "TestResult") -> Iterable[str]:
    """A braked joint may well stand still: that is no doubt here."""
    still = f"q{2 - test.test.joint} never moves"
    return (w for w in test.test.recording.warnings if still not in w)


def _test(test: "TestResult") -> Iterable[str]:
    left = float(np.sqrt(test.solved.chi2))
    if test.solved.chi2 > _STRUCTURE and test.solved.enlarged:
        yield (
            f"{test.name}: {ratio(left)} times the noise is left: friction is more than Coulomb "
            "and viscous, something else turned the joint, or the noise is not white (the steps of "
            "an encoder are not); the errors allow for it as if it were chance"
        )
    elif test.solved.chi2 < _OVERSTATED:
        yield (
            f"{test.name}: only {ratio(left)} times the noise is left: noise is overstated, and "
            "the errors are too large"
        )
    elif test.solved.enlarged:
        yield f"{test.name}: what is left is not white noise; the errors were enlarged for it"
    for name, number in test.friction.items():
        if number and name != "offset" and number.value < -_SURE * number.std:
            yield (
                f"{test.name}: {name.replace('_', ' ')} is negative, which adds energy: is the "
                "torque's sign the angle's?"
            )


def _close(result: "InertiaResult") -> Iterable[str]:
    apart = result.separation
    if apart.excess > CLOSE:
        yield (
            f"the elbow angles are close (Eq. 16): the error of coupling is {ratio(apart.excess)} "
            "times what 0 and pi would give; record one more test with the shoulder driven, the "
            "elbow turned further"
        )
    for name, value, std in zip(_NAMES, result.values, result.std, strict=True):
        if std > _COARSE * abs(value):
            yield f"{name} is known to no better than {plain(100 * std / abs(value), 2)} %"


def _contradiction(result: "InertiaResult") -> Iterable[str]:
    chi2 = result.reduced_chi2
    free = len(result.tests) - 3
    if chi2 is not None and chdtrc(free, free * chi2) < CALIBRATED:
        yield (
            f"the tests disagree, by {ratio(float(np.sqrt(chi2)))} times their errors: is every "
            "theta2 right, and did nothing change between them? the errors were enlarged for it"
        )


def _bearings(result: "InertiaResult") -> Iterable[str]:
    bearings = result.experiment.bearings
    if not bearings or problem_with(result):
        return
    try:
        table = ArmTable(result.link_lengths, *(float(x) for x in result.values))
        check_bearings(table, bearings)
    except InputError as error:
        yield str(error)


def _given(result: "InertiaResult") -> Iterable[str]:
    """Inertias that the experiment has already, where they differ."""
    table = result.experiment.inertia
    for name, value, std in zip(_NAMES, result.values, result.std, strict=True):
        given = getattr(table, name)
        if given is not None and abs(given - value) > _SURE * std:
            yield (
                f"[arm] has {name} = {given:g}; these tests say {plain(value, 5)}, "
                f"{ratio(abs(given - value) / std)} standard errors away"
            )
