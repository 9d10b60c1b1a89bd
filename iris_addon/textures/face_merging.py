"""Which faces share a chart: neighbours of one facing, merged bottom-up while their shape wastes no room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MERGE_ROUNDS = 60
"""Most rounds in which charts merge."""
STEEPEST_COSINE = 0.75
"""Smallest cosine of a face with the normal of its chart: it is stretched 1.33 times, and walls never share a chart."""
STEEP_TEXELS = 0.5
"""Texels of steeper faces that a chart may hold: slivers and grains must not each become a chart."""
BORDER_WEIGHT = 1.0
"""Weight of a common border along a whole chart, relative to the cosine between two charts."""
MERGED_SIZE = 1.05
"""Room that a merged chart may take in the atlas, in that of its two halves; one seam less is worth the rest."""
GUTTER = 2
"""Texels between charts."""
MOST_CHARTS = 1 / 24
"""Charts per texel of the atlas from which the smallest share their texels."""
GRAIN_TEXELS = 16
"""Texels below which charts are pooled when there are too many."""


def merge_faces(
    corners: FloatArray, texels: FloatArray, pairs: tuple[IntArray, IntArray], rng: np.random.Generator
) -> IntArray:
    """Charts of faces, merged bottom-up.

    In each round a chart prefers one neighbour (similar normal, long common border), and pairs that prefer each other
    merge, unless the merged chart would hold faces too steep for its mean normal or waste room in the atlas. All steps
    are vectorised over charts, so that 400 000 faces take a few seconds.

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
    for _ in range(MERGE_ROUNDS):
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
    """Charts with neighbouring small ones of one facing joined, for a mesh of more components than the atlas can hold.

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
    reach = float(np.ptp(centre, axis=0).max())
    spacing = float(np.sqrt(np.linalg.norm(cross, axis=1).sum())) / size
    pooled = np.arange(n)
    while pooled.max() >= size**2 * MOST_CHARTS and spacing < 2 * reach:
        spacing *= 1.5
        cells = np.column_stack([np.floor((centre - centre.min(0)) / spacing).astype(np.int64), axis])
        key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(0) + 1))
        pooled = np.unique(np.where(grain, key, key.max() + 1 + np.arange(n)), return_inverse=True)[1]
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
        return cls(
            area=area,
            texels=texels,
            facing=normals * texels[:, None],
            first=centre * area[:, None],
            second=second * area[:, None],
        )

    def merged(self, names: IntArray, n: int) -> _Charts:
        return _Charts(*(sums(names, x, n) for x in (self.area, self.texels, self.facing, self.first, self.second)))

    def take(self, index: IntArray) -> _Charts:
        return _Charts(
            area=self.area[index],
            texels=self.texels[index],
            facing=self.facing[index],
            first=self.first[index],
            second=self.second[index],
        )

    def __add__(self, other: _Charts) -> _Charts:
        return _Charts(
            area=self.area + other.area,
            texels=self.texels + other.texels,
            facing=self.facing + other.facing,
            first=self.first + other.first,
            second=self.second + other.second,
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
        return ((half.facing * both.facing).sum(1) < STEEPEST_COSINE * length * size) & (size > STEEP_TEXELS)

    return ~steep(a) & ~steep(b) & (both.cell() < MERGED_SIZE * (a.cell() + b.cell()))


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
    """(n,) whether faces steeper than :data:`STEEPEST_COSINE` cover more than :data:`STEEP_TEXELS` of a chart."""
    facing = sums(chart, normals * texels[:, None], n)
    cosine = (facing[chart] * normals).sum(1) / np.maximum(np.linalg.norm(facing, axis=1), 1e-300)[chart]
    return np.bincount(chart, texels * (cosine < STEEPEST_COSINE), n) > STEEP_TEXELS


def sums(chart: IntArray, values: FloatArray, n: int) -> FloatArray:
    """(n,) or (n, k) sums of ``values`` (F,) or (F, k) per chart."""
    if values.ndim == 1:
        return np.bincount(chart, values, n).astype(np.float64)
    return np.stack([np.bincount(chart, column, n) for column in values.T], 1).astype(np.float64)
