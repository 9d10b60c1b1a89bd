"""The solution of a room before its textures are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import NDArray

from ..lighting.problem import Lights
from ..model.light_states import joined_arrays, split_arrays
from ..response.photometry import Photometry
from .gloss import Gloss


@dataclass(frozen=True)
class Solution:
    """Camera, light and gloss that explain the photos together.

    Attributes:
        photometry: response and exposure of the photos.
        lights: of each light state, the lamps, light from outside, and the light of every patch.
        gloss: roughness and metallic of every region.
    """

    photometry: Photometry
    lights: Sequence[Lights]
    gloss: Gloss

    def arrays(self) -> dict[str, NDArray]:
        """Lights and gloss as plain arrays for a checkpoint."""
        return {**joined_arrays([lights.arrays() for lights in self.lights]), **self.gloss.arrays()}

    @staticmethod
    def from_arrays(photometry: Photometry, arrays: dict[str, NDArray], n_states: int) -> Solution:
        """Inverse of :meth:`arrays` under ``photometry``."""
        lights = [Lights.from_arrays(own) for own in split_arrays(arrays, n_states)]
        return Solution(photometry, lights, Gloss.from_arrays(arrays))
