"""JSON knows no infinities, and none of NumPy's numbers."""

import math
from collections.abc import Mapping
from typing import Any


def finite(value: Any) -> Any:
    """The same of Python's own numbers, with null for what is not finite."""
    if isinstance(value, Mapping):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    if getattr(value, "shape", None) == ():
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
