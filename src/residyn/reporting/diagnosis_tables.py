"""A diagnosis as tables for a paper: the error falling, and what might have been missing."""

from typing import TYPE_CHECKING

import numpy as np

from ..fitting.publish import (
    NEEDS,
    effect,
    escaped,
    lines,
    measured,
    residuals,
    scientific,
    table,
    unit,
)
from .numbers import plain, prefixed
from .words import base_name, listed, nats, percent, worth_showing

if TYPE_CHECKING:
    from ..diagnosis.result import Diagnosis, ModelState


def latex(found: "Diagnosis") -> str:
    """Two tables: the models on the way, and the candidates that are worth a line."""
    return f"{_models(found)}\n{_candidates(found).removeprefix(NEEDS).lstrip()}"


def _models(found: "Diagnosis") -> str:
    joints, held = found.fit.joints, any(r.held_out is not None for r in found.ladder)
    units = found.fit.experiment.units or ("",) * len(joints)
    scales = [
        prefixed(name, float(min(r.fit.rmse[j] for r in found.ladder)))
        for j, name in enumerate(units)
    ]
    above, below, rules = [""], ["Model"], []
    for joint, (_, short) in zip(joints, scales, strict=True):
        words = f"{escaped(joint)} ({unit(short)})"
        if held:
            rules.append(rf"\cmidrule(lr){{{len(below) + 1}-{len(below) + 2}}}")
            above.append(rf"\multicolumn{{2}}{{c}}{{{words}}}")
            below += ["fitted", "held out"]
        else:
            below.append(words)
    below.append(r"Reduced $\chi^2$")
    rows = []
    for step in found.ladder:
        cells = [_model(step)]
        checks = _held_out(step)
        for j, (factor, _) in enumerate(scales):
            cells.append(_size(step.fit.rmse[j] / factor))
            if held:
                cells.append(_size(checks[j] / factor))
        rows.append([*cells, scientific(plain(step.fit.reduced_chi2))])
    over = f"{' & '.join([*above, ''])} \\\\\n{' '.join(rules)}\n" if held else ""
    return table("l" + "r" * (len(below) - 1), below, [rows], over)


def _model(step: "ModelState") -> str:
    """What joined, with its place in words."""
    if step.added is None:
        return escaped(base_name(step.fit))
    gone = [_placed(x) for x in step.dropped]
    return f"+ {_placed(step.added)}" + (f" without {listed(gone)}" if gone else "")


def _placed(label: str) -> str:
    """`coulomb_friction:elbow` is "coulomb friction (elbow)"."""
    name, _, place = label.partition(":")
    return escaped(name.replace("_", " ") + (f" ({place})" if place else ""))


def _candidates(found: "Diagnosis") -> str:
    head = ["Effect", "Probability", r"$\Delta\log$ evidence", "Value", "Unit"]
    rows = []
    for c in worth_showing(found):
        sure = escaped(percent(c.probability)).replace("<", "$<$").replace(">", "$>$")
        first = [effect(c.effect), sure, f"${nats(c.log_evidence)}$"]
        if not c.parameters:
            rows.append([*first, "--", ""])
        for i, (name, v) in enumerate(c.parameters.items()):
            own = f"{escaped(name.rpartition('.')[2])} " if len(c.parameters) > 1 else ""
            begin = first if i == 0 else ["", "", ""]
            rows.append([*begin, own + measured(v.value, v.std), unit(v.unit)])
    return table("lrrrl", head, [rows])


def comma_separated(found: "Diagnosis") -> str:
    """One line for each number: which table and which line of it, name, value, std, unit."""
    rows: list[tuple[object, ...]] = []
    units = found.fit.experiment.units or ("",) * len(found.fit.joints)
    for step in found.ladder:
        own = "ladder", base_name(step.fit) if step.added is None else f"+ {step.added}"
        for name, joint, x, u in residuals(step.fit):
            if name != "check_rmse":
                rows.append((*own, f"{name}:{joint}", x, None, u))
        if step.held_out is not None:
            for joint, x, u in zip(found.fit.joints, _held_out(step), units, strict=True):
                rows.append((*own, f"check_rmse:{joint}", x, None, u))
        rows.append((*own, "reduced_chi2", step.fit.reduced_chi2, None, "1"))
        rows.append((*own, "log_evidence", step.log_evidence, None, "1"))
    for c in found.candidates:
        own = "candidate", c.effect
        rows.append((*own, "probability", c.probability, None, "1"))
        rows.append((*own, "log_evidence", c.log_evidence, None, "1"))
        rows += [(*own, name, v.value, v.std, v.unit) for name, v in c.parameters.items()]
    return lines(("table", "model", "name", "value", "std", "unit"), rows)


def _held_out(step: "ModelState") -> np.ndarray:
    held = step.held_out
    return np.full(len(step.fit.joints), np.nan) if held is None else held.held_out.rmse


def _size(x: float) -> str:
    return scientific(plain(float(x)))
