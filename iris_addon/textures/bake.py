"""Textures: albedo per pixel, fused over photos into texels.

``kd = (L - specular) / Ld`` at every pixel, with the irradiance interpolated from patches, so that the texture keeps
the photos' resolution and the shading stays out of it. Texels take a robust mean over photos, weighted by resolution,
angle and the precision of the byte behind each value, and hardly see pixels on an edge, which mix two surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Integer, kernel
from ..base.group_by import group_equal, group_medians
from ..base.parallel import over_shares
from ..lighting.balance import MAX_ALBEDO
from ..response.observations import MIXED_WEIGHT

DIM = 0.05
"""Share of the median irradiance below which a quotient of radiance and irradiance is not worth much."""
HIGHLIGHT = 20.0
"""Inverse of the specular radiance, in irradiance / pi, from which on errors of the lobe outweigh all others."""
RIM_SAY = 1e-5
"""Say of a pixel on an edge of what was modelled: where all are such, however many they are texels stay in doubt."""
DIM_ALBEDO = 0.02
"""Added to albedo where it divides: relative differences of black surfaces are noise."""
UNTOLD = 0.01
"""Share of a texel's weight from which on a channel counts as seen: where every photo has a byte of 0, it is less."""
TINY = np.float32(1e-12)
OUTLIER = 0.25
"""Relative distance from a texel's mean at which a photo loses half its say."""


@dataclass(frozen=True)
class TexelAlbedo:
    """Albedo fused in the texels that some photo shows, neither clipped nor black in one channel at least.

    Attributes:
        texel: (T,) int64 flat index of each, ascending.
        value: (T, 3) float32; NaN where all photos that show the channel are clipped or black.
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
    scanned: NDArray[np.bool_],
    usual_footprint: float,
    usual_irradiance: float,
) -> NDArray[np.float32]:
    """(n, 3) say of a pixel: near and head-on it sees more, in the dark, under a highlight and on an edge less.

    An error of the irradiance or of the specular part is one of the albedo once divided by the irradiance.

    Args:
        irradiance: (n, 3) irradiance / pi.
        specular: (n, 3) radiance taken off the pixel's.
        mixed: (n,) pixels on an edge.
        scanned: (n,) pixels on a scan: an edge is one of colour there, and mixes what is lit alike.
        usual_footprint, usual_irradiance: medians over all pixels, which "near" and "dark" are meant by.
    """
    near = usual_footprint / np.maximum(footprint, 1e-6)
    lit = irradiance / (irradiance + DIM * usual_irradiance)
    highlight = HIGHLIGHT * specular.mean(1) / np.maximum(irradiance.mean(1), 1e-6)
    edge = np.where(mixed, np.where(scanned, np.float32(MIXED_WEIGHT), np.float32(RIM_SAY)), np.float32(1))
    sharp = cosine**2 * np.clip(near, 0.05, 20.0) ** 2 * edge
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
    row = np.full(n_texels, -1, np.int32)
    row[texel[weight.any(1)]] = 0
    texels = np.flatnonzero(row == 0)
    row[texels] = np.arange(len(texels), dtype=np.int32)
    fused, norm = np.empty((len(texels), 3), np.float32), np.empty(len(texels), np.float32)
    at = row[texel]

    def work(some: slice) -> None:
        first, agreeing = np.zeros((2, some.stop - some.start, 6), np.float32)
        _add_up(at, some.start, value, weight, first)
        _add_up_agreeing(at, some.start, value, weight, first, agreeing)
        shown = agreeing[:, :3] / np.maximum(agreeing[:, 3:], TINY)
        norm[some] = first[:, 3:].max(1)
        fused[some] = np.where(first[:, 3:] > UNTOLD * norm[some, None], shown, np.nan)

    # Every thread goes through all pixels and adds up those of its own texels: reading them is the lesser part.
    over_shares(len(texels), work)
    return TexelAlbedo(texels, fused, norm)


@kernel
def _add_up(
    row: NDArray[np.int32],
    begin: Integer,
    value: NDArray[np.floating],
    weight: NDArray[np.floating],
    sums: NDArray[np.float32],
) -> None:
    """Weighted values, then weights, of the texels (T, 6) from ``begin`` on; pixels of no texel are -1."""
    for i in range(len(row)):
        t = row[i] - begin
        if 0 <= t < len(sums):
            for c in range(3):
                sums[t, c] += weight[i, c] * value[i, c]
                sums[t, 3 + c] += weight[i, c]


@kernel
def _add_up_agreeing(
    row: NDArray[np.int32],
    begin: Integer,
    value: NDArray[np.floating],
    weight: NDArray[np.floating],
    first: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> None:
    """The same, pixels counting the less the further they are off the mean of their texel by the ``first`` sums."""
    for i in range(len(row)):
        t, off, level = row[i] - begin, 0.0, DIM_ALBEDO
        if t < 0 or t >= len(sums):
            continue
        for c in range(3):
            mean = first[t, c] / max(first[t, 3 + c], TINY)
            off += abs(value[i, c] - mean) / 3
            level += mean / 3
        say = 1 / (1 + (off / (level * OUTLIER)) ** 2)
        for c in range(3):
            sums[t, c] += say * weight[i, c] * value[i, c]
            sums[t, 3 + c] += say * weight[i, c]


# ---- Colour of texels of which some channels were clipped in every photo --------------------------------------------
#
# The white of a rug in the sun is read in blue alone. What red and green it has is told by texels of its region that
# are as blue and were seen whole, in the shade of a table; the mean colour of the region is that of the rug's red
# pattern too.


STEPS = 3
"""Steps per octave of brightness, and of the balance between channels, by which texels count as alike."""
ENOUGH = 10
"""Texels seen whole that are asked for, to tell what others like them have."""
LEAST = 1e-3
LEVELS = 32
"""Steps of brightness; so many of the balance too, around even."""
ALL = 7
"""Bits of the three channels."""
KNOWN: tuple[Sequence[int], ...] = (*combinations(range(3), 1), *combinations(range(3), 2))


def complete_channels(
    value: NDArray[np.floating], region: NDArray[np.integer], region_mean: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(T, 3) texels with the channels that were clipped in every photo as those of their part have them that look alike
    in the others, and where those are few as the region has them on the mean.

    Args:
        value: (T, 3) base colour, NaN where clipped; one channel at least is known.
        part: (T,) part of each texel.
        part_mean: (n_regions, 3) base colour.
    """
    known = np.isfinite(value)
    code = (known * np.array([1, 2, 4], np.uint8)).sum(1, dtype=np.uint8)
    clipped = np.flatnonzero(code != ALL)
    completed = value.astype(np.float32)
    completed[clipped] = _like_the_region(value[clipped], region_mean[region[clipped]])
    for channels in KNOWN:
        rows = np.flatnonzero(code == sum(1 << c for c in channels))
        lacking = np.zeros(len(region_mean), bool)
        lacking[region[rows]] = True
        whole = np.flatnonzero((code == ALL) & lacking[region])
        if len(whole):
            share, found = _share_of_like(value[rows], region[rows], value[whole], region[whole], channels)
            guess = value[rows][:, channels].sum(1, keepdims=True) * share
            guess = np.where(known[rows], value[rows], np.minimum(guess, MAX_ALBEDO))
            completed[rows[found]] = guess[found]
    return completed


def _like_the_region(value: NDArray[np.floating], colour: NDArray[np.floating]) -> NDArray[np.floating]:
    """(n, 3) texels completed by the ratio between the channels of ``colour`` (n, 3)."""
    known = np.isfinite(value)
    scale = np.where(known, value, 0.0).sum(1) / np.maximum((colour * known).sum(1), 1e-4)
    return np.where(known, value, np.clip(colour * scale[:, None], 0.0, MAX_ALBEDO))


def _share_of_like(
    value: NDArray[np.floating],
    region: NDArray[np.integer],
    whole: NDArray[np.floating],
    region_of_whole: NDArray[np.integer],
    channels: Sequence[int],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Median colour of the texels ``whole`` (w, 3) that look in the ``channels`` like each of ``value`` (n, 3) and are
    of its region, over their sum in the channels, (n, 3); and where there are enough of them, (n,)."""
    asked, look = group_equal(_look(value, region, channels)), _look(whole, region_of_whole, channels)
    at = np.minimum(np.searchsorted(asked.keys, look), len(asked.keys) - 1)
    alike = np.flatnonzero(asked.keys[at] == look)
    told, colour = at[alike], whole[alike]
    share = colour / np.maximum(colour[:, channels].sum(1, keepdims=True), LEAST)
    median = group_medians(share, told, len(asked.keys))
    enough = np.bincount(told, minlength=len(asked.keys)) >= ENOUGH
    return median[asked.group], enough[asked.group]


def _look(value: NDArray[np.floating], region: NDArray[np.integer], channels: Sequence[int]) -> NDArray[np.int64]:
    """(n,) number that texels of one region have in common which look alike in the ``channels``."""
    seen = np.log2(np.maximum(value[:, channels], LEAST)) * STEPS
    level = np.clip(np.rint(seen.mean(1)) + LEVELS - 1, 0, LEVELS - 1)
    balance = np.clip(np.rint(seen[:, -1] - seen[:, 0]) + LEVELS // 2, 0, LEVELS - 1)
    return (region.astype(np.int64) * LEVELS + level.astype(np.int64)) * LEVELS + balance.astype(np.int64)
