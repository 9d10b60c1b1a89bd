"""A convex shell around a room whose mesh has holes, and where on it rays end that leave the mesh.

Most of what a scan misses stands at its walls or close to them: from wherever one looks, what is missing on a wall is
on the shell where it belongs, and what was further in is moved a little.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, HalfspaceIntersection

from ..capture.types import Mesh
from ..result.panorama import equirect_texels
from ..transport.tracer import Tracer

DIRECTIONS = 400
"""In which the points that the shell is drawn through lie furthest out."""
CLEARANCE = 1.01
"""The shell stands off the walls by a hundredth of its size, lest they flicker."""
STEP_BACK = 0.1
"""Of the room's size: so far from where a photo was taken one still stands within."""


class Shell:
    """A closed convex surface.

    Attributes:
        vertices: (V, 3) float64 metres.
        faces: (F, 3) int64, counter-clockwise from within.
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
        self.vertices, self.faces = vertices, faces
        self._tracer = Tracer(Mesh(vertices, faces))

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) from where pictures on it are painted."""
        return self.vertices.mean(0)

    def texels(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating], shape: tuple[int, ...]
    ) -> NDArray[np.int32]:
        """(n,) texel of an equirectangular picture of ``shape`` (H, 2 H, ...) around the centre that each ray meets,
        -1 for none; origins within the shell and unit directions (n, 3)."""
        met = np.full(len(origins), -1, np.int32)
        distance = self._tracer.closest(origins, directions).distance
        on = np.isfinite(distance)
        place = origins[on] + distance[on, None] * directions[on] - self.centre
        met[on] = equirect_texels(place, shape[1], shape[0])
        return met

    def places(self, directions: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n, 3) points of the shell in unit ``directions`` (n, 3) from its centre, and unit normals that look in."""
        hits = self._tracer.closest(np.broadcast_to(self.centre, directions.shape), directions)
        on = hits.face >= 0  # a ray along an edge may slip through
        distance = np.where(on, hits.distance, np.median(hits.distance[on]))
        normals = np.where(on[:, None], self._tracer.normals[hits.face], -directions)
        return self.centre + distance[:, None] * directions, normals


def shell_around(mesh: Mesh, positions: NDArray[np.floating]) -> Shell | None:
    """A shell of few faces around ``mesh`` and cameras at ``positions`` (n, 3), with room to step back; None if all
    lies in a plane."""
    surface = mesh.vertices[np.unique(mesh.faces)]
    if _flat(np.concatenate([surface, positions])):
        return None
    step = STEP_BACK * float(np.ptp(surface, axis=0).max()) * np.concatenate([np.eye(3), -np.eye(3)])
    hull = _hull(np.concatenate([surface, *(positions + one for one in step)]))
    return Shell(hull.points, _inward_faces(hull))


def _flat(points: NDArray[np.floating]) -> bool:
    """Whether ``points`` (n, 3) lie in a plane."""
    return bool(np.linalg.matrix_rank(points - points.mean(0), tol=1e-6 * float(np.ptp(points))) < 3)


def _hull(points: NDArray[np.floating]) -> ConvexHull:
    """A convex body of few faces around all of ``points`` (n, 3), lest it hide a pane that stands back in its wall.

    The hull of what lies furthest out in some directions, with each of its faces moved out until nothing is beyond it.
    """
    k = np.arange(DIRECTIONS) + 0.5
    z, azimuth = 1 - 2 * k / DIRECTIONS, np.pi * (1 + 5**0.5) * k  # a Fibonacci lattice on the sphere
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], -1)
    points = np.asarray(points, np.float64)
    outermost = points[ConvexHull(points).vertices]
    extreme = np.unique((outermost @ directions.T).argmax(0))
    inner = ConvexHull(outermost[extreme])
    normals = np.unique(inner.equations[:, :3].round(6), axis=0)
    offsets = (outermost @ normals.T).max(0)
    planes = np.concatenate([normals, -offsets[:, None]], 1)
    corners = HalfspaceIntersection(planes, inner.points.mean(0)).intersections
    return ConvexHull(corners.mean(0) + CLEARANCE * (corners - corners.mean(0)))


def _inward_faces(hull: ConvexHull) -> NDArray[np.int64]:
    """(F, 3) triangles of ``hull``, counter-clockwise from within."""
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    outward = np.einsum("fc,fc->f", np.cross(b - a, c - a), hull.equations[:, :3]) > 0
    return np.where(outward[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)
