"""What people read: text for a terminal, tables for a paper, and one page that can be mailed.

Results hold data; here stands what is said of them. Printing a result must not wait for pictures:
the page, which draws them, is imported when it is asked for.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._inertia import write_inertia as write_inertia
    from ._page import render as render
    from ._page import write_report as write_report
    from ._race import write_race as write_race
    from ._unload import write_unload as write_unload

_PLACES = {
    "render": "_page",
    "write_inertia": "_inertia",
    "write_race": "_race",
    "write_report": "_page",
    "write_unload": "_unload",
}
__all__ = ["render", "write_inertia", "write_race", "write_report", "write_unload"]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
