"""What is left after the ladder, judged and put into words."""

from collections.abc import Sequence

import numpy as np

from .._units import plain, ratio
from ..fitting.result import Fit
from .result import Verdict
from .rung import Step
from .words import chance, listed

LEFT = 4e-3
"""Probability, if it is noise, below which something is taken to be left."""
_LIKELY = 0.7  # probability below which a name is a guess
_MOSTLY = 0.5  # of what is left
_SLIGHT = 0.1  # of the residual's size: structure smaller than this does not matter


def verdict_on(last: Step, added: bool, instead: bool = False) -> Verdict:
    """About what is left: noise, or not; `instead`: one law of no catalogue is likelier than all
    names together."""
    if instead:
        return "unexplained"
    if last.white >= LEFT or slight(last):
        return "missing" if added else "adequate"
    return "unexplained"


def slight(step: Step) -> bool:
    """Whether what is not noise is so small a part of the residual that it does not matter: all
    structure taken out, the residual would hardly be smaller. Real noise is never quite white; a
    noise that was stated is taken to be."""
    if any(r.recording.noise_given for r in step.near.fitted):
        return False
    bands = step.where.frequency
    freedom = sum(p.whole.freedom for p in bands)
    energy = sum(p.whole.energy for p in bands)
    if freedom <= 0 or energy <= 0:
        return False
    # Noise is what the quieter half of the bands say it is.
    levels = sorted((p.whole.energy / p.whole.freedom, p.whole.freedom) for p in bands
                    if p.whole.freedom > 0)  # fmt: skip
    count = np.cumsum([f for _, f in levels])
    floor = levels[int(np.searchsorted(count, 0.5 * count[-1]))][0]
    beyond = sum(max(0.0, p.whole.energy - floor * p.whole.freedom) for p in bands)
    return bool(1.0 - np.sqrt(max(0.0, 1.0 - beyond / energy)) < _SLIGHT)


def _looks_like(last: Step) -> list[str]:
    """Which torque, of whatever law, would explain most of what is left."""
    seen = last.unnamed
    if seen is None or seen.p >= LEFT or seen.drop < _MOSTLY * (last.cost - last.readings):
        return []
    return [f"Most of it is what a torque would do that {seen.words}."]


def words_for(
    verdict: Verdict,
    base: Fit,
    last: Step,
    kept: Sequence[tuple[str, float]],
    groups: Sequence[tuple[str, ...]],
    instead: str = "",
) -> tuple[str, ...]:
    """The verdict in a few sentences; `kept` are names and how sure each is; `instead` is what one
    law would be that is likelier than all of them."""
    fit = last.fit
    worst = int(np.nanargmax(base.rmse / base.noise))
    joint = fit.joints[worst]
    before, after = (f.rmse[worst] / f.noise[worst] for f in (base, fit))
    if verdict == "adequate":
        if last.white >= LEFT:
            return (
                "Nothing is missing that these recordings could show: what springs and dampers "
                f"leave is {ratio(after)} times the noise and white ({chance(last.white)}).",
            )
        return (
            "Nothing is missing that matters: what is left is "
            f"{ratio(after)} times the noise; it is not quite white ({chance(last.white)}), but "
            "no effect of the catalogue makes it smaller by as much as a model should.",
        )
    names = listed([f"{name} ({100 * p:.0f} %)" for name, p in kept]) if kept else ""
    # As many digits as it takes to see the difference.
    digits = next((d for d in (2, 3) if plain(before, d) != plain(after, d)), 4)
    fall = (
        f"the error at the {joint} falls from {plain(before, digits)} to {plain(after, digits)} "
        "times the noise"
    )
    if verdict == "missing":
        be = "is" if len(kept) == 1 else "are"
        if min(p for _, p in kept) < _LIKELY:
            be = "may be"
        words = [
            f"{names} {be} missing: with {'it' if len(kept) == 1 else 'them'} {fall}, and what "
            f"is left is no more than noise ({chance(last.white)})."
        ]
    elif instead:
        words = [
            f"With {names}, {fall}, and what is left is no more than noise ({chance(last.white)}).",
            f"But one torque that {instead} would do as much with fewer numbers: likelier than all "
            "of these names is one law that is not in the catalogue.",
        ]
    elif kept:
        words = [
            f"{names} explain{'s' * (len(kept) == 1)} part of it: {fall}.",
            "Something real is left that no effect of the catalogue explains "
            f"({chance(last.white)}): see the torque that is still missing.",
        ]
    else:
        words = [
            "Something real is missing that no effect of the catalogue explains: springs and "
            f"dampers leave {ratio(after)} times the noise at the {joint}, and it is not noise "
            f"({chance(last.white)}). See the torque that is missing."
        ]
    if verdict == "unexplained" and not instead:
        words += _looks_like(last)
    for group in groups:
        words.append(f"These recordings cannot tell {group[0]} from {listed(list(group[1:]))}.")
    return tuple(words)
