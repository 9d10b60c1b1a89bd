"""Ray tracing behind one small interface: closest hit and visibility against a fixed triangle mesh.

Rays run on an engine of :mod:`iris_addon.rays.engines` and are counted, because the number of rays is the cost of a
method that does not depend on the machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import over_blocks
from ..model.capture import DEGENERATE_AREA, Mesh
from .engines import EMBREE, RayEngine

END_MARGIN = 0.25
"""Length by which shadow rays are shortened so as not to hit their own end, in epsilon. Small, because a lampshade may
be close to its bulb."""


@dataclass(frozen=True)
class Hits:
    """Closest hits of n rays.

    Attributes:
        face: (n,) int32 face index in the mesh as read, -1 where the ray escaped.
        distance: (n,) float32 metres, inf where it escaped.
        barycentric: (n, 2) float32 weights of the face's second and third corner.
    """

    face: NDArray[np.int32]
    distance: NDArray[np.float32]
    barycentric: NDArray[np.float32]


class Tracer:
    """Rays against the non-degenerate triangles of ``mesh``.

    Degenerate triangles have no normal, and one NaN ray slows Embree down a hundredfold: both are kept out here.

    Attributes:
        rays_traced: rays cast since construction.
        epsilon: metres to move an origin off its surface.
        normals: (F, 3) float32 unit normals, zero for degenerate faces.
        areas: (F,) square metres.
        engine: what rays run on.
    """

    def __init__(
        self,
        mesh: Mesh,
        normals: NDArray[np.floating] | None = None,
        noise: float = 0.0,
        without: NDArray[np.integer] | None = None,
        engine: RayEngine = EMBREE,
    ) -> None:
        """The tracer of ``mesh``.

        Args:
            normals: (F, 3) unit normals of the surface behind its faces, by default those of the faces themselves.
            noise: standard deviation of its places, metres: rays start above the bumps that it leaves.
            without: faces that rays pass, such as panes of glass; they count as degenerate.
            engine: what rays run on; outside a solve, and for the few faces of a shell around the mesh, Embree.
        """
        corners = mesh.vertices[mesh.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(cross, axis=1)
        if without is not None:
            length[without] = 0.0
        self.areas = 0.5 * length
        unit = cross / np.maximum(length, 1e-300)[:, None]
        known = unit if normals is None else normals
        self.normals = np.where(length[:, None] > 2 * DEGENERATE_AREA, known, 0.0).astype(np.float32)
        self._kept = np.flatnonzero(self.areas > DEGENERATE_AREA).astype(np.int32)
        self.corners = corners
        self.epsilon = max(2e-5 * _size(corners[self._kept]), noise)
        self.rays_traced = 0
        self.engine = engine
        self._triangles = engine.intersector(corners[self._kept].astype(np.float32))
        self._counting = Lock()

    def closest(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> Hits:
        """Closest hit along each ray; origins and unit directions (n, 3), metres."""
        n = len(origins)
        face = np.empty(n, np.int32)
        distance = np.empty(n, np.float32)
        barycentric = np.empty((n, 2), np.float32)

        def trace(part: slice, o: NDArray[np.float32], d: NDArray[np.float32]) -> None:
            primitive, length, barycentric[part] = self._triangles.closest(o, d)
            face[part] = self._faces(primitive)
            distance[part] = np.where(primitive < 0, np.inf, length)

        self._run(trace, origins, directions)
        return Hits(face, distance, barycentric)

    def hit_faces(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.int32]:
        """(n,) face of the closest hit, -1 where the ray escaped."""
        face = np.empty(len(origins), np.int32)

        def trace(part: slice, o: NDArray[np.float32], d: NDArray[np.float32]) -> None:
            face[part] = self._faces(self._triangles.primitives(o, d))

        self._run(trace, origins, directions)
        return face

    def _faces(self, primitive: NDArray[np.int32]) -> NDArray[np.int32]:
        """(n,) face of the mesh as read of each triangle that is traced, -1 for -1."""
        return np.where(primitive < 0, -1, self._kept[np.maximum(primitive, 0)])

    def visible(self, origins: NDArray[np.floating], targets: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(n,) whether nothing lies between two points (n, 3), metres, both on surfaces."""
        offset = np.asarray(targets, np.float64) - origins
        length = np.linalg.norm(offset, axis=1)
        return self.unoccluded(origins, offset / np.maximum(length, 1e-12)[:, None], length)

    def unoccluded(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], lengths: NDArray[np.floating]
    ) -> NDArray[np.bool_]:
        """(n,) whether nothing lies on each ray before its end, a point of a surface ``lengths`` (n,) metres away."""
        reach = np.maximum(lengths - END_MARGIN * self.epsilon, 0.0).astype(np.float32)
        clear = np.empty(len(origins), bool)

        def trace(part: slice, o: NDArray[np.float32], d: NDArray[np.float32]) -> None:
            clear[part] = ~self._triangles.occluded(o, d, reach[part])

        self._run(trace, origins, directions)
        return clear

    def _run(
        self,
        trace: Callable[[slice, NDArray[np.float32], NDArray[np.float32]], None],
        origins: NDArray[np.floating],
        directions: NDArray[np.floating],
    ) -> None:
        o = np.ascontiguousarray(origins, np.float32)
        d = np.ascontiguousarray(directions, np.float32)
        if not (np.isfinite(o).all() and np.isfinite(d).all()):
            raise FloatingPointError("a ray is not finite; the usual cause is the normal of a degenerate triangle")
        with self._counting:
            self.rays_traced += len(o)
        chunk, at_once = self._triangles.chunk, self._triangles.at_once
        over_blocks(len(o), chunk, lambda part: trace(part, o[part], d[part]), at_once=at_once)


def _size(corners: NDArray[np.floating]) -> float:
    """Diagonal of triangles (F, 3, 3), metres; at most four times that of 98 % of them, without a far backdrop."""
    points = corners.reshape(-1, 3)
    most = np.percentile(points[:: 1 + len(points) // 300_000], (1, 99), axis=0)
    whole = np.ptp(points, axis=0)
    return min(float(np.linalg.norm(whole)), 4 * float(np.linalg.norm(most[1] - most[0])))


def points_on_faces(
    corners: NDArray[np.floating], face: NDArray[np.integer], barycentric: NDArray[np.floating]
) -> NDArray[np.float64]:
    """(n, 3) positions of hits: ``corners`` (F, 3, 3), barycentric weights (n, 2) of corners 1 and 2."""
    u, v = barycentric[:, :1].astype(np.float64), barycentric[:, 1:].astype(np.float64)
    tri = corners[face]
    return tri[:, 0] * (1 - u - v) + tri[:, 1] * u + tri[:, 2] * v
