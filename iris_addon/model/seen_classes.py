"""How often photos show a place of the surface, in the three classes that a person reads off a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .recovered import Textures

SEEN_OFTEN = 0.4
"""Coverage from which on a place is well seen: by one or two photos from nearby, or more from afar."""
SEEN_NEVER = 0.05
"""Coverage up to which what the texture shows is filled in rather than seen."""


@dataclass(frozen=True)
class SeenClass:
    """One class of the map: what it is called, its colour (sRGB, 0 to 1), and the coverage at which it is that."""

    name: str
    color: tuple[float, float, float]
    coverage: float


SEEN_CLASSES = (
    SeenClass("Never", (0.75, 0.16, 0.16), SEEN_NEVER),
    SeenClass("Seldom", (0.98, 0.75, 0.27), 0.5 * (SEEN_NEVER + SEEN_OFTEN)),
    SeenClass("Often", (0.16, 0.47, 0.75), SEEN_OFTEN),
)
"""Red, yellow and blue are told apart by people who do not tell red from green."""


def coverage_of(textures: Textures) -> NDArray[np.float32]:
    """(N, N) 0 to 1; in results that have no coverage, the confidence of single texels."""
    return textures.confidence if textures.coverage is None else textures.coverage


def seen_colors(coverage: NDArray[np.floating]) -> NDArray[np.float32]:
    """Colours (..., 3), sRGB, of ``coverage`` (...): those of :data:`SEEN_CLASSES`, blended in between."""
    known = [seen.coverage for seen in SEEN_CLASSES]
    channels = zip(*(seen.color for seen in SEEN_CLASSES), strict=True)
    return np.stack([np.interp(coverage, known, channel).astype(np.float32) for channel in channels], -1)
