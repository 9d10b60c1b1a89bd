"""Which photos see which points of the surface, and where in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from ..capture.alignment import small_camera
from ..capture.types import Camera
from ..transport.tracer import Tracer, points_on_faces

Floats = NDArray[np.float64]

GRAZING = 0.25
"""Smallest cosine at which a surface is looked at."""
NEAR = 0.01
"""Metres, and per metre of distance, between a point and what its ray hits that still are the same place."""
DEPTH_WIDTH = 80
EDGE = 0.08
"""Relative step of depth that is an edge; near one, a pose that is off shows the wrong side of it."""
MARGIN = 0.01
"""Of the image width: what is closer to its border may lie outside."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points that pixels show.

    Attributes:
        position: (n, 3) metres.
        normal: (n, 3) unit.
    """

    position: Floats
    normal: NDArray[np.floating]

    @staticmethod
    def of(cameras: Sequence[Camera], tracer: Tracer, n: int, rng: np.random.Generator) -> SurfacePoints:
        """About ``n`` points behind random pixels of all photos alike."""
        positions, normals = [], []
        for camera in cameras:
            rays = camera.rays(rng.integers(camera.width * camera.height, size=-(-n // len(cameras))))
            hits = tracer.closest(*rays)
            face = hits.face[hits.face >= 0]
            positions.append(points_on_faces(tracer.corners, face, hits.barycentric[hits.face >= 0]))
            normals.append(tracer.normals[face])
        return SurfacePoints(np.concatenate(positions), np.concatenate(normals))

    def halves(self) -> tuple[SurfacePoints, SurfacePoints]:
        """Every second point, and the others."""
        first, second = (SurfacePoints(self.position[k::2], self.normal[k::2]) for k in (0, 1))
        return first, second


def seen_points(points: SurfacePoints, camera: Camera, tracer: Tracer) -> NDArray[np.int64]:
    """Indices of the points that a photo shows well: not aslant, not at the border, and not near an edge of depth."""
    local = camera.local(points.position)
    ahead = np.flatnonzero(local[:, 2] < -1e-3)
    at = camera.project(local[ahead])
    margin = MARGIN * camera.width
    size = np.array([camera.width, camera.height])
    inside = ((at > margin) & (at < size - margin)).all(1)
    index, at = ahead[inside], at[inside]
    sight = points.position[index] - camera.position
    distance = np.linalg.norm(sight, axis=1)
    direction = sight / distance[:, None]
    facing = np.abs((direction * points.normal[index]).sum(1)) > GRAZING
    index, at, distance, direction = index[facing], at[facing], distance[facing], direction[facing]
    hit = tracer.closest(np.broadcast_to(camera.position, direction.shape), direction).distance
    small = small_camera(camera, DEPTH_WIDTH)
    column, row = (np.minimum(at * (small.width / camera.width), (small.width - 1, small.height - 1))).astype(int).T
    clear = (np.abs(hit - distance) < NEAR * (1 + distance)) & ~_beside_edges(small, tracer)[row, column]
    return index[clear]


def _beside_edges(camera: Camera, tracer: Tracer) -> NDArray[np.bool_]:
    """(H, W) whether depth makes a step next to a pixel; the borders of the mesh are steps too."""
    distance = tracer.closest(*camera.rays()).distance.reshape(camera.height, camera.width)
    return ~(maximum_filter(distance, 3) < (1 + EDGE) * minimum_filter(distance, 3))
