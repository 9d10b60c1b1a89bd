"""Gather rays: cosine-distributed rays from each patch, and the patches they meet.

They are ``G`` of equation (1), kept as the patch that each ray meets; those that escape carry light from outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, Real, inlined, kernel
from ..base.parallel import BLOCK, over_random_blocks
from ..base.progress import Progress
from ..rays.sampling import Origins, cosine_direction, dot, grazing, r2_sequence, vector
from ..rays.tracer import Tracer
from ..surface.patches import Lookup, PatchGrid, patch_at

UNKNOWN, ESCAPED = -1, -2
"""In place of a patch: a surface without one, and no surface at all."""


@dataclass(frozen=True)
class GatherRays:
    """R cosine-distributed rays from each of P patches, and the faces they meet.

    Attributes:
        face: (P, R) int32 face, -1 where the ray escaped.
        direction: (P, R, 3) float16 unit direction, away from the patch.
        distance: (P, R) float32 metres.
        schlick_start, schlick_end: (P, R) float16 Schlick's S of the angles at which each ray leaves and arrives.
    """

    face: NDArray[np.int32]
    direction: NDArray[np.float16]
    distance: NDArray[np.float32]
    schlick_start: NDArray[np.float16]
    schlick_end: NDArray[np.float16]


@kernel
def _shoot(
    position: NDArray[np.float32],
    normal: NDArray[np.float32],
    per_patch: int,
    epsilon: float,
    u: NDArray[np.float32],
    start: NDArray[np.float32],
    along: NDArray[np.float32],
    grazing_start: NDArray[np.float32],
) -> None:
    """Write start and direction (n, R, 3) and S (n, R) of cosine-distributed rays; starts cycle over a patch's points.

    Args:
        position, normal: (n · per_patch, 3) points on the patches.
        u: (n, R, 2) in [0, 1).
    """
    for p in range(u.shape[0]):
        for r in range(u.shape[1]):
            k = p * per_patch + r % per_patch
            nx, ny, nz = vector(normal, k)
            x, y, z = cosine_direction(nx, ny, nz, u[p, r, 0], u[p, r, 1])
            along[p, r, 0], along[p, r, 1], along[p, r, 2] = x, y, z
            for axis in range(3):
                start[p, r, axis] = position[k, axis] + epsilon * normal[k, axis]
            grazing_start[p, r] = grazing(x * nx + y * ny + z * nz)


@kernel
def _arrive(
    normals: NDArray[np.float32],
    face: NDArray[np.int32],
    distance: NDArray[np.float32],
    along: NDArray[np.float32],
    point: NDArray[np.float32],
    grazing_end: NDArray[np.float32],
) -> None:
    """Move ``point`` (n, 3) from where rays start to where they end, and write S there; rays that escape stay."""
    for i in range(len(face)):
        f = face[i]
        grazing_end[i] = 0.0
        if f >= 0:
            cosine = along[i, 0] * normals[f, 0] + along[i, 1] * normals[f, 1] + along[i, 2] * normals[f, 2]
            grazing_end[i] = grazing(abs(cosine))
            for axis in range(3):
                point[i, axis] += along[i, axis] * distance[i]


def gather(
    tracer: Tracer, origins: Origins, n_rays: int, rng: np.random.Generator, progress: Progress
) -> tuple[GatherRays, NDArray[np.float32]]:
    """Trace ``n_rays`` cosine-distributed rays from every patch.

    Returns:
        The rays, and the points they hit, (P, R, 3) metres (the origin where a ray escaped).
    """
    n = len(origins.position)
    face = np.empty((n, n_rays), np.int32)
    point = np.empty((n, n_rays, 3), np.float32)
    direction = np.empty((n, n_rays, 3), np.float16)
    distance = np.empty((n, n_rays), np.float32)
    schlick_start = np.empty((n, n_rays), np.float16)
    schlick_end = np.empty((n, n_rays), np.float16)

    def work(rows: slice, rng: np.random.Generator) -> None:
        end, u = point[rows], r2_sequence(rows.stop - rows.start, n_rays, rng)
        along, s = np.empty_like(end), np.empty(end.shape[:2], np.float32)
        _shoot(*origins.flat(rows), tracer.epsilon, u, end, along, s)
        hits = tracer.closest(end.reshape(-1, 3), along.reshape(-1, 3))
        face[rows] = hits.face.reshape(-1, n_rays)
        distance[rows] = hits.distance.reshape(-1, n_rays)
        direction[rows], schlick_start[rows] = along, s
        _arrive(tracer.normals, hits.face, hits.distance, along.reshape(-1, 3), end.reshape(-1, 3), s.ravel())
        schlick_end[rows] = s

    over_random_blocks(n, BLOCK // n_rays, work, rng, progress.update)
    return GatherRays(
        face=face, direction=direction, distance=distance, schlick_start=schlick_start, schlick_end=schlick_end
    ), point


# ---- the patches they meet -----------------------------------------------------------------------------------------


def facing_normals(tracer: Tracer, face: NDArray[np.integer], direction: NDArray[np.floating]) -> NDArray[np.float32]:
    """(n, 3) normals of hit faces on the side that rays of ``direction`` (n, 3) arrive at."""
    normal = tracer.normals[face]
    return normal * np.where(dot(normal, direction) > 0, np.float32(-1), np.float32(1))[:, None]


@inlined
def find_patch(
    grid: Lookup,
    normals: NDArray[np.float32],
    regions: NDArray[np.int32],
    face: Integer,
    x: Real,
    y: Real,
    z: Real,
    dx: Real,
    dy: Real,
    dz: Real,
) -> Integer:
    """Patch at (x, y, z) on ``face``, met by a ray along (dx, dy, dz): UNKNOWN without one, ESCAPED without a face."""
    if face < 0:
        return np.int64(ESCAPED)
    nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
    if nx * dx + ny * dy + nz * dz > 0:
        nx, ny, nz = -nx, -ny, -nz
    return patch_at(grid, x, y, z, nx, ny, nz, regions[face])


@kernel
def _find_patches(
    grid: Lookup,
    normals: NDArray[np.float32],
    regions: NDArray[np.int32],
    face: NDArray[np.int32],
    point: NDArray[np.floating],
    direction: NDArray[np.floating],
    patch: NDArray[np.int32],
) -> None:
    for i in range(len(patch)):
        x, y, z = point[i, 0], point[i, 1], point[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        patch[i] = find_patch(grid, normals, regions, face[i], x, y, z, dx, dy, dz)


def find_patches(
    tracer: Tracer,
    grid: PatchGrid,
    regions: NDArray[np.int32],
    face: NDArray[np.int32],
    point: NDArray[np.floating],
    direction: NDArray[np.floating],
) -> NDArray[np.int32]:
    """(n,) patch of each hit, UNKNOWN or ESCAPED where there is none.

    Args:
        regions: (F,) region of each face.
        face: (n,) face hit, -1 for none.
        point: (n, 3) metres.
        direction: (n, 3) of the rays.
    """
    patch = np.empty(len(face), np.int32)
    _find_patches(grid.lookup, tracer.normals, regions, face, point, direction, patch)
    return patch
