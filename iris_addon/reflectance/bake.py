"""Textures: albedo per pixel, fused over photos into texels.

``kd = (L - specular) / Ld`` at every pixel, with the irradiance interpolated from patches, so that the texture keeps
the photos' resolution and the shading stays out of it. Texels take a robust mean over photos, weighted by resolution,
angle and the precision of the byte behind each value, and hardly see pixels on an edge, which mix two surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..emission.balance import MAX_ALBEDO
from ..grouping import group_sums
from ..response.observations import MIXED_SAY

DIM = 0.05
"""Share of the median irradiance below which a quotient of radiance and irradiance is not worth much."""
HIGHLIGHT = 20.0
"""Inverse of the specular radiance, in irradiance / pi, from which on errors of the lobe outweigh all others."""
DIM_ALBEDO = 0.02
"""Added to albedo where it divides: relative differences of black surfaces are noise."""
OUTLIER = 0.25
"""Relative distance from a texel's mean at which a photo loses half its say."""


@dataclass(frozen=True)
class TexelAlbedo:
    """Albedo fused in the texels that some photo shows, unclipped in one channel at least.

    Attributes:
        texel: (T,) int64 flat index of each, ascending.
        value: (T, 3) float32; NaN where no photo shows the channel unclipped.
        weight: (T,) float32 total weight.
    """

    texel: NDArray[np.int64]
    value: NDArray[np.float32]
    weight: NDArray[np.float32]


def pixel_albedo(
    radiance: NDArray[np.floating],
    specular: NDArray[np.floating],
    ls0: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    metallic: NDArray[np.floating],
) -> NDArray[np.float32]:
    """(n, 3) base colour of each pixel: of the diffuse part for dielectrics, of the specular lobe for metals."""
    per_unit = np.where(metallic[:, None] > 0.5, ls0, irradiance)
    return np.clip((radiance - specular) / np.maximum(per_unit, 1e-5), 0.0, MAX_ALBEDO).astype(np.float32)


def pixel_weight(
    cosine: NDArray[np.floating],
    footprint: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    specular: NDArray[np.floating],
    mixed: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """(n, 3) say of a pixel: near and head-on it sees more, in the dark, under a highlight and on an edge less.

    An error of the irradiance or of the specular part is one of the albedo once divided by the irradiance.

    Args:
        irradiance: (n, 3) irradiance / pi.
        specular: (n, 3) radiance taken off the pixel's.
        mixed: (n,) pixels on an edge.
    """
    near = np.median(footprint) / np.maximum(footprint, 1e-6)
    lit = irradiance / (irradiance + DIM * np.median(irradiance))
    highlight = HIGHLIGHT * specular.mean(1) / np.maximum(irradiance.mean(1), 1e-6)
    sharp = cosine**2 * np.clip(near, 0.05, 20.0) ** 2 * np.where(mixed, np.float32(MIXED_SAY), 1)
    return ((sharp / (1 + highlight**2))[:, None] * lit**2).astype(np.float32)


def fuse_texels(
    texel: NDArray[np.integer],
    value: NDArray[np.floating],
    weight: NDArray[np.floating],
    n_texels: int,
) -> TexelAlbedo:
    """Robust weighted mean per texel.

    Args:
        texel: (n,) flat texel index of each pixel.
        value: (n, 3) albedo.
        weight: (n, 3) say per channel; 0 where clipped.
    """
    reached = np.zeros(n_texels, bool)
    reached[texel[weight.any(1)]] = True
    texels = np.flatnonzero(reached)
    # The last row takes the pixels without a say in texels that no other reaches.
    row_of_texel = np.full(n_texels, len(texels), np.int32)
    row_of_texel[texels] = np.arange(len(texels), dtype=np.int32)
    row = row_of_texel[texel]

    def mean(w: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        norm = group_sums(w, row, len(texels) + 1)
        return group_sums(w * value, row, len(texels) + 1) / np.maximum(norm, 1e-12), norm

    first, norm = mean(weight)
    expected = first.astype(np.float32)[row]
    off = np.abs(value - expected).mean(1, keepdims=True) / (expected.mean(1, keepdims=True) + DIM_ALBEDO)
    fused, _ = mean(weight / (1 + (off / OUTLIER) ** 2))
    shown = np.where(norm > 0, fused, np.nan)[:-1].astype(np.float32)
    return TexelAlbedo(texels, shown, norm[:-1].max(1).astype(np.float32))
