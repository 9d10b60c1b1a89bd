"""Roughness and metallic per part, from how its photos change with the view.

For each level of roughness the reflected light is predicted; what remains after it is taken off must be one diffuse
albedo per patch whatever the view, and much the same albedo over a part. A part that shows no view dependence keeps
the rough dielectric it started as: gloss has to earn its place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..response.observations import group_sums
from .ggx import DIELECTRIC_F0

LEVELS = (0.1, 0.2, 0.32, 0.5, 0.7, 1.0)
"""Six roughness levels as in IRIS; between them the best level is interpolated."""
MIN_OBSERVATIONS = 40
MAX_OBSERVATIONS = 500
GAIN_NEEDED = 0.06
"""Relative fall of the robust residual that a gloss must bring over the rough dielectric."""
METAL_GAIN_NEEDED = 0.15
SPATIAL_WEIGHT = 0.35
"""Say of "the albedo is even over the part" against "the albedo is the same from every view"."""
ROBUST = 0.15


@dataclass(frozen=True)
class Gloss:
    """Material of each part id.

    Attributes:
        roughness, metallic: (n_parts,).
        decided: (n_parts,) bool, the photos decided; elsewhere the default stands.
    """

    roughness: NDArray[np.float64]
    metallic: NDArray[np.float64]
    decided: NDArray[np.bool_]

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        return {"roughness": self.roughness, "metallic": self.metallic, "decided": self.decided}

    @staticmethod
    def from_arrays(arrays: dict[str, NDArray]) -> Gloss:
        """Inverse of :meth:`arrays`."""
        return Gloss(arrays["roughness"], arrays["metallic"], arrays["decided"])


def rough_everywhere(n_parts: int) -> Gloss:
    """The null hypothesis."""
    return Gloss(np.ones(n_parts), np.zeros(n_parts), np.zeros(n_parts, bool))


def choose_observations(
    part: NDArray[np.integer], patch: NDArray[np.integer], weight: NDArray[np.floating], rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices of the observations to fit on: per part up to MAX_OBSERVATIONS, whole patches with all their views."""
    shuffle = rng.permutation(int(patch.max()) + 1)
    usable = np.flatnonzero(weight > 0)
    order = usable[np.lexsort((shuffle[patch[usable]], part[usable]))]
    rank = np.arange(len(order)) - np.searchsorted(part[order], part[order])
    return np.sort(order[rank < MAX_OBSERVATIONS])


def fit_gloss(
    part: NDArray[np.integer],
    patch: NDArray[np.integer],
    weight: NDArray[np.floating],
    radiance: NDArray[np.floating],
    irradiance: NDArray[np.floating],
    diffuse: NDArray[np.floating],
    lobes: list[tuple[NDArray[np.floating], NDArray[np.floating]]],
    n_parts: int,
    forced: bool | None = None,
) -> Gloss:
    """Fit every part with enough observations.

    Args:
        part, patch, weight: (m,) of each observation.
        radiance: (m, 3) observed.
        irradiance: (m, 3) irradiance / pi at it.
        diffuse: (levels, m) factor of the diffuse lobe towards the camera.
        lobes: per level of LEVELS, (Ls0, Ls1), (m, 3) each.
        forced: True takes the best material however little it gains, False none but the rough dielectric.
    """
    gloss = rough_everywhere(n_parts)
    if forced is False:
        return gloss
    order = np.argsort(part, kind="stable")
    ids, first, count = np.unique(part[order], return_index=True, return_counts=True)
    for label, start, n in zip(ids, first, count, strict=True):
        if n < MIN_OBSERVATIONS:
            continue
        rows = order[start : start + n]
        _, local = np.unique(patch[rows], return_inverse=True)
        fit = _PartFit(local, weight[rows], radiance[rows], np.maximum(irradiance[rows], 1e-5))
        plastic = np.array(
            [fit.dielectric(*(x[rows] for x in (d, *lobe))) for d, lobe in zip(diffuse, lobes, strict=True)]
        )
        metal = np.array([fit.metal(s0[rows], s1[rows]) for s0, s1 in lobes])
        _decide(gloss, int(label), plastic, metal, 0.0 if forced else 1.0)
    return gloss


def _decide(gloss: Gloss, label: int, plastic: NDArray[np.float64], metal: NDArray[np.float64], caution: float) -> None:
    """Write the simplest material that explains the part about as well as any; ``caution`` scales the gains needed."""
    null = plastic[-1]
    best_metal, best_plastic = float(metal.min()), float(plastic.min())
    gloss.decided[label] = True
    if best_metal < (1 - caution * METAL_GAIN_NEEDED) * best_plastic:
        gloss.metallic[label] = 1.0
        gloss.roughness[label] = _interpolate_minimum(metal)
    elif best_plastic < (1 - caution * GAIN_NEEDED) * null:
        gloss.roughness[label] = _interpolate_minimum(plastic)


def _interpolate_minimum(cost: NDArray[np.float64]) -> float:
    """Roughness at the vertex of a parabola through the best level and its neighbours, in log roughness."""
    x = np.log(LEVELS)
    k = int(np.argmin(cost))
    if k in (0, len(cost) - 1):
        return LEVELS[k]
    a, b, _ = np.polyfit(x[k - 1 : k + 2], cost[k - 1 : k + 2], 2)
    return float(np.exp(np.clip(-b / (2 * a), x[k - 1], x[k + 1]))) if a > 0 else LEVELS[k]


@dataclass(frozen=True)
class _PartFit:
    """Observations of one part; ``patch`` counts from 0."""

    patch: NDArray[np.int64]
    weight: NDArray[np.floating]
    radiance: NDArray[np.floating]
    irradiance: NDArray[np.floating]

    def dielectric(self, diffuse: NDArray[np.floating], s0: NDArray[np.floating], s1: NDArray[np.floating]) -> float:
        """Robust cost with albedo free per patch and the 4 % lobe taken off; ``diffuse`` (m,) view factor."""
        return self._cost(self.radiance - DIELECTRIC_F0 * s0 - s1, self.irradiance * diffuse[:, None])

    def metal(self, s0: NDArray[np.floating], s1: NDArray[np.floating]) -> float:
        """Robust cost with the specular colour free per patch and no diffuse part."""
        return self._cost(self.radiance - s1, np.maximum(s0, 1e-5))

    def _cost(self, explained: NDArray[np.floating], per_albedo: NDArray[np.floating]) -> float:
        """Residual of radiance relative to itself, between the views of a patch and between patches."""
        albedo = np.clip(explained / per_albedo, 0.0, 1.2)
        n = int(self.patch.max()) + 1
        # The brighter the light, the surer the quotient.
        w = self.weight[:, None] * per_albedo
        mean = group_sums(w * albedo, self.patch, n) / np.maximum(group_sums(w, self.patch, n), 1e-9)
        typical = np.median(mean, axis=0)
        scale = np.maximum(self.radiance, 1e-4)
        offset = explained - albedo * per_albedo  # what clipping the albedo could not explain
        views = ((mean[self.patch] - albedo) * per_albedo - offset) / scale
        space = (typical - albedo) * per_albedo / scale
        total = np.log1p((views / ROBUST) ** 2) + SPATIAL_WEIGHT * np.log1p((space / ROBUST) ** 2)
        return float((self.weight @ total.mean(1)) / self.weight.sum())
