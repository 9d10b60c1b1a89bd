"""Regions: the faces of a mesh divided into connected surfaces of one material.

:func:`split_regions` works before anything is known of the light. It starts from connected components, within the
regions of the mesh file where it names any; a file's region may be one material or a whole room joined into an object,
so that it is only a hint that surfaces have one gloss (:mod:`iris_addon.materials.gloss`). Then

- large components of a modelled surface between sharp edges become regions: the shell of a room is often one
  component, though its floor and its walls are of different materials (:func:`split_creases`);
- scans, which have no sharp edges, are split along edges of colour (:func:`split_scan`).

Once the light is about known, :func:`joined_regions` finds regions of a scan that a shadow or a highlight split.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_equal, group_means, group_medians, group_sums
from ..model.capture import Mesh
from .primary_rays import PixelSamples
from .topology import component_labels, smooth_components, smooth_edges

FLAT_COSINE = 0.9999
"""Cosine between normals from which on they are those of one plane."""
REGION_MIN_SHARE = 0.01
"""Share of all pixels from which on a component between sharp edges is a region of its own."""
COLOUR_FLOOR = 0.03
"""Display value added before the logarithm of a colour is taken."""
SCAN_MIN_FACES = 20_000
"""Faces from which on a component may be a scan, not a modelled object."""
SCAN_MIN_SHARE = 0.3
"""Share of all pixels from which on a component may be a scan."""
SCAN_MAX_FLAT_EDGES = 0.5
"""Share of flat edges below which a component may be a scan: a modelled wall cut fine stays flat, a scanned one is
rough."""
SCAN_GRANULARITY = 0.6
"""Log-colour step times face count up to which a small region of a scan joins a neighbour."""
SCAN_MIN_REGION = 60
"""Faces of a region of a scan, below which it joins a neighbour at any step."""
SCAN_UNSEEN_STEP = 0.15
"""Log-colour step assumed between faces of a scan that no photo shows."""
SCAN_CREASE_STEP = 0.3
"""Log-colour step that a right angle between faces of a scan counts as."""
REJOIN_MAX_STEP = 0.06
"""Step of log albedo across a border up to which both sides are one material."""
REJOIN_MAX_DIFFERENCE = 0.25
"""Difference of mean log albedo below which regions are one material; small steps may add up to more."""
REJOIN_MIN_BORDER = 5
"""Edges of the mesh that a border must have for its step to count."""


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
    """Divide the faces of ``mesh`` into regions, before anything is known of the light.

    Args:
        adjacency: pairs of faces that share an edge, two (k,).
        normals: (F, 3) unit.
        samples: the n pixels on the mesh.
        z: (n, 3) display values of the pixels.
    """
    components = component_labels(len(mesh.faces), *adjacency)
    scanned = scanned_faces(components, adjacency, normals, samples)
    regions = components
    if mesh.regions is not None:
        a, b = adjacency
        within = mesh.regions[a] == mesh.regions[b]
        regions = component_labels(len(mesh.faces), a[within], b[within])
    regions = split_creases(regions, adjacency, normals, samples, scanned)
    if scanned.any():
        log_colour = np.log(group_means(z, samples.face, len(mesh.faces)) + COLOUR_FLOOR)
        regions = split_scan(regions, adjacency, normals, samples, log_colour, scanned)
    if mesh.regions is None:
        return Regions(regions, scanned, None)
    in_file = np.empty(int(regions.max()) + 1, np.int32)
    in_file[regions] = mesh.regions
    return Regions(regions, scanned, in_file)


def scanned_faces(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
) -> NDArray[np.bool_]:
    """(F,) faces of components that were scanned: many faces, a large share of the photos, and hardly a flat edge.

    Args:
        regions: (F,) connected component of each face.
        normals: (F, 3) unit.
    """
    size = np.bincount(regions)
    share = np.bincount(regions[samples.face], minlength=len(size)) / len(samples.face)
    edges_of = regions[adjacency[0]]
    flat = np.bincount(edges_of, smooth_edges(normals, adjacency, FLAT_COSINE), len(size))
    rough = flat < SCAN_MAX_FLAT_EDGES * np.bincount(edges_of, minlength=len(size))
    return ((size >= SCAN_MIN_FACES) & (share >= SCAN_MIN_SHARE) & rough)[regions]


def split_creases(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) regions in which each large component between sharp edges is one; the rest of a region stays together.

    Args:
        regions: (F,) region of each face.
        normals: (F, 3) unit.
        scanned: (F,) faces of scans, which are not split here.
    """
    component = smooth_components(normals, adjacency, regions)
    pixels = np.bincount(component[samples.face], minlength=int(component.max()) + 1)
    large = pixels >= REGION_MIN_SHARE * len(samples.face)
    label = np.where(large[component] & ~scanned, len(regions) + component, regions)
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def split_scan(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    log_colour: NDArray[np.floating],
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) regions with those of scans split along edges of colour; modelled objects stay as they are.

    Graph segmentation after Felzenszwalb and Huttenlocher (IJCV 2004): neighbouring faces join while the step between
    them is no larger than the steps inside the regions they belong to. Shading changes slowly over a surface and stays
    inside a region; albedo changes in steps, which become borders.

    Args:
        regions: (F,) region of each face.
        normals: (F, 3) unit.
        log_colour: (F, 3) log display value of each face that photos show.
        scanned: (F,) faces of scans.
    """
    n_faces = len(regions)
    seen = samples.seen_faces(n_faces)
    a, b = adjacency
    inside = scanned[a] & scanned[b] & (regions[a] == regions[b])
    a, b = a[inside], b[inside]
    step = np.abs(log_colour[a] - log_colour[b]).max(1) + SCAN_CREASE_STEP * (
        1 - np.abs((normals[a] * normals[b]).sum(1))
    )
    step[~(seen[a] & seen[b])] = SCAN_UNSEEN_STEP
    label = _merge(n_faces, a, b, step)
    # Labels of scans follow those of the other regions.
    label = np.where(scanned, int(regions.max()) + 1 + label, regions)
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def _merge(n: int, a: NDArray[np.int64], b: NDArray[np.int64], step: NDArray[np.floating]) -> NDArray[np.int64]:
    """(n,) region of each of ``n`` nodes that edges ``a``, ``b`` (k,) with a ``step`` (k,) link.

    Edges are taken in order of their step; regions that stay tiny then join a neighbour.
    """
    parent = list(range(n))
    size = [1] * n
    threshold = [SCAN_GRANULARITY] * n

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
            threshold[root] = weight + SCAN_GRANULARITY / size[root]
    for i, j, _ in edges:
        i, j = find(i), find(j)
        if i != j and min(size[i], size[j]) < SCAN_MIN_REGION:
            join(i, j)
    return np.array([find(i) for i in range(n)])


def joined_regions(
    regions: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    log_albedo: NDArray[np.float64],
    pixels: NDArray[np.integer],
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(n_regions,) material of each region: one label for regions of a scan across whose borders albedo has no step.

    A scan is split where the colour of its photos steps, at the edge of a shadow or highlight as well as at that of a
    paint. Once light is divided out, both sides of a shadow's edge are the same.

    Args:
        regions: (F,) region of each face.
        log_albedo: (F, 3) of each face that has ``pixels`` (F,).
        scanned: (F,) faces of a scan; the regions of all others stay apart.
    """
    n = int(regions.max()) + 1
    a, b = adjacency
    known = scanned & (pixels > 0)
    border = known[a] & known[b] & (regions[a] != regions[b])
    a, b = a[border], b[border]
    swap = regions[a] > regions[b]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    groups = group_equal(regions[a].astype(np.int64) * n + regions[b])
    step = np.abs(group_medians(log_albedo[a] - log_albedo[b], groups.group, len(groups.keys))).max(1)
    step[groups.count < REJOIN_MIN_BORDER] = np.inf
    weight = np.where(known, pixels, 0)[:, None].astype(np.float64)
    total, sums = (
        group_sums(weight, regions, n),
        group_sums(weight * np.where(known[:, None], log_albedo, 0.0), regions, n),
    )
    label = np.arange(n, dtype=np.int32)
    for k in np.argsort(step, kind="stable"):
        if step[k] > REJOIN_MAX_STEP:
            break
        one, other = label[groups.keys[k] // n], label[groups.keys[k] % n]
        if one != other and np.abs(sums[one] / total[one] - sums[other] / total[other]).max() < REJOIN_MAX_DIFFERENCE:
            sums[one] += sums[other]
            total[one] += total[other]
            label[label == other] = one
    return label
