"""Connected surfaces split into regions: modelled ones along sharp edges, scans along edges of colour.

A room's shell is often one component, though its floor and its walls are of different materials: its large pieces
between sharp edges become regions of their own. A scan has no sharp edges. What a capture calls one region may be one
material or a whole room joined into an object: its pieces are regions as well, and that they were one is no more than a
hint that they shine alike (:mod:`iris_addon.materials.gloss`).

Felzenszwalb & Huttenlocher's graph segmentation (IJCV 2004) on the faces of a component: neighbours join while the
step between them is no larger than the steps inside the regions they belong to. Shading changes slowly over a surface
and stays inside a region; albedo changes in steps and makes its border.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.group_by import group_equal, group_means, group_medians, group_sums
from ..model.capture import Mesh
from .primary_rays import PixelSamples
from .topology import component_labels, smooth_components, smooth_edges

SCAN_FACES = 20_000
"""A component with so many faces and so large a share of the pixels is a scan, not a modelled object."""
SCAN_SHARE = 0.3
COPLANAR, SCAN_COPLANAR = 0.9999, 0.5
"""Cosine between the normals of neighbours in one plane, and the share of such edges from which a component is
modelled, however many its faces are: a wall cut fine stays flat, a scanned one is rough."""
GRANULARITY = 0.6
"""Log-colour step times face count up to which a small region joins whatever it touches."""
MIN_FACES = 60
DARK = 0.03
"""Display value that is added before the logarithm is taken."""
UNSEEN_STEP = 0.15
PIECE_SHARE = 0.01
"""Share of all pixels from which a piece between sharp edges is a region of its own."""


class Regions(NamedTuple):
    """The faces of a mesh in regions, connected surfaces of one material.

    Attributes:
        of_face: (F,) int32 region of each face, 0 to n_regions - 1.
        scanned: (F,) bool, faces of scans.
        in_file: (n_regions,) int32 region of the mesh file that each lies in; None if the file names none.
    """

    of_face: NDArray[np.int32]
    scanned: NDArray[np.bool_]
    in_file: NDArray[np.int32] | None


def split_regions(
    mesh: Mesh,
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    z: NDArray[np.floating],
) -> Regions:
    """Components, those of each of the capture's own regions where it brings some, the large ones split; without such,
    those that lie in one plane and look alike are one.

    Args:
        normals: (F, 3) unit.
        z: (n, 3) display values of the pixels.
    """
    components = component_labels(len(mesh.faces), *adjacency)
    scanned = scanned_faces(components, adjacency, normals, samples)
    if mesh.regions is None:
        pieces = components
    else:
        a, b = adjacency
        within = mesh.regions[a] == mesh.regions[b]
        pieces = component_labels(len(mesh.faces), a[within], b[within])
    regions = split_creases(pieces, adjacency, normals, samples, scanned)
    log_colour = np.log(group_means(z, samples.face, len(mesh.faces)) + DARK)
    if scanned.any():
        regions = split_scan(regions, adjacency, normals, samples, log_colour, scanned)
    if mesh.regions is None:
        regions = joined_in_plane(regions, mesh, normals, samples, log_colour, PIECE_SHARE)
        return Regions(np.unique(regions, return_inverse=True)[1].astype(np.int32), scanned, None)
    in_file = np.empty(int(regions.max()) + 1, np.int32)
    in_file[regions] = mesh.regions
    return Regions(regions, scanned, in_file)


def scanned_faces(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
) -> NDArray[np.bool_]:
    """(F,) faces of components that were scanned: large in faces and in the photos, and nowhere flat."""
    size = np.bincount(regions)
    share = np.bincount(regions[samples.face], minlength=len(size)) / len(samples.face)
    edges_of = regions[adjacency[0]]
    flat = np.bincount(edges_of, smooth_edges(normals, adjacency, COPLANAR), len(size))
    rough = flat < SCAN_COPLANAR * np.bincount(edges_of, minlength=len(size))
    return ((size >= SCAN_FACES) & (share >= SCAN_SHARE) & rough)[regions]


def split_creases(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) regions with the large pieces between sharp edges apart; what is left of a region, or ``scanned``, stays
    one."""
    piece = smooth_components(normals, adjacency, regions)
    pixels = np.bincount(piece[samples.face], minlength=int(piece.max()) + 1)
    large = pixels >= PIECE_SHARE * len(samples.face)
    label = np.where(large[piece] & ~scanned, len(regions) + piece, regions)
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def split_scan(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    log_colour: NDArray[np.floating],
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) regions with those of ``scanned`` (F,) faces split; modelled objects stay as they are.

    Args:
        regions: (F,) part of each face.
        normals: (F, 3) unit.
        log_colour: (F, 3) log display value of each face that photos show.
    """
    n_faces = len(regions)
    seen = samples.seen_faces(n_faces)
    a, b = adjacency
    inside = scanned[a] & scanned[b] & (regions[a] == regions[b])
    a, b = a[inside], b[inside]
    step = np.abs(log_colour[a] - log_colour[b]).max(1) + 0.3 * (1 - np.abs((normals[a] * normals[b]).sum(1)))
    step[~(seen[a] & seen[b])] = UNSEEN_STEP
    label = _merge(n_faces, a, b, step)
    # Labels of scans go behind those of the other regions.
    label = np.where(scanned, int(regions.max()) + 1 + label, regions)
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def _merge(n: int, a: NDArray[np.int64], b: NDArray[np.int64], step: NDArray[np.floating]) -> NDArray[np.int64]:
    """Region of each of n nodes; edges in order of their step, then regions that stayed tiny."""
    parent = list(range(n))
    size = [1] * n
    threshold = [GRANULARITY] * n

    def find(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    def join(i: int, j: int) -> int:
        if size[i] < size[j]:
            i, j = j, i
        parent[j] = i
        size[i] += size[j]
        return i

    order = np.argsort(step, kind="stable")
    edges = list(zip(a[order].tolist(), b[order].tolist(), step[order].tolist(), strict=True))
    for i, j, weight in edges:
        i, j = find(i), find(j)
        if i != j and weight <= min(threshold[i], threshold[j]):
            root = join(i, j)
            threshold[root] = weight + GRANULARITY / size[root]
    for i, j, _ in edges:
        i, j = find(i), find(j)
        if i != j and min(size[i], size[j]) < MIN_FACES:
            join(i, j)
    return np.array([find(i) for i in range(n)])


# ---- Pieces of one plane that a gap keeps apart: a wall of which a scan lacks a strip, or that a door interrupts ----
#
# Colours of photos tell, before anything is known of the light: where two pieces come closest light is about the same.


COPLANAR_MAX_GAP = 0.5
"""Metres between pieces of one wall at most."""
OFFSET, FLAT = 1e-3, 0.9999
"""Metres between planes that are one, and the cosine between their normals."""
COPLANAR_MAX_STEP = 0.15
"""Step of log colour across a gap up to which both sides are alike: paint and what is left of shading."""
COPLANAR_BORDER = 20
"""Pairs of faces, the closest, that are compared."""


def joined_in_plane(
    regions: NDArray[np.int32],
    mesh: Mesh,
    normals: NDArray[np.floating],
    samples: PixelSamples,
    log_colour: NDArray[np.floating],
    least_share: float,
) -> NDArray[np.int32]:
    """(F,) regions with flat ones joined to larger ones of their plane that look alike across a gap.

    Args:
        regions: (F,) part of each face.
        normals: (F, 3) unit.
        log_colour: (F, 3) log display value of each face that photos show.
        least_share: of all pixels, that the larger one of the two must have.
    """
    n = int(regions.max()) + 1
    pixels = np.bincount(samples.face, minlength=len(regions))
    share = np.bincount(regions, pixels, n) / len(samples.face)
    middle = mesh.vertices[mesh.faces].mean(1)
    normal, height, flat = _planes(regions, middle, normals, n)
    seen = np.flatnonzero(pixels > 0)
    seen = seen[np.argsort(regions[seen], kind="stable")]
    start = np.searchsorted(regions[seen], np.arange(n + 1))
    label = np.arange(n, dtype=np.int32)
    for large in np.argsort(-share, kind="stable")[: (share >= least_share).sum()]:
        in_plane = flat & flat[large] & (normal @ normal[large] > FLAT) & (np.abs(height - height[large]) < OFFSET)
        pieces = np.flatnonzero(in_plane & (share > 0) & (share < share[large]))
        if not len(pieces):
            continue
        there = seen[start[large] : start[large + 1]]
        wall = cKDTree(middle[there])
        for piece in pieces:
            here = seen[start[piece] : start[piece + 1]]
            distance, nearest = wall.query(middle[here], distance_upper_bound=COPLANAR_MAX_GAP)
            border = np.argsort(distance, kind="stable")[: min(COPLANAR_BORDER, np.isfinite(distance).sum())]
            step = np.abs(log_colour[here[border]] - log_colour[there[nearest[border]]]).max(1)
            if len(border) and np.median(step) < COPLANAR_MAX_STEP:
                label[piece] = label[large]
    return label[regions]


def _planes(
    regions: NDArray[np.int32], middle: NDArray[np.floating], normals: NDArray[np.floating], n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Mean normal (n, 3) of each of ``n`` regions, its distance (n,) from the origin along it, and whether it is flat.

    Args:
        middle: (F, 3) of each face.
    """
    normal = group_means(np.asarray(normals, np.float64), regions, n)
    height = np.einsum("fk,fk->f", middle, normal[regions])
    mean_height = group_means(height[:, None], regions, n)[:, 0]
    flat = np.linalg.norm(normal, axis=1) > FLAT
    flat &= np.bincount(regions, np.abs(height - mean_height[regions]) > OFFSET, n) == 0
    return normal, mean_height, flat


# ---- Regions of a scan that are one material after all --------------------------------------------------------------
#
# A scan is split where the colour of its photos steps (:mod:`iris_addon.surface.regions`), before anything is known of
# the light: the edge of a shadow or of a highlight splits a cupboard's front as well as the edge of its paint does.
# Once light is divided out, what is left on both sides of such a border is the same.


REJOIN_MAX_STEP = 0.06
"""Step of log albedo across a border up to which both sides are one material."""
APART = 0.25
"""Difference of mean log albedo at which they are not, however small the steps on the way."""
MIN_BORDER = 5
"""Edges of the mesh that a border must have to tell."""


def joined_regions(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    log_albedo: NDArray[np.float64],
    pixels: NDArray[np.integer],
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(n_regions,) material of each region: the same label for regions of a scan across whose borders albedo takes no
    step.

    Args:
        regions: (F,) part per face.
        log_albedo: (F, 3) of each face, where it has ``pixels`` (F,).
        scanned: (F,) faces of a scan; the regions of all others stay apart.
    """
    n = int(regions.max()) + 1
    a, b = adjacency
    told = scanned & (pixels > 0)
    border = told[a] & told[b] & (regions[a] != regions[b])
    a, b = a[border], b[border]
    swap = regions[a] > regions[b]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    groups = group_equal(regions[a].astype(np.int64) * n + regions[b])
    step = np.abs(group_medians(log_albedo[a] - log_albedo[b], groups.group, len(groups.keys))).max(1)
    step[groups.count < MIN_BORDER] = np.inf
    weight = np.where(told, pixels, 0)[:, None].astype(np.float64)
    total, sums = (
        group_sums(weight, regions, n),
        group_sums(weight * np.where(told[:, None], log_albedo, 0.0), regions, n),
    )
    label = np.arange(n, dtype=np.int32)
    for k in np.argsort(step, kind="stable"):
        if step[k] > REJOIN_MAX_STEP:
            break
        one, other = label[groups.keys[k] // n], label[groups.keys[k] % n]
        if one != other and np.abs(sums[one] / total[one] - sums[other] / total[other]).max() < APART:
            sums[one] += sums[other]
            total[one] += total[other]
            label[label == other] = one
    return label
