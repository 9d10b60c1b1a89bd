"""Surface patches: the cells on which radiance and irradiance are kept.

A patch is what lies in one cell of a grid, faces one way and belongs to one part. The grid's cell size doubles from
level to level and follows the pixel footprint of the photos block by block, so that a patch covers a few pixels
wherever a camera was close and little is spent where none was. Triangles play no role: a mesh of ten million of them
or with long slivers gives the same patches, and every point on the surface finds its patch by hashing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

N_LEVELS = 6
FINEST = 0.01
"""Finest cell, metres; a cell spans ``FINEST * 2**level``."""


def _mix(*columns: NDArray[np.integer]) -> NDArray[np.uint64]:
    """64-bit hash of integer columns; with 10^6 keys a collision has probability 10^-7."""
    key = np.zeros(len(columns[0]), np.uint64)
    for column in columns:
        key = (key + column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return key


def _find(sorted_keys: NDArray[np.uint64], keys: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Position of each key in ``sorted_keys``, -1 where absent."""
    if len(sorted_keys) == 0:
        return np.full(len(keys), -1)
    at = np.minimum(np.searchsorted(sorted_keys, keys), len(sorted_keys) - 1)
    return np.where(sorted_keys[at] == keys, at, -1)


@dataclass(frozen=True)
class PatchGrid:
    """The hash from surface points to patches.

    Attributes:
        origin: (3,) metres; off the mesh's own grid so that axis-aligned walls do not lie on cell borders.
        scale: world metres per grid metre (1 for captures in metres).
        block_keys, block_levels: level per block of the coarsest size, keys sorted; blocks absent are coarsest.
        cell_keys, cell_patches: patch per cell, keys sorted.
    """

    origin: NDArray[np.float64]
    scale: float
    block_keys: NDArray[np.uint64]
    block_levels: NDArray[np.int8]
    cell_keys: NDArray[np.uint64]
    cell_patches: NDArray[np.int32]

    def lookup(
        self, position: NDArray[np.floating], normal: NDArray[np.floating], part: NDArray[np.integer]
    ) -> NDArray[np.int32]:
        """(n,) patch of each surface point, -1 where there is none; ``normal`` is on the side looked at."""
        keys = cell_keys(position, normal, part, self.origin, self.scale, self.block_keys, self.block_levels)
        at = _find(self.cell_keys, keys)
        return np.where(at >= 0, self.cell_patches[at], -1).astype(np.int32)


def block_keys(position: NDArray[np.floating], origin: NDArray[np.float64], scale: float) -> NDArray[np.uint64]:
    """Hash of the coarsest cell around each point."""
    block = np.floor((position - origin) / (scale * FINEST * 2 ** (N_LEVELS - 1))).astype(np.int64)
    return _mix(block[:, 0], block[:, 1], block[:, 2])


def cell_keys(
    position: NDArray[np.floating],
    normal: NDArray[np.floating],
    part: NDArray[np.integer],
    origin: NDArray[np.float64],
    scale: float,
    known_blocks: NDArray[np.uint64],
    block_levels: NDArray[np.int8],
) -> NDArray[np.uint64]:
    """Hash of (cell at the block's level, 26 directions of the normal, part) for each point."""
    at = _find(known_blocks, block_keys(position, origin, scale))
    level = np.where(at >= 0, block_levels[at] if len(block_levels) else 0, N_LEVELS - 1)
    cell = np.floor((position - origin) / (scale * FINEST * 2.0**level)[:, None]).astype(np.int64)
    facing = np.rint(normal).astype(np.int64) @ np.array([9, 3, 1])
    return _mix(cell[:, 0], cell[:, 1], cell[:, 2], facing, level, part)


def choose_levels(
    position: NDArray[np.floating],
    footprint: NDArray[np.floating],
    origin: NDArray[np.float64],
    scale: float,
    pixels_per_patch: float,
) -> tuple[NDArray[np.uint64], NDArray[np.int8]]:
    """Level of every block that photos see, from the lower quartile of its pixels' footprints."""
    wanted = np.log2(np.maximum(pixels_per_patch * footprint / (scale * FINEST), 1e-6))
    keys = block_keys(position, origin, scale)
    order = np.lexsort((wanted, keys))
    unique, first, count = np.unique(keys[order], return_index=True, return_counts=True)
    quartile = wanted[order][first + count // 4]
    return unique, np.clip(np.floor(quartile + 0.5), 0, N_LEVELS - 1).astype(np.int8)
