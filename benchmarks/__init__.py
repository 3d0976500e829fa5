"""Tables of the documentation, one command each; programs are compiled as in commands."""

import contextlib

with contextlib.suppress(ImportError):  # PySINDy runs where residyn is not installed
    from residyn.runtime.settings import set_compiler_options

    set_compiler_options()
