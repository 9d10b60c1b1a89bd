"""From pixels with an albedo to Principled textures on the atlas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..grouping import group_medians, group_sums
from ..parallel import filled
from ..result.types import Textures
from ..surface.atlas_texels import Atlas
from ..surface.samples import PixelSamples
from ..surface.texel_fill import extend_texels, fill_texels
from .alike import painted_alike
from .bake import DIM_ALBEDO, TexelAlbedo, fuse_texels
from .clipped_channels import complete_channels
from .gloss import Gloss
from .paint import Paint, find_paint

DOUBT = 0.02
"""Weight (in head-on pixels) that what is expected of a texel counts for."""
NEIGHBOUR_ERROR = 0.1
"""Relative spread of a part's texels from which a texel is more like those beside it than like the part's mean."""
REACH = 3
"""Texels over which good ones tell about doubtful ones."""
FULL_CONFIDENCE = 4.0
"""Weight (in head-on pixels) at which a texel counts as well seen."""


def make_textures(
    atlas: Atlas,
    parts: NDArray[np.int32],
    lamps: NDArray[np.bool_],
    gloss: Gloss,
    samples: PixelSamples,
    albedo: NDArray[np.floating],
    weight: NDArray[np.floating],
    light_error: NDArray[np.floating],
    painted: NDArray[np.bool_],
) -> tuple[Textures, NDArray[np.float32], Paint]:
    """Fuse pixels into texels, even out what is paint of one colour, fill what no photo saw.

    Args:
        atlas: with the texels of ``samples``.
        lamps: (F,) bool, emitting faces; they reflect nothing.
        albedo: (n, 3) base colour of each pixel.
        weight: (n, 3) say of each pixel and channel.
        light_error: (n,) standard deviation of the log irradiance at each pixel.
        painted: (n_parts,) bool, parts that may be of one colour.

    Returns:
        The textures, the fused base colour at every pixel (n, 3), and what each part is painted with.
    """
    face, texel, size = atlas.face, atlas.texel, atlas.size
    fused = fuse_texels(texel, albedo, weight, size * size)
    # By the pixels, not by the faces under texel centres: at a chart's border those lie beyond it.
    part, error = np.empty(size * size, np.int32), np.empty(size * size, np.float32)
    part[texel], error[texel] = parts[samples.face], light_error
    part, error, sure = part[fused.texel], error[fused.texel], fused.weight > DOUBT
    alike = painted_alike(fused.value[sure], error[sure], part[sure], painted)
    kind = alike[part]
    mean = _part_means(alike[parts[samples.face]], albedo, weight, len(painted)).astype(np.float32)
    seen = with_expected(fused, kind, mean, size)
    paint = find_paint(seen[sure], error[sure], kind[sure], painted).of_parts(alike)
    evened, expected = paint.evened(seen, error, part), paint.colour(mean[alike])[parts]
    base_color = _fill(fused.texel, evened, face, samples.seen_faces(len(parts)), expected)
    # A last entry stands for texels of no face, -1.
    base_color[np.append(lamps, False)[face]] = 0.0
    roughness = np.append(gloss.roughness[parts], 1.0).astype(np.float32)[face]
    metallic = np.append(gloss.metallic[parts], 0.0).astype(np.float32)[face]
    confidence = np.zeros((size, size), np.float32)
    confidence.flat[fused.texel] = np.clip(fused.weight / FULL_CONFIDENCE, 0, 1)
    textures = Textures(base_color, roughness, metallic, confidence)
    return textures, base_color.reshape(-1, 3)[texel], paint


def _fill(
    texel: NDArray[np.integer],
    value: NDArray[np.float32],
    face: NDArray[np.int32],
    seen_faces: NDArray[np.bool_],
    expected: NDArray[np.floating],
) -> NDArray[np.float32]:
    """(size, size, 3) base colour everywhere: ``value`` (T, 3) at ``texel`` (T,), faces seen in part filled from their
    own texels, faces never seen as is ``expected`` (F, 3) of them."""
    known = np.zeros(face.shape, bool)
    known.flat[texel] = True
    base_color = np.zeros((*face.shape, 3), np.float32)
    base_color.reshape(-1, 3)[texel] = value
    filled = fill_texels(base_color, known)
    unseen = np.append(~seen_faces, False)[face] & ~known
    filled[unseen] = expected[face[unseen]]
    return filled


def with_expected(
    fused: TexelAlbedo, part: NDArray[np.integer], part_mean: NDArray[np.float32], size: int
) -> NDArray[np.float32]:
    """(T, 3) fused texels, mixed with what is expected where they say little.

    That is where hardly any light falls, and on edges, where photos mix two surfaces. Expected is the colour of the
    part, as far as the part is of one colour, else that of the texels beside it.

    Args:
        part: (T,) part of each texel.
    """
    colour = part_mean[part]
    own = complete_channels(fused.value, part, part_mean)
    sure = fused.weight > DOUBT
    plain = _plain(own, colour, part, sure, len(part_mean))[part]
    beside, found = extend_texels(fused.texel, own, sure, part, size, REACH)

    def mixed(rows: slice) -> NDArray[np.float32]:
        blend = np.where(found[rows] & ~sure[rows], 1 - plain[rows], 0)[:, None]
        expected = colour[rows] + blend * (beside[rows] - colour[rows])
        doubt = DOUBT * np.where(found[rows], 1, plain[rows])
        share = (doubt / (fused.weight[rows] + doubt))[:, None]
        return own[rows] + share * (expected - own[rows])

    return filled(np.empty_like(own), mixed)


def _plain(
    value: NDArray[np.float32],
    colour: NDArray[np.float32],
    part: NDArray[np.integer],
    sure: NDArray[np.bool_],
    n_parts: int,
) -> NDArray[np.float32]:
    """(n_parts,) 1 for parts whose texels are of one colour, near 0 for textured ones."""
    rows = np.flatnonzero(sure)

    def off(block: slice) -> NDArray[np.float32]:
        v, c = value[rows[block]], colour[rows[block]]
        return np.abs(v - c).mean(1) / (c.mean(1) + DIM_ALBEDO)

    spread = group_medians(filled(np.empty(len(rows), value.dtype), off)[:, None], part[rows], n_parts)[:, 0]
    return (1 / (1 + (spread / NEIGHBOUR_ERROR) ** 4)).astype(np.float32)


def _part_means(
    part: NDArray[np.integer], albedo: NDArray[np.floating], weight: NDArray[np.floating], n_parts: int
) -> NDArray[np.float64]:
    """(n_parts, 3) weighted mean base colour; the overall mean for parts never seen."""
    norm = group_sums(weight, part, n_parts)
    total = group_sums(weight * albedo, part, n_parts)
    overall = total.sum(0) / np.maximum(norm.sum(0), 1e-9)
    return np.where(norm > 0, total / np.maximum(norm, 1e-12), overall)
