"""What may be assumed about the scale of a capture; needs no package, so that a command line is read without any."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CameraHeight:
    """An assumed median height of the cameras over the floor, where nothing tells the unit of a capture."""

    metres: float
