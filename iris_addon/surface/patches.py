"""Surface patches: the cells on which radiance and irradiance are solved.

A patch is the part of one region that lies in one cell of a grid and faces one of 26 directions, equation (6). The cell
size doubles from level to level and follows the pixel footprint of the photos block by block, so that a patch covers a
few pixels wherever a camera was close. Triangles play no role: a mesh of ten million triangles, or of long slivers,
gives the same patches.

First the grid: any point on the surface finds its patch by hashing, in kernels as well (:func:`patch_at`). Then the
patches that photos see (:func:`build_surface`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, Real, inlined, kernel
from ..base.group_by import Groups, group_equal, group_means
from ..base.parallel import BLOCK, over_blocks
from ..model.capture import Mesh
from ..rays.sampling import Origins
from .primary_rays import PixelSamples

N_LEVELS = 6
"""Levels of cells; the coarsest cell, a block, is 32 times the finest."""
FINEST_CELL = 0.01
"""Side of the finest cell, metres; a cell of a level measures ``FINEST_CELL * 2**level``."""
SLOTS_PER_KEY = 4
"""Of a hash table; most keys then lie in their first slot."""
FIRST_PIXELS_PER_PATCH = 3.0
"""Side of a patch in pixels, before the budget of patches asks for larger ones."""
ORIGINS_PER_PATCH = 8
"""Points on a patch from which its rays start."""
NORMAL_SPREAD_CELL = 0.1
"""Side of the cells, metres, within which normals are compared."""
LARGEST_ROOM = 300.0
"""Extent of what photos show, metres, above which the capture is taken to be in another unit, and the grid scaled."""
ABSENT = np.uint64(0xFFFFFFFFFFFFFFFF)
"""In place of key and number in an empty slot of a hash table."""


@inlined
def _mix(key: Integer, value: Integer) -> Integer:
    """Hash of another integer on top of ``key``, 64 bits; with 10^6 keys a collision has probability 10^-7."""
    key = (key + np.uint64(np.int64(value))) * np.uint64(0x9E3779B97F4A7C15)
    return key ^ (key >> np.uint64(29))


@inlined
def _cell(x: Real, y: Real, z: Real, per_metre: Real) -> Integer:
    """Number of the cell that a point lies in; the same again two million cells away."""
    i, j, k = math.floor(x * per_metre), math.floor(y * per_metre), math.floor(z * per_metre)
    return (i & 0x1FFFFF) | (j & 0x1FFFFF) << 21 | (k & 0x1FFFFF) << 42


class Slots(NamedTuple):
    """A hash table from distinct 64-bit keys to numbers, by open addressing: one or two reads where bisection takes 17.

    Attributes:
        table: (2^b, 2) uint64, key and number in each slot; ABSENT where empty.
        shift: bits by which a key is shifted right to give its slot.
    """

    table: NDArray[np.uint64]
    shift: np.uint64

    @staticmethod
    def of(keys: NDArray[np.uint64], numbers: NDArray[np.integer]) -> Slots:
        """The table of ``keys`` (n,) and their ``numbers`` (n,), none of them negative."""
        bits = max(4, int(np.ceil(np.log2(max(len(keys), 1) * SLOTS_PER_KEY))))
        slots = Slots(np.full((1 << bits, 2), ABSENT, np.uint64), np.uint64(64 - bits))
        _fill(slots, keys, numbers.astype(np.uint64))
        return slots


@inlined
def number_of(slots: Slots, key: Integer) -> Integer:
    """The number of ``key``, -1 where it is absent."""
    at = np.int64(key >> slots.shift)
    while slots.table[at, 1] != ABSENT:
        if slots.table[at, 0] == key:
            return np.int64(slots.table[at, 1])
        at = (at + 1) & (len(slots.table) - 1)
    return np.int64(-1)


@kernel
def _fill(slots: Slots, keys: NDArray[np.uint64], numbers: NDArray[np.uint64]) -> None:
    for i in range(len(keys)):
        at = np.int64(keys[i] >> slots.shift)
        while slots.table[at, 1] != ABSENT:
            at = (at + 1) & (len(slots.table) - 1)
        slots.table[at, 0], slots.table[at, 1] = keys[i], numbers[i]


class Cells(NamedTuple):
    """A grid of cells as kernels take it.

    Attributes:
        origin: (3,) metres.
        per_metre: number of finest cells in a metre.
        levels: level of each known block; a block is a cell of the coarsest level.
    """

    origin: NDArray[np.float64]
    per_metre: float
    levels: Slots


def cells(origin: NDArray[np.float64], scale: float, block_keys: NDArray[np.uint64], levels: NDArray[np.int8]) -> Cells:
    """The grid of a :class:`PatchGrid` with these attributes."""
    return Cells(origin, 1 / (scale * FINEST_CELL), Slots.of(block_keys, levels))


@inlined
def _block_key(origin: NDArray[np.float64], per_metre: Real, x: Real, y: Real, z: Real) -> Integer:
    """Hash of the coarsest cell around a point."""
    x, y, z = x - origin[0], y - origin[1], z - origin[2]
    return _mix(np.uint64(0), _cell(x, y, z, per_metre / (1 << (N_LEVELS - 1))))


@inlined
def _level_at(cells: Cells, x: Real, y: Real, z: Real) -> Integer:
    """Level of the cells around a point."""
    level = number_of(cells.levels, _block_key(cells.origin, cells.per_metre, x, y, z))
    return level if level >= 0 else np.int64(N_LEVELS - 1)


@inlined
def _side(x: Real) -> Integer:
    """A coordinate of a unit vector rounded: 0, 1, 2 for −1, 0, 1."""
    return 2 if x > 0.5 else (0 if x < -0.5 else 1)


@inlined
def _cell_key(
    cells: Cells, level: Integer, x: Real, y: Real, z: Real, nx: Real, ny: Real, nz: Real, region: Integer
) -> Integer:
    """Hash of (cell of ``level``, 26 directions of the normal, region): equation (6)."""
    facing = 9 * _side(nx) + 3 * _side(ny) + _side(nz)
    x, y, z = x - cells.origin[0], y - cells.origin[1], z - cells.origin[2]
    key = _mix(np.uint64(0), _cell(x, y, z, cells.per_metre / (1 << level)))
    return _mix(key, (np.int64(region) * 27 + facing) * N_LEVELS + level)


@kernel
def _cell_keys(
    cells: Cells, position: NDArray, normal: NDArray, region: NDArray[np.integer], keys: NDArray[np.uint64]
) -> None:
    for i in range(len(keys)):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        level = _level_at(cells, x, y, z)
        keys[i] = _cell_key(cells, level, x, y, z, normal[i, 0], normal[i, 1], normal[i, 2], region[i])


@kernel
def _block_keys(origin: NDArray[np.float64], per_metre: float, position: NDArray, keys: NDArray[np.uint64]) -> None:
    for i in range(len(keys)):
        keys[i] = _block_key(origin, per_metre, position[i, 0], position[i, 1], position[i, 2])


class Lookup(NamedTuple):
    """The patches of a grid as kernels take them: its cells, and the patch of each known cell."""

    cells: Cells
    patches: Slots


@inlined
def patch_at(lookup: Lookup, x: Real, y: Real, z: Real, nx: Real, ny: Real, nz: Real, region: Integer) -> Integer:
    """Patch of a surface point, -1 where there is none; the normal is that of the visible side."""
    level = _level_at(lookup.cells, x, y, z)
    patch = number_of(lookup.patches, _cell_key(lookup.cells, level, x, y, z, nx, ny, nz, region))
    if patch < 0 and level != N_LEVELS - 1:  # surfaces that no photo shows have patches of the coarsest size
        patch = number_of(lookup.patches, _cell_key(lookup.cells, N_LEVELS - 1, x, y, z, nx, ny, nz, region))
    return patch


@kernel
def _patches_at(
    lookup: Lookup, position: NDArray, normal: NDArray, region: NDArray[np.integer], patch: NDArray[np.int32]
) -> None:
    for i in range(len(patch)):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        patch[i] = patch_at(lookup, x, y, z, normal[i, 0], normal[i, 1], normal[i, 2], region[i])


@dataclass(frozen=True)
class PatchGrid:
    """The hash from surface points to patches.

    Attributes:
        origin: (3,) metres; at odd fractions of a cell, so that axis-aligned walls do not lie on cell borders.
        scale: world metres per grid metre (1 for captures in metres).
        block_keys, block_levels: (b,) uint64 and int8 level of each known block, a cell of the coarsest level; other
            blocks have that level.
        cell_keys, cell_patches: (c,) uint64 and int32 patch of each cell.
    """

    origin: NDArray[np.float64]
    scale: float
    block_keys: NDArray[np.uint64]
    block_levels: NDArray[np.int8]
    cell_keys: NDArray[np.uint64]
    cell_patches: NDArray[np.int32]

    def patches(
        self, position: NDArray[np.floating], normal: NDArray[np.floating], region: NDArray[np.integer]
    ) -> NDArray[np.int32]:
        """(n,) patch of each surface point, -1 where there is none; ``normal`` is that of the visible side."""
        patch = np.empty(len(position), np.int32)
        _patches_at(self.lookup, position, normal, region, patch)
        return patch

    @cached_property
    def lookup(self) -> Lookup:
        """The grid as kernels take it."""
        known = cells(self.origin, self.scale, self.block_keys, self.block_levels)
        return Lookup(known, Slots.of(self.cell_keys, self.cell_patches))

    def joined(self, unseen: PatchGrid) -> PatchGrid:
        """This grid and, for points where it has no patch, ``unseen``, a grid of the coarsest cells alone."""
        keys, patches = (self.cell_keys, unseen.cell_keys), (self.cell_patches, unseen.cell_patches)
        return replace(self, cell_keys=np.concatenate(keys), cell_patches=np.concatenate(patches))


def block_keys(position: NDArray[np.floating], origin: NDArray[np.float64], scale: float) -> NDArray[np.uint64]:
    """(n,) hash of the coarsest cell around each point (n, 3)."""
    keys = np.empty(len(position), np.uint64)
    over_blocks(
        len(keys), BLOCK, lambda rows: _block_keys(origin, 1 / (scale * FINEST_CELL), position[rows], keys[rows])
    )
    return keys


def cell_keys(
    grid: Cells, position: NDArray[np.floating], normal: NDArray[np.floating], region: NDArray[np.integer]
) -> NDArray[np.uint64]:
    """(n,) hash of (cell at the block's level, 26 directions of the normal, region) for each point, equation (6)."""
    keys = np.empty(len(position), np.uint64)
    over_blocks(len(keys), BLOCK, lambda rows: _cell_keys(grid, position[rows], normal[rows], region[rows], keys[rows]))
    return keys


def choose_levels(
    blocks: Groups[np.uint64], footprint: NDArray[np.floating], scale: float, pixels_per_patch: float
) -> NDArray[np.int8]:
    """(b,) level of every block that photos see, from the lower quartile of its pixels' footprints.

    Args:
        blocks: the n pixels grouped by their :func:`block_keys`.
        footprint: (n,) metres on the surface spanned by each pixel.
        scale: world metres per grid metre.
        pixels_per_patch: wanted side of a patch.
    """
    wanted = np.log2(np.maximum(pixels_per_patch * footprint / (scale * FINEST_CELL), 1e-6))
    level = np.clip(np.floor(wanted + 0.5), 0, N_LEVELS - 1).astype(np.int64)
    n = len(blocks.keys)
    histogram = np.bincount(blocks.group * N_LEVELS + level, minlength=n * N_LEVELS).reshape(n, N_LEVELS)
    quartile = (np.cumsum(histogram, axis=1) <= (blocks.count // 4)[:, None]).sum(1)
    return quartile.astype(np.int8)


# ---- the patches that photos see -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Surface:
    """The P patches that photos see.

    Attributes:
        grid: surface point to patch.
        sample_patch: (n,) int32 patch of every pixel sample.
        position, normal: (P, 3) float32 mean over the patch's pixels; the normal has unit length.
        footprint: (P,) float32 metres, that of one of its pixels.
        region: (P,) int32 region of each patch.
        count: (P,) int64 pixels on each.
        spread: (P,) spread of the region's normals around each patch, see :func:`normal_spread`: 0 in a plane, at most
            sqrt(2/3).
        origins: points on each patch from which rays start.
        pixels_per_patch: side of a patch in pixels with which the budget of patches is met.
    """

    grid: PatchGrid
    sample_patch: NDArray[np.int32]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    footprint: NDArray[np.float32]
    region: NDArray[np.int32]
    count: NDArray[np.int64]
    spread: NDArray[np.float64]
    origins: Origins
    pixels_per_patch: float


def build_surface(
    mesh: Mesh, samples: PixelSamples, regions: NDArray[np.int32], max_patches: int, rng: np.random.Generator
) -> Surface:
    """Patches as fine as ``max_patches`` allows.

    Args:
        samples: the pixels on the mesh.
        regions: (F,) region of each face.
    """
    used = mesh.vertices[np.unique(mesh.faces)]
    # The extent of what most pixels show: a few far-away faces are no sign of another unit of length.
    some = samples.position[:: 1 + len(samples.position) // 100_000]
    extent = float(np.ptp(np.percentile(some, (2, 98), axis=0), axis=0).max())
    scale = max(extent / LARGEST_ROOM, 1e-6) if extent > LARGEST_ROOM else 1.0
    origin = used.min(0) - scale * np.array([0.1234, 0.2345, 0.3456])
    region = regions[samples.face]
    pixels_per_patch = FIRST_PIXELS_PER_PATCH
    blocks = group_equal(block_keys(samples.position, origin, scale))
    while True:
        levels = choose_levels(blocks, samples.footprint, scale, pixels_per_patch)
        keys = cell_keys(cells(origin, scale, blocks.keys, levels), samples.position, samples.normal, region)
        groups = group_equal(keys)
        n = len(groups.keys)
        if n <= max_patches or pixels_per_patch > 100:
            break
        pixels_per_patch *= max(1.1, min(2.0, (n / max_patches) ** 0.5))
        if (levels == N_LEVELS - 1).mean() > 0.5:
            # Most cells have the coarsest level already: only a coarser grid helps. Captures far larger than a room.
            scale *= 2
            blocks = group_equal(block_keys(samples.position, origin, scale))
    patch, order, start, count = groups.group, groups.order, groups.start, groups.count
    grid = PatchGrid(
        origin=origin,
        scale=scale,
        block_keys=blocks.keys,
        block_levels=levels,
        cell_keys=groups.keys,
        cell_patches=np.arange(n, dtype=np.int32),
    )
    pick = order[start[:, None] + (rng.random((n, ORIGINS_PER_PATCH)) * count[:, None]).astype(np.int64)]
    normal = group_means(samples.normal, patch, n)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    position = group_means(samples.position, patch, n).astype(np.float32)
    region_of_patch = region[order[start]]
    cell = np.floor((position - origin) / (NORMAL_SPREAD_CELL * scale)).astype(np.int64)
    around = np.unique(np.column_stack([cell, region_of_patch]), axis=0, return_inverse=True)[1].reshape(-1)
    return Surface(
        grid=grid,
        sample_patch=patch,
        position=position,
        normal=normal.astype(np.float32),
        footprint=samples.footprint[order[start + count // 2]],
        region=region_of_patch,
        count=count,
        spread=normal_spread(samples.normal, around[patch])[around],
        origins=Origins(samples.position[pick], samples.normal[pick]),
        pixels_per_patch=pixels_per_patch,
    )


def normal_spread(normal: NDArray[np.floating], group: NDArray[np.integer]) -> NDArray[np.float64]:
    """(m,) root mean square sine of the angle between the unit normals (n, 3) of each group and their common axis.

    The axis is the principal axis of their second moment, so that the two sides of a sheet agree.
    """
    m = int(group.max()) + 1
    products = np.concatenate([normal * np.roll(normal, -k, axis=1) for k in (0, 1)], 1)
    xx, yy, zz, xy, yz, zx = (group_means(products, group, m)).T
    moment = np.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz], 1).reshape(m, 3, 3)
    return np.sqrt(np.clip(1 - np.linalg.eigvalsh(moment)[:, -1], 0.0, None))
