"""What people read: text for a terminal, tables for a paper, and one page that can be mailed.

Results hold data; here stands what is said of them. Printing a result must not wait for pictures:
the page, which draws them, is imported when it is asked for.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._page import render as render
    from ._page import write_report as write_report
    from ._race import write_race as write_race

__all__ = ["render", "write_race", "write_report"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import _page, _race

    return getattr(_race if name == "write_race" else _page, name)
