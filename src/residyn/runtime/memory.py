"""Memory that compiling leaves behind.

XLA and LLVM free what they needed for a program, but glibc keeps it for later, in pieces: several
hundred MB after a few programs. Asked to, it gives them back.
"""

import contextlib
import ctypes


def give_back() -> None:
    """Give freed memory back to the system, where the C library knows how to."""
    # Another C library has no such function; on Windows, None names no library.
    with contextlib.suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
