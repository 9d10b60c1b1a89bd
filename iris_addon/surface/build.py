"""From pixels on the mesh to patches: the surface that all later rooms speak about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Mesh
from ..grouping import group_equal, group_means
from ..transport.gather import Origins
from .patches import N_LEVELS, PatchGrid, block_keys, cell_keys, cells, choose_levels
from .samples import PixelSamples

FIRST_PIXELS_PER_PATCH = 3.0
ORIGINS_PER_PATCH = 8
AROUND = 0.1
"""Metres over which normals are compared."""


@dataclass(frozen=True)
class Surface:
    """Patches that photos see.

    Attributes:
        grid: surface point to patch.
        sample_patch: (n,) int32 patch of every pixel sample.
        position, normal: (P, 3) float32 mean over the patch's pixels; the normal has unit length.
        footprint: (P,) float32 metres, that of one of its pixels.
        part: (P,) int32.
        count: (P,) int64 pixels.
        spread: (P,) how the part's normals differ around each patch: 0 in a plane, at most sqrt(2/3).
        origins: points on each patch from which rays start.
        pixels_per_patch: edge length of a patch in pixels that met the patch budget.
    """

    grid: PatchGrid
    sample_patch: NDArray[np.int32]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    footprint: NDArray[np.float32]
    part: NDArray[np.int32]
    count: NDArray[np.int64]
    spread: NDArray[np.float64]
    origins: Origins
    pixels_per_patch: float


def build_surface(
    mesh: Mesh, samples: PixelSamples, parts: NDArray[np.int32], max_patches: int, rng: np.random.Generator
) -> Surface:
    """Patches as fine as ``max_patches`` allows.

    Args:
        parts: (F,) part per face.
    """
    used = mesh.vertices[np.unique(mesh.faces)]
    # Of what most pixels show: a backdrop far away is no sign of another unit of length.
    some = samples.position[:: 1 + len(samples.position) // 100_000]
    extent = float(np.ptp(np.percentile(some, (2, 98), axis=0), axis=0).max())
    scale = max(extent / 300.0, 1e-6) if extent > 300.0 else 1.0
    origin = used.min(0) - scale * np.array([0.1234, 0.2345, 0.3456])
    part = parts[samples.face]
    pixels_per_patch = FIRST_PIXELS_PER_PATCH
    blocks = group_equal(block_keys(samples.position, origin, scale))
    while True:
        levels = choose_levels(blocks, samples.footprint, scale, pixels_per_patch)
        keys = cell_keys(cells(origin, scale, blocks.keys, levels), samples.position, samples.normal, part)
        groups = group_equal(keys)
        n = len(groups.keys)
        if n <= max_patches or pixels_per_patch > 100:
            break
        pixels_per_patch *= max(1.1, min(2.0, (n / max_patches) ** 0.5))
        if (levels == N_LEVELS - 1).mean() > 0.5:
            # Where most cells are as coarse as they get, only a coarser grid helps: captures far larger than a room.
            scale *= 2
            blocks = group_equal(block_keys(samples.position, origin, scale))
    patch, order, start, count = groups.group, groups.order, groups.start, groups.count
    grid = PatchGrid(origin, scale, blocks.keys, levels, groups.keys, np.arange(n, dtype=np.int32))
    pick = order[start[:, None] + (rng.random((n, ORIGINS_PER_PATCH)) * count[:, None]).astype(np.int64)]
    normal = group_means(samples.normal, patch, n)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    position = group_means(samples.position, patch, n).astype(np.float32)
    part_of_patch = part[order[start]]
    cell = np.floor((position - origin) / (AROUND * scale)).astype(np.int64)
    around = np.unique(np.column_stack([cell, part_of_patch]), axis=0, return_inverse=True)[1].reshape(-1)
    return Surface(
        grid,
        patch,
        position,
        normal.astype(np.float32),
        samples.footprint[order[start + count // 2]],
        part_of_patch,
        count,
        normal_spread(samples.normal, around[patch])[around],
        Origins(samples.position[pick], samples.normal[pick]),
        pixels_per_patch,
    )


def normal_spread(normal: NDArray[np.floating], group: NDArray[np.integer]) -> NDArray[np.float64]:
    """(m,) root mean square sine of the angle between the unit normals (n, 3) of each group and their common axis.

    The axis is the direction that has most of their second moment, so the two sides of a sheet agree.
    """
    m = int(group.max()) + 1
    products = np.concatenate([normal * np.roll(normal, -k, axis=1) for k in (0, 1)], 1)
    xx, yy, zz, xy, yz, zx = (group_means(products, group, m)).T
    moment = np.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz], 1).reshape(m, 3, 3)
    return np.sqrt(np.clip(1 - np.linalg.eigvalsh(moment)[:, -1], 0.0, None))
