"""What people read: text for a terminal, tables for a paper, and one page that can be mailed.

Results hold data; here stands what is said of them. Printing a result must not wait for pictures:
the page, which draws them, is imported when it is asked for.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .inertia import write_inertia as write_inertia
    from .page import render as render
    from .page import write_report as write_report
    from .race import write_race as write_race
    from .unload import write_unload as write_unload

_PLACES = {
    "render": "page",
    "write_inertia": "inertia",
    "write_race": "race",
    "write_report": "page",
    "write_unload": "unload",
}
__all__ = ["render", "write_inertia", "write_race", "write_report", "write_unload"]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
