"""JSON knows no infinities, no NaN and no scalars of NumPy."""

import math
from collections.abc import Mapping
from typing import Any


def finite(value: Any) -> Any:
    """The same value in Python's own numbers, with None for every one that is not finite."""
    if isinstance(value, Mapping):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    if getattr(value, "shape", None) == ():
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def number(x: Any) -> float | None:
    """A scalar as JSON writes it."""
    return finite(float(x))
