"""Charts: groups of joined faces that one flat projection lays out without folding.

Faces are merged bottom-up. In every round each chart names the neighbour it would rather join (similar normal, long
common border) and pairs that name each other merge, unless the merged chart would hold faces too steep for its mean
normal or waste room in the atlas. Everything is vectorised over charts, so that 400 000 faces take a few seconds.
Charts whose projection still overlaps itself (spiral ramps, doubled faces) are found by :mod:`.atlas` on the finished
layout and split there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STEEPEST = 0.75
"""Smallest cosine of a face with the normal of its chart: it is stretched 1.33 times, and walls never share a chart."""
HIDDEN_TEXELS = 0.5
"""Texels of faces steeper than that which a chart may hold: slivers and grains must not each become a chart."""
BORDER_WEIGHT = 1.0
"""Worth of a common border along a whole chart, relative to the cosine between two charts."""
WASTE = 1.05
"""How much more of the atlas a merged chart may take than its two halves; one seam less is worth that."""
GUTTER = 2
GRAIN_TEXELS = 16
"""Charts below this size are pooled when there are too many."""
MAX_ROUNDS = 60


def merge_faces(
    corners: FloatArray, texels: FloatArray, pairs: tuple[IntArray, IntArray], rng: np.random.Generator
) -> IntArray:
    """Charts of faces.

    Args:
        corners: (F, 3, 3) of faces that have an area.
        texels: (F,) area of each face in texels.
        pairs: indices of faces that share an edge, two arrays.

    Returns:
        (F,) chart per face, numbered from 0 without gaps.
    """
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    normals = cross / (2 * area[:, None])
    charts = _Charts.of_faces(corners, normals, area, texels)
    chart = np.arange(len(corners))
    links = _Links.between(*pairs, np.ones(len(pairs[0])), len(corners))
    for _ in range(MAX_ROUNDS):
        open_links = np.flatnonzero(_may_merge(links, charts))
        if len(open_links) == 0:
            break
        n = len(charts.texels)
        chosen = open_links[_mutual_choice(links, open_links, charts, rng)]
        partner = np.arange(n)
        partner[links.b[chosen]] = links.a[chosen]
        refused = _too_steep(partner[chart], normals, texels, n)[links.a[chosen]]
        partner[links.b[chosen][refused]] = links.b[chosen][refused]
        kept = np.ones(len(links.a), bool)
        kept[chosen] = False
        names, renumbered = np.unique(partner, return_inverse=True)
        links = links.take(kept).renamed(renumbered, len(names))
        charts = charts.merged(renumbered, len(names))
        chart = renumbered[chart]
    return chart


def pool_grains(chart: IntArray, corners: FloatArray, texels: FloatArray, size: int) -> IntArray:
    """Charts with neighbouring small ones of one facing joined, for a soup of more pieces than the atlas has room for.

    Args:
        chart: (F,) chart per face.
        corners: (F, 3, 3).
        texels: (F,) area of each face in texels; all of them fit the atlas.
        size: side of the atlas in texels.
    """
    n = int(chart.max()) + 1
    grain = np.bincount(chart, texels, n) < GRAIN_TEXELS
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = sums(chart, cross, n)
    axis = np.abs(facing).argmax(1) + 3 * (facing.sum(1) < 0)
    centre = sums(chart, corners.mean(1), n) / np.bincount(chart, minlength=n)[:, None]
    spacing = float(np.sqrt(np.linalg.norm(cross, axis=1).sum())) / size
    names = np.arange(n)
    while len(names) > size**2 / 12:
        spacing *= 1.5
        cells = np.column_stack([np.floor((centre - centre.min(0)) / spacing).astype(np.int64), axis])
        key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(0) + 1))
        names, pooled = np.unique(np.where(grain, key, key.max() + 1 + np.arange(n)), return_inverse=True)
    return pooled[chart]


@dataclass(frozen=True)
class _Charts:
    """Sums over the faces of n charts.

    Attributes:
        area: (n,) square metres.
        texels: (n,) area in texels.
        facing: (n, 3) normals times texels.
        first, second: (n, 3) and (n, 6) moments of the area, metres³ and metres⁴ (xx, yy, zz, yz, xz, xy).
    """

    area: FloatArray
    texels: FloatArray
    facing: FloatArray
    first: FloatArray
    second: FloatArray

    @classmethod
    def of_faces(cls, corners: FloatArray, normals: FloatArray, area: FloatArray, texels: FloatArray) -> _Charts:
        corners = corners - corners.mean((0, 1))
        centre = corners.mean(1)
        i, j = [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]
        # Mean of x xᵀ over a triangle: (9 c cᵀ + the sum of its corners' p pᵀ) / 12.
        second = (9 * centre[:, i] * centre[:, j] + (corners[:, :, i] * corners[:, :, j]).sum(1)) / 12
        return cls(area, texels, normals * texels[:, None], centre * area[:, None], second * area[:, None])

    def merged(self, names: IntArray, n: int) -> _Charts:
        return _Charts(*(sums(names, x, n) for x in (self.area, self.texels, self.facing, self.first, self.second)))

    def take(self, index: IntArray) -> _Charts:
        return _Charts(self.area[index], self.texels[index], self.facing[index], self.first[index], self.second[index])

    def __add__(self, other: _Charts) -> _Charts:
        return _Charts(
            self.area + other.area,
            self.texels + other.texels,
            self.facing + other.facing,
            self.first + other.first,
            self.second + other.second,
        )

    def cell(self) -> FloatArray:
        """(n,) texels of the rectangle that has the chart's moments, with its gutter.

        A w x h rectangle has variances w²/12 and h²/12; trace and second invariant of the covariance give w·h and
        w + h without its eigenvalues.
        """
        mean = self.first / self.area[:, None]
        xx, yy, zz, yz, xz, xy = (
            self.second / self.area[:, None] - mean[:, [0, 1, 2, 1, 0, 0]] * mean[:, [0, 1, 2, 2, 2, 1]]
        ).T
        minors = xx * yy + yy * zz + xx * zz - xy**2 - yz**2 - xz**2
        product = 12 * np.sqrt(np.maximum(minors, 0))
        total = np.sqrt(np.maximum(12 * (xx + yy + zz) + 2 * product, 0))
        density = np.sqrt(self.texels / self.area)
        return product * density**2 + GUTTER * total * density + GUTTER**2


@dataclass(frozen=True)
class _Links:
    """Common borders of charts: ``a < b`` chart indices, ``length`` in edges; every pair once."""

    a: IntArray
    b: IntArray
    length: FloatArray

    @classmethod
    def between(cls, a: IntArray, b: IntArray, length: FloatArray, n: int) -> _Links:
        kept = a != b
        key = np.minimum(a, b)[kept] * n + np.maximum(a, b)[kept]
        order = np.argsort(key)
        key = key[order]
        first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])) if len(key) else np.zeros(0, np.int64)
        total = np.add.reduceat(length[kept][order], first) if len(first) else np.zeros(0)
        return cls(key[first] // n, key[first] % n, total)

    def take(self, kept: NDArray[np.bool_]) -> _Links:
        return _Links(self.a[kept], self.b[kept], self.length[kept])

    def renamed(self, names: IntArray, n: int) -> _Links:
        return _Links.between(names[self.a], names[self.b], self.length, n)


def _may_merge(links: _Links, charts: _Charts) -> NDArray[np.bool_]:
    """Quick test of all links: mean normals not too far apart, no waste of atlas."""
    a, b = charts.take(links.a), charts.take(links.b)
    both = a + b
    length = np.linalg.norm(both.facing, axis=1)

    def steep(half: _Charts) -> NDArray[np.bool_]:
        size = np.linalg.norm(half.facing, axis=1)
        return ((half.facing * both.facing).sum(1) < STEEPEST * length * size) & (size > HIDDEN_TEXELS)

    return ~steep(a) & ~steep(b) & (both.cell() < WASTE * (a.cell() + b.cell()))


def _mutual_choice(links: _Links, among: IntArray, charts: _Charts, rng: np.random.Generator) -> IntArray:
    """Indices into ``among`` of links that are the best at both their ends; ties (coplanar faces) fall by chance."""
    n = len(charts.texels)
    border = np.bincount(links.a, links.length, n) + np.bincount(links.b, links.length, n)
    a, b = links.a[among], links.b[among]
    mean = charts.facing / np.maximum(np.linalg.norm(charts.facing, axis=1, keepdims=True), 1e-300)
    shared = links.length[among] / np.minimum(border[a], border[b])
    score = (mean[a] * mean[b]).sum(1) + BORDER_WEIGHT * shared + 0.05 * rng.random(len(among))
    best = np.full(n, -np.inf)
    np.maximum.at(best, a, score)
    np.maximum.at(best, b, score)
    return np.flatnonzero((score == best[a]) & (score == best[b]))


def _too_steep(chart: IntArray, normals: FloatArray, texels: FloatArray, n: int) -> NDArray[np.bool_]:
    """(n,) whether faces steeper than :data:`STEEPEST` cover more than :data:`HIDDEN_TEXELS` of a chart."""
    facing = sums(chart, normals * texels[:, None], n)
    cosine = (facing[chart] * normals).sum(1) / np.maximum(np.linalg.norm(facing, axis=1), 1e-300)[chart]
    return np.bincount(chart, texels * (cosine < STEEPEST), n) > HIDDEN_TEXELS


def sums(chart: IntArray, values: FloatArray, n: int) -> FloatArray:
    """(n,) or (n, k) sums of ``values`` (F,) or (F, k) per chart."""
    if values.ndim == 1:
        return np.bincount(chart, values, n).astype(np.float64)
    return np.stack([np.bincount(chart, column, n) for column in values.T], 1).astype(np.float64)
