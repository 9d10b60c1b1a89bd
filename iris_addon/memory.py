"""Memory of this process: what it keeps, and how much it has taken."""

from __future__ import annotations

import ctypes
import sys
from functools import cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Of malloc.h: free memory at the end of a heap above which, and arrays as of which, all is given back; heaps."""


@cache
def keep_freed_memory() -> None:
    """Let this process keep the memory of arrays that are gone for the next ones, where the C library is GNU's.

    Given back it would come again page by page, each cleared by the system: a twentieth of a solve. One heap serves all
    threads that begin after this: those of single threads have 64 MB at most, and are given back whole once empty.
    """
    if sys.platform != "linux":
        return
    # Where the C library is another one (musl), it has no such switch.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, 1 << 25)  # the most it takes
        mallopt(_TRIM_THRESHOLD, (1 << 31) - 1)
        mallopt(_ARENA_MAX, 1)


def peak_memory_bytes() -> int | None:
    """Largest resident size of this process so far; None where the system does not tell (Windows)."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
