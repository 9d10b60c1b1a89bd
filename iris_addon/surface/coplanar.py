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
    n, corners = int(parts.max()) + 1, mesh.vertices[mesh.faces]
    pixels = np.bincount(samples.face, minlength=len(parts))
    share = np.bincount(parts, pixels, n) / len(samples.face)
    mean_normal = group_means(np.asarray(normals, np.float64), parts, n)
    middle = corners.mean(1)
    height = np.einsum("fk,fk->f", middle, mean_normal[parts])
    mean_height = group_means(height[:, None], parts, n)[:, 0]
    flat = np.linalg.norm(mean_normal, axis=1) > FLAT
    flat &= np.bincount(parts, np.abs(height - mean_height[parts]) > OFFSET, n) == 0
    label = np.arange(n, dtype=np.int32)
    for large in np.flatnonzero(flat & (share >= least_share)):
        in_plane = (
            flat & (np.abs(mean_height - mean_height[large]) < OFFSET) & (mean_normal @ mean_normal[large] > FLAT)
        )
        for small in np.flatnonzero(in_plane & (share > 0) & (share < share[large])):
            here, there = (np.flatnonzero((parts == part) & (pixels > 0)) for part in (small, large))
            distance, nearest = cKDTree(middle[there]).query(middle[here])
            border = np.argsort(distance, kind="stable")[:BORDER]
            step = np.abs(log_colour[here[border]] - log_colour[there[nearest[border]]]).max(1)
            if distance.min() < GAP and np.median(step) < STEP:
                label[small] = label[large]
    return label[parts]
