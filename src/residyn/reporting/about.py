"""Which module writes about which result."""

import importlib
from types import ModuleType
from typing import Any

_ABOUT = {
    "Fit": "fit",
    "Comparison": "compare",
    "Diagnosis": "diagnosis",
    "Plan": "plan",
    "Test": "plan",
    "Atlas": "detectable",
    "InertiaResult": "inertia",
    "Unloading": "unload",
    "OverModels": "over_models",
    "Race": "race",
}


def of(result: Any) -> ModuleType:
    """The module that writes about results of this class."""
    name = next(kind.__name__ for kind in type(result).__mro__ if kind.__name__ in _ABOUT)
    return importlib.import_module(f".{_ABOUT[name]}", __package__)
