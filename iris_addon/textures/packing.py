"""Rectangles into a square: bottom-left skyline over columns of texels, small ones chained to strips first.

Upright rectangles by falling height fill 92 to 97 % of the square; lying ones, or other orders, 75 to 94 %.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

IntArray = NDArray[np.int64]

GRAIN = 12
"""Rectangles up to this height, texels, are chained to strips before they are placed."""
STRIP = 256
"""Longest strip, texels."""
TRIALS = 12
"""Scales tried in the search for the largest, at most."""
CLOSE_ENOUGH = 0.99
"""Filled share of the height at which the search for the largest scale ends."""


def pack(extent: NDArray[np.float64], size: int, gutter: int) -> tuple[IntArray, IntArray, float]:
    """Place all rectangles in ``size`` x ``size`` texels at the largest common scale found.

    Args:
        extent: (n, 2) width and height in texels at scale 1; higher than wide packs best.
        gutter: texels that each rectangle gets beside its own, shared between its two sides.

    Returns:
        (n, 2) first column and row of each cell, (n, 2) its width and height in texels, and the scale. A rectangle
        larger than the square at that scale has to shrink to its cell less the gutter.

    Raises:
        ValueError: they do not fit even at one texel each.
    """
    smallest = np.full(extent.shape, 1 + gutter)
    corners, height = _skyline(smallest, size)
    if height > size:
        raise ValueError(f"{len(extent)} charts do not fit into {size} x {size} texels")
    best, low, high = (corners, smallest, 0.0), 0.0, np.inf
    scale = 0.9 * size / np.sqrt(max(float(extent.prod(1).sum()), 1e-12))
    for _ in range(TRIALS):
        cells = _cell_sizes(extent, scale, size, gutter)
        corners, height = _skyline(cells, size)
        if height <= size:
            best, low = (corners, cells, scale), scale
        else:
            high = scale
        if high < low * 1.004 or CLOSE_ENOUGH * size <= height <= size:
            break
        guess = scale * np.sqrt(size / height)
        scale = guess if low < guess < high else (low + min(high, 2 * low)) / 2
    return best


def _cell_sizes(extent: NDArray[np.float64], scale: float, size: int, gutter: int) -> IntArray:
    """(n, 2) whole texels for each rectangle and its gutter, at most ``size``."""
    return np.clip(np.ceil(extent * scale).astype(np.int64), 1, size - gutter) + gutter


def _skyline(cells: IntArray, size: int) -> tuple[IntArray, int]:
    """First column and row of each cell (n, 2), and the height of the whole."""
    order = np.lexsort((-cells[:, 0], -cells[:, 1]))
    group, offset = _strips(cells[order], size)
    first = np.flatnonzero(np.concatenate([[True], group[1:] != group[:-1]]))
    last = np.append(first[1:], len(order)) - 1
    widths = offset[last] + cells[order[last], 0]
    heights = cells[order[first], 1]
    corners = np.empty((len(first), 2), np.int64)
    level = np.zeros(size, np.int64)
    for k, (width, height) in enumerate(zip(widths.tolist(), heights.tolist(), strict=True)):
        # Highest column under the rectangle for every place of its left side.
        under = maximum_filter1d(level, width, origin=-(width // 2), mode="nearest")[: size - width + 1]
        x = int(under.argmin())
        corners[k] = x, under[x]
        level[x : x + width] = under[x] + height
    placed = corners[group]
    placed[:, 0] += offset
    result = np.empty_like(placed)
    result[order] = placed
    return result, int(level.max())


def _strips(cells: IntArray, size: int) -> tuple[IntArray, IntArray]:
    """Strip (n,) of each cell, cells sorted by falling height, and its first column within the strip."""
    grain = cells[:, 1] <= GRAIN
    limit = min(STRIP, size)
    # Cells of one height, cut where their summed width passes a multiple of what leaves room for the widest of them.
    run = np.concatenate([[0], np.cumsum(cells[1:, 1] != cells[:-1, 1])])
    start = np.cumsum(cells[:, 0]) - cells[:, 0]
    first_of_run = np.searchsorted(run, run)
    widest = cells[first_of_run, 0]
    room = np.maximum(limit - widest, 1)
    chunk = (start - start[first_of_run]) // room
    fresh = np.concatenate([[True], (run[1:] != run[:-1]) | (chunk[1:] != chunk[:-1]) | ~grain[1:] | ~grain[:-1]])
    group = np.cumsum(fresh) - 1
    return group, start - start[np.flatnonzero(fresh)][group]
