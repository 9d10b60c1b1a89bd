"""Triangle meshes cut finer and coarser, with the old face of every new one. For sweeps and scaling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from iris_addon.model.capture import Mesh

FaceMap = NDArray[np.int64]


def with_geometry(mesh: Mesh, vertices: NDArray[np.float64], faces: NDArray[np.int64], old: FaceMap) -> Mesh:
    """``mesh`` with other triangles and the regions of the ``old`` faces (n,) they come from; UVs are dropped."""
    regions = None if mesh.regions is None else mesh.regions[old]
    return replace(mesh, vertices=vertices, faces=faces, uv=None, regions=regions)


def subdivide_edges(mesh: Mesh, longest: float) -> tuple[Mesh, FaceMap]:
    """Halve every edge longer than ``longest`` metres until there is none; neighbours stay joined edge to edge.

    A face with one, two or three long edges becomes two, three or four (red-green refinement). Whether an edge is cut
    depends on the edge alone, so no gap or T-junction appears.

    Returns:
        The mesh, faces in the order of the old ones, and the old face of each new one.
    """
    vertices, faces, old = mesh.vertices, mesh.faces, np.arange(len(mesh.faces))
    while True:
        ends = vertices[faces]
        long = np.linalg.norm(np.roll(ends, -1, axis=1) - ends, axis=2) > longest
        if not long.any():
            return with_geometry(mesh, vertices, faces, old), old
        edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], -1)[long], axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = np.full(faces.shape, -1, np.int64)
        middle[long] = len(vertices) + which.ravel()
        vertices = np.concatenate([vertices, vertices[unique].mean(1)])
        refined, parents = _refine(faces, middle)
        order = np.argsort(parents, kind="stable")
        faces, old = refined[order], old[parents[order]]


def _refine(faces: NDArray[np.int64], middle: NDArray[np.int64]) -> tuple[NDArray[np.int64], FaceMap]:
    """Faces cut at ``middle`` (n, 3), the vertex inside edge k, k + 1 or -1; and the parent of each triangle."""
    cuts = (middle >= 0).sum(1)
    # Turn each face so that its cut edges come first.
    first = np.where(cuts == 1, (middle >= 0).argmax(1), np.where(cuts == 2, ((middle < 0).argmax(1) + 1) % 3, 0))
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, 1).T
    ab, bc, ca = np.take_along_axis(middle, turn, 1).T
    templates = {
        0: [(a, b, c)],
        1: [(a, ab, c), (ab, b, c)],
        2: [(ab, b, bc), (a, ab, bc), (a, bc, c)],
        3: [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)],
    }
    refined, parents = [], []
    for count, triangles in templates.items():
        rows = np.flatnonzero(cuts == count)
        for triangle in triangles:
            refined.append(np.stack([corner[rows] for corner in triangle], 1))
            parents.append(rows)
    return np.concatenate(refined), np.concatenate(parents)


def cluster(mesh: Mesh, cell: float, keep: NDArray[np.bool_]) -> tuple[Mesh, FaceMap]:
    """Merge the vertices of each cubic ``cell`` (metres) into their mean and drop the faces that collapse.

    Args:
        keep: (F,) faces whose vertices stay as they are.
    """
    free = np.ones(len(mesh.vertices), bool)
    free[mesh.faces[keep]] = False
    _, label = np.unique(np.floor(mesh.vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    label = np.where(free, label.ravel(), label.max() + 1 + np.arange(len(free)))
    _, label = np.unique(label, return_inverse=True)
    count = np.bincount(label)
    means = np.stack([np.bincount(label, mesh.vertices[:, k]) / count for k in range(3)], -1)
    faces = label[mesh.faces]
    left = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    old = np.flatnonzero(left | keep)
    return with_geometry(mesh, means, faces[old], old), old


def select(mesh: Mesh, kept: NDArray[np.bool_]) -> tuple[Mesh, FaceMap]:
    """The faces ``kept`` (F,) alone."""
    old = np.flatnonzero(kept)
    return with_geometry(mesh, mesh.vertices, mesh.faces[old], old), old
