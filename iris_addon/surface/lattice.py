"""Which pixels lie side by side: the lattices of all photos in one array."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Camera

NO_PIXEL = -1
"""A place of the lattice whose pixel is not among those asked about."""
BEYOND_PHOTO = -2
NEIGHBOURS = [(down, across) for down in (-1, 0, 1) for across in (-1, 0, 1) if down or across]


@dataclass(frozen=True)
class Lattice:
    """The lattices of all photos, see :func:`.samples.pixel_lattice`, in one array with a margin around each.

    Attributes:
        slot: (n,) place of each pixel in that array.
        pitch: (n,) length of a row of its lattice there.
        occupant: pixel at each place, :data:`NO_PIXEL` or :data:`BEYOND_PHOTO` for none.
    """

    slot: NDArray[np.int64]
    pitch: NDArray[np.int64]
    occupant: NDArray[np.int32]

    @staticmethod
    def of(
        view: NDArray[np.integer], pixel: NDArray[np.integer], cameras: Sequence[Camera], stride: int, margin: int
    ) -> Lattice:
        """The lattice of pixels (n,) of views (n,), to be asked for pixels up to ``margin`` rows or columns away."""
        wide = np.array([-(-camera.width // stride) + 2 * margin for camera in cameras])
        high = np.array([-(-camera.height // stride) + 2 * margin for camera in cameras])
        first = np.concatenate([[0], np.cumsum(wide * high)])
        row, column = np.divmod(pixel, np.array([camera.width for camera in cameras])[view])
        pitch = wide[view]
        slot = first[view] + (row // stride + margin) * pitch + column // stride + margin
        occupant = np.full(first[-1], BEYOND_PHOTO, np.int32)
        for start, stop, width in zip(first[:-1], first[1:], wide, strict=True):
            occupant[start:stop].reshape(-1, width)[margin:-margin, margin:-margin] = NO_PIXEL
        occupant[slot] = np.arange(len(slot), dtype=np.int32)
        return Lattice(slot, pitch, occupant)

    def pixel_at(self, own: slice | NDArray[np.integer], down: int, across: int) -> NDArray[np.int32]:
        """The pixel so many rows below and columns beside each of ``own``, negative where there is none."""
        return self.occupant[self.slot[own] + down * self.pitch[own] + across]
