"""The pattern of a lamp, as the light balance knows it: how bright each of its patches is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class LampPattern:
    """Luminance over a lamp.

    Attributes:
        faces: of the lamp.
        patch: (k,) the seen patches on it.
        position: (k, 3) metres, of each.
        area: (k,) share of the lamp that is nearest to each.
        share: (k,) luminance of each over the mean.
    """

    faces: NDArray[np.int64]
    patch: NDArray[np.int64]
    position: NDArray[np.floating]
    area: NDArray[np.floating]
    share: NDArray[np.floating]

    def at(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(n,) luminance at ``points`` (n, 3) of the lamp over its mean: that of the nearest place."""
        return self.share[self._tree.query(points, workers=-1)[1]].astype(np.float32)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.position)
