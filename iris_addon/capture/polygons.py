"""Polygons to triangles in file order, concave ones and those with a hole cut to their edge too.

A fan from the first corner covers what a concave polygon leaves out: it walls up windows.
"""

from __future__ import annotations

import mapbox_earcut
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.capture import FloatArray


def triangulate(vertices: FloatArray, corners: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F, 3) triangles of polygons, as positions in ``corners``.

    Args:
        vertices: (V, 3).
        corners: (n,) vertex indices, polygon after polygon.
        counts: (P,) corners of each polygon; those with fewer than three give no triangle.
    """
    start = np.concatenate([[0], np.cumsum(counts)[:-1]]) if len(counts) else np.empty(0, np.int64)
    made = np.maximum(counts - 2, 0)
    first = np.concatenate([[0], np.cumsum(made)[:-1]]) if len(made) else made
    triangles = np.empty((int(made.sum()), 3), np.int64)
    is_triangle, is_quad = counts == 3, counts == 4
    triangles[first[is_triangle]] = start[is_triangle, None] + np.arange(3)
    quads = start[is_quad, None] + np.arange(4)
    turn = _splits_badly(vertices[corners[quads]]).astype(np.int64) if len(quads) else np.empty(0, np.int64)
    for half, pattern in enumerate(((0, 1, 2), (0, 2, 3))):
        triangles[first[is_quad] + half] = np.take_along_axis(quads, (np.array(pattern) + turn[:, None]) % 4, axis=1)
    for polygon in np.flatnonzero(counts > 4):
        own = slice(start[polygon], start[polygon] + counts[polygon])
        triangles[first[polygon] : first[polygon] + made[polygon]] = start[polygon] + _cut(vertices[corners[own]])
    return triangles


def texture_coordinates(values: ArrayLike) -> NDArray[np.float32]:
    """``values`` in single precision; those beyond its range become infinite, which no texture has."""
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)


def _splits_badly(quads: FloatArray) -> NDArray[np.bool_]:
    """(n,) whether the diagonal from corner 0 to 2 leaves ``quads`` (n, 4, 3), because corner 1 or 3 is concave."""
    a, b, c, d = np.moveaxis(quads, 1, 0)
    first, second = np.cross(b - a, c - a), np.cross(c - a, d - a)
    return (first * second).sum(-1) < 0


def _cut(points: FloatArray) -> NDArray[np.int64]:
    """(n - 2, 3) triangles of one polygon (n, 3), with its orientation; degenerate ones fill up what ear cutting leaves
    out along bridges to a hole."""
    n = len(points)
    normal = _normal(points)
    length = float(np.linalg.norm(normal))
    found = np.empty((0, 3), np.int64)
    if np.isfinite(length) and length > 0:
        right = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        right /= np.linalg.norm(right)
        flat = (points - points[0]) @ np.stack([right, np.cross(normal / length, right)], 1)
        ends = np.array([n], np.uint32)
        found = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), ends).reshape(-1, 3).astype(np.int64)
        a, b, c = (flat[found[:, k]] for k in range(3))
        turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
        found[turned] = found[turned][:, ::-1]
    filler = np.zeros((max(n - 2 - len(found), 0), 3), np.int64)
    return np.concatenate([found, filler])[: n - 2]


def _normal(points: FloatArray) -> FloatArray:
    """(3,) Newell's normal of a polygon, twice its area long."""
    local = points - points[0]
    return np.cross(local, np.roll(local, -1, axis=0)).sum(0)
