"""How often photos show the surface, as a smooth map: what a person reads off it is where to take more photos.

The confidence of single texels is of no use for that. On a scan the texels along every seam of the atlas and every edge
are seen by pixels that mix two surfaces, so that a well-photographed wall is covered by a net of black lines.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, Real, inlined, kernel
from ..base.parallel import BLOCK, over_blocks
from .fill import fill_texels
from .texel_points import TexelPoints

COVERAGE_CELL = 0.1
"""Metres over which the confidence is averaged. A person moves a camera by more than that."""
COVERAGE_MAX_CELLS = 4_000_000
"""Cells of the box around the mesh; a larger room has larger cells."""
COVERAGE_SPLATTED = 4_000_000
"""Texels that the averages are made from, at most; of more, every second, third …"""


def smooth_coverage(points: TexelPoints, confidence: NDArray[np.floating], size: int) -> NDArray[np.float32]:
    """Confidence averaged over the surface, of all texels of an atlas.

    The averages are those of a bilateral grid (Chen, Paris and Durand 2007): cells of space, six for the six sides a
    surface can face, which keeps the two sides of a wall or of a table top apart. Where the surface is curved the six
    blend by the squares of its normal.

    Args:
        points: T texels.
        confidence: (T,) of each, 0 to 1.
        size: side N of the atlas in texels.

    Returns:
        (N, N) 0 to 1; texels without a surface continue those beside them.
    """
    image, known = np.zeros((size, size), np.float32), np.zeros((size, size), bool)
    if not len(points.texel):
        return image
    low, high = points.position.min(0), points.position.max(0)
    cell = _cell(high - low)
    grid = np.zeros((6, *(np.ceil((high - low) / cell).astype(int) + 2), 2), np.float32)
    some = slice(None, None, -(-len(points.texel) // COVERAGE_SPLATTED))
    place = ((points.position - low) / np.float32(cell)).astype(np.float32)
    _splat(place[some], points.normal[some], points.size[some], confidence[some].astype(np.float32), grid)
    mean = np.empty(len(points.texel), np.float32)
    over_blocks(len(mean), BLOCK, lambda rows: _slice(place[rows], points.normal[rows], grid, mean[rows]))
    image.flat[points.texel], known.flat[points.texel] = mean, True
    return np.clip(fill_texels(image[..., None], known)[..., 0], 0.0, 1.0)


def _cell(extent: NDArray[np.floating]) -> float:
    """Side of the cells of a box of ``extent`` (3,), metres."""
    cell = COVERAGE_CELL
    while np.prod(np.ceil(extent / cell) + 2) > COVERAGE_MAX_CELLS:
        cell *= 1.25
    return cell


@inlined
def _share(place: Real, corner: Integer) -> Real:
    """Trilinear weight of the lower (0) or the upper (1) cell along an axis."""
    fraction = place - np.floor(place)
    return fraction if corner == 1 else 1 - fraction


@kernel
def _splat(
    place: NDArray[np.float32],
    normal: NDArray[np.float32],
    side: NDArray[np.float32],
    value: NDArray[np.float32],
    grid: NDArray[np.float32],
) -> None:
    """Add values and their weights, the areas of texels, to the cells around their places (T, 3)."""
    for t in range(len(place)):
        x, y, z = int(place[t, 0]), int(place[t, 1]), int(place[t, 2])
        for axis in range(3):
            facing = normal[t, axis] * normal[t, axis] * side[t] * side[t]
            sheet = 2 * axis + (1 if normal[t, axis] < 0 else 0)
            for corner in range(8):
                i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                weight = facing * _share(place[t, 0], i) * _share(place[t, 1], j) * _share(place[t, 2], k)
                grid[sheet, x + i, y + j, z + k, 0] += weight * value[t]
                grid[sheet, x + i, y + j, z + k, 1] += weight


@kernel
def _slice(
    place: NDArray[np.float32], normal: NDArray[np.float32], grid: NDArray[np.float32], mean: NDArray[np.float32]
) -> None:
    """Means of the cells around places (T, 3)."""
    for t in range(len(place)):
        x, y, z = int(place[t, 0]), int(place[t, 1]), int(place[t, 2])
        total, norm = 0.0, 1e-30
        for axis in range(3):
            sheet = 2 * axis + (1 if normal[t, axis] < 0 else 0)
            for corner in range(8):
                i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                share = _share(place[t, 0], i) * _share(place[t, 1], j) * _share(place[t, 2], k)
                weight = normal[t, axis] * normal[t, axis] * share
                held = grid[sheet, x + i, y + j, z + k, 1]
                if held > 0:
                    total += weight * grid[sheet, x + i, y + j, z + k, 0] / held
                    norm += weight
        mean[t] = total / norm
