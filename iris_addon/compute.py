"""What a solve computes on, and what it takes."""

from __future__ import annotations

import ctypes
import sys
from typing import Literal

import torch

from .errors import BadInput

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Of malloc.h: free memory at the end of the heap above which, and arrays as of which, all is given back."""


def choose_device(wanted: Literal["auto", "cpu", "cuda"]) -> str:
    """The torch device to use: a GPU where there is one, unless told otherwise.

    Raises:
        BadInput: a GPU was asked for and torch finds none.
    """
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise BadInput("torch finds no CUDA device", "use --device auto, or install the CUDA build of torch")
    return "cuda" if wanted != "cpu" and available else "cpu"


def keep_freed_memory() -> None:
    """Let this process keep the memory of arrays that are gone for the next ones, where the C library is GNU's.

    Given back it would come again page by page, each cleared by the system: a twentieth of a solve.
    """
    if sys.platform != "linux":
        return
    # Where the C library is another one (musl), it has no such switch.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, 1 << 25)  # the most it takes
        mallopt(_TRIM_THRESHOLD, (1 << 31) - 1)


def peak_memory_bytes() -> int | None:
    """Largest resident size of this process so far; None where the system does not tell (Windows)."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
