"""The next tests in words and lines that a technician can follow, in 80 columns."""

import math

from ..diagnosis.candidate_tests import Test
from ..diagnosis.plan import Plan
from ..physics.parameter import INERTIA
from .layout import Table, filled, printed
from .names import listed, named, position, spoken, upper
from .numbers import amount, measured, percent, plain

_TELLS = 2.0  # standard errors by which one reading tells two models apart 19 times in 20


def motion_words(test: Test) -> str:
    """ "release the shoulder at 0.30 rad and the elbow at 0 rad, counted from rest"."""
    if test.drive is not None:
        d = test.drive
        unit = "N" if test.units[list(test.release).index(d.joint)] == "m" else "N m"
        return (
            f"from rest, drive the {d.joint} with {plain(d.torque, 3)} {unit}, a sine that rises "
            f"from {plain(d.low, 2)} to {plain(d.high, 2)} Hz"
        )
    angles = [
        f"the {joint} at {_angle(x, unit)}"
        for (joint, x), unit in zip(test.release.items(), test.units, strict=True)
    ]
    return f"release {listed(angles)}, counted from rest"


def setting_words(test: Test) -> str:
    """ "elbow at 0.5 rad, on the air bearings"; empty where there is nothing to set."""
    words = []
    if test.theta2 is not None:
        words.append(f"the elbow's rest at {_angle(test.theta2, 'rad')}")
    if test.air_bearings is not None:
        words.append("on the air bearings" if test.air_bearings else "without the air bearings")
    if test.extra_mass is not None:
        unit = INERTIA.unit(*filter(None, test.units[:1]))
        load = f"with {plain(test.extra_mass, 3)} {unit} of load"
        words.append(load if test.extra_mass else "bare")
    if test.load is not None:
        words.append(f"under a load of {plain(test.load, 3)} N")
    return ", ".join(words)


def recipe(test: Test) -> str:
    """All that is to be done, as part of a sentence."""
    setting = f" ({words})" if (words := setting_words(test)) else ""
    return f"{motion_words(test)}{setting}, and record {plain(test.duration, 2)} s"


def _angle(value: float, unit: str) -> str:
    """ "0.300 rad (17 deg)": people set degrees."""
    degrees = f" ({math.degrees(value):.0f} deg)" if unit == "rad" and value else ""
    return f"{amount(value, unit)}{degrees}"


def _errors(count: float) -> str:
    """A count of standard errors; of the smallest, rounding is all that is left."""
    return "less than 0.01" if count < 0.01 else plain(count, 2)


def sentence(test: Test) -> str:
    joints = tuple(test.release)
    one, other = (spoken(x, joints) for x in test.between)
    aim = f"tell {one} from {other}"
    if not all(test.between):  # the one is the other with more
        aim = f"see whether {other if test.between[1] else one} is there"
    parts = f"{_errors(test.difference)} standard errors of all readings together"
    now = _errors(test.now)
    if not test.helps:
        return (
            f"Nothing would help: no test within the limits would {aim}. At best the predictions "
            f"differ by {parts}, where now it is {now}."
        )
    tells = f"the predictions then differ by {parts}, where now it is {now}"
    if test.difference < 1.0:
        tells = (
            "these two then differ by less than a standard error of all readings together, but not "
            "in how far they leave the readings open"
        )
    return (
        f"To {aim}, {recipe(test)}: {tells}, "
        f"and the likeliest is expected to have {percent(test.probability_right)}."
    )


def outcomes(test: Test) -> Table:
    joints = tuple(test.release)
    reads = position([test.unit]) if test.reads == "angle" else test.reads
    what = f"{reads} of the {test.joint} after {plain(test.time, 3)} s"
    rows = [
        [
            upper(named(x.added, joints)),
            measured(x.reading, x.std, test.unit),
            percent(x.probability),
        ]
        for x in test.outcomes
    ]
    return Table(["if the model is", what, "probability then"], rows)


def text(found: Plan | Test) -> str:
    return "\n".join(filled(sentence(found)) if isinstance(found, Test) else _plan(found))


def _plan(plan: Plan) -> list[str]:
    among = 1.0 - plan.left_out  # so that all that is printed adds up to 100 %
    rows = [[percent(among * m.probability), named(m.added, plan.joints)] for m in plan.models]
    out = ["[[Models in play]]", *(printed(Table(["", ""], rows, left=(1,))) if rows else [])]
    if plan.channels is not None:
        words = f"It seems that {plan.channels.words} ({percent(plan.channels.probability)})."
        out += filled(words, "    ")
        return [*out, *filled("No test is planned before that is settled.", "    ")]
    rest = (
        (plan.unnamed, "a law without a name, which predicts no other test, has"),
        (plan.left_out - plan.unnamed, "less likely models share"),
    )
    for probability, words in rest:
        if probability > 0.005:
            out += filled(upper(f"{words} {percent(probability)}."), "    ")
    if plan.models and plan.unexplained > 0.5:
        out += filled(
            "None of them is complete: something is left that no effect of the catalogue explains. "
            "No test gives that a name; a test only tells these models apart.",
            "    ",
        )
    out.append("[[Next tests]]")
    if plan.settled:
        words = "the recordings tell these models apart with odds of more than 20 to 1 already"
        return [*out, *filled(f"Nothing more is needed: {words}.", "    ")]
    if len(plan.models) < 2:
        only = "only one" if plan.models else "none"
        words = f"No test is planned: a test tells models with names apart, and {only} is in play."
        return [*out, *filled(words, "    ")]
    if not plan.helps:
        words = f"Nothing would help: none of {plan.tried} tests within limits tells them apart."
        if plan.tests:
            words += (
                " The best is expected to lower the entropy of the models from "
                f"{plain(plan.entropy, 2)} to {plain(plan.tests[0].entropy, 2)} nats."
            )
        return [*out, *filled(words, "    ")]
    before = plan.entropy
    for i, test in enumerate(plan.tests, 1):
        if not test.helps:
            out += filled("A further test would hardly tell more.", "    ")
            break
        out += _test(i, test, before)
        before = test.entropy
    if len(plan.tests) > 1:
        out += filled(
            "Each test is the best beside those above it. Make the first, add its recording to the "
            "experiment, and plan again.",
            "    ",
        )
    return out


def _test(index: int, test: Test, before: float) -> list[str]:
    out = filled(upper(motion_words(test)), f"{index:>3}  ")
    rows = {
        "set": upper(setting_words(test)),
        "record": f"{plain(test.duration, 2)} s",
        "tells": f"entropy {plain(before, 2)} -> {plain(test.entropy, 2)} nats; the likeliest "
        f"model is then expected to have {percent(test.probability_right)}",
    }
    for head, words in rows.items():
        out += filled(words, f"     {head:<8}") if words else []
    out += printed(outcomes(test), indent=5)
    if len(test.outcomes) > 1:
        one, other = test.outcomes[:2]
        if abs(one.reading - other.reading) < _TELLS * math.hypot(one.std, other.std):
            out += filled(
                "That one reading is not enough to tell the first two apart: it takes the whole "
                f"recording, in which they differ by {plain(test.difference, 2)} standard errors.",
                "     ",
            )
    return out
