"""Principled textures on the atlas, from base colour at pixels and gloss of regions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_medians, group_sums
from ..base.parallel import filled
from ..materials.gloss import Gloss
from ..model.recovered import Textures
from ..surface.primary_rays import PixelSamples
from .atlas import Atlas
from .bake import DIM_ALBEDO, PixelAlbedo, TexelAlbedo, complete_channels
from .coverage import smooth_coverage
from .fill import extend_texels, fill_texels
from .paint import Paint, find_paint, shared_paint
from .texel_points import TexelPoints

EXPECTED_WEIGHT = 0.02
"""Weight of the expected colour of a texel, in head-on pixels; a texel of less weight is uncertain."""
TEXTURED_SPREAD = 0.1
"""Relative spread of a region's texels from which on a texel is expected to be like its neighbours, not the region."""
EXTEND_TEXELS = 3
"""Distance, in texels, over which certain texels replace uncertain ones."""
FULL_CONFIDENCE_WEIGHT = 4.0
"""Weight of a texel, in head-on pixels, at which its confidence is 1."""


@dataclass(frozen=True)
class PaintedTexels:
    """Base colour of texels as photos show it, with the surface under them.

    Attributes:
        points: T texels.
        fused: base colour of those among them that a photo shows.
        light_error: (T,) standard deviation of the log irradiance that it was divided by.
        bounded: (T, 3) bool, channels that clip in a photo that is no doubtful one.
        measured: (T, 3) bool, channels that some photo shows unclipped.
    """

    points: TexelPoints
    fused: TexelAlbedo
    light_error: NDArray[np.floating]
    bounded: NDArray[np.bool_]
    measured: NDArray[np.bool_]


def make_textures(
    atlas: Atlas,
    regions: NDArray[np.int32],
    lamps: NDArray[np.bool_],
    gloss: Gloss,
    samples: PixelSamples,
    pixels: PixelAlbedo,
    texels: PaintedTexels,
    painted: NDArray[np.bool_],
) -> tuple[Textures, Paint]:
    """Make paint of one colour even, and fill what no photo shows.

    Args:
        regions: (F,) region of each face.
        lamps: (F,) bool, emitting faces; they reflect nothing.
        samples: the n pixels on the mesh.
        pixels: their base colour.
        texels: as photos show them.
        painted: (n_regions,) bool, regions that may be of one colour.

    Returns:
        The textures, and the paint of each region.
    """
    face, size, fused = atlas.face, atlas.size, texels.fused
    row = np.searchsorted(texels.points.texel, fused.texel)
    region, error = regions[texels.points.face[row]], texels.light_error[row]
    sure = fused.weight > EXPECTED_WEIGHT
    label = shared_paint(fused.value[sure], error[sure], region[sure], painted)
    kind = label[region]
    mean = _region_means(label[regions[samples.face]], pixels, len(painted)).astype(np.float32)
    seen = with_expected(fused, kind, mean, size)
    paint = find_paint(seen[sure], error[sure], kind[sure], painted).of_regions(label)
    evened, expected = paint.evened(seen, error, region), paint.colour(mean[label])[regions]
    # The last entry of each table is for texels without a face, -1.
    black = np.append(lamps, False)[face]
    base_color = _fill(fused.texel, evened, face, black, samples.seen_faces(len(regions)), expected)
    roughness = np.append(gloss.roughness[regions], 1.0).astype(np.float32)[face]
    metallic = np.append(gloss.metallic[regions], 0.0).astype(np.float32)[face]
    confidence = np.zeros((size, size), np.float32)
    confidence.flat[fused.texel] = np.clip(fused.weight / FULL_CONFIDENCE_WEIGHT, 0, 1)
    coverage = smooth_coverage(texels.points, confidence.flat[texels.points.texel], size)
    return Textures(base_color, roughness, metallic, confidence, coverage=coverage), paint


def _fill(
    texel: NDArray[np.integer],
    value: NDArray[np.float32],
    face: NDArray[np.int32],
    black: NDArray[np.bool_],
    seen_faces: NDArray[np.bool_],
    expected: NDArray[np.floating],
) -> NDArray[np.float32]:
    """(N, N, 3) base colour of all texels.

    Args:
        texel: (T,) flat index of the texels of ``value`` (T, 3). Faces that photos show in part are filled from these.
        face: (N, N) face under each texel, -1 for none.
        black: (N, N) bool, texels that reflect nothing; so do those of the gutter beside them.
        seen_faces: (F,) bool; other faces have the ``expected`` colour (F, 3).
    """
    known = np.zeros(face.shape, bool)
    known.flat[texel] = True
    base_color = np.zeros((*face.shape, 3), np.float32)
    base_color.reshape(-1, 3)[texel] = value
    known |= black
    base_color[black] = 0.0
    filled = fill_texels(base_color, known)
    unseen = np.append(~seen_faces, False)[face] & ~known
    filled[unseen] = expected[face[unseen]]
    return filled


def with_expected(
    fused: TexelAlbedo, region: NDArray[np.integer], region_mean: NDArray[np.float32], size: int
) -> NDArray[np.float32]:
    """(T, 3) fused texels, mixed with the expected colour where they are uncertain.

    That is where hardly any light falls, and on edges, where photos mix two surfaces. The expected colour is that of
    the region, as far as the region is of one colour, else that of the texels beside it.

    Args:
        region: (T,) region of each texel.
        region_mean: (n_regions, 3) mean base colour.
        size: side of the atlas in texels.
    """
    colour = region_mean[region]
    own = complete_channels(fused.value, region, region_mean)
    sure = fused.weight > EXPECTED_WEIGHT
    plain = _plain(own, colour, region, sure, len(region_mean))[region]
    beside, found = extend_texels(fused.texel, own, sure, region, size, EXTEND_TEXELS)

    def mixed(rows: slice) -> NDArray[np.float32]:
        blend = np.where(found[rows] & ~sure[rows], 1 - plain[rows], 0)[:, None]
        expected = colour[rows] + blend * (beside[rows] - colour[rows])
        weight = EXPECTED_WEIGHT * np.where(found[rows], 1, plain[rows])
        share = (weight / (fused.weight[rows] + weight))[:, None]
        return own[rows] + share * (expected - own[rows])

    return filled(np.empty_like(own), mixed)


def _plain(
    value: NDArray[np.float32],
    colour: NDArray[np.float32],
    region: NDArray[np.integer],
    sure: NDArray[np.bool_],
    n_regions: int,
) -> NDArray[np.float32]:
    """(n_regions,) 1 for regions of one colour, near 0 for textured ones.

    Args:
        value: (T, 3) base colour of texels.
        colour: (T, 3) mean colour of their region.
        sure: (T,) bool, texels that are certain.
    """
    rows = np.flatnonzero(sure)

    def off(block: slice) -> NDArray[np.float32]:
        v, c = value[rows[block]], colour[rows[block]]
        return np.abs(v - c).mean(1) / (c.mean(1) + DIM_ALBEDO)

    spread = group_medians(filled(np.empty(len(rows), value.dtype), off)[:, None], region[rows], n_regions)[:, 0]
    return (1 / (1 + (spread / TEXTURED_SPREAD) ** 4)).astype(np.float32)


def _region_means(region: NDArray[np.integer], pixels: PixelAlbedo, n_regions: int) -> NDArray[np.float64]:
    """(n_regions, 3) weighted mean base colour over the pixels of each region, labelled by ``region`` (n,); the overall
    mean for regions never seen."""
    norm = group_sums(pixels.weight, region, n_regions)
    total = group_sums(pixels.weight * pixels.value, region, n_regions)
    overall = total.sum(0) / np.maximum(norm.sum(0), 1e-9)
    return np.where(norm > 0, total / np.maximum(norm, 1e-12), overall)
