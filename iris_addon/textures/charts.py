"""Charts of a texture atlas: texels of its own for each face, as many as the photos resolve.

Faces are merged to charts (:func:`merge_faces`). Each chart is projected along its mean normal, rotated to its tightest
rectangle and scaled to the density its faces need, and the rectangles are packed (:mod:`.packing`). Charts whose
projection overlaps itself (spiral ramps, doubled faces) are then split. A general unwrapper would flatten curved
surfaces with less stretch, but takes minutes on meshes of a few hundred thousand faces and thousands of components;
rooms are mostly flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.random_streams import stream
from ..model.capture import DEGENERATE_AREA, Mesh
from ..surface.primary_rays import PixelSamples
from ..surface.topology import component_labels, edge_adjacency
from .atlas import Atlas, covered_texels, plane_areas
from .packing import pack
from .texel_density import resolved_side, texel_density_from_footprint

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

UNSEEN_SHARE = 0.25
"""Texel density of unseen faces relative to the median of the seen ones."""
MOST_UNSEEN = 0.15
"""Most texels of all unseen faces, relative to all seen ones."""
MOST_OF_ONE_FACE = 4
"""A single face gets at most one in so many texels."""
EXPECTED_FILL = 0.6
"""Share of the atlas that charts cover, before it is known."""
MOST_CHARTS = 1 / 8
"""Charts per texel of the atlas from which the smallest share their texels."""
MERGE_ROUNDS, SPLIT_ROUNDS = 60, 2
"""Most rounds in which charts merge, and in which those that overlap themselves are split."""
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
GRAIN_TEXELS = 16
"""Texels below which charts are pooled when there are too many."""
OVERLAP_TEXELS = 2
"""Overlaid texels from which a chart is split."""
FINEST_CHECK = 2048
"""Finest grid, points per side, on which overlaps are looked for."""


def atlas_for_photos(mesh: Mesh, samples: PixelSamples, reduction: NDArray[np.integer], most: int) -> Atlas:
    """The atlas of ``mesh``, with as many texels as the photos resolve, and the texel under each pixel of ``samples``.

    Its texture coordinates are the mesh's own, or else new ones whose texels are as large as the pixels of the photos.

    Args:
        samples: pixels of reduced photos.
        reduction: (n_views,) rows and columns of the photo on file in one of those.
        most: side of the atlas in texels, at most.
    """
    footprint = samples.footprint / reduction[samples.view].astype(np.float32)
    density = texel_density_from_footprint(samples.face, footprint, len(mesh.faces))
    size = min(resolved_side(mesh, density), most)
    uv = build_atlas(mesh, density, size) if mesh.uv is None else mesh.uv
    return Atlas.of(uv, size, samples.face, samples.barycentric)


def build_atlas(mesh: Mesh, texel_density: NDArray[np.floating], size: int) -> NDArray[np.float32]:
    """UVs that give every face its own texels.

    One factor on all densities makes the charts fill the atlas. A chart has one density, that at which it gets as many
    texels as its faces ask for in total; one longer than the atlas is shrunk to fit. Faces tilted against their chart
    are stretched up to 1 / :data:`STEEPEST_COSINE`; slivers and grains that make up less than half a texel of a
    chart may fold. Charts keep a gutter of two texels, one where charts of a few texels crowd the atlas; where there
    are more loose components than texels, neighbouring ones share theirs.

    Args:
        texel_density: (F,) wanted texels per metre, 0 for unseen faces.
        size: side of the atlas in texels.

    Returns:
        (F, 3, 2) float32 per corner in [0, 1]; all corners of degenerate faces at 0.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    kept = np.flatnonzero(areas > DEGENERATE_AREA)
    uv = np.zeros((len(mesh.faces), 3, 2), np.float32)
    if len(kept) == 0:
        return uv
    areas, corners = areas[kept], corners[kept]
    wanted = _wanted_texels(areas, texel_density[kept])
    faces = _Faces(corners, cross[kept] / (2 * areas[:, None]), areas, wanted)
    pairs = edge_adjacency(Mesh(mesh.vertices, mesh.faces[kept]))
    texels = wanted * (EXPECTED_FILL * size**2 / wanted.sum())
    chart = merge_faces(faces.corners, texels, pairs, stream(0, "textures.charts"))
    crowded = chart.max() >= size**2 * MOST_CHARTS
    if crowded:
        chart = pool_grains(chart, faces.corners, texels, size)
    for _ in range(0 if crowded else SPLIT_ROUNDS):
        flat = _flatten(faces, chart)
        placed = _place(flat, chart, size)
        lower = _overlaid(placed, flat.depth, chart, min(size, FINEST_CHECK))
        if not lower.any():
            break
        chart = _split(chart, lower, pairs)
    else:
        placed = _place(_flatten(faces, chart), chart, size)
    uv[kept] = placed
    return uv


def _wanted_texels(areas: FloatArray, density: NDArray[np.floating]) -> FloatArray:
    """(F,) texels per face up to a common factor, for ``density`` (F,) that is 0 on unseen faces.

    Neither all unseen faces together nor a single seen one (the ground plane a house stands on) may take the atlas.
    """
    seen = density > 0
    if not seen.any():
        return areas
    wanted = areas * density.astype(np.float64) ** 2
    if np.count_nonzero(seen) > MOST_OF_ONE_FACE:  # among fewer, each may have its share
        largest = -np.partition(-wanted, range(MOST_OF_ONE_FACE))[:MOST_OF_ONE_FACE]
        # With m faces cut to the cap, the others' sum is MOST_OF_ONE_FACE - m times the cap.
        for m, at_most in enumerate(largest):
            cap = (wanted.sum() - largest[:m].sum()) / (MOST_OF_ONE_FACE - m)
            if at_most <= cap:
                wanted = np.minimum(wanted, cap)
                break
    unseen = areas[~seen] * (UNSEEN_SHARE * np.median(density[seen])) ** 2
    wanted[~seen] = unseen * min(1.0, MOST_UNSEEN * wanted.sum() / max(unseen.sum(), 1e-300))
    return wanted


@dataclass(frozen=True)
class _Faces:
    """Faces that have an area: corners (F, 3, 3), unit normals, areas in m², wanted texels up to a factor."""

    corners: FloatArray
    normals: FloatArray
    areas: FloatArray
    wanted: FloatArray


@dataclass(frozen=True)
class _Flat:
    """Charts before packing, in texels at scale 1.

    Attributes:
        corners: (F, 3, 2) in the rectangle of the face's chart, which starts at 0.
        depth: (F, 3) metres along the chart's normal.
        extent: (n, 2) rectangle per chart, higher than wide.
    """

    corners: FloatArray
    depth: FloatArray
    extent: FloatArray


def _flatten(faces: _Faces, chart: IntArray) -> _Flat:
    """Project every chart along its mean normal, turn it to its tightest rectangle, scale it to its density."""
    n = int(chart.max()) + 1
    axes = _frames(sums(chart, faces.normals * faces.wanted[:, None], n))
    # Relative to one corner of the chart: nothing is lost far from the origin.
    some_face = np.zeros(n, np.int64)
    some_face[chart] = np.arange(len(chart))
    local = np.einsum("fij,fcj->fci", axes[chart], faces.corners - faces.corners[some_face[chart], :1])
    flat, depth = local[..., :2], local[..., 2]
    projected = plane_areas(flat)
    # A grain that closes on itself projects to nothing; its density must not explode.
    covered = np.maximum(np.bincount(chart, projected, n), 0.1 * np.bincount(chart, faces.areas, n))
    density = np.sqrt(np.bincount(chart, faces.wanted, n) / covered)

    order = np.argsort(chart, kind="stable")
    starts = 3 * np.searchsorted(chart[order], np.arange(n))
    points = flat[order].reshape(-1, 2)
    angle = _tightest_angle(points, starts)
    cos, sin = np.cos(angle)[chart, None], np.sin(angle)[chart, None]
    rotated = np.stack([flat[..., 0] * cos - flat[..., 1] * sin, flat[..., 0] * sin + flat[..., 1] * cos], -1)
    rotated *= density[chart, None, None]
    points = rotated[order].reshape(-1, 2)
    low = np.minimum.reduceat(points, starts)
    return _Flat(rotated - low[chart, None], depth, np.maximum.reduceat(points, starts) - low)


def _frames(facing: FloatArray) -> FloatArray:
    """(n, 3, 3) rows: two tangents and the normal, right-handed, for normals ``facing`` (n, 3) of any length.

    The first tangent follows the world axis most at right angles to the normal, so that walls come out upright.
    """
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    normal = np.where(length > 1e-300, facing / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    axis = np.eye(3)[np.abs(normal).argmin(1)]
    tangent = axis - normal * (axis * normal).sum(1, keepdims=True)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.stack([tangent, np.cross(normal, tangent), normal], 1)


def _tightest_angle(points: FloatArray, starts: IntArray) -> FloatArray:
    """(n,) angle by which to turn each run of ``points`` (m, 2) to get its smallest rectangle, standing upright."""
    best_area = np.full(len(starts), np.inf)
    best = np.zeros(len(starts))
    lying = np.zeros(len(starts), bool)
    run = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(points))))
    # Coarse to fine; the first angle, 0, keeps its place unless another one is clearly better.
    for step, offsets in ((7.5, np.arange(12)), (2.5, (-1, 1)), (1.0, (-1, 1)), (0.4, (-1, 1))):
        base = best.copy()
        for offset in offsets:
            angle = base + np.radians(step * offset)
            cos, sin = np.cos(angle)[run], np.sin(angle)[run]
            x, y = points[:, 0] * cos - points[:, 1] * sin, points[:, 0] * sin + points[:, 1] * cos
            width = np.maximum.reduceat(x, starts) - np.minimum.reduceat(x, starts)
            height = np.maximum.reduceat(y, starts) - np.minimum.reduceat(y, starts)
            better = width * height < 0.995 * best_area
            best_area = np.where(better, width * height, best_area)
            best = np.where(better, angle, best)
            lying = np.where(better, width > height, lying)
    return best + 0.5 * np.pi * lying


def _place(flat: _Flat, chart: IntArray, size: int) -> NDArray[np.float32]:
    """(F, 3, 2) UVs of packed charts."""
    gutter = 2 if 9 * len(flat.extent) < size**2 / 8 else 1
    corner, cell, scale = pack(flat.extent, size, gutter)
    room = (cell - gutter).astype(np.float64)
    factor = np.minimum(scale, (room / np.maximum(flat.extent, 1e-300)).min(1))
    start = corner + 0.5 * (cell - flat.extent * factor[:, None])
    return ((start[chart, None] + flat.corners * factor[chart, None, None]) / size).astype(np.float32)


def _overlaid(uv: NDArray[np.float32], depth: FloatArray, chart: IntArray, size: int) -> NDArray[np.bool_]:
    """(F,) faces that lie under another one of their chart.

    Faces keep their depth, so that the lower turn of a spiral is taken off as one component; coplanar ones are ordered
    by a small height that grows with their index.
    """
    covered = covered_texels(uv, size)
    overlaid = np.bincount(covered.texel, minlength=1)[covered.texel] > 1
    texel, face, weights = covered.texel[overlaid], covered.face[overlaid], covered.barycentric[overlaid]
    height = 1000 * depth / max(float(np.ptp(depth)), 1e-12) + 0.5 * np.arange(len(uv))[:, None] / len(uv)
    of_face = height[face]
    order = np.lexsort((of_face[:, 0] + ((of_face[:, 1:] - of_face[:, :1]) * weights).sum(1), texel))
    texel, face = texel[order], face[order]
    lower, upper = face[np.diff(texel, prepend=-1) != 0], face[np.diff(texel, append=-1) != 0]
    balance = np.bincount(lower, minlength=len(uv)) - np.bincount(upper, minlength=len(uv))
    count = np.bincount(chart[lower], minlength=int(chart.max()) + 1)
    return (balance > 0) & (count[chart] >= OVERLAP_TEXELS)


def _split(chart: IntArray, lower: NDArray[np.bool_], pairs: tuple[IntArray, IntArray]) -> IntArray:
    """Charts with their ``lower`` faces taken off, each connected component a chart."""
    layer = 2 * chart + lower
    split = np.zeros(int(chart.max()) + 1, bool)
    split[chart[lower]] = True
    a, b = pairs
    joined = layer[a] == layer[b]
    component = component_labels(len(chart), a[joined], b[joined]).astype(np.int64)
    return np.unique(np.where(split[chart], len(split) + component, chart), return_inverse=True)[1]


# ---- merging faces to charts ---------------------------------------------------------------------------------------


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
