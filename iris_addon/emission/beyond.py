"""What reflected rays meet that escape through holes of the mesh: the surfaces that photos show there.

A varnished front beside a hole does not mirror the lamps that light from outside stands for, but the chair that the
scan missed. Cycles shows glossy rays the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Mesh
from ..result.panorama import equirect_texels
from ..result.types import Backdrop
from ..transport.tracer import Tracer


class Beyond:
    """A backdrop, or none, as rays from within meet it.

    Attributes:
        backdrop: None where the mesh has hardly any holes.
        radiance: (T, 3) float32 of its texels, row by row.
    """

    def __init__(self, backdrop: Backdrop | None) -> None:
        self.backdrop = backdrop
        self.radiance = np.zeros((0, 3), np.float32) if backdrop is None else backdrop.picture.reshape(-1, 3)
        self._shell = None if backdrop is None else Tracer(Mesh(backdrop.vertices, backdrop.faces))

    def texels(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.int32]:
        """(n,) texel that each ray meets, -1 for none; origins within the shell and unit directions (n, 3)."""
        met = np.full(len(origins), -1, np.int32)
        if self.backdrop is None or self._shell is None:
            return met
        distance = self._shell.closest(origins, directions).distance
        on = np.isfinite(distance)
        place = origins[on] + distance[on, None] * directions[on] - self.backdrop.centre
        height, width = self.backdrop.picture.shape[:2]
        met[on] = equirect_texels(place, width, height)
        return met
