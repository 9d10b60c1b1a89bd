"""The solution of a room before its textures are made."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray

from ..lighting.problem import Lights
from ..response.photometry import Photometry
from .gloss import Gloss


@dataclass(frozen=True)
class Solution:
    """Camera, light and gloss that explain the photos together.

    Attributes:
        photometry: response and exposure of the photos.
        lights: the lamps, light from outside, and the light of every patch.
        gloss: roughness and metallic of every region.
    """

    photometry: Photometry
    lights: Lights
    gloss: Gloss

    def arrays(self) -> dict[str, NDArray]:
        """Lights and gloss as plain arrays for a checkpoint."""
        return {**self.lights.arrays(), **self.gloss.arrays()}

    @staticmethod
    def from_arrays(photometry: Photometry, arrays: dict[str, NDArray]) -> Solution:
        """Inverse of :meth:`arrays` under ``photometry``."""
        return Solution(photometry, Lights.from_arrays(arrays), Gloss.from_arrays(arrays))
