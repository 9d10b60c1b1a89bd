"""Whether the highlights that a gloss predicts are in the photos: the share of them, equation (26).

The cost of a gloss, equation (24), falls a little with any lobe that resembles an error of the light, and rises where
the mesh puts a highlight a finger's breadth beside its place. How much of a predicted highlight is there tells both
apart: on matte walls it is 0.0 to 0.2, whatever the cost says, on glossy surfaces about 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import MAD, group_equal, group_medians, group_sums
from ..base.parallel import over_each
from ..brdf.ggx import DIELECTRIC_F0
from .region_fits import MIN_RADIANCE, LobeHalves, RegionFits

EXPECTED_SHARE = 0.7
"""Share that photos show of the highlights of glossy regions whose normals are known: meshes are not quite right, and
patches average."""
MODEL_ERROR = 0.25
"""Standard deviation of a share however well it is observed: lobes lie between levels, and normals are off."""
LIGHT_ERROR = 0.003
"""Error of the light from view to view, relative: fainter highlights tell nothing."""
FAINTEST = 1e-6
"""Highlights relative to the radiance below which there are none."""
MAX_EVIDENCE = 7.0
"""Logarithm of a likelihood ratio beyond which evidence is no more certain."""
OUTLIER = 2.0
"""Deviation at which an observation, or a patch of its region, starts to lose its weight, standard deviations."""
MIN_DEVIATION = 0.01
"""Least standard deviation of observations, relative."""
MIN_ALBEDO = 1e-3
"""Albedo below which differences are none."""
MIN_ALBEDO_DEVIATION = 0.05
"""Least standard deviation of the log albedo of the patches of a region."""
SHARE_LIMITS = (-0.5, 2.0)
"""Shares between which residuals are taken while the fit goes on."""
PASSES = 6
"""Fits, each with weights from the residuals of the last."""
MIN_BLOCK_SIDE, BLOCK_SIDE = 0.001, 0.25
"""Least and largest side in metres of the blocks whose residuals count as one for the standard error."""
TINY = 1e-20
"""In place of a sum of squares that is zero."""


@dataclass(frozen=True)
class ShownHighlights:
    """The share of each predicted highlight that photos show.

    Attributes:
        share: (k, levels) of each region; 1 is what the gloss predicts, 0 what a rough surface shows.
        variance: (k, levels), infinite where nothing is predicted.
        expected: (k,) the share of a glossy region, less where its normals are badly known.
    """

    share: NDArray[np.float64]
    variance: NDArray[np.float64]
    expected: NDArray[np.float64]

    @property
    def evidence(self) -> NDArray[np.float64]:
        """(k, levels) log of how much likelier the share is if the highlight exists than if it does not."""
        expected = self.expected[:, None]
        ratio = expected * (self.share - expected / 2) / self.variance
        return np.clip(ratio, -MAX_EVIDENCE, MAX_EVIDENCE)


def find_highlights(
    fits: RegionFits,
    position: NDArray[np.floating],
    diffuse: NDArray[np.floating],
    lobes: Sequence[LobeHalves],
    traced: int,
    known: NDArray[np.floating],
) -> ShownHighlights:
    """The share of its highlights that photos show, of every region and level.

    A surface may be anything between rough and of a level of gloss. With y what a rough surface of the patch's albedo
    does not explain, and h what the gloss adds to it, both less what another albedo of the patch explains, the
    share is the robust least-squares solution of y = share h.

    Args:
        position: (m, 3) metres.
        diffuse: (levels, m) view factor of the diffuse lobe.
        lobes: per level, the last of which is rough, the specular lobes of both halves of the rays.
        traced: the first levels, whose highlights are looked for.
        known: (k,) from 0 to 1, how well the normals of each region are known: a highlight of others lies elsewhere.
    """
    n_regions = int(fits.region.max()) + 1
    patch, region = fits.patch, fits.region[fits.patch]
    radiance, irradiance = fits.radiance.mean(1), fits.irradiance.mean(1)
    scale = np.maximum(radiance, MIN_RADIANCE)
    rough = np.mean([_dielectric(half) for half in lobes[-1]], axis=0)
    light, shown = diffuse[-1] * irradiance, radiance - rough
    trust = _trust(fits, shown, light, scale)
    blocks = _Blocks.of(region, position)

    def per_region(values: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.asarray(np.bincount(region, values, n_regions), np.float64)

    def robust(off: NDArray[np.floating]) -> NDArray[np.float64]:
        """(m,) weights by the residuals ``off`` (m,) of a fit."""
        relative = off / scale
        deviation = MAD * group_medians(np.abs(relative)[:, None], region, n_regions)[:, 0]
        return trust / (1 + (relative / (OUTLIER * np.maximum(deviation, MIN_DEVIATION))[region]) ** 2)

    def share_of(level: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        more_diffuse = (diffuse[level] - diffuse[-1]) * irradiance
        halves = [_dielectric(half) - rough for half in (lobes[level][0], lobes[level][-1])]

        def fit(weights: Sequence[NDArray[np.floating]]) -> _Fit:
            power, explained, seen = np.zeros((3, n_regions))
            sides = []
            # A weight from the residual under one half of the rays knows of its noise; the other half does not.
            for k, weight in enumerate(weights):
                albedo = _albedo(patch, shown, light, weight)[patch]
                added = [half + albedo * more_diffuse for half in halves]
                left, own, other = (
                    values - _albedo(patch, values, light, weight)[patch] * light
                    for values in (shown, added[k], added[1 - k])
                )
                sides.append((left, own, weight * other))
                power += per_region(weight * other * own)
                explained += per_region(weight * other * left)
                seen += per_region(weight * scale**2)
            shines = power > FAINTEST**2 * seen
            power = np.where(shines, power, 1.0)
            share = np.where(shines, explained / power, 0.0)
            return _Fit(share=share, shines=shines, power=power, seen=seen, sides=sides)

        found = fit([trust, trust])
        for _ in range(PASSES - 1):
            limited = np.clip(found.share, *SHARE_LIMITS)[region]
            found = fit([robust(left - limited * own) for left, own, _ in found.sides])
        share, shines, power, seen, sides = found
        pull = sum((pulling * (left - share[region] * own) for left, own, pulling in sides), np.zeros(len(region)))
        error = blocks.squared_error(pull, n_regions) / power**2
        return share, np.where(shines, error + MODEL_ERROR**2 + LIGHT_ERROR**2 * seen / power, np.inf)

    found = over_each(range(traced), share_of)
    share, variance = (np.stack(column, 1) for column in zip(*found, strict=True))
    return ShownHighlights(share, variance, EXPECTED_SHARE * np.asarray(known, np.float64))


class _Fit(NamedTuple):
    """One fit of the shares of k regions to m observations.

    Attributes:
        share: (k,).
        shines: (k,) bool, whether a highlight is predicted.
        power, seen: (k,) weighted sums of squares of the predicted highlight, 1 where there is none, and of radiance.
        sides: under the weight of either half of the rays, what is left of the radiance, what is left of the highlight
            of that half, and that of the other times the weight, (m,) each.
    """

    share: NDArray[np.float64]
    shines: NDArray[np.bool_]
    power: NDArray[np.float64]
    seen: NDArray[np.float64]
    sides: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]


def _albedo(
    patch: NDArray[np.integer],
    values: NDArray[np.floating],
    light: NDArray[np.floating],
    weight: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(n,) albedo of each patch whose light (m,) is closest to ``values`` (m,), least squares by ``weight`` (m,)."""
    norm = np.bincount(patch, weight * light * light)
    return np.bincount(patch, weight * values * light) / np.maximum(norm, TINY)


def _dielectric(lobe: tuple[NDArray[np.floating], NDArray[np.floating]]) -> NDArray[np.float64]:
    """(m,) what a dielectric reflects of the lobe (Ls0, Ls1), mean over channels."""
    return (DIELECTRIC_F0 * lobe[0] + lobe[1]).mean(1)


def _trust(
    fits: RegionFits, shown: NDArray[np.floating], light: NDArray[np.floating], scale: NDArray[np.floating]
) -> NDArray[np.float64]:
    """(m,) weight of each observation: less where the patch has another albedo than its region, since then the mesh, or
    the light there, is not what it seems."""
    weight = fits.weight / scale**2
    log_albedo = np.log(np.maximum(_albedo(fits.patch, shown, light, weight), MIN_ALBEDO))[:, None]
    off = np.abs(log_albedo - fits.medians(log_albedo)[fits.region])
    deviation = np.maximum(MAD * fits.medians(off), MIN_ALBEDO_DEVIATION)[fits.region]
    # Geman and McClure's weight: a patch that is far off counts for nothing.
    return weight / (1 + (off / (OUTLIER * deviation))[fits.patch, 0] ** 2) ** 2


@dataclass(frozen=True)
class _Blocks:
    """Parts of the regions whose residuals count as one, since errors of the light are smooth.

    Attributes:
        of_observation: (m,) block of each observation.
        region: (blocks,) region of each block.
    """

    of_observation: NDArray[np.integer]
    region: NDArray[np.integer]

    @staticmethod
    def of(region: NDArray[np.integer], position: NDArray[np.floating]) -> _Blocks:
        """Cubes of BLOCK_SIDE, or of the standard deviation of a region's places where that is less."""
        count = np.bincount(region)[:, None]
        mean = group_sums(position, region, len(count)) / count
        spread = np.sqrt(group_sums((position - mean[region]) ** 2, region, len(count)) / count).max(1)
        side = np.clip(spread, MIN_BLOCK_SIDE, BLOCK_SIDE)[region, None]
        key = region.astype(np.int64)
        for axis in np.floor((position - mean[region]) / side).astype(np.int64).T:
            key = (key << 12) | (axis & 0xFFF)  # two blocks of one region 4096 sides apart may be one
        groups = group_equal(key)
        return _Blocks(groups.group, region[groups.order[groups.start]])

    def squared_error(self, pull: NDArray[np.floating], n_regions: int) -> NDArray[np.float64]:
        """(n_regions,) variance of the sum of ``pull`` (m,), whose observations have no mean, over each region."""
        count = np.bincount(self.region, minlength=n_regions)
        per_block = np.bincount(self.of_observation, pull, len(self.region))
        block = np.bincount(self.region, per_block**2, n_regions) * count / np.maximum(count - 1, 1)
        alone = np.bincount(self.region, np.bincount(self.of_observation, pull**2, len(self.region)), n_regions)
        return np.asarray(np.maximum(block, alone), np.float64)
