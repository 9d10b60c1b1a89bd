"""The cost of a gloss over a region, equation (24).

For each level of roughness the specular light is predicted and subtracted. What remains must be one diffuse albedo per
patch, whatever the view, and about the same albedo over a region.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import kernel
from ..base.group_by import group_medians
from ..brdf.ggx import DIELECTRIC_F0

COST_SPATIAL_WEIGHT = 0.35
"""Weight of "the albedo is even over the region" relative to "the albedo is the same from every view"."""
COST_ROBUST = 0.15
"""Relative residual at which an observation starts to count as an outlier."""
COST_MAX_ALBEDO, MIN_RADIANCE = 1.2, 1e-4
"""Largest albedo of a patch, and radiance below which residuals are no longer relative."""
COST_NOISY_ROUGHNESS = 0.4
"""Roughness above which the lobes of few rays are too noisy to identify a metal."""
LobeHalves = Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]]
"""(Ls0, Ls1) from two independent sets of rays; a single entry where they are free of noise."""


@dataclass(frozen=True)
class RegionFits:
    """The m observations of k regions, and the n patches they show.

    Attributes:
        patch: (m,) patch of each observation, 0 to n - 1.
        region: (n,) region of each patch, 0 to k - 1.
        weight: (m,) statistical weight.
        radiance: (m, 3) observed, scene-linear Rec.709.
        irradiance: (m, 3) irradiance / pi.
    """

    patch: NDArray[np.integer]
    region: NDArray[np.integer]
    weight: NDArray[np.floating]
    radiance: NDArray[np.floating]
    irradiance: NDArray[np.floating]

    def dielectric(self, diffuse: NDArray[np.floating], halves: LobeHalves) -> NDArray[np.float64]:
        """(n,) robust cost with one free albedo per patch and the 4 % lobe subtracted.

        Args:
            diffuse: (m,) view factor of the diffuse lobe.
            halves: (m, 3) specular lobes.
        """
        light = self.irradiance * diffuse[:, None]
        return self._cost([self._solved(self.radiance - DIELECTRIC_F0 * s0 - s1, light) for s0, s1 in halves])

    def metal(self, roughness: float, halves: LobeHalves) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Robust cost (n,) with one free specular colour per patch and no diffuse part, and the median colour (k, 3).

        A wide lobe of few rays either meets a lamp or misses it, and a metal sends no other light. From
        COST_NOISY_ROUGHNESS on the noise is therefore kept in the cost, which counts against the metal.
        """
        mean = np.mean([s0 for s0, _ in halves], axis=0), np.mean([s1 for _, s1 in halves], axis=0)
        colour = self._solved(self.radiance - mean[1], np.maximum(mean[0], 1e-5))
        if roughness >= COST_NOISY_ROUGHNESS:
            return self._cost([colour]), colour.median
        cost = self._cost([self._solved(self.radiance - s1, np.maximum(s0, 1e-5)) for s0, s1 in halves])
        return cost, colour.median

    def _solved(self, explained: NDArray[np.floating], per_albedo: NDArray[np.floating]) -> _Solved:
        """Diffuse albedo or specular colour of each patch by least squares over its views.

        Args:
            explained: (m, 3) radiance that the albedo has to explain.
            per_albedo: (m, 3) radiance per unit of albedo.
        """
        albedo, norm = np.zeros((2, len(self.region), 3))
        _fit(self.patch, self.weight, explained, per_albedo, albedo, norm)
        return _Solved(explained, per_albedo, albedo, self.medians(albedo))

    def medians(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k, C) median of the patches' values (n, C) per region."""
        return group_medians(values, self.region, int(self.region.max()) + 1)

    def mean(self, cost: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k,) mean of the costs (n,) of a region's patches, weighted by observations."""
        weight = self._patch_weight
        return np.bincount(self.region, weight * cost) / np.bincount(self.region, weight)

    def standard_error(self, cost: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k,) standard error of :meth:`mean` from the spread of a region's patches; for a single patch, the mean."""
        weight, mean, n = self._patch_weight, self.mean(cost), np.bincount(self.region)
        off = weight * (cost - mean[self.region])
        spread = np.sqrt(np.bincount(self.region, off**2)) / np.bincount(self.region, weight)
        return np.where(n > 1, spread * np.sqrt(n / np.maximum(n - 1, 1)), np.abs(mean))

    @cached_property
    def _patch_weight(self) -> NDArray[np.float64]:
        """(n,) sum of the weights of each patch's observations."""
        return np.asarray(np.bincount(self.patch, self.weight, len(self.region)), np.float64)

    def _cost(self, halves: Sequence[_Solved]) -> NDArray[np.float64]:
        """(n,) robust mean of the squared residuals without the noise of few rays, equation (24).

        The square of a noisy residual contains the variance of the noise, so the smooth null hypothesis would always
        win. The product of two residuals from independent halves of the rays does not. It is averaged over the views of
        a patch before the robust loss, which would otherwise shrink noisy values.
        """
        sums = np.zeros((2, len(self.region), 3))
        _add_products(self.patch, self.region, self.weight, self.radiance, halves[0], halves[-1], sums)
        views, space = _robust(sums / self._patch_weight[:, None])
        return (views + COST_SPATIAL_WEIGHT * space).mean(1)


class _Solved(NamedTuple):
    """A least-squares albedo and what it was fitted to.

    Attributes:
        explained: (m, 3) radiance that the albedo has to explain.
        per_albedo: (m, 3) radiance per unit of albedo.
        albedo: (n, 3) of each patch.
        median: (k, 3) of each region.
    """

    explained: NDArray[np.floating]
    per_albedo: NDArray[np.floating]
    albedo: NDArray[np.float64]
    median: NDArray[np.float64]


@kernel
def _fit(
    patch: NDArray[np.integer],
    weight: NDArray[np.floating],
    explained: NDArray[np.floating],
    per_albedo: NDArray[np.floating],
    albedo: NDArray[np.float64],
    norm: NDArray[np.float64],
) -> None:
    """Fill ``albedo`` (n, 3) with the least-squares albedo of every patch; it and ``norm`` (n, 3) start as zeros."""
    for i in range(len(patch)):
        for c in range(3):
            albedo[patch[i], c] += weight[i] * explained[i, c]
            norm[patch[i], c] += weight[i] * per_albedo[i, c]
    for p in range(len(albedo)):
        for c in range(3):
            albedo[p, c] = min(max(albedo[p, c] / max(norm[p, c], 1e-9), 0.0), COST_MAX_ALBEDO)


@kernel
def _add_products(
    patch: NDArray[np.integer],
    region: NDArray[np.integer],
    weight: NDArray[np.floating],
    radiance: NDArray[np.floating],
    one: _Solved,
    other: _Solved,
    sums: NDArray[np.float64],
) -> None:
    """Add to ``sums`` (2, n, 3) the products of the relative residuals of both halves: with the albedo of the patch,
    and with the median albedo of its region."""
    for i in range(len(patch)):
        p, k = patch[i], region[patch[i]]
        for c in range(3):
            relative = weight[i] / max(radiance[i, c], MIN_RADIANCE) ** 2
            x, y = one.per_albedo[i, c], other.per_albedo[i, c]
            a, b = one.explained[i, c], other.explained[i, c]
            sums[0, p, c] += relative * (one.albedo[p, c] * x - a) * (other.albedo[p, c] * y - b)
            sums[1, p, c] += relative * (one.median[k, c] * x - a) * (other.median[k, c] * y - b)


def _robust(square: NDArray[np.floating]) -> NDArray[np.floating]:
    """Cauchy's loss of squared residuals, odd in its argument because noise may have made them negative."""
    return np.copysign(np.log1p(np.abs(square) / COST_ROBUST**2), square)
