"""All that is said of laws without a name: sentences and tables."""

from collections.abc import Iterator

from ..diagnosis.forecast import ModelState
from ..diagnosis.law import Law
from ..diagnosis.result import Diagnosis
from .layout import NUMBERS, Table, filled, printed, section
from .names import (
    at,
    error_change,
    force,
    listed,
    modal,
    position,
    spoken,
    upper,
)
from .numbers import measured, nats, percent
from .tried import model_name, times_noise

_WHAT = {"direction": "friction", "angle": "stiffness", "rate": "damping"}


def what(law: Law, joints: tuple[str, ...] | list[str]) -> str:
    """ "a torque at the elbow that depends on the rate"."""
    how = "changes with" if law.variable == "time" else "depends on the"
    acts = _WHAT[law.factor] if law.factor else force([law.unit])
    return f"a {acts}{at(law.joint, joints)} that {how} {variable(law)}"


def variable(law: Law) -> str:
    """Of which it is a law: "angle", or "position" where the joint slides; "rate" or "time"."""
    return position([law.variable_unit]) if law.variable == "angle" else law.variable


def formula(law: Law) -> str:
    """Equation and numbers; empty where there is none."""
    if law.formula is None:
        return ""
    each = law.formula.parameters.items()
    numbers = [f"{name} {measured(value, std, unit)}" for name, (value, std, unit) in each]
    return f"{law.formula.equation}, {listed(numbers)}"


def models(found: Diagnosis, comma: bool = False) -> Iterator[tuple[str, ModelState]]:
    """What joined each model that is shown, and the model."""
    for step in found.models:
        law = next((x for x in found.laws if x.model is step), None)
        name = model_name(step, comma) if law is None else f"+ {what(law, found.fit.joints)}"
        yield name, step


def sentences(found: Diagnosis) -> Iterator[str]:
    """What is known of the likeliest law."""
    if not found.laws:
        return
    law, *others = found.laws
    joints, told = found.fit.joints, formula(law)
    beside = f"Beside {spoken(law.beside, joints)}, " if law.beside else ""
    first = upper(f"{beside}what has no name {modal(law.probability)} {what(law, joints)}")
    yield f"{first} ({percent(law.probability)})" + (f": {told}." if told else ".")
    if law.variable == "time" and not law.factor:
        yield "A sensor whose zero drifts moves the readings in the same way."
    if others:
        rest = [f"{what(x, joints)} ({percent(x.probability)})" for x in others]
        yield f"It may also be {' or '.join(rest)}."


def fall(found: Diagnosis) -> Iterator[str]:
    """How far the error falls with the likeliest law at its joint."""
    if not beside_fit(found):
        return
    j = found.fit.joints.index(found.laws[0].joint)
    before, after = (times_noise(m)[j] for m in found.models[-2:])
    words = f"With the law without a name{' as well' if found.added else ''} the error"
    yield f"{words}{at(found.fit.joints[j], found.fit.joints)} {error_change(before, after)}."


def beside_fit(found: Diagnosis) -> str:
    """What the numbers of the last model with names are, where a law joined it; else nothing."""
    if len(found.models) == len(found.ladder):
        return ""
    return "These numbers are those of the model without the law that has no name."


def text(found: Diagnosis) -> list[str]:
    if not found.laws:
        return []
    rows = []
    for law in found.laws:
        lines = [upper(what(law, found.fit.joints))]
        lines += filled(formula(law), "  ", width=NUMBERS) if law.formula else []
        rows.append(["\n".join(lines), percent(law.probability), nats(law.log_evidence)])
    note = (
        "free curves of one variable: probability, and log evidence (nats) relative to the best "
        "model with names only"
    )
    table = Table(["", "probability", "log evidence"], rows)
    out = [*section("Laws without a name", note), *printed(table)]
    first = found.laws[0]
    if first.found is not None:
        kind = "its formula" if first.formula else "its curve, a table,"
        words = f"--found FILE writes {kind} as a class, for --with {first.found.label}"
        out += filled(words, "    ", 6)
    return out


def table(found: Diagnosis) -> Table:
    rows = [
        [what(x, found.fit.joints), percent(x.probability), nats(x.log_evidence), formula(x)]
        for x in found.laws
    ]
    return Table(["law", "probability", "log evidence (nats)", "formula"], rows, left=(0, 3))
