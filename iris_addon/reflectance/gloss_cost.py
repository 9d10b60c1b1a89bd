"""How badly each gloss explains the photos of every part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..grouping import group_medians
from ..kernels import kernel
from .ggx import DIELECTRIC_F0

SPATIAL_WEIGHT = 0.35
"""Say of "the albedo is even over the part" against "the albedo is the same from every view"."""
ROBUST = 0.15
MOST, DARK = 1.2, 1e-4
"""Largest albedo of a patch, and radiance below which residuals are no longer relative."""
WIDE = 0.4
"""Roughness from which the lobes of few rays are too noisy to tell a metal."""
LobeHalves = Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]]
"""(Ls0, Ls1) from two independent sets of rays, or once where there is no noise to tell apart."""


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
        return self._cost([self._solved(self.radiance - DIELECTRIC_F0 * s0 - s1, light) for s0, s1 in halves])

    def metal(self, roughness: float, halves: LobeHalves) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) robust cost with the specular colour free per patch and no diffuse part, (k, 3) that colour's median.

        A wide lobe of few rays meets a lamp or misses it, and a metal has nothing else to send: such a cost keeps the
        noise in it, which speaks against the metal.
        """
        mean = np.mean([s0 for s0, _ in halves], axis=0), np.mean([s1 for _, s1 in halves], axis=0)
        colour = self._solved(self.radiance - mean[1], np.maximum(mean[0], 1e-5))
        if roughness >= WIDE:
            return self._cost([colour]), colour.median
        cost = self._cost([self._solved(self.radiance - s1, np.maximum(s0, 1e-5)) for s0, s1 in halves])
        return cost, colour.median

    def _solved(self, explained: NDArray[np.floating], per_albedo: NDArray[np.floating]) -> _Solved:
        """Diffuse albedo or specular colour of each patch, least squares over its views."""
        albedo, norm = np.zeros((2, len(self.part), 3))
        _fit(self.patch, self.weight, explained, per_albedo, albedo, norm)
        return _Solved(explained, per_albedo, albedo, self._medians(albedo))

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

    def _cost(self, halves: Sequence[_Solved]) -> NDArray[np.float64]:
        """(n,) robust mean of the squared residuals, less the noise of few rays.

        The square of a noisy residual has the noise's variance in it, and the smooth null hypothesis would always
        win. The product of two residuals from independent halves of the rays has not; it is averaged over the views of
        a patch before the robust loss, which would shrink what is noisy.
        """
        sums = np.zeros((2, len(self.part), 3))
        _add_products(self.patch, self.part, self.weight, self.radiance, halves[0], halves[-1], sums)
        views, space = _robust(sums / self._say[:, None])
        return (views + SPATIAL_WEIGHT * space).mean(1)


class _Solved(NamedTuple):
    """Radiance that albedo has to explain and light per albedo, (m, 3) each; the albedo of each patch (n, 3) and its
    median over each part (k, 3)."""

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
    """Sums become the least squares ``albedo`` (n, 3) of every patch."""
    for i in range(len(patch)):
        for c in range(3):
            albedo[patch[i], c] += weight[i] * explained[i, c]
            norm[patch[i], c] += weight[i] * per_albedo[i, c]
    for p in range(len(albedo)):
        for c in range(3):
            albedo[p, c] = min(max(albedo[p, c] / max(norm[p, c], 1e-9), 0.0), MOST)


@kernel
def _add_products(
    patch: NDArray[np.integer],
    part: NDArray[np.integer],
    weight: NDArray[np.floating],
    radiance: NDArray[np.floating],
    one: _Solved,
    other: _Solved,
    sums: NDArray[np.float64],
) -> None:
    """Add up products (2, n, 3) of the relative residuals of either half: between the views of a patch, and between
    patches of a part."""
    for i in range(len(patch)):
        p, k = patch[i], part[patch[i]]
        for c in range(3):
            say = weight[i] / max(radiance[i, c], DARK) ** 2
            x, y = one.per_albedo[i, c], other.per_albedo[i, c]
            a, b = one.explained[i, c], other.explained[i, c]
            sums[0, p, c] += say * (one.albedo[p, c] * x - a) * (other.albedo[p, c] * y - b)
            sums[1, p, c] += say * (one.median[k, c] * x - a) * (other.median[k, c] * y - b)


def _robust(square: NDArray[np.floating]) -> NDArray[np.floating]:
    """Cauchy's loss of squared residuals that noise may have made negative."""
    return np.copysign(np.log1p(np.abs(square) / ROBUST**2), square)
