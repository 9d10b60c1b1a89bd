"""How fine texels are: as many as the pixels of the photos resolve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..capture.mesh_files import face_areas
from ..model.capture import Mesh
from .atlas import plane_areas

DENSITY_RANGE = 8.0
"""How far the density of a seen face may lie from the median, either way."""
TEXELS_PER_PIXEL = 1.1
"""Texels along a pixel of the nearest photos. In the bundled room 1.2 and 1.7 have the same errors, 0.8 has 0.2 dB
more, and time grows with the square."""
RESOLVED_FILL, RESOLVED_SHARE = 0.72, 0.9
"""Share of an atlas that charts of our own cover; and share of the pixels that texels of the mesh's own atlas must
resolve, whose density may differ from place to place."""
SIDE_STEP = 256
"""The side of an atlas that is smaller than allowed is a multiple of this many texels."""


def texel_density_from_footprint(
    face: NDArray[np.integer], footprint: NDArray[np.floating], n_faces: int
) -> NDArray[np.float64]:
    """(n_faces,) texels per metre that the photos can fill, 0 for unseen faces.

    One texel per pixel at the lower quartile of a face's footprints, within :data:`DENSITY_RANGE` of the median face.

    Args:
        face: (n,) face under each pixel.
        footprint: (n,) metres on the surface spanned by that pixel.
    """
    # One sort of 64-bit keys: positive floats order like their bits.
    keys = (face.astype(np.uint64) << np.uint64(32)) | footprint.astype(np.float32).view(np.uint32)
    keys.sort()
    bounds = np.searchsorted(keys >> np.uint64(32), np.arange(n_faces + 1, dtype=np.uint64))
    count = np.diff(bounds)
    seen = count > 0
    density = np.zeros(n_faces)
    if seen.any():
        quartile = keys[(bounds[:-1] + count // 4)[seen]] & np.uint64(0xFFFFFFFF)
        wanted = 1 / np.maximum(quartile.astype(np.uint32).view(np.float32), 1e-9)
        median = np.median(wanted)
        density[seen] = np.clip(wanted, median / DENSITY_RANGE, median * DENSITY_RANGE)
    return density


def resolved_side(mesh: Mesh, density: NDArray[np.floating]) -> int:
    """Side of an atlas of ``mesh`` in texels from which on finer ones would show no more.

    Args:
        density: (F,) pixels of the photos per metre, 0 for unseen faces.
    """
    pixels = face_areas(mesh) * density**2
    if mesh.uv is None:
        side = np.sqrt(pixels.sum() / RESOLVED_FILL)
    else:
        on_atlas = plane_areas(mesh.uv.astype(np.float64))
        shown = np.flatnonzero((pixels > 0) & (on_atlas > 0))
        sides = np.sqrt(pixels[shown] / on_atlas[shown])
        order = np.argsort(sides)
        enough = np.searchsorted(np.cumsum(pixels[shown][order]), RESOLVED_SHARE * pixels[shown].sum())
        side = sides[order[enough]] if len(shown) else 0.0
    return SIDE_STEP * max(1, int(np.ceil(TEXELS_PER_PIXEL * side / SIDE_STEP)))
