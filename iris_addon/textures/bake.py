"""Albedo at pixels, fused over photos into texels.

At each pixel ``kd = (L - specular) / Ld``, with the irradiance interpolated from patches, so that the texture has the
resolution of the photos and no shading. Texels take a robust mean over photos, weighted by resolution, angle and the
precision of the byte behind each value; mixed pixels have almost no weight. Channels that clip in every photo are
completed from similar texels of the region (:func:`complete_channels`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_equal, group_medians
from ..lighting.balance import MAX_ALBEDO
from ..surface.primary_rays import PixelSamples

DIM_IRRADIANCE = 0.05
"""Irradiance, in medians, below which radiance over irradiance is unreliable."""
HIGHLIGHT_PRECISION = 20.0
"""Inverse of the specular radiance, per irradiance / pi, from which on errors of the lobe outweigh all others."""
MODELLED_EDGE_WEIGHT = 1e-5
"""Weight of a mixed pixel on a modelled surface: a texel that only such pixels show stays uncertain, however many."""
SCANNED_EDGE_WEIGHT = 0.05
"""Weight of a mixed pixel on a scan: outlines lie beside their place, so that many pixels count as mixed that show one
surface alone, and texels that no others show are certain by them (experiment 0112)."""
DIM_ALBEDO = 0.02
"""Added to albedo in denominators and logarithms: relative differences of black surfaces are noise."""
CHANNEL_MIN_SHARE = 0.01
"""Share of a texel's weight from which on a channel counts as seen; a byte of 0 in every photo gives less."""
OUTLIER_DISTANCE = 0.25
"""Relative distance from a texel's mean at which a photo loses half its weight."""
SIMILAR_STEPS = 3
"""Steps per octave of brightness, and of the balance of channels, within which texels are similar."""
SIMILAR_MIN_TEXELS = 10
"""Similar texels seen in all channels that a clipped channel is completed from, at least."""
SIMILAR_LEVELS = 32
"""Number of steps of brightness, and of balance around even."""
SIMILAR_FLOOR = 1e-3
"""Least value whose logarithm is taken."""
ALL_CHANNELS = 7
"""Bits of the three channels."""
KNOWN_CHANNELS: tuple[Sequence[int], ...] = (*combinations(range(3), 1), *combinations(range(3), 2))
"""Sets of channels from which the others can be completed."""


@dataclass(frozen=True)
class PixelAlbedo:
    """Base colour at the n pixels of all photos.

    Attributes:
        value: (n, 3) linear Rec.709, 0 to MAX_ALBEDO.
        weight: (n, 3) statistical weight of each channel, in units of the median one; 0 where clipped.
    """

    value: NDArray[np.floating]
    weight: NDArray[np.floating]


@dataclass(frozen=True)
class TexelAlbedo:
    """Base colour of the T texels that a photo shows neither clipped nor black, in one channel at least.

    Attributes:
        texel: (T,) int64 flat index of each, ascending.
        value: (T, 3) float32 linear Rec.709; NaN in channels that are clipped or black in all photos.
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
    """(n, 3) base colour of each pixel: of the diffuse part for dielectrics, of the specular lobe for metals.

    Args:
        radiance: (n, 3) seen, scene-linear Rec.709.
        specular: (n, 3) radiance to subtract from it.
        ls0: (n, 3) specular lobe of reflectance 1.
        irradiance: (n, 3) irradiance / pi, times the view factor of the diffuse lobe.
        metallic: (n,) 0 or 1.
    """
    per_unit = np.where(metallic[:, None] > 0.5, ls0, irradiance)
    return np.clip((radiance - specular) / np.maximum(per_unit, 1e-5), 0.0, MAX_ALBEDO).astype(np.float32)


@dataclass(frozen=True)
class UsualPixel:
    """Medians over the pixels of all photos.

    Attributes:
        footprint: metres.
        irradiance: over pi.
        weight: what :func:`pixel_weight` times the precision gives.
    """

    footprint: float
    irradiance: float
    weight: float = 1.0

    def at(self, zoom: float) -> UsualPixel:
        """The same of photos with ``zoom`` times as many rows and columns."""
        return replace(self, footprint=self.footprint / zoom)


def pixel_weight(
    samples: PixelSamples,
    irradiance: NDArray[np.floating],
    specular: NDArray[np.floating],
    mixed: NDArray[np.bool_],
    scanned: NDArray[np.bool_],
    usual: UsualPixel,
) -> NDArray[np.float32]:
    """(n, 3) weight of each pixel: larger close by and head-on, smaller in the dark, under a highlight and where mixed.

    Dividing by irradiance turns errors of irradiance and of the specular part into errors of albedo.

    Args:
        samples: the pixels.
        irradiance: (n, 3) irradiance / pi.
        specular: (n, 3) radiance subtracted from that of the pixel.
        mixed: (n,) bool, mixed pixels.
        scanned: (n,) bool, pixels on a scan, whose edges are edges of colour between surfaces in the same light.
    """
    resolution = usual.footprint / np.maximum(samples.footprint, 1e-6)
    lit = irradiance / (irradiance + DIM_IRRADIANCE * usual.irradiance)
    highlight = HIGHLIGHT_PRECISION * specular.mean(1) / np.maximum(irradiance.mean(1), 1e-6)
    edge = np.where(mixed, np.where(scanned, SCANNED_EDGE_WEIGHT, MODELLED_EDGE_WEIGHT), 1).astype(np.float32)
    sharp = samples.cosine**2 * np.clip(resolution, 0.05, 20.0) ** 2 * edge
    return ((sharp / (1 + highlight**2))[:, None] * lit**2).astype(np.float32)


# ---- channels that clip in every photo -----------------------------------------------------------------------------


def complete_channels(
    value: NDArray[np.floating], region: NDArray[np.integer], region_mean: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(T, 3) texels whose unknown channels are those of texels of their region that are similar in the known ones.

    Of the white of a rug in the sun only blue may be unclipped. Its red and green are those of texels as blue that were
    seen in the shade; the mean colour of the region would be that of the rug's red pattern too. It serves where similar
    texels are few.

    Args:
        value: (T, 3) base colour, NaN where clipped; one channel at least is known.
        region: (T,) region of each texel.
        region_mean: (n_regions, 3) base colour.
    """
    known = np.isfinite(value)
    code = (known * np.array([1, 2, 4], np.uint8)).sum(1, dtype=np.uint8)
    clipped = np.flatnonzero(code != ALL_CHANNELS)
    completed = value.astype(np.float32)
    completed[clipped] = _like_the_region(value[clipped], region_mean[region[clipped]])
    for channels in KNOWN_CHANNELS:
        rows = np.flatnonzero(code == sum(1 << c for c in channels))
        lacking = np.zeros(len(region_mean), bool)
        lacking[region[rows]] = True
        whole = np.flatnonzero((code == ALL_CHANNELS) & lacking[region])
        if len(whole):
            share, found = _share_of_similar(value[rows], region[rows], value[whole], region[whole], channels)
            guess = value[rows][:, channels].sum(1, keepdims=True) * share
            guess = np.where(known[rows], value[rows], np.minimum(guess, MAX_ALBEDO))
            completed[rows[found]] = guess[found]
    return completed


def _like_the_region(value: NDArray[np.floating], colour: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n, 3) texels completed by the ratio between the channels of ``colour`` (n, 3)."""
    known = np.isfinite(value)
    scale = np.where(known, value, 0.0).sum(1) / np.maximum((colour * known).sum(1), 1e-4)
    return np.where(known, value, np.clip(colour * scale[:, None], 0.0, MAX_ALBEDO))


def _share_of_similar(
    value: NDArray[np.floating],
    region: NDArray[np.integer],
    whole: NDArray[np.floating],
    region_of_whole: NDArray[np.integer],
    channels: Sequence[int],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Colour of the texels of a region that are similar in the ``channels``.

    Args:
        value: (n, 3) texels with unknown channels, of ``region`` (n,).
        whole: (w, 3) texels without, of ``region_of_whole`` (w,).

    Returns:
        (n, 3) median over the texels ``whole`` similar to each of ``value``, relative to their sum in the channels; and
        (n,) bool, whether there are enough of them.
    """
    groups, key = (
        group_equal(_similarity_key(value, region, channels)),
        _similarity_key(whole, region_of_whole, channels),
    )
    at = np.minimum(np.searchsorted(groups.keys, key), len(groups.keys) - 1)
    similar = np.flatnonzero(groups.keys[at] == key)
    group, colour = at[similar], whole[similar]
    share = colour / np.maximum(colour[:, channels].sum(1, keepdims=True), SIMILAR_FLOOR)
    median = group_medians(share, group, len(groups.keys))
    enough = np.bincount(group, minlength=len(groups.keys)) >= SIMILAR_MIN_TEXELS
    return median[groups.group], enough[groups.group]


def _similarity_key(
    value: NDArray[np.floating], region: NDArray[np.integer], channels: Sequence[int]
) -> NDArray[np.int64]:
    """(n,) key that texels (n, 3) of one ``region`` (n,) share which are similar in the ``channels``."""
    n, seen = SIMILAR_LEVELS, np.log2(np.maximum(value[:, channels], SIMILAR_FLOOR)) * SIMILAR_STEPS
    level = np.clip(np.rint(seen.mean(1)) + n - 1, 0, n - 1)
    balance = np.clip(np.rint(seen[:, -1] - seen[:, 0]) + n // 2, 0, n - 1)
    return (region.astype(np.int64) * n + level.astype(np.int64)) * n + balance.astype(np.int64)
