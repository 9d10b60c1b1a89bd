"""Surface patches: the cells on which radiance and irradiance are kept.

A patch is what lies in one cell of a grid, faces one way and belongs to one part. The grid's cell size doubles from
level to level and follows the pixel footprint of the photos block by block, so that a patch covers a few pixels
wherever a camera was close and little is spent where none was. Triangles play no role: a mesh of ten million of them
or with long slivers gives the same patches, and every point on the surface finds its patch by hashing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..grouping import Groups

N_LEVELS = 6
FINEST = 0.01
"""Finest cell, metres; a cell spans ``FINEST * 2**level``."""
FREE_SLOTS = 4
"""Slots of a hash table per key; most keys then lie in their first slot."""


def _mix(*columns: NDArray[np.integer]) -> NDArray[np.uint64]:
    """64-bit hash of integer columns; with 10^6 keys a collision has probability 10^-7."""
    key = np.zeros(len(columns[0]), np.uint64)
    for column in columns:
        key = (key + column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return key


@dataclass(frozen=True)
class KeyIndex:
    """Finds 64-bit hashes among the distinct ``keys`` by open addressing: one or two reads where a search takes 17."""

    keys: NDArray[np.uint64]

    @cached_property
    def _slots(self) -> tuple[NDArray[np.int32], np.uint64]:
        """Position of the key in each slot, -1 where empty; and by how much a key is shifted to give its slot."""
        bits = max(4, int(np.ceil(np.log2(max(len(self.keys), 1) * FREE_SLOTS))))
        shift = np.uint64(64 - bits)
        slots = np.full(1 << bits, -1, np.int32)
        open_ = np.arange(len(self.keys), dtype=np.int32)
        slot = (self.keys >> shift).astype(np.int64)
        while len(open_):
            free = slots[slot] < 0
            slots[slot[free]] = open_[free]
            left = slots[slot] != open_
            open_, slot = open_[left], (slot[left] + 1) & (len(slots) - 1)
        return slots, shift

    def find(self, keys: NDArray[np.uint64]) -> NDArray[np.int32]:
        """(n,) position of each key, -1 where absent."""
        if len(self.keys) == 0:
            return np.full(len(keys), -1, np.int32)
        slots, shift = self._slots
        slot = (keys >> shift).astype(np.int64)
        found = slots[slot]
        open_ = np.flatnonzero((self.keys[found] != keys) & (found >= 0))
        while len(open_):
            slot[open_] = (slot[open_] + 1) & (len(slots) - 1)
            found[open_] = slots[slot[open_]]
            open_ = open_[(self.keys[found[open_]] != keys[open_]) & (found[open_] >= 0)]
        return found


@dataclass(frozen=True)
class PatchGrid:
    """The hash from surface points to patches.

    Attributes:
        origin: (3,) metres; off the mesh's own grid so that axis-aligned walls do not lie on cell borders.
        scale: world metres per grid metre (1 for captures in metres).
        block_keys, block_levels: level per block of the coarsest size; blocks absent are coarsest.
        cell_keys, cell_patches: patch per cell.
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
        keys = cell_keys(position, normal, part, self.origin, self.scale, self._blocks, self.block_levels)
        at = self._cells.find(keys)
        return np.where(at >= 0, self.cell_patches[at], np.int32(-1)) if len(self.cell_patches) else at

    @cached_property
    def _blocks(self) -> KeyIndex:
        return KeyIndex(self.block_keys)

    @cached_property
    def _cells(self) -> KeyIndex:
        return KeyIndex(self.cell_keys)


def block_keys(position: NDArray[np.floating], origin: NDArray[np.float64], scale: float) -> NDArray[np.uint64]:
    """Hash of the coarsest cell around each point."""
    size = scale * FINEST * 2 ** (N_LEVELS - 1)
    return _mix(*(np.floor((position[:, axis] - origin[axis]) / size).astype(np.int64) for axis in range(3)))


def cell_keys(
    position: NDArray[np.floating],
    normal: NDArray[np.floating],
    part: NDArray[np.integer],
    origin: NDArray[np.float64],
    scale: float,
    known_blocks: KeyIndex,
    block_levels: NDArray[np.int8],
) -> NDArray[np.uint64]:
    """Hash of (cell at the block's level, 26 directions of the normal, part) for each point."""
    at = known_blocks.find(block_keys(position, origin, scale))
    level = np.where(at >= 0, block_levels[at] if len(block_levels) else 0, N_LEVELS - 1)
    size = (scale * FINEST * 2.0 ** np.arange(N_LEVELS))[level]
    cell = [np.floor((position[:, axis] - origin[axis]) / size).astype(np.int64) for axis in range(3)]
    facing = np.rint(normal).astype(np.int64)
    return _mix(*cell, 9 * facing[:, 0] + 3 * facing[:, 1] + facing[:, 2], level, part)


def choose_levels(
    blocks: Groups[np.uint64], footprint: NDArray[np.floating], scale: float, pixels_per_patch: float
) -> NDArray[np.int8]:
    """(b,) level of every block that photos see, from the lower quartile of its pixels' footprints.

    Args:
        blocks: the n pixels by their :func:`block_keys`.
        footprint: (n,) metres.
    """
    wanted = np.log2(np.maximum(pixels_per_patch * footprint / (scale * FINEST), 1e-6))
    level = np.clip(np.floor(wanted + 0.5), 0, N_LEVELS - 1).astype(np.int64)
    n = len(blocks.keys)
    histogram = np.bincount(blocks.group * N_LEVELS + level, minlength=n * N_LEVELS).reshape(n, N_LEVELS)
    quartile = (np.cumsum(histogram, axis=1) <= (blocks.count // 4)[:, None]).sum(1)
    return quartile.astype(np.int8)
