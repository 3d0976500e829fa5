"""Names, probabilities and numbers as every text, table and picture says them."""

import math
from collections.abc import Sequence

from ..diagnosis.result import Candidate, Diagnosis, ModelState, Value
from ..effects import CATALOGUE
from ..fitting.result import Fit
from .numbers import plain, ratio, with_error

PLAIN = "springs and dampers"
_CERTAIN = 0.995
SURE = 0.9
"""Probability from which a sentence says "is"."""
_LINE = 0.001  # probability from which a candidate is worth a line
_MOST = 8
_FEWEST = 3


def listed(words: Sequence[str]) -> str:
    """ "a, b and c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def upper(words: str) -> str:
    """The same with a capital first letter."""
    return words[:1].upper() + words[1:]


def lower(words: str) -> str:
    """The same with a small first letter, unless it begins with a person's name."""
    named = words.split(" ", 1)[0] in ("Coulomb", "Stribeck", "Bouc-Wen")
    return words if named else words[:1].lower() + words[1:]


def unbroken(words: str) -> str:
    """For a page: numbers stay with their signs and units."""
    words = words.replace(" +/- ", " ± ").replace("^2", "²").replace("^3", "³")
    for bare in (" ± ", " %", "N m", "> ", "< "):
        words = words.replace(bare, bare.replace(" ", "\u00a0"))
    return words


# -- names ---------------------------------------------------------------------------------------


def title(label: str) -> str:
    """What an effect is called in words: "Coulomb friction" of `coulomb_friction:elbow`."""
    name = label.partition(":")[0]
    kind = CATALOGUE.get(name)
    return upper(name.replace("_", " ")) if kind is None else kind.titled()


def placed(words: str, place: str | None, joints: Sequence[str]) -> str:
    """Words with a place: "gravity", "dry friction at the elbow"; where there is but one
    joint, without it."""
    if place is None or (place in joints and len(joints) == 1):
        return words
    if place not in joints:
        return f"{words} ({place})"
    return f"{words} at the {place}"


def at_place(label: str, joints: Sequence[str]) -> str:
    """ "Coulomb friction at the elbow"."""
    return placed(title(label), label.partition(":")[2] or None, joints)


def base_name(fit: Fit) -> str:
    """ "springs and dampers", and what else the user put in."""
    usual = {f"{kind}:{joint}" for kind in ("spring", "damper") for joint in fit.joints}
    more = [lower(at_place(x, fit.joints)) for x in fit.model.labels if x not in usual]
    return " + ".join([PLAIN, *more])


def model_name(step: ModelState) -> str:
    """What joined the model on the way: "+ gravity"; of the base model, all that it has."""
    if step.added is None:
        return base_name(step.fit)
    joints = step.fit.joints
    gone = [lower(at_place(x, joints)) for x in step.dropped]
    name = f"+ {lower(at_place(step.added, joints))}"
    return f"{name} without {listed(gone)}" if gone else name


# -- numbers -------------------------------------------------------------------------------------


def percent(probability: float) -> str:
    """A probability: never 100 %, as nothing measured is certain."""
    if not math.isfinite(probability):
        return "?"
    if probability > _CERTAIN:
        return "> 99 %"
    return "< 1 %" if probability < 1 - _CERTAIN else f"{100 * probability:.0f} %"


def share_words(share: float) -> str:
    """A share as per cent: "3.1 %", "< 0.01 %"."""
    if not math.isfinite(share):
        return "?"
    return "< 0.01 %" if 0 < share < 1e-4 else f"{plain(100 * share, 2)} %"


def modal(probability: float, many: bool = False) -> str:
    """ "is", "is probably" or "may be", as the probability allows."""
    verb = "are" if many else "is"
    if probability >= SURE:
        return verb
    return f"{verb} probably" if probability >= 0.5 else "may be"


def value_words(value: Value) -> str:
    """ "0.2003 +/- 0.0012 N m"."""
    number, error = with_error(value.value, value.std)
    unit = "" if value.unit == "1" else f" {value.unit}"
    if not math.isfinite(value.std):
        return f"{plain(value.value, 4)}{unit}"
    return f"{number} +/- {error}{unit}"


def nats(log_evidence: float) -> str:
    """A log evidence relative to the best model's."""
    if not math.isfinite(log_evidence):
        return "-"
    return "0" if abs(log_evidence) < 0.05 else (
        f"{log_evidence:.1f}" if abs(log_evidence) < 99.95 else f"{log_evidence:.0f}"
    )  # fmt: skip


def times_noise(step: ModelState) -> list[tuple[float, float | None]]:
    """Per joint the error in times the noise, where it was fitted and where it was not."""
    held = step.held_out
    return [
        (float(times), None if held is None else float(held.held_out.ratio[j]))
        for j, times in enumerate(step.times_noise)
    ]


def times(value: float) -> str:
    """How many times the noise, to two digits."""
    return ratio(value) if not value >= 1e4 else f"{value:.1e}"


def worth_showing(found: Diagnosis, most: int = _MOST) -> tuple[Candidate, ...]:
    """The candidates that deserve a line: the likely ones, and the best of the rest."""
    told = [c for c in found.candidates if c.probability >= _LINE or c.effect in found.added]
    rest = [c for c in found.candidates if c not in told and math.isfinite(c.log_evidence)]
    return (*told, *rest[: max(0, len(found.added) + _FEWEST - len(told))])[:most]
