"""Memory that would stay with the process after its use.

XLA and LLVM free what they needed for a program, but glibc keeps it for later, in pieces: several
hundred MB after a few programs. Asked to, it gives them back. Arrays of megabytes are pieces, too:
once one of that size is freed, glibc takes the next ones from its heaps, unless it is told a size.
"""

import contextlib
import ctypes

_LARGE = 4 << 20
"""Bytes from which an array has pages of its own, which go back when it is freed. New pages cost a
millisecond for 4 MB, far less than whatever fills them."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of malloc.h


def give_back() -> None:
    """Give freed memory back to the system, where the C library knows how to."""
    # Another C library has no such function; on Windows, None names no library.
    with contextlib.suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def give_back_arrays() -> None:
    """Have large arrays given back when they are freed, where the C library knows how to.

    Told one size, glibc no longer finds the other by itself: how much that is free at the end of
    its heap it keeps. That is twice the first as a rule, but 128 kB where nobody says so; and then
    an array of a quarter of a MB has new pages each time it is made, seven times its own cost.
    """
    with contextlib.suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGE)
        ctypes.CDLL(None).mallopt(_TRIM_THRESHOLD, 2 * _LARGE)
