"""How fine texels are: as many as the pixels of the photos resolve, or as are asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..capture.mesh_files import face_areas
from ..model.capture import Mesh
from ..model.texture_size import LARGEST_SIDE, AskedSize, blender_bytes, in_blender
from ..surface.primary_rays import PixelSamples
from .atlas import Atlas, plane_areas

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
EXACT_SIDE_STEP = 4
"""The same where a density is asked for, which a coarser step would miss in small rooms."""
EXACT_MIN_SIDE = 64
"""Side of the smallest atlas that a density gives."""
DENSITY_REACHED = 0.95
"""Share of the density asked for from which on it counts as reached."""


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


def side_for_density(mesh: Mesh, shown: NDArray[np.bool_], density: float) -> int:
    """Side of the mesh's own atlas at which the faces ``shown`` (F,) have a mean of ``density`` texels per metre."""
    return exact_side(density / max(mean_density(mesh, shown, 1), 1e-9))


def exact_side(side: float) -> int:
    """The side of an atlas in whole steps that is next to ``side``."""
    return max(EXACT_MIN_SIDE, EXACT_SIDE_STEP * round(min(side, 1e9) / EXACT_SIDE_STEP))


def describe_atlas(mesh: Mesh, atlas: Atlas, samples: PixelSamples, patterned: bool = False) -> dict[str, Any]:
    """What report.json says of an atlas: its side, the mean density of what photos see, and its bytes in Blender, with
    those of a pattern of lamps where the result is ``patterned``."""
    density = mean_density(mesh, samples.seen_faces(len(mesh.faces)), atlas.size)
    return {
        "side": atlas.size,
        "texels_per_metre": round(density, 2),
        "bytes_in_blender": blender_bytes(atlas.size, patterned),
    }


def density_warnings(reached: dict[str, Any], asked: AskedSize) -> list[str]:
    """A warning that the atlas does not hold the density that was asked for, or none.

    Args:
        reached: of :func:`describe_atlas`.
    """
    side, density = reached["side"], reached["texels_per_metre"]
    if asked.density is None or density >= DENSITY_REACHED * asked.density or side < asked.most:
        return []
    needed = 2 ** int(np.ceil(np.log2(side * asked.density / max(density, 1e-9) / DENSITY_REACHED)))
    if needed <= LARGEST_SIDE:
        fix = f"an atlas size of {needed} holds more ({in_blender(needed)} in Blender)"
    else:
        fix = "ask for fewer"
    return [
        f"the textures have {density:.3g} texels per metre and not the {asked.density:g} asked for, because the atlas "
        f"may have {side} texels a side at most: {fix}"
    ]


def mean_density(mesh: Mesh, shown: NDArray[np.bool_], side: int) -> float:
    """Texels per metre of the faces ``shown`` (F,): the root of their texels, in an atlas of ``side``, over their area.

    Args:
        mesh: with its texture coordinates.
    """
    if mesh.uv is None:
        raise ValueError("the mesh has no texture coordinates")
    shown = shown if shown.any() else np.ones(len(mesh.faces), bool)
    texels = float(plane_areas(mesh.uv[shown].astype(np.float64)).sum()) * side**2
    area = float(face_areas(mesh)[shown].sum())
    return float(np.sqrt(texels / area)) if area > 0 else 0.0
