"""JSON knows no infinities and no NaN: they are written as null."""

import math
from collections.abc import Mapping
from typing import Any


def finite(value: Any) -> Any:
    """The same value, with None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def number(x: Any) -> float | None:
    """A scalar as JSON writes it."""
    return finite(float(x))
