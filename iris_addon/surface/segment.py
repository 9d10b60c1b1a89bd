"""Connected surfaces split into parts: modelled ones along sharp edges, scans along edges of colour.

A room's shell is often one component, though its floor and its walls are of different materials: its large pieces
between sharp edges become parts of their own. A scan has no sharp edges. What a capture calls one part may be one
material or a whole room joined into an object: its pieces are parts as well, and that they were one is no more than a
hint that they shine alike (:mod:`iris_addon.reflectance.part_costs`).

Felzenszwalb & Huttenlocher's graph segmentation (IJCV 2004) on the faces of a component: neighbours join while the
step between them is no larger than the steps inside the regions they belong to. Shading changes slowly over a surface
and stays inside a region; albedo changes in steps and makes its border.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..capture.types import Mesh
from ..grouping import group_means
from .coplanar import joined_in_plane
from .parts import component_labels, pieces_between_edges, smooth_edges
from .samples import PixelSamples

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
"""Share of all pixels from which a piece between sharp edges is a part of its own."""


class Split(NamedTuple):
    """Faces in parts.

    Attributes:
        parts: (F,) part per face.
        scanned: (F,) faces of scans.
        given: (n_parts,) what of the capture's own parts each is a piece of; None if it brings none.
    """

    parts: NDArray[np.int32]
    scanned: NDArray[np.bool_]
    given: NDArray[np.int32] | None


def split_parts(
    mesh: Mesh,
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    z: NDArray[np.floating],
) -> Split:
    """Components, those of each of the capture's own parts where it brings some, the large ones split; without such,
    those that lie in one plane and look alike are one.

    Args:
        normals: (F, 3) unit.
        z: (n, 3) display values of the pixels.
    """
    components = component_labels(len(mesh.faces), *adjacency)
    scanned = scanned_faces(components, adjacency, normals, samples)
    if mesh.parts is None:
        pieces = components
    else:
        a, b = adjacency
        within = mesh.parts[a] == mesh.parts[b]
        pieces = component_labels(len(mesh.faces), a[within], b[within])
    parts = split_creases(pieces, adjacency, normals, samples, scanned)
    log_colour = np.log(group_means(z, samples.face, len(mesh.faces)) + DARK)
    if scanned.any():
        parts = split_scan(parts, adjacency, normals, samples, log_colour, scanned)
    if mesh.parts is None:
        parts = joined_in_plane(parts, mesh, normals, samples, log_colour, PIECE_SHARE)
        return Split(np.unique(parts, return_inverse=True)[1].astype(np.int32), scanned, None)
    given = np.empty(int(parts.max()) + 1, np.int32)
    given[parts] = mesh.parts
    return Split(parts, scanned, given)


def scanned_faces(
    parts: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
) -> NDArray[np.bool_]:
    """(F,) faces of components that were scanned: large in faces and in the photos, and nowhere flat."""
    size = np.bincount(parts)
    share = np.bincount(parts[samples.face], minlength=len(size)) / len(samples.face)
    edges_of = parts[adjacency[0]]
    flat = np.bincount(edges_of, smooth_edges(normals, adjacency, COPLANAR), len(size))
    rough = flat < SCAN_COPLANAR * np.bincount(edges_of, minlength=len(size))
    return ((size >= SCAN_FACES) & (share >= SCAN_SHARE) & rough)[parts]


def split_creases(
    parts: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) parts with the large pieces between sharp edges apart; what is left of a part, or ``scanned``, stays one."""
    piece = pieces_between_edges(normals, adjacency, parts)
    pixels = np.bincount(piece[samples.face], minlength=int(piece.max()) + 1)
    large = pixels >= PIECE_SHARE * len(samples.face)
    label = np.where(large[piece] & ~scanned, len(parts) + piece, parts)
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def split_scan(
    parts: NDArray[np.int32],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    normals: NDArray[np.floating],
    samples: PixelSamples,
    log_colour: NDArray[np.floating],
    scanned: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) parts with those of ``scanned`` (F,) faces split; modelled objects stay as they are.

    Args:
        parts: (F,) part of each face.
        normals: (F, 3) unit.
        log_colour: (F, 3) log display value of each face that photos show.
    """
    n_faces = len(parts)
    seen = samples.seen_faces(n_faces)
    a, b = adjacency
    inside = scanned[a] & scanned[b] & (parts[a] == parts[b])
    a, b = a[inside], b[inside]
    step = np.abs(log_colour[a] - log_colour[b]).max(1) + 0.3 * (1 - np.abs((normals[a] * normals[b]).sum(1)))
    step[~(seen[a] & seen[b])] = UNSEEN_STEP
    label = _merge(n_faces, a, b, step)
    # Labels of scans go behind those of the other parts.
    label = np.where(scanned, int(parts.max()) + 1 + label, parts)
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
