"""Charts into a square: their convex hulls, packed by xatlas; those of a few texels laid to strips first.

xatlas is given hulls and not faces, so that a scan of a million triangles packs as fast as a model. Its time rises with
the square of the number of charts, of which most are grains: a strip of them is one chart to it. It moves charts only:
left to turn them it mirrors some, and it stretches thin ones to whole texels.
"""

from __future__ import annotations

import ctypes

import numpy as np
import xatlas
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from .texel_density import EXACT_MIN_SIDE, EXACT_SIDE_STEP, exact_side

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

GRAIN = 12
"""Charts up to this height, texels, are laid to strips."""
STRIP = 256
"""Longest strip, texels."""
MARGIN = 1.0
"""Texels that are kept free on every side of a chart. No two hulls with their margins touch one texel: those beside a
texel of a chart, which get its colour and which linear lookups read, are beside no other chart."""
GRID = 1 / 16
"""Texels to which corners of hulls are rounded. xatlas ignores slivers, and takes what they join for two charts."""
RECTANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
COARSEST_STEP, FINEST_STEP = 1.06, 1.01
"""Ratio of scales by which the search for the largest moves, and at which it ends."""
SIDE_RATIO = 1.03
"""Ratio of the sides that are tried for charts whose scale is given."""
TRIALS = 24
"""Scales tried, at most; a search tries five."""


def pack(corners: FloatArray, chart: IntArray, size: int) -> FloatArray:
    """Place all charts in ``size`` x ``size`` texels at the largest common scale found.

    Args:
        corners: (F, 3, 2) of faces in the rectangle of their chart, which starts at 0 and is higher than wide.
        chart: (F,) chart of each face, numbered from 0 without gaps.

    Returns:
        (F, 3, 2) in texels of the atlas: charts moved and scaled by one factor; those longer than the atlas are
        shrunk to fit.

    Raises:
        ValueError: there are more charts than the square holds at a texel each.
    """
    hulls = _hulls(corners, chart)
    extent = np.array([hull.max(0) for hull in hulls])
    found, low, high = None, 0.0, np.inf
    scale = _expected_scale(extent, size)
    for _ in range(TRIALS):
        layout = _layout(hulls, extent, scale, size)
        if layout is None:
            high = scale
        else:
            found, low = layout, scale
        if high < FINEST_STEP * low:
            break
        scale = min(np.sqrt(low * high), low * COARSEST_STEP) if low else scale / COARSEST_STEP
    if found is None:
        raise ValueError(f"{len(hulls)} charts do not fit into {size} x {size} texels")
    start, scales = found
    return corners * scales[chart, None, None] + start[chart, None]


def pack_unscaled(corners: FloatArray, chart: IntArray, most: int) -> tuple[FloatArray, int] | None:
    """Place all charts as large as they are in the smallest square found.

    Args:
        corners, chart: as for :func:`pack`, in texels.
        most: side of the square in texels, at most.

    Returns:
        (F, 3, 2) in texels, and the side of the square in whole steps; None where one of ``most`` does not hold them.
    """
    hulls = _hulls(corners, chart)
    extent = np.array([hull.max(0) for hull in hulls])
    least = max(EXACT_MIN_SIDE, int(np.ceil(extent.max() + 2 * MARGIN)))
    # The square in which their rectangles would take all the room; hulls may need less.
    rectangles = (np.maximum(extent, 1) + 2 * MARGIN + 0.5).prod(1).sum()
    side = min(most, max(least, exact_side(float(np.sqrt(rectangles)))))
    if least > most:
        return None
    while (layout := _layout(hulls, extent, 1.0, side)) is None:
        if side == most:
            return None
        least = side + 1
        side = min(most, max(exact_side(SIDE_RATIO * side), side + EXACT_SIDE_STEP))
    start, smaller = layout[0], side
    while (smaller := min(exact_side(smaller / SIDE_RATIO), smaller - EXACT_SIDE_STEP)) >= least:
        layout = _layout(hulls, extent, 1.0, smaller)
        if layout is None:
            break
        start, side = layout[0], smaller
    return corners + start[chart, None], side


def shelves(extent: FloatArray, length: float) -> tuple[IntArray, FloatArray]:
    """Rectangles side by side on shelves, the highest first: the (n,) shelf of each, and where on it it starts.

    Args:
        extent: (n, 2) width and height.
        length: of a shelf; the last rectangle may reach beyond.
    """
    order = np.argsort(-extent[:, 1], kind="stable")
    start = np.cumsum(extent[order, 0]) - extent[order, 0]
    shelf = np.unique((start // length).astype(np.int64), return_inverse=True)[1]
    head = start[np.searchsorted(shelf, shelf)]
    of_rectangle, place = np.empty(len(extent), np.int64), np.empty(len(extent))
    of_rectangle[order], place[order] = shelf, start - head
    return of_rectangle, place


def _expected_scale(extent: FloatArray, size: int) -> float:
    """Scale at which rectangles of (n, 2) ``extent`` and their room in between fill the square."""
    low, high = 0.0, 4 * size / np.sqrt(max(float(extent.prod(1).sum()), 1e-12))
    for _ in range(40):
        scale = (low + high) / 2
        cells = np.clip(extent * scale, 1, size) + 2 * MARGIN + 0.5
        low, high = (scale, high) if cells.prod(1).sum() < size**2 else (low, scale)
    return max(low, 1e-12)


def _hulls(corners: FloatArray, chart: IntArray) -> list[FloatArray]:
    """Convex hull (m, 2) of each chart's ``corners`` (F, 3, 2); of one that has no width, its rectangle."""
    order = np.argsort(chart, kind="stable")
    points = corners[order].reshape(-1, 2)
    first = 3 * np.searchsorted(chart[order], np.arange(int(chart.max()) + 1))
    end = np.append(first[1:], len(points))
    extent = np.maximum.reduceat(points, first)
    return [_hull(points[a:b], extent[k]) for k, (a, b) in enumerate(zip(first, end, strict=True))]


def _hull(points: FloatArray, extent: FloatArray) -> FloatArray:
    """Convex hull (m, 2) of ``points`` (n, 2); of points on a line, whichever way it runs, the rectangle ``extent``."""
    if extent.min() <= 1e-6 * extent.max():
        return extent * RECTANGLE
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # on a slanting line
        return extent * RECTANGLE


def _layout(
    hulls: list[FloatArray], extent: FloatArray, scale: float, size: int
) -> tuple[FloatArray, FloatArray] | None:
    """(n, 2) texel at which the rectangle of each chart starts, and its (n,) scale; None if all do not fit."""
    # xatlas would shrink what is longer than the square, and stretch what is no whole number of texels.
    scales = np.minimum(scale, (size - 2 * MARGIN) / np.maximum(extent.max(1), 1e-12))
    inside = extent * scales[:, None]
    room = np.ceil(np.maximum(inside, 1) + 2 * MARGIN - 1e-6)
    grain = room[:, 1] <= GRAIN
    # What is packed as one: a chart, or grains side by side.
    piece, column = np.cumsum(~grain) - 1, np.zeros(len(hulls))
    shelf, column[grain] = shelves(room[grain], min(STRIP, size / 4))
    piece[grain] = np.count_nonzero(~grain) + shelf
    pieces = np.zeros((int(piece.max()) + 1, 2))
    np.maximum.at(pieces, piece, room + np.column_stack([column, np.zeros(len(hulls))]))
    outlines = [_grown(hulls[k] * scales[k], room[k] - inside[k]) for k in np.flatnonzero(~grain)]
    outlines += list(pieces[len(outlines) :, None] * RECTANGLE)
    corner = _packed(outlines, size)
    if corner is None:
        return None
    start = corner[piece] + (room - inside) / 2
    start[:, 0] += column
    return start, scales


def _grown(hull: FloatArray, free: FloatArray) -> FloatArray:
    """Convex polygon (m, 2) of all places of ``hull`` (h, 2) in a rectangle that is ``free`` (2,) wider and higher."""
    grown = (hull[:, None] + free * RECTANGLE).reshape(-1, 2)
    grown = (grown / GRID).round() * GRID
    return grown[ConvexHull(grown).vertices]


def _packed(outlines: list[FloatArray], size: int) -> FloatArray | None:
    """(m, 2) first texel of the rectangles of convex polygons where xatlas puts them; None if not all fit."""
    points = np.concatenate([np.vstack([outline, outline.mean(0)]) for outline in outlines])
    corners = np.array([len(outline) for outline in outlines])
    first = np.cumsum(corners + 1) - corners - 1
    # Triangles between each side and the middle.
    polygon = np.repeat(np.arange(len(outlines)), corners)
    side = np.arange(len(polygon)) - (np.cumsum(corners) - corners)[polygon]
    after = (side + 1) % corners[polygon]
    fan = first[polygon, None] + np.column_stack([side, after, corners[polygon]])
    atlas = xatlas.Atlas()
    # Its destructor joins threads and, once in ten thousand times, never returns; what it holds is small.
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(atlas))
    atlas.add_uv_mesh(points.astype(np.float32), fan.astype(np.uint32), polygon[:, None].astype(np.uint32))
    options = xatlas.PackOptions()
    options.resolution, options.texels_per_unit, options.padding = size, 1.0, 0
    options.bilinear = False  # margins are there for it
    options.rotate_charts = options.rotate_charts_to_axis = False
    atlas.generate(xatlas.ChartOptions(), options)
    if atlas.atlas_count > 1:
        return None
    _, triangles, uv = atlas.get_mesh(0)
    placed = uv[triangles] * [atlas.width, atlas.height]
    # xatlas adds half a texel to all places.
    return np.minimum.reduceat(placed.min(1), np.cumsum(corners) - corners) - 0.5
