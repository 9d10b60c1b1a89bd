"""Roughness and metallic per region, from how its photos change with the view.

For each level of roughness the specular light is predicted and subtracted. What remains must be one diffuse albedo per
patch, whatever the view, and about the same albedo over a region; the cost of a gloss, equation (24), measures the
deviation (:class:`RegionFits`). Costs are pooled over regions that may be of one material, equation (25)
(:class:`RegionCosts`). A region is glossy or metallic only if that lowers its cost enough, equation (26)
(:func:`fit_gloss`); otherwise it stays the rough dielectric it started as.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import kernel
from ..base.group_by import MAD, group_medians, rank_in_group
from ..base.parallel import over_each
from ..brdf.ggx import DIELECTRIC_F0
from ..decide import Decisions
from .region_costs import POOL_MAX_OBSERVATIONS, RegionCosts

COST_SPATIAL_WEIGHT = 0.35
"""Weight of "the albedo is even over the region" relative to "the albedo is the same from every view"."""
COST_ROBUST = 0.15
"""Relative residual at which an observation starts to count as an outlier."""
COST_MAX_ALBEDO, COST_MIN_RADIANCE = 1.2, 1e-4
"""Largest albedo of a patch, and radiance below which residuals are no longer relative."""
COST_NOISY_ROUGHNESS = 0.4
"""Roughness above which the lobes of few rays are too noisy to identify a metal."""
COST_MIN_ROUGH = 0.02
"""Least cost of the rough dielectric: below, the noise of the photos prevails."""
GLOSS_LEVELS = (0.1, 0.2, 0.32, 0.5, 0.7, 1.0)
"""Roughness levels that are tried, as in IRIS; between them the best level is interpolated."""
GLOSS_RAYS = (8, 16, 32, 32)
"""Reflected rays per observation at each of the first levels; wider lobes need more because they are noisier. The other
levels see what the hemisphere sees. They differ from a rough surface by their sheen alone, and an error in the shape of
the diffuse lobe looks the same."""
GLOSS_MIN_OBSERVATIONS = 10
"""Observations of a region below which it keeps the default."""
GLOSS_MAX_OBSERVATIONS = POOL_MAX_OBSERVATIONS
"""Observations of one region, at most. With a quarter of them large matte walls were taken for glossy in one random
draw and not in the next."""
GLOSS_ALL_OBSERVATIONS = 500_000
"""Observations of all regions, at most: each has 88 rays, and thousands of regions would fill the memory. redkitchen
has 330,000."""
METAL_MAX_COLOUR = 0.95
"""Largest specular colour of a metal."""
LobeHalves = Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]]
"""(Ls0, Ls1) from two independent sets of rays; a single entry where they are free of noise."""


# ---- The cost of a gloss, equation (24) -----------------------------------------------------------------------------


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
        return _Solved(explained, per_albedo, albedo, self._medians(albedo))

    def _medians(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
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
            relative = weight[i] / max(radiance[i, c], COST_MIN_RADIANCE) ** 2
            x, y = one.per_albedo[i, c], other.per_albedo[i, c]
            a, b = one.explained[i, c], other.explained[i, c]
            sums[0, p, c] += relative * (one.albedo[p, c] * x - a) * (other.albedo[p, c] * y - b)
            sums[1, p, c] += relative * (one.median[k, c] * x - a) * (other.median[k, c] * y - b)


def _robust(square: NDArray[np.floating]) -> NDArray[np.floating]:
    """Cauchy's loss of squared residuals, odd in its argument because noise may have made them negative."""
    return np.copysign(np.log1p(np.abs(square) / COST_ROBUST**2), square)


# ---- The fit --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gloss:
    """Material of each region id.

    Attributes:
        roughness, metallic: (n_regions,) Principled roughness, and 0 or 1.
        specular: (n_regions, 3) reflectance at normal incidence: 4 %, or a metal's colour.
        decided: (n_regions,) bool, whether photos decided; elsewhere the default stands.
        layered: whether dielectrics take the light they reflect off the diffuse light below them, equation (11).
    """

    roughness: NDArray[np.float64]
    metallic: NDArray[np.float64]
    specular: NDArray[np.float64]
    decided: NDArray[np.bool_]
    layered: bool = False

    def of_regions(self, material: NDArray[np.integer]) -> Gloss:
        """The gloss of regions of which each has that of the region ``material`` (n_regions,)."""
        m = material
        return Gloss(
            roughness=self.roughness[m],
            metallic=self.metallic[m],
            specular=self.specular[m],
            decided=self.decided[m],
            layered=self.layered,
        )

    def arrays(self) -> dict[str, NDArray]:
        """Plain arrays for a checkpoint."""
        return {
            "roughness": self.roughness,
            "metallic": self.metallic,
            "specular": self.specular,
            "decided": self.decided,
            "layered": np.array(self.layered),
        }

    @staticmethod
    def from_arrays(arrays: dict[str, NDArray]) -> Gloss:
        """Inverse of :meth:`arrays`."""
        a = arrays
        return Gloss(
            roughness=a["roughness"],
            metallic=a["metallic"],
            specular=a["specular"],
            decided=a["decided"],
            layered=bool(a["layered"]),
        )


def rough_everywhere(n_regions: int) -> Gloss:
    """The null hypothesis: rough dielectrics."""
    specular = np.full((n_regions, 3), DIELECTRIC_F0)
    return Gloss(np.ones(n_regions), np.zeros(n_regions), specular, np.zeros(n_regions, bool))


def choose_observations(
    region: NDArray[np.integer], patch: NDArray[np.integer], weight: NDArray[np.floating], rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices of the observations to fit, random whole patches with all their views.

    Each region has at most GLOSS_MAX_OBSERVATIONS of them, or fewer if all regions together would exceed
    GLOSS_ALL_OBSERVATIONS.

    Args:
        region, patch: (M,) of each observation.
        weight: (M,) statistical weight; observations of weight 0 are left out.
    """
    shuffle = rng.permutation(int(patch.max()) + 1)
    usable = np.flatnonzero(weight > 0)
    order = usable[np.lexsort((shuffle[patch[usable]], region[usable]))]
    rank = rank_in_group(region[order])
    most = min(GLOSS_MAX_OBSERVATIONS, _even_share(np.bincount(region[usable]), GLOSS_ALL_OBSERVATIONS))
    return np.sort(order[rank < most])


def _even_share(counts: NDArray[np.integer], total: int) -> int:
    """The limit for each of ``counts`` (n,) under which they sum to ``total`` or less."""
    ascending = np.sort(counts)
    left = total - np.concatenate([[0], np.cumsum(ascending)[:-1]])
    share = left // np.arange(len(ascending), 0, -1)
    return int(share[np.argmax(share < ascending)]) if (share < ascending).any() else total


@dataclass(frozen=True)
class GlossObservations:
    """Observations that gloss is fitted to, m of them.

    Attributes:
        region, patch, weight: (m,) region, patch and statistical weight of each.
        position: (m, 3) metres.
        radiance: (m, 3) observed, scene-linear Rec.709.
        irradiance: (m, 3) irradiance / pi.
        diffuse: (levels, m) view factor of the diffuse lobe.
        lobes: per level of GLOSS_LEVELS, (Ls0, Ls1) of (m, 3) each from either half of the rays; a single entry if free
            of noise.
        layer: (levels, m) further view factor if dielectrics take the light they reflect off the diffuse light below;
            None where the diffuse lobe is Burley's, whose model has no such layer.
        in_file: (n_regions,) object of the mesh file that each region lies in; None if the file names none.
        scanned: (n_regions,) bool, regions of a scan; None without one.
    """

    region: NDArray[np.integer]
    patch: NDArray[np.integer]
    weight: NDArray[np.floating]
    position: NDArray[np.floating]
    radiance: NDArray[np.floating]
    irradiance: NDArray[np.floating]
    diffuse: NDArray[np.floating]
    lobes: Sequence[LobeHalves]
    layer: NDArray[np.floating] | None = None
    in_file: NDArray[np.integer] | None = None
    scanned: NDArray[np.bool_] | None = None


def fit_gloss(observed: GlossObservations, n_regions: int, decisions: Decisions) -> Gloss:
    """Roughness and metallic of every region with enough observations, decided by equation (26).

    Args:
        decisions: where gloss and metal are decided. If gloss is forced, each region takes the best material however
            little it gains; if it is forbidden, all stay rough dielectrics.
    """
    gloss, forced = rough_everywhere(n_regions), decisions.forces("gloss")
    costs, layered = (None, False) if decisions.forbids("gloss") else _layered_or_not(observed)
    if costs is not None:
        for k, (plastic, metal, error) in enumerate(zip(*costs.pooled(), strict=True)):
            label, own, own_error = int(costs.ids[k]), costs.plastic[k], costs.error[k]
            best, best_alone, subject = _best_traced(plastic), _best_traced(own), f"region {label}"
            if decisions.accept("metal", plastic.min(), metal.min(), share=float(not forced), subject=subject):
                _make_metal(gloss, label, metal, costs.colour[k])
            elif decisions.accept("gloss", plastic[-1], plastic[best], error[best], subject=subject) and (
                forced or not decisions.accept("matte_alone", own[best], own[-1], own_error[best], subject=subject)
            ):
                gloss.roughness[label] = _interpolate_minimum(plastic)
            elif decisions.accept("gloss_alone", own[-1], own[best_alone], own_error[best_alone], subject=subject):
                gloss.roughness[label] = _interpolate_minimum(own)
            gloss.decided[label] = True
    return replace(gloss, layered=layered)


def _layered_or_not(observed: GlossObservations) -> tuple[RegionCosts | None, bool]:
    """The better of the costs without and with a dielectric layer over the diffuse light, and whether with it."""
    either = _region_costs(observed)
    if not either:
        return None, False
    plain = either[0]
    explains = [
        np.average(costs.pooled()[0].min(1) * costs.rough / plain.rough, weights=plain.count) for costs in either
    ]
    best = int(np.argmin(explains))
    return either[best], best == 1


def _region_costs(observed: GlossObservations) -> list[RegionCosts]:
    """Costs without and, where there may be one, with a layer over the diffuse light; empty without regions."""
    o = observed
    order = np.argsort(o.region, kind="stable")
    ids, first, count = np.unique(o.region[order], return_index=True, return_counts=True)
    enough = count >= GLOSS_MIN_OBSERVATIONS
    if not enough.any():
        return []
    per_region = [order[start : start + n] for start, n in zip(first[enough], count[enough], strict=True)]
    rows = np.concatenate(per_region)
    _, one, patch = np.unique(o.patch[rows], return_index=True, return_inverse=True)
    region = np.repeat(np.arange(len(per_region)), count[enough])[one]
    fits = RegionFits(
        patch=patch,
        region=region,
        weight=o.weight[rows],
        radiance=o.radiance[rows],
        irradiance=np.maximum(o.irradiance[rows], 1e-5),
    )
    lobes = [[(s0[rows], s1[rows]) for s0, s1 in halves] for halves in o.lobes]
    levels = range(len(GLOSS_LEVELS))
    metals = over_each(levels, lambda k: fits.metal(GLOSS_LEVELS[k], lobes[k]))
    metal, colour = np.stack([fits.mean(cost) for cost, _ in metals], 1), np.stack([colour for _, colour in metals], 1)
    centre = np.stack([o.position[own].mean(0) for own in per_region])
    log_albedo = np.log(np.maximum(o.radiance, 1e-4) / np.maximum(o.irradiance, 1e-4))
    off = [np.abs(log_albedo[own] - np.median(log_albedo[own], axis=0)) for own in per_region]
    texture = MAD * np.array([np.median(each.max(1)) for each in off])
    if o.scanned is None:
        texture[:] = 0
    else:
        texture[~o.scanned[ids[enough]]] = 0
    log_albedo = np.stack([np.median(log_albedo[own], axis=0) for own in per_region])
    in_file = np.arange(int(ids.max()) + 1) if o.in_file is None else o.in_file

    def with_diffuse(factor: NDArray[np.floating]) -> RegionCosts:
        dielectric = over_each(levels, lambda k: fits.dielectric(factor[k][rows], lobes[k]))
        plastic = np.stack([fits.mean(cost) for cost in dielectric], 1)
        error = np.stack([fits.standard_error(dielectric[-1] - cost) for cost in dielectric], 1)
        null = np.maximum(plastic[:, -1:], COST_MIN_ROUGH)
        return RegionCosts(
            ids=ids[enough],
            rough=null[:, 0],
            plastic=plastic / null,
            metal=metal / null,
            error=error / null,
            colour=colour,
            count=count[enough].astype(np.float64),
            centre=centre,
            log_albedo=log_albedo,
            in_file=in_file[ids[enough]],
            texture=texture,
        )

    return [with_diffuse(o.diffuse), *([] if o.layer is None else [with_diffuse(o.diffuse * o.layer)])]


def _make_metal(gloss: Gloss, label: int, cost: NDArray[np.float64], colour: NDArray[np.float64]) -> None:
    """Set the region ``label`` to a metal with costs ``cost`` (levels,) and colours ``colour`` (levels, 3)."""
    gloss.metallic[label] = 1.0
    gloss.roughness[label] = _interpolate_minimum(cost)
    gloss.specular[label] = np.clip(colour[int(np.argmin(cost))], DIELECTRIC_F0, METAL_MAX_COLOUR)


def _best_traced(cost: NDArray[np.float64]) -> int:
    """The best of the traced levels; at the others a surface differs from a rough one by its sheen alone."""
    return int(np.argmin(cost[: len(GLOSS_RAYS)]))


def _interpolate_minimum(cost: NDArray[np.float64]) -> float:
    """Roughness at the vertex of a parabola through the best level and its neighbours, in log roughness."""
    x = np.log(GLOSS_LEVELS)
    k = int(np.argmin(cost))
    if k in (0, len(cost) - 1):
        return GLOSS_LEVELS[k]
    a, b, _ = np.polyfit(x[k - 1 : k + 2], cost[k - 1 : k + 2], 2)
    return float(np.exp(np.clip(-b / (2 * a), x[k - 1], x[k + 1]))) if a > 0 else GLOSS_LEVELS[k]
