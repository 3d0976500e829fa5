"""What is said of a comparison: two to five sentences, then where the residual is, part by part.

Each sentence says one thing and its number: whether anything is left, at which joint and when, at
which swing, at which frequency, and how far a prediction can be trusted. What noise alone could
have done is not said.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..diagnosis.compare import Comparison, OwnNumbers
from ..diagnosis.evidence import NOISE
from ..diagnosis.missing_torque import Missing
from ..diagnosis.residuals import Cell, Part, Where
from ..recordings.experiment import Experiment
from . import figures as plot
from .layout import Table, filled, printed, section
from .names import at_place, force, listed, lower, the, when_held_out
from .numbers import amount, p_size, p_value, percent, plain, prefixed, share, times

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LARGER = 1.2  # reduced chi-square beyond which more is left than the noise that was stated
_SMALLER = 0.8  # reduced chi-square below which less is
_TELLS = 4.0  # standard deviations of chance by which a part must exceed the noise to be named
_CONTRAST = 1.5  # times as large: one part against another
_NEAR = 0.8  # of the largest: as good as the largest
_READINGS = 20  # a part of fewer is not spoken of
_MOSTLY = 2 / 3
_NAMED = 0.1  # share of the excess from which a band is named
_CLEAR = 2.0  # times its neighbours: a multiple of a mode that stands by itself
_WORSE = 1.15  # of what three standard errors of the prediction allow


# -- the sentences ---------------------------------------------------------------------------


def sentences(found: Comparison) -> tuple[str, ...]:
    chi2, at, left, p_values = found.fit.reduced_chi2, found.where, _left(found), _p_values(found)
    given = all(r.recording.noise_given for r in found.fit.fitted)
    noise = "stated" if given else "estimated"
    if found.p >= NOISE and chi2 > _LARGER:
        words = [
            f"What is left is white ({p_values}), and yet {left}: more noise than was {noise}, "
            "not a motion that the model lacks."
        ]
    elif found.p >= NOISE:
        words = [
            f"Nothing is left that the noise does not explain: what is left is white ({p_values}), "
            f"{left}."
        ]
        if chi2 < _SMALLER:
            words.append(f"The noise that was {noise} is more than these readings show.")
    elif found.fit.coloured_noise:
        words = [f"What is left is noise, though not white ({p_values}): {left}."]
    else:
        first = f"Something small is left that is not noise: {left}, but not white"
        if chi2 > _LARGER:
            first = f"The model misses something: it leaves {left}, and that is not white"
        words = [f"{first} ({p_values}).", _when(at), _swing(at), _frequency(found)]
    return tuple(filter(None, [*words, *_held_out(found), *map(_own, found.runs)]))


def _excess(cell: Cell) -> float:
    """Energy beyond what noise alone would leave."""
    return max(0.0, cell.energy - cell.freedom)


def _tells(cell: Cell) -> bool:
    return cell.energy - cell.freedom > _TELLS * math.sqrt(2 * max(cell.freedom, 1.0))


def _left(found: Comparison) -> str:
    """ "3.5 mrad at the shoulder (7.1 times the noise) and 3.1 mrad at the elbow (6 times)"."""
    words, at = [], found.where
    each = zip(at.joints, found.fit.units, found.fit.rmse, at.joint, strict=True)
    for joint, unit, rmse, cell in each:
        noise = "" if words else " the noise"
        size = amount(float(rmse), unit, 2)
        words.append(f"{size} at {the(joint)} ({times(cell.ratio)} times{noise})")
    return listed(words)


def _p_values(found: Comparison) -> str:
    each = [p for p in found.where.white.values() if math.isfinite(p)]
    if not each:
        return "too few readings to tell"
    least = "" if len(each) == 1 else ", the least of the joints"
    return f"whiteness test: {p_value(min(each), NOISE)}{least}"


def _worst(at: Where) -> int:
    return max(range(len(at.joint)), key=lambda j: _excess(at.joint[j]))


def _when(at: Where) -> str:
    worst, total = _worst(at), sum(map(_excess, at.joint))
    alone = len(at.joint) > 1 and _excess(at.joint[worst]) > _MOSTLY * total
    told = [(p, p.cells[worst] if alone else p.whole) for p in at.time]
    told = [(p, c) for p, c in told if c.freedom > _READINGS]
    parts = [f"at {the(at.joints[worst])}"] if alone else []
    if told:
        most, least = (f(told, key=lambda pair: pair[1].ratio) for f in (max, min))
        high, low = times(most[1].ratio), times(least[1].ratio)
        near = [p for p, c in told if c.ratio > _NEAR * most[1].ratio]
        third = at.time[-1].stop / 3  # early, late: what lies within the first, within the last
        thirds = {int(p.stop > third) + int(p.start >= 2 * third) for p in near}
        if _tells(most[1]) and most[1].ratio > _CONTRAST * least[1].ratio and len(thirds) < 3:
            when = listed([("early", "midway", "late")[i] for i in sorted(thirds)])
            spans = f"{high} times the noise {_span(most[0])}, {low} times {_span(least[0])}"
            parts.append(f"{when} ({spans})")
        elif _tells(most[1]):
            sizes = low if low == high else f"{low} to {high}"
            even = f"all along ({sizes} times the noise)"
            return f"It fails {f'most {parts[0]}, ' if alone else ''}{even}."
    return f"It fails most {', '.join(parts)}." if parts else ""


def _span(part: Part) -> str:
    return f"from {part.start:.3g} to {part.stop:.3g} s"


def _swing(at: Where) -> str:
    """At large swings, at small ones?"""
    j = _worst(at)
    told = [p for p in at.amplitude[j] if p.whole.freedom > _READINGS]
    if len(told) < 2 or not any(_tells(p.whole) for p in told):
        return ""
    first, last = told[0], told[-1]
    words = [
        f"{times(p.whole.ratio)} times the noise {which} {amount(edge, at.units[j], 2)}"
        for p, which, edge in ((first, "above", first.start), (last, "below", last.stop))
    ]
    sizes = [p.whole.ratio for p in told]
    for kind, own, said in (("large", sizes, words), ("small", sizes[::-1], words[::-1])):
        if own[0] > _CONTRAST * own[-1] and own[0] * _NEAR > max(own[1:]):
            return f"At the {at.joints[j]} it is worst at {kind} swings: {', '.join(said)}."
    return ""


def _frequency(found: Comparison) -> str:
    at, bands = found.where, found.where.frequency
    total = sum(_excess(p.whole) for p in bands)
    parts = sorted((p for p in bands if _tells(p.whole)), key=lambda p: -_excess(p.whole))
    line = _line(found)
    if not parts or total <= 0:
        return f"There is {line}." if line else ""
    named = [p for p in parts if _excess(p.whole) > _NAMED * total][:3] or parts[:1]
    shares = [f"{plain(100 * _excess(p.whole) / total, 2)} % {_band(p, at)}" for p in named]
    words = f"Of what exceeds the noise, {listed(shares).replace(' % ', ' % lies ', 1)}"
    # Multiples of modes that exceed the bands beside them.
    clear = [
        p
        for before, p, after in zip(bands, bands[1:], bands[2:], strict=False)
        if " x " in p.name and _tells(p.whole) and p not in named
        if p.whole.ratio > _CLEAR * max(before.whole.ratio, after.whole.ratio)
    ][:2]
    if clear:
        each = [f"{times(p.whole.ratio)} times the noise {_band(p, at)}" for p in clear]
        acts = force(found.fit.experiment.units)
        words += f"; {listed(each)} is a sign of a {acts} that is not linear"
    return f"{words}; there is {line}." if line else f"{words}."


def _line(found: Comparison) -> str:
    """Lines where no mode is, and no multiple of one: "a line of 13.98 Hz at the mass"."""
    at: dict[str, list[str]] = {}
    for joint, line in found.where.line.items():
        if line is None:
            continue
        f, own = line.frequency, found.where.recordings[line.recording]
        names = [b.name for b in own.bands if b.start <= f < b.stop]
        if names and names[0] in ("below mode 1", "between", "low", "above"):
            at.setdefault(plain(f, 4), []).append(f"at {the(joint)}")
    each = [f"a line of {f} Hz {listed(joints)}" for f, joints in at.items()]
    return listed(each) if each else ""


def _band(part: Part, at: Where) -> str:
    """Where it is: "around mode 1 (1.23 Hz)"; of recordings whose modes differ from the lowest to
    the highest, "around mode 1 (0.71 to 1.23 Hz)"."""
    i = next(k for k, p in enumerate(at.frequency) if p is part)
    factor, found_mode, mode = part.name.rpartition("mode ")
    if found_mode and not factor.startswith("below"):
        times_mode = int(factor.split()[0]) if factor else 1
        each = [times_mode * own.modes[int(mode) - 1].frequency_hz for own in at.recordings]
        return f"around {part.name} ({_range(each)} Hz)"
    starts, stops = zip(*(own.bands[i][1:] for own in at.recordings), strict=True)
    if part.name == "above":
        return f"above {_range(starts)} Hz"
    if at.alike:
        edges = f"{plain(part.start)} and {plain(part.stop)} Hz"
        return f"between {edges}" if part.start > 0 else f"below {plain(part.stop)} Hz"
    before, after = (at.frequency[k].name if k >= 0 else "" for k in (i - 1, i + 1))
    after = f"{_range(stops)} Hz" if after == "above" else after
    return f"between {before} and {after}" if before else f"below {after}"


def _range(each: Sequence[float]) -> str:
    low, high = plain(min(each)), plain(max(each))
    return low if low == high else f"{low} to {high}"


def _held_out(found: Comparison) -> list[str]:
    held = found.held_out
    ratios = [] if held is None else [times(x) for x in held.held_out.ratio if math.isfinite(x)]
    if held is None or not ratios:
        return []
    off = f"{listed(ratios)} times the noise"
    if held.what == "check recordings":
        words = f"The held-out recordings are off by {off}"
    else:
        words = f"The last third, held out and predicted from the first two, is off by {off}"
    # Worse than where it was fitted, and than three standard errors of the prediction allow.
    expected, now, then = held.held_out.expected, held.held_out.ratio, held.fitted.ratio
    bound = 1.0 if expected is None else np.sqrt(1 + 9 * (expected**2 - 1))
    worse = np.flatnonzero((now > _WORSE * bound) & (now > _WORSE * then))
    if len(worse):
        joints = listed([the(found.fit.joints[j]) for j in worse])
        at = f"at {joints} " if len(worse) < len(ratios) else ""
        fitted = listed([times(then[j]) for j in worse])
        return [f"{words}: {at}worse than where it was fitted ({fitted} times)."]
    return [f"{words}{', as it should be' if found.p >= NOISE else ''}."]


def _own(each: OwnNumbers) -> str:
    sure = max(each.probability, 1.0 - each.probability)
    odds = percent(sure)
    if each.probability > 0.5:
        return f"{each.effect} differs in {each.recording} from the other recordings ({odds})."
    return (
        f"{each.effect} is the same in {each.recording} as in the other recordings ({odds}): "
        "it needs no own numbers."
    )


# -- in a terminal ---------------------------------------------------------------------------


def text(found: Comparison) -> str:
    """The verdict, the fit, and all tables, in 80 columns."""
    tables = [*_where(found), *_outside(found), *_horizon(found)]
    return "\n".join([*filled(" ".join(found.words)), "", str(found.fit), *tables])


def _by_joint(label: str, joints: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]):
    """Rows of one cell a joint; more joints than there is room for stand below each other."""
    if len(joints) <= 3:
        return printed(Table([label, *joints], [[name, *cells] for name, cells in rows]))
    flat = [[name, j, c] for name, cells in rows for j, c in zip(joints, cells, strict=True)]
    return printed(Table([label, "joint", ""], flat, left=(0, 1)))


def _where(found: Comparison) -> list[str]:
    at, total = found.where, found.where.total

    def cells(each: Sequence[Cell]) -> list[str]:
        shares = (100 * c.energy / total if total > 0 else 0.0 for c in each)
        return [f"{s:5.1f} %{_x(c.ratio):>8}" for s, c in zip(shares, each, strict=True)]

    def rows(parts: Sequence[Part], size: float = 1.0) -> list[tuple[str, list[str]]]:
        return [
            (f"{_edge(p.start / size)} - {_edge(p.stop / size)}  {p.name}".strip(), cells(p.cells))
            for p in parts
        ]

    out = section("Where", "share of the squared residual, and rms in times the noise")
    p_values = ["-" if math.isnan(p) else p_size(p) for p in at.white.values()]
    white = (f"p of whiteness test ({NOISE:g})", p_values)
    out += _by_joint("", at.joints, [("all", cells(at.joint)), white])
    out += _by_joint("time since the start, s", at.joints, rows(at.time))
    for joint, unit, parts in zip(at.joints, at.units, at.amplitude, strict=True):
        size, name = prefixed(unit, parts[0].stop if parts else 1.0)
        label = f"swing at {the(joint)}, {name}".rstrip(", ")
        out += _by_joint(label, (joint,), rows(parts, size))
    whose = "" if at.alike else f", as in {at.recordings[0].name}"
    return [*out, *_by_joint(f"frequency, Hz{whose}", at.joints, rows(at.frequency))]


def _edge(x: float) -> str:
    return plain(x, 3) if x < 100 else f"{x:.0f}"


def _x(ratio: float) -> str:
    return f"{times(ratio)} x" if ratio == ratio else "-"


def _outside(found: Comparison) -> list[str]:
    held = found.held_out
    if held is None:
        return []
    rows = []
    for label, error in (("held out", held.held_out), ("fitted", held.fitted)):
        sizes = zip(error.rmse, found.fit.units, error.ratio, strict=True)
        rows.append((label, [f"{amount(x, unit)}{_x(r):>8}" for x, unit, r in sizes]))
    if held.held_out.expected is not None:
        rows.append(("a right model: held out", [_x(x) for x in held.held_out.expected]))
    head = section("Held out", f"{when_held_out(held.what)}; rms, and in times the noise")
    return [*head, *_by_joint("", found.fit.joints, rows)]


def _horizon(found: Comparison) -> list[str]:
    ahead = found.horizon
    if ahead is None:
        return []
    note = (
        "error of predictions against the time ahead, from a fit of the first "
        f"{plain(ahead.seconds)} s; in brackets what a right model would leave"
    )
    rows = [("0 (where it was fitted)", [_x(x) for x in ahead.fitted.ratio])]
    for a in ahead.ahead:
        right = a.error.expected
        cells = [
            _x(x) + ("" if right is None else f" ({times(right[j])})")
            for j, x in enumerate(a.error.ratio)
        ]
        rows.append((f"{plain(a.start)} - {plain(a.stop)}", cells))
    return [*section("Horizon", note), *_by_joint("s ahead", found.fit.joints, rows)]


# -- on a page -------------------------------------------------------------------------------


def pairs(missing: Sequence[Missing]) -> list[tuple[Missing, int]]:
    return [(found, joint) for found in missing for joint in range(len(found.joints))]


def clearest(each: Sequence[tuple[Missing, int]]) -> list[tuple[Missing, int]]:
    """Of missing torques, each of a recording and a joint, those that are larger than what is not
    known of them, the clearest first."""

    def clarity(pair: tuple[Missing, int]) -> float:
        torque, std = (x[:, pair[1]] for x in (pair[0].torque.torque, pair[0].torque.std))
        return float(np.sqrt(np.mean(torque**2) / np.mean(std**2)))

    return sorted((p for p in each if p[0].significant(p[1])), key=clarity, reverse=True)


def draw_torque(
    experiment: Experiment, found: Missing, joint: int, *, narrow: bool = False
) -> "Figure":
    return plot.missing_torque(
        found.torque,
        joint,
        name=experiment.joints[joint],
        unit=experiment.units[joint] if experiment.units else None,
        curves=found.curves_at(joint),
        link_angle=None if found.link_angle is None else found.link_angle[:, joint],
        narrow=narrow,
    )


def torque_words(found: Missing, joint: int) -> str:
    part = float(found.torque.share_of_spring[joint])
    words = f"{found.recording}, {found.joints[joint]}: "
    words += f"{plain(float(found.torque.rms[joint]))} {found.units[joint]} rms is missing"
    acts = force([found.units[joint]])
    words += f", {share(part)} of the restoring {acts}." if part == part else "."
    if not found.significant(joint):
        return f"{words} It is smaller than its own 95 % band: nothing is seen to be missing here."
    drawn = found.curves_at(joint)
    if not drawn:
        return words
    name = lower(at_place(drawn[0].effect, found.joints))
    part = share(found.explained(drawn[0], joint))
    return f"{words} Blue: {name}, which explains {part} of its mean square."
