"""What a solve computes on."""

from __future__ import annotations

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
