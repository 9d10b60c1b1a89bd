"""The pattern of lamps as a texture: the radiance of each texel over the mean of its lamp.

Texels of such a lamp are painted as those of any surface, with radiance in the place of base colour. What clips in all
photos has the radiance that the mean of the lamp, which the light of the room tells, leaves for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lighting.lamp_evidence import PATTERN_CLIPS
from .atlas import Atlas
from .fill import fill_texels
from .principled import EXPECTED_WEIGHT, PaintedTexels

TINY = 1e-9


@dataclass(frozen=True)
class PatternedLamp:
    """A lamp that is not equally bright everywhere.

    Attributes:
        faces: of the mesh.
        radiance: (3,) mean over its area as the light of the room tells it, scene-linear Rec.709.
        level: radiance for which a painted texel has the value 1.
        brightest: radiance up to which photos show it without clipping.
    """

    faces: NDArray[np.int64]
    radiance: NDArray[np.float64]
    level: float
    brightest: float


def lamp_pattern(
    atlas: Atlas, texels: PaintedTexels, areas: NDArray[np.floating], lamps: Sequence[PatternedLamp]
) -> tuple[NDArray[np.float32], list[NDArray[np.float64]]]:
    """The pattern of ``lamps``, at least one, and the mean radiance (3,) of each as photos show it.

    Args:
        areas: (F,) of the mesh's faces, square metres.

    Returns:
        (N, N, 3) radiance of texels over the mean of their lamp, 1 on other faces; and the means.
    """
    points = texels.points
    area = areas[points.face] / np.bincount(points.face, minlength=len(areas))[points.face]
    radiance, sure = np.full((len(points.texel), 3), np.nan), np.zeros(len(points.texel), bool)
    rows = np.searchsorted(points.texel, texels.fused.texel)
    radiance[rows], sure[rows] = texels.fused.value, texels.fused.weight > EXPECTED_WEIGHT
    pattern, known = np.ones((atlas.size * atlas.size, 3), np.float32), np.zeros(atlas.size * atlas.size, bool)
    means = []
    for lamp in lamps:
        own = np.flatnonzero(np.isin(points.face, lamp.faces))
        unknown = np.isnan(radiance[own])
        clips = unknown & texels.bounded[own]
        # What photos show unclipped and hardly count for is black in all of them.
        black = unknown & ~clips & texels.measured[own]
        seen = np.where(black, 0.0, radiance[own] * lamp.level)
        seen[~sure[own] & ~clips.any(1)] = np.nan
        complete = with_clipped(seen, clips, area[own], lamp)
        shown = np.isfinite(complete).all(1)
        mean, shares = lamp.radiance, np.ones((len(own), 3))
        if shown.any():
            mean = np.average(complete[shown], 0, area[own[shown]])
            shares = complete / np.maximum(mean, TINY)
        means.append(mean)
        told = shown | ~shown.any()
        pattern[points.texel[own[told]]], known[points.texel[own[told]]] = shares[told], True
    filled = fill_texels(pattern.reshape(atlas.size, atlas.size, 3), known.reshape(atlas.size, atlas.size))
    others = (atlas.face >= 0) & ~np.isin(atlas.face, np.concatenate([lamp.faces for lamp in lamps]))
    filled[others] = 1.0
    return filled, means


def with_clipped(
    radiance: NDArray[np.floating], clips: NDArray[np.bool_], area: NDArray[np.floating], lamp: PatternedLamp
) -> NDArray[np.float64]:
    """(T, 3) radiance of the texels of ``lamp``: of all that clip, the one which gives the lamp its mean.

    Args:
        radiance: (T, 3), NaN where no photo tells it.
        clips: (T, 3) bool, where all photos clip.
        area: (T,) of the texels.
    """
    completed = np.array(radiance, np.float64)
    for channel, of_lamp in enumerate(lamp.radiance):
        values, clipped = completed[:, channel], clips[:, channel]
        known = np.isfinite(values)
        if clipped.any():
            left = of_lamp * area[known | clipped].sum() - area[known] @ values[known]
            # Of little that clips, the mean was measured without the excess.
            little = area[clipped].sum() <= PATTERN_CLIPS * area[known | clipped].sum()
            values[clipped] = lamp.brightest if little else max(left / area[clipped].sum(), lamp.brightest)
    return completed
