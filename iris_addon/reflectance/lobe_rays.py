"""Reflected rays kept: what they meet, and what that counts for in either specular lobe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels import kernel, rows_of
from ..parallel import BLOCK, over_blocks
from ..transport.patch_hits import ESCAPED
from ..transport.transport import radiance_table


class LobeRays(NamedTuple):
    """Reflected rays of n points at one roughness each.

    Attributes:
        target: (n, S) int32 patch hit, N and on for the texels of what lies beyond the mesh, UNKNOWN or ESCAPED.
        face: (n, S) int32 face hit, -1 where escaped.
        weight0, weight1: (n, S) float32, what the radiance each ray meets counts for in either lobe.
        schlick: (n, S) float32, S of the angle at which each ray arrives.
    """

    target: NDArray[np.int32]
    face: NDArray[np.int32]
    weight0: NDArray[np.float32]
    weight1: NDArray[np.float32]
    schlick: NDArray[np.float32]

    @staticmethod
    def nothing(n: int, n_rays: int) -> LobeRays:
        """Rays that meet nothing."""
        shape = n, n_rays
        weight0, weight1, schlick = (np.zeros(shape, np.float32) for _ in range(3))
        return LobeRays(np.full(shape, ESCAPED, np.int32), np.full(shape, -1, np.int32), weight0, weight1, schlick)

    def radiance(
        self,
        met: NDArray[np.floating],
        kappa: NDArray[np.floating],
        face_emission: NDArray[np.floating],
        unknown: NDArray[np.floating],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """``Ls0`` and ``Ls1``, (n, 3) each.

        Args:
            met: (N + T, 3) reflected radiance of every patch, and radiance of every texel beyond the mesh.
            kappa: (N + T,) of their diffuse lobes.
            face_emission: (F, 3).
            unknown: (3,) for hits without a patch.
        """
        n, samples = self.target.shape
        lobes = np.empty((2, n, 3), np.float32)
        table = radiance_table(met, unknown)
        own = np.append(kappa, [0.0, 0.0])  # the last two for ESCAPED and UNKNOWN
        emitted, emits = face_emission.astype(np.float32), face_emission.any(1)
        over_blocks(
            n, BLOCK // samples, lambda rows: _sum_up(rows_of(self, rows), table, own, emitted, emits, lobes[:, rows])
        )
        return lobes[0], lobes[1]


@kernel
def _sum_up(
    rays: LobeRays,
    table: NDArray[np.float32],
    kappa: NDArray[np.float64],
    emitted: NDArray[np.float32],
    emits: NDArray[np.bool_],
    lobes: NDArray[np.float32],
) -> None:
    """Both lobes (2, n, 3): emission of lamps and reflected radiance of patches, weighted."""
    for i in range(rays.target.shape[0]):
        for c in range(3):
            lobes[0, i, c] = lobes[1, i, c] = 0.0
        for j in range(rays.target.shape[1]):
            w0, w1 = rays.weight0[i, j], rays.weight1[i, j]
            if w0 + w1 > 0:
                face, target, spread = rays.face[i, j], rays.target[i, j], 1.0
                on_lamp = face >= 0 and emits[face]
                if not on_lamp:
                    spread += kappa[target] * rays.schlick[i, j]
                for c in range(3):
                    light = spread * (emitted[face, c] if on_lamp else table[target, c])
                    lobes[0, i, c] += w0 * light
                    lobes[1, i, c] += w1 * light
