"""Rays beside the gather rays, from few of the patches or to few of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grouping import group_sums
from .transport import radiance_table, table_rows


@dataclass(frozen=True)
class SparseRays:
    """k rays, each with its own weight.

    Attributes:
        n_rows: N patches, seen and unseen.
        row: (k,) patch that gathers.
        weight: (k, 1) or (k, 3) float32 share of the radiance met that arrives as irradiance / pi.
        target: (k,) int32 patch met, UNKNOWN or ESCAPED.
        face: (k,) int32 face met, -1 where escaped.
    """

    n_rows: int
    row: NDArray[np.integer]
    weight: NDArray[np.float32]
    target: NDArray[np.int32]
    face: NDArray[np.int32]

    @staticmethod
    def joined(rays: Sequence[SparseRays]) -> SparseRays:
        """All rays of several sets between the same patches."""
        columns = zip(*((one.row, one.weight, one.target, one.face) for one in rays), strict=True)
        return SparseRays(rays[0].n_rows, *map(np.concatenate, columns))

    def gather_radiance(
        self, radiance: NDArray[np.floating], unknown: NDArray[np.floating], emitter_faces: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi to be added to :meth:`iris_addon.transport.transport.Transport.gather_radiance`, whose
        arguments these are."""
        rows = table_rows(self.target, self.face, emitter_faces)
        carried = self.weight * radiance_table(radiance, unknown)[rows]
        return group_sums(carried, self.row, self.n_rows).astype(np.float32)
