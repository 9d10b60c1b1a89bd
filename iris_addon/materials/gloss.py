"""Roughness and metallic per region, from how its photos change with the view.

For each level of roughness the reflected light is predicted; what remains after it is taken off must be one diffuse
albedo per patch whatever the view, and much the same albedo over a region. A region that shows no view dependence keeps
the rough dielectric it started as: gloss has to earn its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..base.compiled import kernel
from ..base.group_by import group_medians
from ..base.parallel import over_each
from ..brdf.ggx import DIELECTRIC_F0
from ..decide import Decisions

WELL_OBSERVED = 2000
"""Observations that regions lend to one at most."""
NEAR = 1.0
"""Metres over which regions of like albedo are taken for pieces of one material."""
LIKE = 0.05
"""Difference in log albedo at which they no longer are."""
LIKE_KIN = 0.1
"""The same for pieces of what the capture says is one region, however far apart: small ones are off by as much."""
NEIGHBOURS = 24


@dataclass(frozen=True)
class RegionCosts:
    """Costs of k regions at every level, and what tells which of them are one material.

    Attributes:
        ids: (k,) part ids.
        rough: (k,) cost of the rough dielectric.
        plastic, metal: (k, levels) relative to that.
        error: (k, levels) standard error of how much ``plastic`` lies below the rough dielectric.
        colour: (k, levels, 3) specular colour of the metal.
        count: (k,) observations.
        centre: (k, 3) metres.
        log_albedo: (k, 3).
        given: (k,) what of the capture's own regions each is a piece of.
    """

    ids: NDArray[np.integer]
    rough: NDArray[np.float64]
    plastic: NDArray[np.float64]
    metal: NDArray[np.float64]
    error: NDArray[np.float64]
    colour: NDArray[np.float64]
    count: NDArray[np.float64]
    centre: NDArray[np.float64]
    log_albedo: NDArray[np.float64]
    given: NDArray[np.integer]

    def pooled(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Plastic and metal costs of every region averaged with those of near regions of like albedo and of its kin,
        pieces of the same region of the capture; the error of such an average, and the observations behind it."""
        near, first = self._candidates()
        own = near == np.arange(len(near))[:, None]
        kin = self.given[near] == self.given[:, None]
        distance = np.linalg.norm(self.centre[near] - self.centre[:, None], axis=-1) / NEAR
        unlike = np.abs(self.log_albedo[near] - self.log_albedo[:, None]).max(-1)
        apart = np.where(kin, (unlike / LIKE_KIN) ** 2, distance**2 + (unlike / LIKE) ** 2)
        say = np.where(first & ~own, self.count[near] * np.exp(-0.5 * apart), 0.0)
        # However many they are, a region that was well observed itself is not outvoted.
        say *= np.minimum(1.0, WELL_OBSERVED / np.maximum(say.sum(1, keepdims=True), 1e-9))
        say += (first & own) * self.count[:, None]
        total = say.sum(1)
        say /= total[:, None]
        return (
            np.einsum("kn,knl->kl", say, self.plastic[near]),
            np.einsum("kn,knl->kl", say, self.metal[near]),
            np.sqrt(np.einsum("kn,knl->kl", say**2, self.error[near] ** 2)),
            total,
        )

    def _candidates(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(k, m) regions that may be of one material with each: the nearest, itself among them, and the best observed
        of its kin; and where in a row a region is listed first."""
        n = len(self.ids)
        near = cKDTree(self.centre).query(self.centre, k=min(NEIGHBOURS, n))[1].reshape(n, -1)
        best = np.lexsort((-self.count, self.given))
        rank = np.arange(n) - np.searchsorted(self.given[best], self.given[best])
        most = min(NEIGHBOURS, int(rank.max()) + 1)  # one where the capture brings no regions
        listed = rank < most
        kin = np.full((int(self.given.max()) + 1, most), -1)
        kin[self.given[best[listed]], rank[listed]] = best[listed]
        kin = kin[self.given]
        other = (kin >= 0) & ~(kin[:, :, None] == near[:, None]).any(-1)
        return np.concatenate([near, kin], 1), np.concatenate([np.ones(near.shape, bool), other], 1)


# ---- How badly each gloss explains the photos of every region -------------------------------------------------------


SPATIAL_WEIGHT = 0.35
"""Say of "the albedo is even over the region" against "the albedo is the same from every view"."""
ROBUST = 0.15
MOST, DARK = 1.2, 1e-4
"""Largest albedo of a patch, and radiance below which residuals are no longer relative."""
WIDE = 0.4
"""Roughness from which the lobes of few rays are too noisy to tell a metal."""
LobeHalves = Sequence[tuple[NDArray[np.floating], NDArray[np.floating]]]
"""(Ls0, Ls1) from two independent sets of rays, or once where there is no noise to tell apart."""


@dataclass(frozen=True)
class RegionFits:
    """Observations of k regions, m in all; ``patch`` (m,) and ``region``, (n,) of each of the n patches, count from
    0."""

    patch: NDArray[np.integer]
    region: NDArray[np.integer]
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
        albedo, norm = np.zeros((2, len(self.region), 3))
        _fit(self.patch, self.weight, explained, per_albedo, albedo, norm)
        return _Solved(explained, per_albedo, albedo, self._medians(albedo))

    def _medians(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k, C) median of the patches' values (n, C) per region."""
        return group_medians(values, self.region, int(self.region.max()) + 1)

    def mean(self, cost: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k,) mean over the observations of each region of what its patches (n,) cost."""
        say = self._say
        return np.bincount(self.region, say * cost) / np.bincount(self.region, say)

    def standard_error(self, cost: NDArray[np.floating]) -> NDArray[np.float64]:
        """(k,) of :meth:`mean`, from how much the patches of a region differ; of a single patch, as large as the
        mean."""
        say, mean, n = self._say, self.mean(cost), np.bincount(self.region)
        off = say * (cost - mean[self.region])
        spread = np.sqrt(np.bincount(self.region, off**2)) / np.bincount(self.region, say)
        return np.where(n > 1, spread * np.sqrt(n / np.maximum(n - 1, 1)), np.abs(mean))

    @cached_property
    def _say(self) -> NDArray[np.float64]:
        """(n,) observations of each patch, by weight."""
        return np.asarray(np.bincount(self.patch, self.weight, len(self.region)), np.float64)

    def _cost(self, halves: Sequence[_Solved]) -> NDArray[np.float64]:
        """(n,) robust mean of the squared residuals, less the noise of few rays.

        The square of a noisy residual has the noise's variance in it, and the smooth null hypothesis would always
        win. The product of two residuals from independent halves of the rays has not; it is averaged over the views of
        a patch before the robust loss, which would shrink what is noisy.
        """
        sums = np.zeros((2, len(self.region), 3))
        _add_products(self.patch, self.region, self.weight, self.radiance, halves[0], halves[-1], sums)
        views, space = _robust(sums / self._say[:, None])
        return (views + SPATIAL_WEIGHT * space).mean(1)


class _Solved(NamedTuple):
    """Radiance that albedo has to explain and light per albedo, (m, 3) each; the albedo of each patch (n, 3) and its
    median over each region (k, 3)."""

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
    region: NDArray[np.integer],
    weight: NDArray[np.floating],
    radiance: NDArray[np.floating],
    one: _Solved,
    other: _Solved,
    sums: NDArray[np.float64],
) -> None:
    """Add up products (2, n, 3) of the relative residuals of either half: between the views of a patch, and between
    patches of a region."""
    for i in range(len(patch)):
        p, k = patch[i], region[patch[i]]
        for c in range(3):
            say = weight[i] / max(radiance[i, c], DARK) ** 2
            x, y = one.per_albedo[i, c], other.per_albedo[i, c]
            a, b = one.explained[i, c], other.explained[i, c]
            sums[0, p, c] += say * (one.albedo[p, c] * x - a) * (other.albedo[p, c] * y - b)
            sums[1, p, c] += say * (one.median[k, c] * x - a) * (other.median[k, c] * y - b)


def _robust(square: NDArray[np.floating]) -> NDArray[np.floating]:
    """Cauchy's loss of squared residuals that noise may have made negative."""
    return np.copysign(np.log1p(np.abs(square) / ROBUST**2), square)


LEVELS = (0.1, 0.2, 0.32, 0.5, 0.7, 1.0)
"""Six roughness levels as in IRIS; between them the best level is interpolated."""
FIT_RAYS = (8, 16, 32, 32)
"""Reflected rays per observation at each level, the wider the lobe the more for its noise. The levels beyond see what
the hemisphere sees; they differ from a rough surface by their sheen alone, which the shape of a diffuse lobe feigns."""
MIN_OBSERVATIONS = 10
MIN_COST = 0.02
"""Cost below which the rough dielectric explains a region but for the noise of the photos."""
MAX_OBSERVATIONS = WELL_OBSERVED
"""Of one region. With a quarter of them large matte walls passed for glossy in one draw and not in the next."""
ALL_OBSERVATIONS = 500_000
"""Of all regions: each has 88 rays, and thousands of regions would fill the memory. redkitchen has 330,000."""
MAX_METAL = 0.95
"""Brightest specular colour."""
FEW = 90
"""Observations by which the gain needed is doubled: chance explains a few."""


@dataclass(frozen=True)
class Gloss:
    """Material of each region id.

    Attributes:
        roughness, metallic: (n_regions,).
        specular: (n_regions, 3) reflectance at normal incidence: 4 %, or a metal's colour.
        decided: (n_regions,) bool, the photos decided; elsewhere the default stands.
        layered: whether dielectrics take their light off the diffuse light below them.
    """

    roughness: NDArray[np.float64]
    metallic: NDArray[np.float64]
    specular: NDArray[np.float64]
    decided: NDArray[np.bool_]
    layered: bool = False

    def of_regions(self, material: NDArray[np.integer]) -> Gloss:
        """The same for regions, each with the gloss of its ``material``, (n_regions,)."""
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
    """The null hypothesis."""
    specular = np.full((n_regions, 3), DIELECTRIC_F0)
    return Gloss(np.ones(n_regions), np.zeros(n_regions), specular, np.zeros(n_regions, bool))


def choose_observations(
    region: NDArray[np.integer], patch: NDArray[np.integer], weight: NDArray[np.floating], rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices of the observations to fit on, whole patches with all their views: per region up to MAX_OBSERVATIONS, and
    of many regions up to as many of each as keep all within ALL_OBSERVATIONS."""
    shuffle = rng.permutation(int(patch.max()) + 1)
    usable = np.flatnonzero(weight > 0)
    order = usable[np.lexsort((shuffle[patch[usable]], region[usable]))]
    rank = np.arange(len(order)) - np.searchsorted(region[order], region[order])
    most = min(MAX_OBSERVATIONS, _even_share(np.bincount(region[usable]), ALL_OBSERVATIONS))
    return np.sort(order[rank < most])


def _even_share(counts: NDArray[np.integer], total: int) -> int:
    """How many each may have at most, so that those who have ``counts`` (n,) have ``total`` together or less."""
    ascending = np.sort(counts)
    left = total - np.concatenate([[0], np.cumsum(ascending)[:-1]])
    share = left // np.arange(len(ascending), 0, -1)
    return int(share[np.argmax(share < ascending)]) if (share < ascending).any() else total


@dataclass(frozen=True)
class GlossObservations:
    """Observations that gloss is fitted to, m of them.

    Attributes:
        part, patch, weight: (m,).
        position: (m, 3) metres.
        radiance: (m, 3) observed.
        irradiance: (m, 3) irradiance / pi.
        diffuse: (levels, m) factor of the diffuse lobe towards the camera.
        lobes: per level of LEVELS, (Ls0, Ls1), (m, 3) each, from either half of the rays; once if free of noise.
        layer: (levels, m) further factor if dielectrics take their light off the diffuse light below; None where the
            diffuse lobe is of a model in which they do not.
        given: (n_regions,) what of the capture's own regions each region is a piece of; None if it brings none.
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
    given: NDArray[np.integer] | None = None


def fit_gloss(observed: GlossObservations, n_regions: int, decisions: Decisions) -> Gloss:
    """Fit every region with enough observations.

    Args:
        decisions: where gloss and metal are decided. Gloss that is forced takes the best material however little it
            gains; where it is forbidden all stay rough dielectrics.
    """
    gloss, forced = rough_everywhere(n_regions), decisions.forces("gloss")
    costs, layered = (None, False) if decisions.forbids("gloss") else _layered_or_not(observed)
    if costs is not None:
        for k, (plastic, metal, error, count) in enumerate(zip(*costs.pooled(), strict=True)):
            label, own, own_error = int(costs.ids[k]), costs.plastic[k], costs.error[k]
            best, best_alone, subject = _best_traced(plastic), _best_traced(own), f"region {label}"
            share = 0.0 if forced else 1.0 + FEW / count
            if decisions.accept("metal", plastic.min(), metal.min(), share=share, subject=subject):
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
    """Costs with or without a layer over the diffuse light, whichever explains the room better, and whether with."""
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
    """Costs without a layer over the diffuse light and, where there may be one, with; nothing without regions to
    fit."""
    o = observed
    order = np.argsort(o.region, kind="stable")
    ids, first, count = np.unique(o.region[order], return_index=True, return_counts=True)
    enough = count >= MIN_OBSERVATIONS
    if not enough.any():
        return []
    pieces = [order[start : start + n] for start, n in zip(first[enough], count[enough], strict=True)]
    rows = np.concatenate(pieces)
    _, one, patch = np.unique(o.patch[rows], return_index=True, return_inverse=True)
    region = np.repeat(np.arange(len(pieces)), count[enough])[one]
    fits = RegionFits(
        patch=patch,
        region=region,
        weight=o.weight[rows],
        radiance=o.radiance[rows],
        irradiance=np.maximum(o.irradiance[rows], 1e-5),
    )
    lobes = [[(s0[rows], s1[rows]) for s0, s1 in halves] for halves in o.lobes]
    levels = range(len(LEVELS))
    metals = over_each(levels, lambda k: fits.metal(LEVELS[k], lobes[k]))
    metal, colour = np.stack([fits.mean(cost) for cost, _ in metals], 1), np.stack([colour for _, colour in metals], 1)
    centre = np.stack([o.position[rows].mean(0) for rows in pieces])
    log_albedo = np.log(np.maximum(o.radiance, 1e-4) / np.maximum(o.irradiance, 1e-4))
    log_albedo = np.stack([np.median(log_albedo[rows], axis=0) for rows in pieces])
    given = np.arange(int(ids.max()) + 1) if o.given is None else o.given

    def with_diffuse(factor: NDArray[np.floating]) -> RegionCosts:
        dielectric = over_each(levels, lambda k: fits.dielectric(factor[k][rows], lobes[k]))
        plastic = np.stack([fits.mean(cost) for cost in dielectric], 1)
        error = np.stack([fits.standard_error(dielectric[-1] - cost) for cost in dielectric], 1)
        null = np.maximum(plastic[:, -1:], MIN_COST)
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
            given=given[ids[enough]],
        )

    return [with_diffuse(o.diffuse), *([] if o.layer is None else [with_diffuse(o.diffuse * o.layer)])]


def _make_metal(gloss: Gloss, label: int, cost: NDArray[np.float64], colour: NDArray[np.float64]) -> None:
    gloss.metallic[label] = 1.0
    gloss.roughness[label] = _interpolate_minimum(cost)
    gloss.specular[label] = np.clip(colour[int(np.argmin(cost))], DIELECTRIC_F0, MAX_METAL)


def _best_traced(cost: NDArray[np.float64]) -> int:
    """The level that fits best of those whose lobes are narrow enough to be traced: no gloss from sheen alone."""
    return int(np.argmin(cost[: len(FIT_RAYS)]))


def _interpolate_minimum(cost: NDArray[np.float64]) -> float:
    """Roughness at the vertex of a parabola through the best level and its neighbours, in log roughness."""
    x = np.log(LEVELS)
    k = int(np.argmin(cost))
    if k in (0, len(cost) - 1):
        return LEVELS[k]
    a, b, _ = np.polyfit(x[k - 1 : k + 2], cost[k - 1 : k + 2], 2)
    return float(np.exp(np.clip(-b / (2 * a), x[k - 1], x[k + 1]))) if a > 0 else LEVELS[k]
