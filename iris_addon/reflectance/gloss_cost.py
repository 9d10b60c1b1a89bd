"""How badly each gloss explains the photos of every part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..grouping import group_medians, group_sums
from .ggx import DIELECTRIC_F0

SPATIAL_WEIGHT = 0.35
"""Say of "the albedo is even over the part" against "the albedo is the same from every view"."""
ROBUST = 0.15
WIDE = 0.4
"""Roughness from which the lobes of few rays are too noisy to tell a metal."""
LobeHalves = Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]]
"""(Ls0, Ls1) from two independent sets of rays, or once where there is no noise to tell apart."""
_Residuals = tuple[NDArray[np.floating], NDArray[np.floating]]


@dataclass(frozen=True)
class PartFits:
    """Observations of k parts, m in all; ``patch`` (m,) and ``part``, (n,) of each of the n patches, count from 0."""

    patch: NDArray[np.integer]
    part: NDArray[np.integer]
    weight: NDArray[np.floating]
    radiance: NDArray[np.floating]
    irradiance: NDArray[np.floating]

    def dielectric(self, diffuse: NDArray[np.floating], halves: LobeHalves) -> NDArray[np.float64]:
        """(n,) robust cost with albedo free per patch and the 4 % lobe taken off; ``diffuse`` (m,) view factor."""
        light = self.irradiance * diffuse[:, None]
        return self._cost([self._residuals(self.radiance - DIELECTRIC_F0 * s0 - s1, light) for s0, s1 in halves])

    def metal(self, roughness: float, halves: LobeHalves) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) robust cost with the specular colour free per patch and no diffuse part, (k, 3) that colour's median.

        A wide lobe of few rays meets a lamp or misses it, and a metal has nothing else to send: such a cost keeps the
        noise in it, which speaks against the metal.
        """
        mean = np.mean([s0 for s0, _ in halves], axis=0), np.mean([s1 for _, s1 in halves], axis=0)
        if roughness >= WIDE:
            halves = [mean]
        cost = self._cost([self._residuals(self.radiance - s1, np.maximum(s0, 1e-5)) for s0, s1 in halves])
        return cost, self._medians(self._albedo(self.radiance - mean[1], np.maximum(mean[0], 1e-5)))

    def _residuals(self, explained: NDArray[np.floating], per_albedo: NDArray[np.floating]) -> _Residuals:
        """Residual of radiance relative to itself (m, 3): between the views of a patch, and between patches."""
        albedo = self._albedo(explained, per_albedo)
        scale = np.maximum(self.radiance, 1e-4)
        views = (albedo[self.patch] * per_albedo - explained) / scale
        return views, (self._medians(albedo)[self.part[self.patch]] * per_albedo - explained) / scale

    def _albedo(self, explained: NDArray[np.floating], per_albedo: NDArray[np.floating]) -> NDArray[np.float64]:
        """(n, 3) diffuse albedo or specular colour of each patch, least squares over its views."""
        n, w = len(self.part), self.weight[:, None]
        total = group_sums(w * per_albedo, self.patch, n)
        return np.clip(group_sums(w * explained, self.patch, n) / np.maximum(total, 1e-9), 0.0, 1.2)

    def _medians(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k, C) median of the patches' values (n, C) per part."""
        return group_medians(values, self.part, int(self.part.max()) + 1)

    def mean(self, cost: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k,) mean over the observations of each part of what its patches (n,) cost."""
        say = self._say
        return np.bincount(self.part, say * cost) / np.bincount(self.part, say)

    def standard_error(self, cost: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k,) of :meth:`mean`, from how much the patches of a part differ; of a single patch, as large as the mean."""
        say, mean, n = self._say, self.mean(cost), np.bincount(self.part)
        off = say * (cost - mean[self.part])
        spread = np.sqrt(np.bincount(self.part, off**2)) / np.bincount(self.part, say)
        return np.where(n > 1, spread * np.sqrt(n / np.maximum(n - 1, 1)), np.abs(mean))

    @cached_property
    def _say(self) -> NDArray[np.float64]:
        """(n,) observations of each patch, by weight."""
        return np.asarray(np.bincount(self.patch, self.weight, len(self.part)), np.float64)

    def _cost(self, halves: Sequence[_Residuals]) -> NDArray[np.float64]:
        """(n,) robust mean of the squared residuals, less the noise of few rays.

        The square of a noisy residual has the noise's variance in it, and the smooth null hypothesis would always
        win. The product of two residuals from independent halves of the rays has not; it is averaged over the views of
        a patch before the robust loss, which would shrink what is noisy.
        """
        n, say = len(self.part), self._say
        views, space = (
            _robust(group_sums(self.weight[:, None] * x * y, self.patch, n) / say[:, None])
            for x, y in zip(halves[0], halves[-1], strict=True)
        )
        return (views + SPATIAL_WEIGHT * space).mean(1)


def _robust(square: NDArray[np.floating]) -> NDArray[np.floating]:
    """Cauchy's loss of squared residuals that noise may have made negative."""
    return np.copysign(np.log1p(np.abs(square) / ROBUST**2), square)
