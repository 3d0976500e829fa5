"""Numbers beside dots on a scale of times the noise: none on another, none on the noise's line."""

import math
from collections.abc import Sequence

from matplotlib.axes import Axes

from ..numbers import ratio
from .style import INK, JOINTS

LINE = 0.155
"""Inches from one line of words to the next."""
_ALIKE = 1.1  # times: errors that differ by less are one number to the reader
_BESIDE = 0.12  # inches from a dot to its words


def _height(ax: Axes, value: float) -> float:
    """Inches of a value above the foot of the axes."""
    inches = ax.get_figure(root=True).get_figheight() * ax.get_position().height  # pyright: ignore
    low, high = ax.get_ylim()
    if ax.get_yscale() == "log":
        low, high, value = math.log(low), math.log(high), math.log(value)
    return inches * (value - low) / (high - low)


def gathered(values: Sequence[tuple[float, int]]) -> list[tuple[float, str, str]]:
    """Labels for errors, one for all that lie on each other."""
    groups: list[list[tuple[float, int]]] = []
    for value, joint in sorted((v, j) for v, j in values if math.isfinite(v)):
        if groups and value < _ALIKE * groups[-1][0][0]:
            groups[-1].append((value, joint))
        else:
            groups.append([(value, joint)])
    labels = []
    for group in groups:
        low, high = ratio(group[0][0]), ratio(group[-1][0])
        same = len({joint for _, joint in group}) == 1
        colour = JOINTS[group[0][1] % len(JOINTS)] if same else INK
        middle = math.sqrt(group[0][0] * group[-1][0])
        labels.append((middle, f"{low} ×" if low == high else f"{low}-{high} ×", colour))
    return labels


def beside(ax: Axes, x: float, side: int, labels: Sequence[tuple[float, str, str]]) -> None:
    """Words beside dots, to the left (-1) or right (1), pushed apart where they would overlap."""
    shown = sorted((v, words, colour) for v, words, colour in labels if math.isfinite(v))
    places, floor = [_height(ax, v) for v, *_ in shown], _height(ax, 1.0)
    # Off the line of the noise, which would strike them out.
    places = [floor + 0.6 * LINE if abs(p - floor) < 0.6 * LINE else p for p in places]
    for _ in range(200):
        for i in range(len(places) - 1):
            short = LINE - (places[i + 1] - places[i])
            if short > 1e-3:
                places[i], places[i + 1] = places[i] - short / 2, places[i + 1] + short / 2
    for place, (value, words, colour) in zip(places, shown, strict=True):
        ax.annotate(
            words,
            (x, value),
            xytext=(side * _BESIDE * 72, (place - _height(ax, value)) * 72),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            color=colour,
            fontweight="bold",
        )
