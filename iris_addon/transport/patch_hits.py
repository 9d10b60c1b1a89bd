"""The patches that rays meet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..kernels import Integer, Real, inlined, kernel
from ..surface.patches import Lookup, PatchGrid, patch_at
from .sampling import dot
from .tracer import Tracer

UNKNOWN, ESCAPED = -1, -2
"""In place of a patch: a surface without one, and nothing met at all."""


def facing_normals(tracer: Tracer, face: NDArray[np.integer], direction: NDArray[np.floating]) -> NDArray[np.float32]:
    """(n, 3) normals of hit faces, turned against the directions the rays came along."""
    normal = tracer.normals[face]
    return normal * np.where(dot(normal, direction) > 0, np.float32(-1), np.float32(1))[:, None]


@inlined
def find_patch(
    grid: Lookup,
    normals: NDArray[np.float32],
    parts: NDArray[np.int32],
    face: Integer,
    x: Real,
    y: Real,
    z: Real,
    dx: Real,
    dy: Real,
    dz: Real,
) -> Integer:
    """Patch of the point (x, y, z) on ``face`` that a ray along (dx, dy, dz) hits, or UNKNOWN; ESCAPED if no face."""
    if face < 0:
        return np.int64(ESCAPED)
    nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
    if nx * dx + ny * dy + nz * dz > 0:
        nx, ny, nz = -nx, -ny, -nz
    return patch_at(grid, x, y, z, nx, ny, nz, parts[face])


@kernel
def _find_patches(
    grid: Lookup,
    normals: NDArray[np.float32],
    parts: NDArray[np.int32],
    face: NDArray[np.int32],
    point: NDArray[np.floating],
    direction: NDArray[np.floating],
    patch: NDArray[np.int32],
) -> None:
    for i in range(len(patch)):
        x, y, z = point[i, 0], point[i, 1], point[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        patch[i] = find_patch(grid, normals, parts, face[i], x, y, z, dx, dy, dz)


def find_patches(
    tracer: Tracer,
    grid: PatchGrid,
    parts: NDArray[np.int32],
    face: NDArray[np.int32],
    point: NDArray[np.floating],
    direction: NDArray[np.floating],
) -> NDArray[np.int32]:
    """(n,) patch of each hit; UNKNOWN or ESCAPED where there is none."""
    patch = np.empty(len(face), np.int32)
    _find_patches(grid.lookup, tracer.normals, parts, face, point, direction, patch)
    return patch
