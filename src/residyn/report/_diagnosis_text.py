"""A diagnosis for a terminal of 80 columns, the verdict first.

The names that its pictures and pages share with it (what a rung is called, which suspects are worth
a line) are here too.
"""

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .._units import plain, with_error
from .words import listed, ratio

if TYPE_CHECKING:
    from ..fitting.result import Fit
    from .result import Candidate, Diagnosis, Rung, Value

_WIDTH = 80
_LABEL, _PAIR, _CHI2 = 36, 16, 12
_PAIRS = (_WIDTH - _LABEL - _CHI2) // _PAIR
_LIKELY = 0.001  # probability from which a suspect is worth a line
_MOST = 8
PLAIN = "springs and dampers"


def lines(found: "Diagnosis") -> list[str]:
    """The whole printout, a string per line."""
    return [
        *_wrapped("", " ".join(found.words)),
        "",
        *ladder(found),
        *suspects(found),
        *lookalikes(found),
        *next_experiment(found),
        "",
        str(found.fit),
    ]


# -- names ---------------------------------------------------------------------------------------


def rung_name(rung: "Rung") -> str:
    """What joined the model at a rung: "+ gravity"; of the base model, all that it has."""
    if rung.added is not None:
        without = f" without {listed(rung.dropped)}" if rung.dropped else ""
        return f"+ {rung.added}{without}"
    return base_name(rung.fit)


def base_name(fit: "Fit") -> str:
    """ "springs and dampers", and what else the user put in."""
    usual = {f"{kind}:{joint}" for kind in ("spring", "damper") for joint in fit.joints}
    return " + ".join([PLAIN, *(label for label in fit.model.labels if label not in usual)])


def at_place(label: str, joints: Sequence[str]) -> str:
    """ "coulomb_friction at the elbow"; a place that is no joint stays as it is written."""
    name, _, place = label.partition(":")
    if place not in joints or name == "inertia_error":
        return label
    return f"{name} at the {place}" if len(joints) > 1 else name


def times_noise(rung: "Rung") -> list[tuple[float, float | None]]:
    """Per joint the error in times the noise, where it was fitted and where it was not."""
    held = rung.held_out
    return [
        (float(times), None if held is None else float(held.held_out.ratio[j]))
        for j, times in enumerate(rung.times_noise)
    ]


def worth_showing(found: "Diagnosis", most: int = _MOST) -> tuple["Candidate", ...]:
    """The suspects that deserve a line: those that were tried, or are likely, or the best few."""
    told = [
        c
        for c in found.candidates
        if c.chi2_drop_refit is not None or c.probability >= _LIKELY or c.effect in found.added
    ]
    return tuple(told or found.candidates[:3])[:most]


def percent(probability: float) -> str:
    """A probability: never 100 %, as nothing measured is certain."""
    if not math.isfinite(probability):
        return "?"
    if probability > 0.995:
        return "> 99 %"
    return "< 1 %" if probability < 0.005 else f"{100 * probability:.0f} %"


def value_words(value: "Value") -> str:
    """ "0.2003 +/- 0.0012 N m"."""
    number, error = with_error(value.value, value.std)
    unit = "" if value.unit == "1" else f" {value.unit}"
    if not math.isfinite(value.std):
        return f"{plain(value.value, 4)}{unit}"
    return f"{number} +/- {error}{unit}"


def fall(chi2: float | None) -> str:
    """A fall of chi-square."""
    if chi2 is None:
        return "-"
    return f"{chi2:.0f}" if math.isfinite(chi2) and abs(chi2) < 1e7 else plain(chi2, 3)


# -- the parts -----------------------------------------------------------------------------------


def ladder(found: "Diagnosis") -> list[str]:
    """The error, rung by rung."""
    joints = found.fit.joints
    held = next((r.held_out.what for r in found.ladder if r.held_out is not None), None)
    head = "rms residual in times the noise"
    if held is not None:
        head += f"; held out: {'the ' if held == 'last third' else ''}{held}"
    out = [f"[[Ladder]]  {head}"]
    if len(joints) > _PAIRS:
        return out + [line for rung in found.ladder for line in _stacked(rung, joints)]
    width, short, long = (_PAIR, 7, 9) if held is not None else (_PAIR // 2, _PAIR // 2, 0)
    names = "".join(f"{_cut(joint, width - 2):>{width}}" for joint in joints)
    out.append(f"{'':{_LABEL}}{names}{'chi-square':>{_CHI2}}")
    kinds = (
        f"{'fitted':>{short}}{'held out':>{long}}" if held is not None else f"{'fitted':>{width}}"
    )
    out.append(f"{'':{_LABEL}}{kinds * len(joints)}{'per reading':>{_CHI2}}")
    for rung in found.ladder:
        *above, name = textwrap.wrap(
            rung_name(rung),
            _LABEL,
            initial_indent="    ",
            subsequent_indent="      ",
            break_on_hyphens=False,
            break_long_words=False,
        )
        if len(name) > _LABEL:
            above, name = [*above, name], ""
        cells = ""
        for fitted, checked in times_noise(rung):
            cells += f"{f'{ratio(fitted)} x':>{short}}"
            if held is not None:
                cells += f"{'-' if checked is None else f'{ratio(checked)} x':>{long}}"
        out += [*above, f"{name:<{_LABEL}}{cells}{plain(rung.fit.reduced_chi2):>{_CHI2}}"]
    return out


def _stacked(rung: "Rung", joints: Sequence[str]) -> list[str]:
    """A rung of more joints than stand side by side."""
    chi2 = f"chi-square {plain(rung.fit.reduced_chi2)} per reading"
    out = [f"    {rung_name(rung)}: {chi2}"]
    for joint, (fitted, checked) in zip(joints, times_noise(rung), strict=True):
        held = "" if checked is None else f"{ratio(checked):>8} x held out"
        out.append(f"      {_cut(joint, 26):<26}{ratio(fitted):>6} x fitted{held}")
    return out


def suspects(found: "Diagnosis") -> list[str]:
    """What might be missing in the base model, the likeliest first."""
    if not found.candidates:
        return []
    out = _wrapped(
        "[[Suspects]]  ",
        "what might be missing in the first model: probability, and by how much chi-square falls "
        "with it, as screened (to first order) and as refitted",
    )
    out.append(f"{'':{_LABEL}}{'probability':>14}{'screened':>14}{'refitted':>14}")
    shown = worth_showing(found)
    for c in shown:
        cells = percent(c.probability), fall(c.chi2_drop_screened), fall(c.chi2_drop_refit)
        name = f"    {c.effect}"
        if len(name) > _LABEL:
            out.append(name)
            name = ""
        out.append(f"{name:<{_LABEL}}{''.join(f'{cell:>14}' for cell in cells)}")
        # Numbers that were only screened are a guess at a first step, and not worth reading.
        if c.chi2_drop_refit is not None:
            numbers = [f"{n.rpartition('.')[2]} {value_words(v)}" for n, v in c.parameters.items()]
            out += _wrapped("        ", ", ".join(numbers)) if numbers else []
    rest = len(found.candidates) - len(shown)
    if rest:
        out.append(f"    and {rest} more that {'was' if rest == 1 else 'were'} screened")
    return out


def lookalikes(found: "Diagnosis") -> list[str]:
    """Names that the recordings cannot tell apart."""
    groups = [g for g in found.lookalikes if len(g) > 1]
    if not groups:
        return []
    out = ["[[Look-alikes]]"]
    for group in groups:
        out += _wrapped("    ", alike(group))
    return out


def alike(group: Sequence[str]) -> str:
    """A group of look-alikes in a sentence."""
    first, *others = group
    return f"{first} cannot be told from {listed(others)} by these recordings."


def next_experiment(found: "Diagnosis") -> list[str]:
    """What to record to tell look-alikes apart."""
    if found.next_experiment is None:
        return []
    return ["[[Next experiment]]", *_wrapped("    ", found.next_experiment.words)]


def _cut(words: str, most: int) -> str:
    return words if len(words) <= most else f"{words[: most - 3]}..."


def _wrapped(head: str, words: str) -> list[str]:
    return textwrap.wrap(
        words,
        _WIDTH,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_on_hyphens=False,
    )
