"""Topology of a mesh: which faces share an edge, which edges are sharp, and connected components."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..model.capture import Mesh

CREASE_COSINE = 0.8
"""Cosine between the normals of neighbours below which their edge is sharp."""
ROUNDED_RADIUS, ROUNDED_MIN_TURN = 0.03, np.radians(5)
"""Radius in metres up to which an edge counts as rounded off, and the turn in radians from one face to the next that is
a step of it at least (docs/experiments/0124)."""
WELD_STEPS = 1_000_000
"""Resolution at which vertices are welded, steps per size of the mesh; three such numbers fit into 64 bits."""


def weld(mesh: Mesh) -> NDArray[np.int64]:
    """(V,) label of each vertex, equal for vertices at the same place up to 1e-6 of the size of the mesh."""
    used = mesh.vertices[np.unique(mesh.faces)]
    low, extent = used.min(0), float(np.ptp(used, axis=0).max())
    steps = np.clip(np.round((mesh.vertices - low) * (WELD_STEPS / extent)), 0, WELD_STEPS).astype(np.int64)
    _, label = np.unique(steps[:, 0] << 40 | steps[:, 1] << 20 | steps[:, 2], return_inverse=True)
    return label


def edge_adjacency(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of faces that share an edge of the welded mesh, two (n,); an edge of k faces gives a chain of k - 1."""
    corner = weld(mesh)[mesh.faces]
    edges = np.sort(np.stack([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]], 1).reshape(-1, 2), axis=1)
    face = np.repeat(np.arange(len(mesh.faces)), 3)
    key = edges[:, 0] * (corner.max() + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    same = (key[order][1:] == key[order][:-1]) & (edges[order][1:, 0] != edges[order][1:, 1])
    return face[order][:-1][same], face[order][1:][same]


def component_labels(n_faces: int, a: NDArray[np.integer], b: NDArray[np.integer]) -> NDArray[np.int32]:
    """(n_faces,) connected component of each face; faces ``a`` (n,) and ``b`` (n,) are linked pair by pair."""
    graph = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(n_faces, n_faces))
    return connected_components(graph, directed=False)[1].astype(np.int32)


def smooth_edges(
    normals: NDArray[np.floating],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    cosine: float = CREASE_COSINE,
) -> NDArray[np.bool_]:
    """(n,) whether the normals (F, 3) of each pair of neighbours differ by less than the angle of ``cosine``."""
    a, b = adjacency
    return np.abs((normals[a] * normals[b]).sum(1)) > cosine


def rounded_edges(
    mesh: Mesh, normals: NDArray[np.floating], adjacency: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> NDArray[np.bool_]:
    """(n,) whether the surface turns between each pair of neighbours as if an edge were rounded off there.

    Modellers bevel the edges of walls and furniture by millimetres, in steps that are not sharp themselves. Which way
    faces are wound does not matter.

    Args:
        normals: (F, 3) unit.
    """
    a, b = adjacency
    cosine = (normals[a] * normals[b]).sum(1)
    turn = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    across = np.where(cosine[:, None] < 0, -1.0, 1.0) * normals[b] - normals[a]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    centre = mesh.vertices[mesh.faces].mean(1)
    # The middle of a step lies halfway across it, the centre of a triangle of it a third of the way.
    step = 1.5 * np.abs(((centre[b] - centre[a]) * across).sum(1))
    return (turn > ROUNDED_MIN_TURN) & (turn > step / ROUNDED_RADIUS)


def smooth_components(
    normals: NDArray[np.floating],
    adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
    group: NDArray[np.integer] | NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(F,) connected component of each face once the mesh is cut along its sharp edges.

    Args:
        normals: (F, 3) unit.
        adjacency: pairs of faces that share an edge, see :func:`edge_adjacency`.
        group: (F,) label that all faces of a component share.
    """
    a, b = adjacency
    joined = smooth_edges(normals, adjacency) & (group[a] == group[b])
    return component_labels(len(normals), a[joined], b[joined])


def initial_regions(mesh: Mesh) -> NDArray[np.int32]:
    """(F,) region of each face before any is split: the mesh file's own, else connected components."""
    return mesh.regions if mesh.regions is not None else component_labels(len(mesh.faces), *edge_adjacency(mesh))
