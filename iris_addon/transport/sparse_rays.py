"""Rays beside the gather rays, from few of the patches or to few of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..kernels import Integer, kernel
from ..parallel import over_shares
from .transport import radiance_table


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
        table, dark = radiance_table(radiance, unknown), np.append(emitter_faces, False)
        sums = np.zeros((self.n_rows, 3))
        over_shares(
            self.n_rows,
            lambda own: _gather(self.row, own.start, self.weight, self.target, self.face, table, dark, sums[own]),
        )
        return sums.astype(np.float32)


@kernel
def _gather(
    row: NDArray[np.integer],
    begin: Integer,
    weight: NDArray[np.float32],
    target: NDArray[np.int32],
    face: NDArray[np.int32],
    table: NDArray[np.float32],
    dark: NDArray[np.bool_],
    sums: NDArray[np.float64],
) -> None:
    """Weighted radiance of the rays of the rows (n, 3) from ``begin`` on; those that meet ``dark`` faces carry none."""
    last = weight.shape[1] - 1
    for i in range(len(row)):
        r = row[i] - begin
        if 0 <= r < len(sums) and not dark[face[i]]:
            for c in range(3):
                sums[r, c] += weight[i, min(c, last)] * table[target[i], c]
