"""Regions: the faces of a mesh divided into connected surfaces of one material.

:func:`split_regions` works before anything is known of the light. It starts from connected components, within the
regions of the mesh file where it names any; a file's region may be one material or a whole room joined into an object,
so that it is only a hint that surfaces have one gloss (:mod:`iris_addon.materials.gloss`). Then

- large components of a modelled surface between edges, sharp or rounded off, become regions: the shell of a room is
  often one component, though its floor and its walls are of different materials (:func:`split_creases`);
- scans are split between the planes and smooth pieces of their surface, and along edges of colour
  (:func:`split_scan`).

Once the light is about known, :func:`joined_regions` finds regions of a scan that a shadow or a highlight split.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_equal, group_means, group_medians, group_sums
from ..model.capture import Mesh
from .primary_rays import PixelSamples
from .scan_surface import ScanSurface
from .topology import ROUNDED_RADIUS, component_labels, rounded_edges, smooth_components, smooth_edges

REGION_MIN_SHARE = 0.01
"""Share of all pixels from which on a component between edges is a region of its own."""
COLOUR_FLOOR = 0.03
"""Display value added before the logarithm of a colour is taken."""
SCAN_GRANULARITY = 0.6
"""Log-colour step times face count up to which a small region of a scan joins a neighbour."""
SCAN_MIN_REGION = 60
"""Faces of a region of a scan, below which it joins a neighbour at any step."""
SCAN_UNSEEN_STEP = 0.15
"""Log-colour step assumed between faces of a scan that no photo shows."""
SCAN_CREASE_STEP = 1.0
"""Log-colour step that the border between two pieces of the surface counts as."""
REJOIN_STEP = 0.06
"""Standard deviation of the step of log albedo across a border inside one material without texture."""
REJOIN_DIFFERENCE = 0.25
"""Standard deviation of the difference of mean log albedo inside one: light is wrong by as much from end to end."""
REJOIN_TEXTURE = 1.0
"""Share of the texture of either side in both: planks of a floor differ as much as the grain of each does."""
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

    @property
    def scans(self) -> NDArray[np.bool_] | None:
        """(n_regions,) regions of scans; None without a scan."""
        if not self.scanned.any():
            return None
        of_region = np.zeros(int(self.of_face.max()) + 1, bool)
        of_region[self.of_face[self.scanned]] = True
        return of_region


def split_regions(
    mesh: Mesh,
    surface: ScanSurface,
    samples: PixelSamples,
    z: NDArray[np.floating],
) -> Regions:
    """Divide the faces of ``mesh`` into regions, before anything is known of the light.

    Args:
        surface: behind the mesh.
        samples: the n pixels on the mesh.
        z: (n, 3) display values of the pixels.
    """
    adjacency, normals, scanned = surface.adjacency, surface.normals, surface.scanned
    regions = component_labels(len(mesh.faces), *adjacency)
    if mesh.regions is not None:
        a, b = adjacency
        within = mesh.regions[a] == mesh.regions[b]
        regions = component_labels(len(mesh.faces), a[within], b[within])
    regions = split_creases(regions, mesh, adjacency, normals, samples, scanned)
    if scanned.any():
        log_colour = np.log(group_means(z, samples.face, len(mesh.faces)) + COLOUR_FLOOR)
        regions = split_scan(regions, surface, samples, log_colour)
    if mesh.regions is None:
        return Regions(regions, scanned, None)
    in_file = np.empty(int(regions.max()) + 1, np.int32)
    in_file[regions] = mesh.regions
    return Regions(regions, scanned, in_file)


def split_creases(
    regions: NDArray[np.int32],
    mesh: Mesh,
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) regions in which each large piece between edges is one; the rest of a region stays together.

    A piece between rounded edges has to be wider than those are: the sides of a slender pipe are no regions.

    Args:
        regions: (F,) region of each face.
        normals: (F, 3) unit.
        scanned: (F,) faces of scans, which are not split here.
    """
    n_faces = len(regions)
    smooth = smooth_components(normals, adjacency, regions)
    a, b = adjacency
    inside = smooth_edges(normals, adjacency) & (smooth[a] == smooth[b]) & ~scanned[a] & ~scanned[b]
    a, b = a[inside], b[inside]
    flat_edges = ~rounded_edges(mesh, normals, (a, b))
    flat = component_labels(n_faces, a[flat_edges], b[flat_edges])
    least = REGION_MIN_SHARE * len(samples.face)
    large = np.bincount(smooth[samples.face], minlength=int(smooth.max()) + 1) >= least
    label = np.where(large[smooth] & ~scanned, n_faces + smooth, regions)
    pixels = np.bincount(flat[samples.face], minlength=int(flat.max()) + 1)
    for piece in np.flatnonzero(pixels >= least):
        own = (flat == piece) & ~scanned
        if own.any() and _width(mesh, mesh.faces[own]) > 2 * ROUNDED_RADIUS:
            label[own] = 2 * n_faces + piece
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def _width(mesh: Mesh, faces: NDArray[np.integer]) -> float:
    """Metres: area of ``faces`` (n, 3) over their extent."""
    corners = mesh.vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    return float(area / max(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)), 1e-12))


def split_scan(
    regions: NDArray[np.int32],
    surface: ScanSurface,
    samples: PixelSamples,
    log_colour: NDArray[np.floating],
) -> NDArray[np.int32]:
    """(F,) regions with those of scans split between pieces of the surface and along edges of colour; modelled objects
    stay as they are.

    Graph segmentation after Felzenszwalb and Huttenlocher (IJCV 2004): neighbouring faces join while the step between
    them is no larger than the steps inside the regions they belong to. Shading changes slowly over a surface and stays
    inside a region; albedo changes in steps, which become borders.

    Args:
        regions: (F,) region of each face.
        log_colour: (F, 3) log display value of each face that photos show.
    """
    n_faces, scanned, piece = len(regions), surface.scanned, surface.pieces
    seen = samples.seen_faces(n_faces)
    a, b = surface.adjacency
    inside = scanned[a] & scanned[b] & (regions[a] == regions[b])
    a, b = a[inside], b[inside]
    step = np.abs(log_colour[a] - log_colour[b]).max(1)
    step[~(seen[a] & seen[b])] = SCAN_UNSEEN_STEP
    step += SCAN_CREASE_STEP * (piece[a] != piece[b])
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
    pieces: NDArray[np.int32],
) -> NDArray[np.int32]:
    """(n_regions,) material of each region: one label for regions of a scan that differ no more than each varies.

    A scan is split where the colour of its photos steps: at the edge of a shadow or highlight, and between the planks
    of a floor, as well as between paints. Once light is divided out, both sides of a shadow's edge are the same; and
    planks differ from each other as each does from end to end. Pairs of neighbours are joined in order of

        max(step² / (REJOIN_STEP² + texture²), difference² / (REJOIN_DIFFERENCE² + texture²))

    up to 1, the step being the median across their border and the texture that of both.

    Args:
        regions: (F,) region of each face.
        log_albedo: (F, 3) of each face that has ``pixels`` (F,).
        scanned: (F,) faces of a scan; the regions of all others stay apart.
        pieces: (F,) smooth piece of the surface of each face; regions of different pieces stay apart.
    """
    n = int(regions.max()) + 1
    known = scanned & (pixels > 0)
    weight = np.where(known, pixels, 0)[:, None].astype(np.float64)
    value = np.where(known[:, None], log_albedo, 0.0)
    moments = group_sums(np.concatenate([weight, weight * value, weight * value**2], 1), regions, n)
    a, b = adjacency
    piece = _most_common(regions, pieces)
    border = known[a] & known[b] & (regions[a] != regions[b]) & (piece[regions[a]] == piece[regions[b]])
    a, b = a[border], b[border]
    swap = regions[a] > regions[b]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    groups = group_equal(regions[a].astype(np.int64) * n + regions[b])
    step = group_medians(log_albedo[a] - log_albedo[b], groups.group, len(groups.keys))
    borders: list[dict[int, NDArray[np.float64]]] = [{} for _ in range(n)]
    for key, count, value in zip(groups.keys.tolist(), groups.count.tolist(), step, strict=True):
        if count >= REJOIN_MIN_BORDER:
            one, other = divmod(key, n)
            # The number of edges, and the step towards the other side times that number.
            borders[one][other] = np.append(count, count * value)
            borders[other][one] = np.append(count, -count * value)
    return _Joining(moments, borders).labels()


def _most_common(regions: NDArray[np.int32], pieces: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n_regions,) piece that most faces of each region lie on; a few may lie on another."""
    both = group_equal(regions.astype(np.int64) << 32 | pieces)
    order = np.argsort(both.count, kind="stable")
    piece = np.empty(int(regions.max()) + 1, np.int32)
    piece[both.keys[order] >> 32] = both.keys[order] & 0xFFFFFFFF  # the last of several stays
    return piece


class _Joining:
    """Agglomeration of n regions.

    Args:
        moments: (n, 7) weight of each, and weighted sums of its log albedo and of that squared.
        borders: per region, the neighbours and (4,) edges shared and the sum of their steps.
    """

    def __init__(self, moments: NDArray[np.float64], borders: list[dict[int, NDArray[np.float64]]]) -> None:
        self._moments, self._borders = moments.copy(), borders
        self._label = np.arange(len(moments), dtype=np.int32)
        self._version = [0] * len(moments)

    def labels(self) -> NDArray[np.int32]:
        """(n,) label of each region after the last pair that belongs together was joined."""
        queue: list[tuple[float, int, int, int, int]] = []
        for one, others in enumerate(self._borders):
            for other in others:
                if one < other:
                    self._propose(queue, one, other)
        while queue:
            _, one, other, version, version_of_other = heappop(queue)
            if (self._version[one], self._version[other]) == (version, version_of_other):
                self._join(one, other)
                for third in self._borders[one]:
                    self._propose(queue, min(one, third), max(one, third))
        while (self._label[self._label] != self._label).any():
            self._label = self._label[self._label]
        return self._label

    def _propose(self, queue: list[tuple[float, int, int, int, int]], one: int, other: int) -> None:
        """Put a pair on the ``queue`` if it is no further apart than it may be."""
        first, second = self._moments[one], self._moments[other]
        mean, mean_of_other = first[1:4] / first[0], second[1:4] / second[0]
        texture = (
            REJOIN_TEXTURE
            * 0.5
            * (np.maximum(first[4:] / first[0] - mean**2, 0) + np.maximum(second[4:] / second[0] - mean_of_other**2, 0))
        )
        edges = self._borders[one][other]
        step = (edges[1:] / edges[0]) ** 2 / (REJOIN_STEP**2 + texture)
        apart = (mean - mean_of_other) ** 2 / (REJOIN_DIFFERENCE**2 + texture)
        worst = float(max(step.max(), apart.max()))
        if worst <= 1:
            heappush(queue, (worst, one, other, self._version[one], self._version[other]))

    def _join(self, one: int, other: int) -> None:
        """Make ``other`` a part of ``one``."""
        self._label[other] = one
        self._moments[one] += self._moments[other]
        self._version[one] += 1
        self._version[other] = -1
        for third, edges in self._borders[other].items():
            del self._borders[third][other]
            if third != one:
                self._borders[one][third] = self._borders[one].get(third, 0) + edges
                self._borders[third][one] = self._borders[third].get(one, 0) + edges * np.array([1, -1, -1, -1])
        self._borders[other] = {}
