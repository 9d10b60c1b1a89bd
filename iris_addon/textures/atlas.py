"""Texels of an atlas: the one that a surface point falls into, the face that each shows, and scan conversion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from ..base.parallel import BLOCK, filled, over_blocks


@dataclass(frozen=True)
class Atlas:
    """The faces of a mesh and the n pixels of photos on textures of N by N texels.

    Attributes:
        uv: (F, 3, 2) per corner, in [0, 1].
        face: (N, N) int32 face under each texel's centre; for texels beside a chart a face of the chart, since filters
            reach there; -1 elsewhere.
        texel: (n,) int64 flat index of the texel under each pixel.
    """

    uv: NDArray[np.floating]
    face: NDArray[np.int32]
    texel: NDArray[np.int64]

    @staticmethod
    def of(uv: NDArray[np.floating], size: int, face: NDArray[np.integer], barycentric: NDArray[np.floating]) -> Atlas:
        """The atlas of texture coordinates ``uv`` (F, 3, 2) with ``size`` squared texels.

        Args:
            face: (n,) face under each pixel.
            barycentric: (n, 2) weights of its corners 1 and 2 there.
        """
        shown, _ = rasterise_atlas(uv, size)
        texel = texel_index(uv, face, barycentric, size)
        # A sliver may cover no texel's centre, but pixels show it.
        uncovered = shown.ravel()[texel] < 0
        shown.ravel()[texel[uncovered]] = face[uncovered]
        beside = np.asarray(maximum_filter(shown, 3))
        return Atlas(uv, np.where(shown < 0, beside, shown), texel)

    @property
    def size(self) -> int:
        """Side N in texels."""
        return len(self.face)


def interpolate_uv(
    uv: NDArray[np.floating], face: NDArray[np.integer], barycentric: NDArray[np.floating]
) -> NDArray[np.floating]:
    """(n, 2) UV of surface points on ``face`` (n,), from ``uv`` (F, 3, 2) and the weights (n, 2) of corners 1 and 2."""
    u, v = barycentric[:, :1], barycentric[:, 1:]
    corners = uv[face]
    return corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v


def plane_areas(corners: NDArray[np.floating]) -> NDArray[np.floating]:
    """(F,) areas of triangles (F, 3, 2) in a plane."""
    edges = corners[:, 1:] - corners[:, :1]
    return 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])


def texel_index(
    uv: NDArray[np.floating], face: NDArray[np.integer], barycentric: NDArray[np.floating], size: int
) -> NDArray[np.int64]:
    """(n,) row * size + column of the texel under each surface point; row 0 is the top of the image (v = 1).

    Args:
        uv: (F, 3, 2) per corner.
        face: (n,) face of each point.
        barycentric: (n, 2) weights of corners 1 and 2.
    """

    def texel(rows: slice) -> NDArray[np.int64]:
        point = interpolate_uv(uv, face[rows], barycentric[rows])
        column = np.clip((point[:, 0] * size).astype(np.int64), 0, size - 1)
        row = np.clip(((1 - point[:, 1]) * size).astype(np.int64), 0, size - 1)
        return row * size + column

    return filled(np.empty(len(face), np.int64), texel)


def rasterise_atlas(uv: NDArray[np.floating], size: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The face under each texel centre, and where on it the centre lies.

    Args:
        uv: (F, 3, 2) per corner, charts without overlap.

    Returns:
        (size, size) int32 face, -1 outside all charts, and (size, size, 2) float32 weights of its corners 1 and 2.
    """
    covered = covered_texels(uv, size)
    face = np.full(size * size, -1, np.int32)
    barycentric = np.zeros((size * size, 2), np.float32)
    face[covered.texel] = covered.face
    barycentric[covered.texel] = covered.barycentric
    return face.reshape(size, size), barycentric.reshape(size, size, 2)


# ---- scan conversion of all triangles at once ----------------------------------------------------------------------


FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Covered:
    """n texel centres inside triangles, each once per triangle.

    Attributes:
        texel: (n,) int64 row * size + column; row 0 is the top of the image (v = 1).
        face: (n,) int32, ascending.
        barycentric: (n, 2) float32 weights of the face's corners 1 and 2.
    """

    texel: NDArray[np.int64]
    face: NDArray[np.int32]
    barycentric: NDArray[np.float32]


def covered_texels(uv: NDArray[np.floating], size: int) -> Covered:
    """All texel centres inside the triangles ``uv`` (F, 3, 2), in an image of ``size`` squared texels.

    A centre on an edge belongs to one side of it only, so that triangles that share an edge leave no gap and do not
    overlap. Outside the unit square nothing is covered.
    """
    x, y = uv[..., 0].astype(np.float64) * size, size - uv[..., 1].astype(np.float64) * size
    first = _first_centre(y.min(1), size)
    height = _first_centre(y.max(1), size) - first
    face = np.repeat(np.arange(len(uv), dtype=np.int32), height)
    row = np.arange(len(face)) - np.repeat(np.cumsum(height) - height - first, height)
    start, width = np.empty_like(row), np.empty_like(row)

    def intersect(rows: slice) -> None:
        left, right = _row_ends(x[face[rows]], y[face[rows]], row[rows] + 0.5)
        start[rows] = _first_centre(left, size)
        width[rows] = _first_centre(right, size) - start[rows]

    over_blocks(len(face), BLOCK, intersect)
    end = np.cumsum(width)
    n = int(end[-1]) if len(end) else 0
    covered = Covered(np.empty(n, np.int64), np.empty(n, np.int32), np.empty((n, 2), np.float32))
    weights = _weights_of_texels(x, y)

    def fill(texels: slice) -> None:
        rows = np.arange(np.searchsorted(end, texels.start, "right"), np.searchsorted(end, texels.stop) + 1)
        inside = np.minimum(end[rows], texels.stop) - np.maximum(end[rows] - width[rows], texels.start)
        of_row = np.repeat(rows, inside)
        column = np.arange(texels.start, texels.stop) - (end - width - start)[of_row]
        covered.face[texels] = face[of_row]
        covered.texel[texels] = row[of_row] * size + column
        affine = weights[covered.face[texels]]
        at = affine[..., 0] * (column + 0.5)[:, None] + affine[..., 1] * (row[of_row] + 0.5)[:, None] + affine[..., 2]
        covered.barycentric[texels] = np.clip(at, 0, 1)

    over_blocks(n, BLOCK, fill)
    return covered


def _first_centre(position: FloatArray, size: int) -> NDArray[np.int64]:
    """Index of the first of ``size`` texels whose centre lies at ``position`` or after it."""
    return np.clip(np.ceil(position - 0.5), 0, size).astype(np.int64)


def _row_ends(x: FloatArray, y: FloatArray, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) where triangles of corners ``x``, ``y`` (n, 3) begin and end on the horizontal lines at ``centre`` (n,)."""
    left, right = np.full(len(centre), np.inf), np.full(len(centre), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        # Always from top to bottom: the faces on both sides of an edge must get the same number.
        down = y[:, a] <= y[:, b]
        top, bottom = np.where(down, y[:, a], y[:, b]), np.where(down, y[:, b], y[:, a])
        at_top, at_bottom = np.where(down, x[:, a], x[:, b]), np.where(down, x[:, b], x[:, a])
        met = (top <= centre) & (centre < bottom)
        at = at_top + (centre - top) * ((at_bottom - at_top) / np.where(met, bottom - top, 1))
        left = np.where(met, np.minimum(left, at), left)
        right = np.where(met, np.maximum(right, at), right)
    return left, right


def _weights_of_texels(x: FloatArray, y: FloatArray) -> FloatArray:
    """(F, 2, 3) the weights of corners 1 and 2 as affine functions of position; zero for triangles without area."""
    x1, x2, y1, y2 = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], y[:, 1] - y[:, 0], y[:, 2] - y[:, 0]
    area = x1 * y2 - x2 * y1
    inverse = np.divide(1, area, out=np.zeros_like(area), where=area != 0)
    slope = np.stack([np.stack([y2, -x2], -1), np.stack([-y1, x1], -1)], 1) * inverse[:, None, None]
    offset = -(slope[..., 0] * x[:, :1] + slope[..., 1] * y[:, :1])
    return np.concatenate([slope, offset[..., None]], -1)
