"""Pieces of one plane that a gap keeps apart: a wall of which a scan lacks a strip, or that a door interrupts.

Colours of photos tell, before anything is known of the light: where two pieces come closest light is about the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..capture.types import Mesh
from ..grouping import group_means
from .samples import PixelSamples

GAP = 0.5
"""Metres between pieces of one wall at most."""
OFFSET, FLAT = 1e-3, 0.9999
"""Metres between planes that are one, and the cosine between their normals."""
STEP = 0.15
"""Step of log colour across a gap up to which both sides are alike: paint and what is left of shading."""
BORDER = 20
"""Pairs of faces, the closest, that are compared."""


def joined_in_plane(
    parts: NDArray[np.int32],
    mesh: Mesh,
    normals: NDArray[np.floating],
    samples: PixelSamples,
    log_colour: NDArray[np.floating],
    least_share: float,
) -> NDArray[np.int32]:
    """(F,) parts with flat ones joined to larger ones of their plane that look alike across a gap.

    Args:
        parts: (F,) part of each face.
        normals: (F, 3) unit.
        log_colour: (F, 3) log display value of each face that photos show.
        least_share: of all pixels, that the larger one of the two must have.
    """
    n = int(parts.max()) + 1
    pixels = np.bincount(samples.face, minlength=len(parts))
    share = np.bincount(parts, pixels, n) / len(samples.face)
    middle = mesh.vertices[mesh.faces].mean(1)
    normal, height, flat = _planes(parts, middle, normals, n)
    seen = np.flatnonzero(pixels > 0)
    seen = seen[np.argsort(parts[seen], kind="stable")]
    start = np.searchsorted(parts[seen], np.arange(n + 1))
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
            distance, nearest = wall.query(middle[here], distance_upper_bound=GAP)
            border = np.argsort(distance, kind="stable")[: min(BORDER, np.isfinite(distance).sum())]
            step = np.abs(log_colour[here[border]] - log_colour[there[nearest[border]]]).max(1)
            if len(border) and np.median(step) < STEP:
                label[piece] = label[large]
    return label[parts]


def _planes(
    parts: NDArray[np.int32], middle: NDArray[np.floating], normals: NDArray[np.floating], n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Mean normal (n, 3) of each of ``n`` parts, its distance (n,) from the origin along it, and whether it is flat.

    Args:
        middle: (F, 3) of each face.
    """
    normal = group_means(np.asarray(normals, np.float64), parts, n)
    height = np.einsum("fk,fk->f", middle, normal[parts])
    mean_height = group_means(height[:, None], parts, n)[:, 0]
    flat = np.linalg.norm(normal, axis=1) > FLAT
    flat &= np.bincount(parts, np.abs(height - mean_height[parts]) > OFFSET, n) == 0
    return normal, mean_height, flat
