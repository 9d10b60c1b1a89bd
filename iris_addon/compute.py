"""What a solve computes on, and what it takes."""

from __future__ import annotations

import sys
from typing import Literal

import torch

from .errors import BadInput


def choose_device(wanted: Literal["auto", "cpu", "cuda"]) -> str:
    """The torch device to use: a GPU where there is one, unless told otherwise.

    Raises:
        BadInput: a GPU was asked for and torch finds none.
    """
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise BadInput("torch finds no CUDA device", "use --device auto, or install the CUDA build of torch")
    return "cuda" if wanted != "cpu" and available else "cpu"


def peak_memory_bytes() -> int | None:
    """Largest resident size of this process so far; None where the system does not tell (Windows)."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
