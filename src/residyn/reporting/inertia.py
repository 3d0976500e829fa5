"""Step 1 as one page."""

import os

from ..procedure import InertiaResult
from ..procedure.printed import apart_words
from ..procedure.result import NAMES, UNITS, Number, TestResult
from . import figures as plot
from .numbers import plain, ratio, with_error
from .picture import picture
from .template import filled, written
from .words import listed, unbroken


def write_inertia(path: str | os.PathLike[str], found: InertiaResult, title: str) -> None:
    """Write step 1 as one self-contained page.

    **Raises:** `InputError` if the file cannot be written.
    """
    written(path, render_inertia(found, title))


def render_inertia(found: InertiaResult, title: str) -> str:
    """The page as text."""
    numbers = found.shoulder, found.elbow, found.coupling
    return filled(
        "inertia.html.j2",
        title=title,
        found=found,
        verdict=unbroken(_verdict(found)),
        rows=[
            (
                name,
                _words(number),
                plain(100 * number.std / abs(number.value), 2),
                unit,
                plain(x, 5),
            )
            for name, number, unit, x in zip(
                NAMES, numbers, UNITS, found.least_squares, strict=True
            )
        ],
        tests=[_test(t, found.experiment.joints) for t in found.tests],
        apart=apart_words(found),
        picture=picture(
            "Inertia about the shoulder against the cosine of the elbow angle",
            plot.composite_inertia(found),
            plot.composite_inertia(found, narrow=True),
        ),
        chi2=None if found.reduced_chi2 is None else plain(found.reduced_chi2, 3),
    )


def _verdict(found: InertiaResult) -> str:
    if found.problem is not None:
        return f"Not physical: {found.problem}."
    numbers = found.shoulder, found.elbow, found.coupling
    each = [
        f"{name} {_words(number)} {unit}"
        for name, number, unit in zip(NAMES, numbers, UNITS, strict=True)
    ]
    return f"The arm on its bearings: {listed(each)}."


def _words(number: Number) -> str:
    value, std = with_error(*number)
    return unbroken(f"{value} +/- {std}")


def _test(test: TestResult, joints: tuple[str, ...]) -> dict[str, str]:
    friction = {
        name: "not told apart" if number is None else _words(number)
        for name, number in test.friction.items()
    }
    return {
        "name": test.name,
        "joint": joints[test.test.joint],
        "theta2": "" if test.test.joint else f"{round(test.test.theta2, 4) + 0.0:.4f}",
        "inertia": _words(test.inertia),
        "left": ratio(test.solved.chi2**0.5),
        **friction,
    }
