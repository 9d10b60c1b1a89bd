"""Rays against triangles by Embree, on all cores of the CPU."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

CHUNK = 1 << 18
"""Rays that one call of Embree traces."""


class EmbreeTriangles:
    """The :class:`~iris_addon.rays.engines.Intersector` of triangles (F, 3, 3), float32 metres, none degenerate.

    Embree releases the interpreter lock, so that each thread traces a chunk of its own.
    """

    chunk, at_once = CHUNK, None

    def __init__(self, corners: NDArray[np.float32]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        self._geometry = TriangleMesh(self._scene, corners)
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))  # builds the BVH

    def primitives(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.int32]:
        """(n,) triangle of the closest hit, -1 for none."""
        return self._scene.run(origins, directions)

    def closest(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """Triangle (n,), distance (n,) and barycentric weights (n, 2) of the closest hit."""
        hit = self._scene.run(origins, directions, output=True)
        return hit["primID"], hit["tfar"], np.column_stack([hit["u"], hit["v"]])

    def occluded(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32], lengths: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """(n,) whether a triangle lies on each ray within its length."""
        return self._scene.run(origins, directions, lengths, query="OCCLUDED") >= 0
