"""Roughness and metallic per region, from how its photos change with the view.

For each level of roughness the specular light is predicted and subtracted. What remains must be one diffuse albedo per
patch, whatever the view, and about the same albedo over a region; the cost of a gloss, equation (24), measures the
deviation (:class:`.RegionFits`). Costs are pooled over regions that may be of one material, equation (25)
(:class:`.RegionLikeness`). A region is metallic only if that lowers its cost enough, and glossy only if photos show the
highlights that the gloss predicts, equation (26) (:func:`fit_gloss`); otherwise it stays the rough dielectric it
started as.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import MAD, rank_in_group
from ..base.parallel import over_each
from ..brdf.ggx import DIELECTRIC_F0
from ..decide import METAL_COLOURS, Decisions
from .region_costs import RegionCosts
from .region_fits import LobeHalves, RegionFits
from .region_likeness import POOL_MAX_OBSERVATIONS, RegionLikeness
from .shown_highlights import find_highlights

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
        known: (m,) from 0 to 1, how well the normal is known; None where a modeller gave it.
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
    known: NDArray[np.floating] | None = None

    @staticmethod
    def joined(states: Sequence[GlossObservations], n_patches: int) -> GlossObservations:
        """The observations of several light states, in each of which ``n_patches`` patches are patches of their own: an
        error of the light of one state is none of the view."""
        first = states[0]
        if len(states) == 1:
            return first

        def levels(column: str) -> NDArray[np.floating]:
            return np.concatenate([getattr(own, column) for own in states], axis=1)

        rows = {
            column: np.concatenate([getattr(own, column) for own in states])
            for column in ("region", "weight", "position", "radiance", "irradiance")
        }
        return replace(
            first,
            patch=np.concatenate([own.patch + k * n_patches for k, own in enumerate(states)]),
            diffuse=levels("diffuse"),
            lobes=[
                [tuple(map(np.concatenate, zip(*half, strict=True))) for half in zip(*halves, strict=True)]
                for halves in zip(*(own.lobes for own in states), strict=True)
            ],
            layer=None if first.layer is None else levels("layer"),
            known=None if first.known is None else np.concatenate([np.asarray(own.known) for own in states]),
            **rows,
        )


def fit_gloss(observed: GlossObservations, n_regions: int, decisions: Decisions) -> Gloss:
    """Roughness and metallic of every region with enough observations, decided by equation (26).

    Args:
        decisions: where gloss and metal are decided. If gloss is forced, each region takes the best material however
            little it gains; if it is forbidden, all stay rough dielectrics.
    """
    gloss, forced = rough_everywhere(n_regions), decisions.forces("gloss")
    regions = None if decisions.forbids("gloss") else _Regions.observed(observed)
    if regions is None:
        return gloss
    costs, factor, layered = _layered_or_not(regions, observed)
    plastics, metals, errors = costs.pooled
    highlights = find_highlights(regions.fits, regions.position, factor, regions.lobes, len(GLOSS_RAYS), regions.known)
    evidence = regions.like.with_like(highlights.evidence).max(1)
    for k, (plastic, metal) in enumerate(zip(plastics, metals, strict=True)):
        label, level = int(regions.ids[k]), int(np.argmin(plastic[: len(GLOSS_RAYS)]))
        subject = f"region {label}"
        as_metal = _metal_costs(
            costs, k, plastic, metal, partial(decisions.accept, share=float(not forced), subject=subject)
        )
        if as_metal is not None:
            _make_metal(gloss, label, as_metal, costs.colour[k])
        elif forced:
            if decisions.accept("gloss", plastic[-1], plastic.min(), subject=subject):
                gloss.roughness[label] = _interpolate_minimum(plastic, int(np.argmin(plastic)))
        elif decisions.accept("highlights", 0.0, -evidence[k], 1.0, subject=subject) or (
            evidence[k] > 0
            and decisions.accept("gloss", plastic[-1], plastic[level], errors[k, level], subject=subject)
        ):
            gloss.roughness[label] = _interpolate_minimum(plastic, level)
        gloss.decided[label] = True
    return replace(gloss, layered=layered)


def _metal_costs(
    costs: RegionCosts, k: int, plastic: NDArray[np.float64], metal: NDArray[np.float64], decide: Callable[..., bool]
) -> NDArray[np.float64] | None:
    """Costs (traced levels,) of region ``k`` as a metal, None if it is none.

    It is one by the costs ``plastic`` and ``metal`` (levels,) pooled with its like, or for certain by its own: a mirror
    in its frame, whose picture of the room passes for a texture like that of the wood. What as a metal would be darker
    or brighter than any is none: black lacquer also shows no light but what it reflects. Nor is one looked for at
    levels whose reflections are not traced.
    """
    traced, (darkest, brightest) = len(GLOSS_RAYS), METAL_COLOURS
    for name, dielectric, cost, error in (
        ("metal", plastic, metal, np.zeros(traced)),
        ("metal_alone", costs.plastic[k], costs.metal[k], costs.metal_error[k]),
    ):
        level = int(np.argmin(cost[:traced]))
        possible = darkest <= costs.colour[k, level].max() <= brightest
        if possible and decide(name, dielectric.min(), cost[level], error[level]):
            return cost[:traced]
    return None


def _layered_or_not(regions: _Regions, observed: GlossObservations) -> tuple[RegionCosts, NDArray[np.floating], bool]:
    """The better of the costs without and with a dielectric layer over the diffuse light, the view factors (levels, m)
    of the diffuse lobe under it, and whether it is the one with."""
    factors = [observed.diffuse, *([] if observed.layer is None else [observed.diffuse * observed.layer])]
    factors = [factor[:, regions.rows] for factor in factors]
    either = [regions.costs(factor) for factor in factors]
    plain = either[0]
    explains = [
        np.average(costs.pooled[0].min(1) * costs.rough / plain.rough, weights=regions.like.count) for costs in either
    ]
    best = int(np.argmin(explains))
    return either[best], factors[best], best == 1


@dataclass(frozen=True)
class _Regions:
    """The k regions that enough observations show, with these observations.

    Attributes:
        ids: (k,) region ids.
        rows: (m,) indices of the observations, region by region.
        fits: the observations, with regions and patches numbered from 0.
        position: (m, 3) metres.
        lobes: per level, the specular lobes of both halves of the rays.
        like: which of the regions may be of one material.
        known: (k,) from 0 to 1, how well their normals are known.
    """

    ids: NDArray[np.integer]
    rows: NDArray[np.int64]
    fits: RegionFits
    position: NDArray[np.floating]
    lobes: list[LobeHalves]
    like: RegionLikeness
    known: NDArray[np.float64]

    @staticmethod
    def observed(o: GlossObservations) -> _Regions | None:
        """The regions of all observations; None if there are none."""
        order = np.argsort(o.region, kind="stable")
        ids, first, count = np.unique(o.region[order], return_index=True, return_counts=True)
        enough = count >= GLOSS_MIN_OBSERVATIONS
        if not enough.any():
            return None
        ids = ids[enough]
        per_region = [order[start : start + n] for start, n in zip(first[enough], count[enough], strict=True)]
        rows = np.concatenate(per_region)
        _, one, patch = np.unique(o.patch[rows], return_index=True, return_inverse=True)
        log_albedo = np.log(np.maximum(o.radiance, 1e-4) / np.maximum(o.irradiance, 1e-4))
        off = [np.abs(log_albedo[own] - np.median(log_albedo[own], axis=0)) for own in per_region]
        texture = MAD * np.array([np.median(each.max(1)) for each in off])
        scanned = np.zeros(len(ids), bool) if o.scanned is None else o.scanned[ids]
        known = np.ones(len(o.weight)) if o.known is None else o.known
        known_of = np.array([known[own].mean() for own in per_region])
        return _Regions(
            ids=ids,
            rows=rows,
            fits=RegionFits(
                patch=patch,
                region=np.repeat(np.arange(len(ids)), count[enough])[one],
                weight=o.weight[rows] * known[rows],
                radiance=o.radiance[rows],
                irradiance=np.maximum(o.irradiance[rows], 1e-5),
            ),
            position=o.position[rows],
            lobes=[[(s0[rows], s1[rows]) for s0, s1 in halves] for halves in o.lobes],
            like=RegionLikeness(
                count=np.asarray(count[enough] * known_of, np.float64),
                centre=np.stack([o.position[own].mean(0) for own in per_region]),
                log_albedo=np.stack([np.median(log_albedo[own], axis=0) for own in per_region]),
                in_file=ids if o.in_file is None else o.in_file[ids],
                texture=np.where(scanned, texture, 0.0),
                scanned=scanned,
            ),
            known=known_of,
        )

    def costs(self, factor: NDArray[np.floating]) -> RegionCosts:
        """Costs of every level under the view factors ``factor`` (levels, m) of the diffuse lobe."""
        levels, fits = range(len(GLOSS_LEVELS)), self.fits
        dielectric = over_each(levels, lambda k: fits.dielectric(factor[k], self.lobes[k]))
        plastic = np.stack([fits.mean(cost) for cost in dielectric], 1)
        error = np.stack([fits.standard_error(dielectric[-1] - cost) for cost in dielectric], 1)
        null = np.maximum(plastic[:, -1:], COST_MIN_ROUGH)
        best = np.argmin(plastic, axis=1)[fits.region]
        best_dielectric = np.stack(dielectric)[best, np.arange(len(best))]
        return RegionCosts(
            like=self.like,
            rough=null[:, 0],
            plastic=plastic / null,
            metal=np.stack([fits.mean(cost) for cost, _ in self._metals], 1) / null,
            error=error / null,
            metal_error=np.stack([fits.standard_error(best_dielectric - cost) for cost, _ in self._metals], 1) / null,
            colour=np.stack([colour for _, colour in self._metals], 1),
        )

    @cached_property
    def _metals(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Per level the costs (n,) of patches as metals, which have no diffuse part, and specular colours (k, 3)."""
        return over_each(range(len(GLOSS_LEVELS)), lambda k: self.fits.metal(GLOSS_LEVELS[k], self.lobes[k]))


def _make_metal(gloss: Gloss, label: int, cost: NDArray[np.float64], colour: NDArray[np.float64]) -> None:
    """Set the region ``label`` to a metal with costs ``cost`` (levels,) and colours ``colour`` (levels, 3)."""
    gloss.metallic[label] = 1.0
    gloss.roughness[label] = _interpolate_minimum(cost, int(np.argmin(cost)))
    gloss.specular[label] = np.clip(colour[int(np.argmin(cost))], DIELECTRIC_F0, METAL_MAX_COLOUR)


def _interpolate_minimum(cost: NDArray[np.float64], k: int) -> float:
    """Roughness at the vertex of a parabola through level ``k`` and its neighbours, in log roughness."""
    x = np.log(GLOSS_LEVELS)
    if k in (0, len(cost) - 1):
        return GLOSS_LEVELS[k]
    a, b, _ = np.polyfit(x[k - 1 : k + 2], cost[k - 1 : k + 2], 2)
    return float(np.exp(np.clip(-b / (2 * a), x[k - 1], x[k + 1]))) if a > 0 else GLOSS_LEVELS[k]
