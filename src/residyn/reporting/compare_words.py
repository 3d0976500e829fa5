"""A comparison in two to five sentences.

Each says one thing and its number: whether anything is left, at which joint and when, at which
swing, at which frequency, and how far a prediction can be trusted. What noise alone could have done
is not said.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..diagnosis.evidence import NOISE
from ..diagnosis.forecast import HeldOut
from ..diagnosis.residuals import Cell, Part, Where
from .numbers import amount, plain
from .words import listed
from .words import times as ratio

if TYPE_CHECKING:
    from ..diagnosis.compare import Comparison

_LARGER = 1.2  # reduced chi-square beyond which more is left than the noise stated
_SMALLER = 0.8
_TELLS = 4.0  # standard deviations of chance by which a part must exceed the noise to be named
_CONTRAST = 1.5  # times as large: one part against another
_NEAR = 0.8  # of the largest: as good as the largest
_READINGS = 20  # a part of fewer is not spoken of
_MOSTLY = 2 / 3
_NAMED = 0.1  # share of the excess from which a band is named
_CLEAR = 2.0  # times its neighbours: a multiple of a mode that stands by itself
_WORSE = 1.15  # of what three standard errors of the prediction allow


def sentences(found: "Comparison") -> tuple[str, ...]:
    """The words of a comparison."""
    sure, chi2 = found.p < NOISE, found.fit.reduced_chi2
    held, left, chances = _held_out(found), _left(found), _chances(found)
    if not sure and chi2 > _LARGER:
        first = (
            f"What is left is white ({chances}), and yet {left}: more noise than was stated, not "
            "a motion that the model lacks."
        )
        return (first, *held)
    if not sure:
        first = (
            f"Nothing is left that the noise does not explain: what is left is white ({chances}), "
            f"{left}."
        )
        less = "The noise that was stated is more than these readings show."
        return (first, *([less] if chi2 < _SMALLER else []), *held)
    if chi2 > _LARGER:
        first = f"The model misses something: it leaves {left}, and that is not white"
    else:
        first = f"Something small is left that is not noise: {left}, but not white"
    at = found.where
    told = (_when(at), _swing(at), _frequency(found))
    return (f"{first} ({chances}).", *(t for t in told if t), *held)


def excess(cell: Cell) -> float:
    """Energy beyond what noise alone would leave."""
    return max(0.0, cell.energy - cell.freedom)


def _tells(cell: Cell) -> bool:
    return cell.energy - cell.freedom > _TELLS * math.sqrt(2 * max(cell.freedom, 1.0))


def _left(found: "Comparison") -> str:
    """ "3.5 mrad at the shoulder (7.1 times the noise) and 3.1 mrad at the elbow (6 times)"."""
    words, at = [], found.where
    for joint, unit, rmse, cell in zip(at.joints, at.units, found.fit.rmse, at.joint, strict=True):
        noise = "" if words else " the noise"
        size = amount(float(rmse), unit, 2)
        words.append(f"{size} at the {joint} ({ratio(cell.ratio)} times{noise})")
    return listed(words)


def _chances(found: "Comparison") -> str:
    words, many = [], len(found.where.joints) > 1
    for joint, white in found.where.white.items():
        known = math.isfinite(white.p)
        said = chance(white.p) if known else "too few readings to tell"
        words.append(f"{said} at the {joint}" if many else said)
    alike = {w.partition(" at the ")[0] for w in words}
    return f"{alike.pop()} at every joint" if many and len(alike) == 1 else ", ".join(words)


def chance(p: float) -> str:
    """A probability."""
    return "p < 1e-12" if p < 1e-12 else f"p = {p:.1g}" if p < 0.095 else f"p = {p:.2f}"


def _worst(at: Where) -> int:
    """The joint with most of what exceeds the noise."""
    return max(range(len(at.joint)), key=lambda j: excess(at.joint[j]))


def _when(at: Where) -> str:
    """At which joint, and when."""
    worst, total = _worst(at), sum(map(excess, at.joint))
    alone = len(at.joint) > 1 and excess(at.joint[worst]) > _MOSTLY * total
    told = [(p, p.cells[worst] if alone else p.whole) for p in at.time]
    told = [(p, c) for p, c in told if c.freedom > _READINGS]
    parts = [f"at the {at.joints[worst]}"] if alone else []
    if told:
        most, least = (f(told, key=lambda pair: pair[1].ratio) for f in (max, min))
        high, low = ratio(most[1].ratio), ratio(least[1].ratio)
        near = [p for p, c in told if c.ratio > _NEAR * most[1].ratio]
        thirds = {min(2, int(1.5 * (p.start + p.stop) / at.time[-1].stop)) for p in near}
        if _tells(most[1]) and most[1].ratio > _CONTRAST * least[1].ratio and len(thirds) < 3:
            when = listed([("early", "midway", "late")[i] for i in sorted(thirds)])
            spans = f"{high} times the noise {_span(most[0])}, {low} times {_span(least[0])}"
            parts.append(f"{when} ({spans})")
        elif _tells(most[1]):
            even = f"all along ({low} to {high} times the noise)"
            return f"It fails {f'most {parts[0]}, ' if alone else ''}{even}."
    return f"It fails most {', '.join(parts)}." if parts else ""


def _span(part: Part) -> str:
    return f"from {part.start:.3g} to {part.stop:.3g} s"


def _swing(at: Where) -> str:
    """At large swings, at small ones?"""
    j = _worst(at)
    told = [p for p in at.amplitude[j] if p.whole.freedom > _READINGS]
    sizes = [p.whole.ratio for p in told]
    if len(told) < 2 or not any(_tells(p.whole) for p in told):
        return ""
    large, small = (
        f"{ratio(p.whole.ratio)} times the noise {which} {amount(edge, at.units[j], 2)}"
        for p, which, edge in (
            (told[0], "above", told[0].start),
            (told[-1], "below", told[-1].stop),
        )
    )
    falls, rises = (
        x[0] > _CONTRAST * x[-1] and x[0] * _NEAR > max(x[1:]) for x in (sizes, sizes[::-1])
    )
    if falls:
        return f"At the {at.joints[j]} it is worst at large swings: {large}, {small}."
    if rises:
        return f"At the {at.joints[j]} it is worst at small swings: {small}, {large}."
    return ""


def _frequency(found: "Comparison") -> str:
    """Around which frequencies."""
    bands = found.where.frequency
    total = sum(excess(p.whole) for p in bands)
    parts = [p for p in bands if _tells(p.whole)]
    if not parts or total <= 0:
        return ""
    parts.sort(key=lambda p: -excess(p.whole))
    named = [p for p in parts if excess(p.whole) > _NAMED * total][:3] or parts[:1]
    shares = [f"{plain(100 * excess(p.whole) / total, 2)} % {_band(p, found)}" for p in named]
    words = f"Of what exceeds the noise, {listed(shares).replace(' % ', ' % lies ', 1)}"
    clear = [p for p in _standing(bands) if p not in named][:2]
    if clear:
        each = [f"{ratio(p.whole.ratio)} times the noise {_band(p, found)}" for p in clear]
        words += f"; {listed(each)} is a sign of a torque that is not linear"
    return f"{words}."


def _standing(parts: Sequence[Part]) -> list[Part]:
    """Multiples of modes that stand out from the bands beside them."""
    found = []
    for before, part, after in zip(parts, parts[1:], parts[2:], strict=False):
        beside = max(before.whole.ratio, after.whole.ratio)
        if " x " in part.name and _tells(part.whole) and part.whole.ratio > _CLEAR * beside:
            found.append(part)
    return found


def _band(part: Part, found: "Comparison") -> str:
    times, found_mode, mode = part.name.rpartition("mode ")
    if found_mode and not times.startswith("below"):
        frequency = found.fit.modes[int(mode) - 1].frequency_hz
        frequency *= int(times.split()[0]) if times else 1
        return f"around {part.name} ({plain(frequency)} Hz)"
    if part.name == "above":
        return f"above {plain(part.start)} Hz"
    if part.start == 0:
        return f"below {plain(part.stop)} Hz"
    return f"between {plain(part.start)} and {plain(part.stop)} Hz"


def _held_out(found: "Comparison") -> list[str]:
    held = found.held_out
    if held is None:
        return []
    times = [ratio(x) for x in held.held_out.ratio if math.isfinite(x)]
    if not times:
        return []
    off = f"{listed(times)} times the noise"
    if held.what == "check recordings":
        words = f"The check recordings, which it was not fitted to, are off by {off}"
    else:
        words = f"The last third, predicted from a fit of the first two, is off by {off}"
    if worse(held):
        fitted = listed([ratio(x) for x in held.fitted.ratio if math.isfinite(x)])
        return [f"{words}: worse than where it was fitted ({fitted} times)."]
    return [f"{words}{', as it should be' if found.p >= NOISE else ''}."]


def worse(held: HeldOut) -> bool:
    """Whether the model errs more where it was not fitted than noise explains."""
    expected = held.held_out.expected
    for j, (now, then) in enumerate(zip(held.held_out.ratio, held.fitted.ratio, strict=True)):
        bound = 1.0 if expected is None else math.sqrt(1 + 9 * (float(expected[j]) ** 2 - 1))
        if now > _WORSE * bound and now > _WORSE * then:
            return True
    return False
