"""Charts of a texture atlas: texels of its own for each face, as many as the photos resolve or as are asked for.

Faces are merged to charts (:mod:`.face_merging`). Each chart is projected along its mean normal, turned to its tightest
rectangle and scaled to the density its faces need. Charts whose projection overlaps itself (spiral ramps, doubled
faces) are split, and all are packed by xatlas (:mod:`.packing`). Its own charts would stretch curved surfaces less, but
take minutes on meshes of a few hundred thousand faces and thousands of components; rooms are mostly flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.random_streams import stream
from ..capture.mesh_files import face_areas
from ..model.capture import DEGENERATE_AREA, Mesh
from ..model.texture_size import AskedSize
from ..surface.primary_rays import PixelSamples
from ..surface.topology import component_labels, edge_adjacency
from .atlas import Atlas, covered_texels, plane_areas
from .face_merging import MOST_CHARTS, merge_faces, pool_grains, sums
from .packing import pack, pack_unscaled, shelves
from .texel_density import exact_side, resolved_side, side_for_density, texel_density_from_footprint

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
SPLIT_ROUNDS = 2
"""Most rounds in which charts that overlap themselves are split."""
OVERLAP_TEXELS = 2
"""Overlaid texels from which a chart is split."""
FINEST_CHECK = 2048
"""Finest grid, points per side, on which overlaps are looked for."""


def atlas_for_photos(mesh: Mesh, samples: PixelSamples, reduction: NDArray[np.integer], asked: AskedSize) -> Atlas:
    """The atlas of ``mesh`` and the texel under each pixel of ``samples``.

    Its texture coordinates are the mesh's own, or else new ones. It has as many texels as the photos resolve, and those
    of new ones are as large as the pixels of the photos, unless ``asked`` says otherwise.

    Args:
        samples: pixels of reduced photos.
        reduction: (n_views,) rows and columns of the photo on file in one of those.
        asked: size of the atlas.
    """
    footprint = samples.footprint / reduction[samples.view].astype(np.float32)
    density = texel_density_from_footprint(samples.face, footprint, len(mesh.faces))
    if asked.density is not None and mesh.uv is None:
        uv, size = build_even_atlas(mesh, density > 0, asked.density, asked.most)
    elif mesh.uv is None:
        size = asked.side or min(resolved_side(mesh, density), asked.most)
        uv = build_atlas(mesh, density, size)
    else:
        needed = resolved_side(mesh, density)
        if asked.density is not None:
            needed = side_for_density(mesh, density > 0, asked.density)
        uv, size = mesh.uv, asked.side or min(needed, asked.most)
    return Atlas.of(uv, size, samples.face, samples.barycentric)


def build_atlas(mesh: Mesh, texel_density: NDArray[np.floating], size: int) -> NDArray[np.float32]:
    """UVs that give every face its own texels.

    One factor on all densities makes the charts fill the atlas. A chart has one density, that at which it gets as many
    texels as its faces ask for in total; one longer than the atlas is shrunk to fit. Faces tilted against their chart
    are stretched up to 1 / :data:`.face_merging.STEEPEST_COSINE`; slivers and grains that make up less than half a
    texel of a chart may fold. Charts keep a gutter of two texels; where there are more loose components than the atlas
    holds, neighbouring ones share their texels.

    Args:
        texel_density: (F,) wanted texels per metre, 0 for unseen faces.
        size: side of the atlas in texels.

    Returns:
        (F, 3, 2) float32 per corner in [0, 1]; all corners of degenerate faces at 0.
    """
    kept, areas = _faces_with_area(mesh)
    if len(kept) == 0:
        return np.zeros((len(mesh.faces), 3, 2), np.float32)
    wanted = _wanted_texels(areas, texel_density[kept])
    flat, chart = _charts(mesh, kept, wanted * (EXPECTED_FILL * size**2 / wanted.sum()), size)
    return _placed(mesh, kept, pack(flat.corners, chart, size) / size)


def build_even_atlas(
    mesh: Mesh, shown: NDArray[np.bool_], density: float, most: int
) -> tuple[NDArray[np.float32], int]:
    """UVs as by :func:`build_atlas` of one density, and the side of the smallest atlas found that holds them.

    Where one of ``most`` texels a side does not, that is filled at the density it holds. Unseen faces have
    :data:`UNSEEN_SHARE` of the density.

    Args:
        shown: (F,) faces that photos see.
        density: texels per metre.
    """
    kept, areas = _faces_with_area(mesh)
    seen = shown[kept] if shown[kept].any() else np.ones(len(kept), bool)
    wanted = areas * np.where(seen, density, 0.0) ** 2
    wanted[~seen] = _unseen_texels(areas[~seen], density, wanted.sum())
    if 0 < wanted.sum() < most**2:
        size = exact_side(np.sqrt(wanted.sum() / EXPECTED_FILL))
        flat, chart = _charts(mesh, kept, wanted, min(size, most))
        packed = pack_unscaled(flat.corners, chart, most)
        if packed is not None:
            placed, side = packed
            return _placed(mesh, kept, placed / side), side
    return build_atlas(mesh, np.where(shown, density, 0.0), most), most


def _faces_with_area(mesh: Mesh) -> tuple[IntArray, FloatArray]:
    """(k,) faces that are not degenerate, and their areas in m²."""
    areas = face_areas(mesh)
    kept = np.flatnonzero(areas > DEGENERATE_AREA)
    return kept, areas[kept]


def _placed(mesh: Mesh, kept: IntArray, corners: FloatArray) -> NDArray[np.float32]:
    """(F, 3, 2) UVs of all faces: ``corners`` (k, 3, 2) of those ``kept``, 0 of the others."""
    uv = np.zeros((len(mesh.faces), 3, 2), np.float32)
    uv[kept] = corners
    return uv


def _charts(mesh: Mesh, kept: IntArray, texels: FloatArray, size: int) -> tuple[_Flat, IntArray]:
    """The faces ``kept`` (k,) merged to charts, which are laid flat: those, in texels, and the (k,) chart of each face.

    Args:
        texels: (k,) that each face is to have.
        size: side of the atlas in texels.
    """
    corners = mesh.vertices[mesh.faces[kept]].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    faces = _Faces(corners, cross / (2 * areas[:, None]), areas, texels)
    pairs = edge_adjacency(Mesh(mesh.vertices, mesh.faces[kept]))
    chart = merge_faces(faces.corners, texels, pairs, stream(0, "textures.charts"))
    crowded = chart.max() >= size**2 * MOST_CHARTS
    if crowded:
        chart = pool_grains(chart, faces.corners, texels, size)
    flat = _flatten(faces, chart)
    for _ in range(0 if crowded else SPLIT_ROUNDS):
        lower = _overlaid(_side_by_side(flat, chart), flat.depth, chart, min(size, FINEST_CHECK))
        if not lower.any():
            break
        chart = _split(chart, lower, pairs)
        flat = _flatten(faces, chart)
    return flat, chart


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
    wanted[~seen] = _unseen_texels(areas[~seen], float(np.median(density[seen])), wanted.sum())
    return wanted


def _unseen_texels(areas: FloatArray, density: float, seen_texels: float) -> FloatArray:
    """(u,) texels of unseen faces, where seen ones have ``density`` and ``seen_texels`` in total."""
    unseen = areas * (UNSEEN_SHARE * density) ** 2
    return unseen * min(1.0, MOST_UNSEEN * seen_texels / max(unseen.sum(), 1e-300))


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


def _side_by_side(flat: _Flat, chart: IntArray) -> NDArray[np.float32]:
    """(F, 3, 2) UVs of charts that lie on shelves in the unit square: quicker than packing, and enough to compare."""
    shelf, start = shelves(flat.extent, float(np.sqrt(flat.extent.prod(1).sum())))
    height = np.zeros(int(shelf.max()) + 1)
    np.maximum.at(height, shelf, flat.extent[:, 1])
    corner = np.column_stack([start, (np.cumsum(height) - height)[shelf]])
    placed = flat.corners + corner[chart, None]
    return (placed / placed.max()).astype(np.float32)


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
