"""Tables of the documentation, one command each; loops are compiled as commands have them."""

import contextlib

with contextlib.suppress(ImportError):  # PySINDy runs where residyn is not installed
    from residyn.runtime.settings import quick_loops

    quick_loops()
