"""What a diagnosis has tried, in words: its models, their errors, and the candidates that deserve a
line."""

import math

from ..diagnosis.forecast import ModelState
from ..diagnosis.result import Candidate, Diagnosis
from .names import at_place, base_name, lower

_LINE = 0.001  # probability from which a candidate is worth a line
_MOST, _FEWEST = 8, 3  # lines of candidates


def model_name(step: ModelState, comma: bool = False) -> str:
    """What joined the model on the way: "+ gravity"; of the base model, all that it has."""
    each = (f"+ {lower(at_place(x, step.fit.joints, comma))}" for x in step.added)
    return " ".join(each) if step.added else base_name(step.fit, comma)


def times_noise(step: ModelState) -> list[tuple[float, float | None]]:
    """Per joint the error in times the noise, where it was fitted and where it was not."""
    held = step.held_out.held_out.ratio if step.held_out else None
    each = [None] * len(step.times_noise) if held is None else map(float, held)
    return list(zip(map(float, step.times_noise), each, strict=True))


def worth_showing(found: Diagnosis) -> tuple[Candidate, ...]:
    """The candidates that deserve a line: the likely ones, and the best of the rest."""
    told = [c for c in found.candidates if c.probability >= _LINE or c.effect in found.added]
    rest = [c for c in found.candidates if c not in told and math.isfinite(c.log_evidence)]
    shown = [*told, *rest[: max(0, len(found.added) + _FEWEST - len(told))]][:_MOST]
    return tuple(c for c in found.candidates if c in shown)


def unnamed(found: Diagnosis) -> str:
    """What does not explain the rest: the whole catalogue, or what there was time for."""
    return f"no effect {'of the catalogue' if found.budget.stopped is None else 'that was tried'}"


def untried(found: Diagnosis) -> bool:
    """Whether the search was ended before it came to any effect."""
    alone = found.budget.models == 1 and not found.explains_nothing
    return found.verdict == "unexplained" and alone
