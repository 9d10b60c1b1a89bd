"""Roughness and metallic per part, from how its photos change with the view.

For each level of roughness the reflected light is predicted; what remains after it is taken off must be one diffuse
albedo per patch whatever the view, and much the same albedo over a part. A part that shows no view dependence keeps
the rough dielectric it started as: gloss has to earn its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..parallel import over_each
from .ggx import DIELECTRIC_F0
from .gloss_cost import LobeHalves, PartFits
from .part_costs import WELL_OBSERVED, PartCosts

LEVELS = (0.1, 0.2, 0.32, 0.5, 0.7, 1.0)
"""Six roughness levels as in IRIS; between them the best level is interpolated."""
FIT_RAYS = (8, 16, 32, 32)
"""Reflected rays per observation at each level, the wider the lobe the more for its noise. The levels beyond see what
the hemisphere sees; they differ from a rough surface by their sheen alone, which the shape of a diffuse lobe feigns."""
MIN_OBSERVATIONS = 10
MIN_COST = 0.02
"""Cost below which the rough dielectric explains a part but for the noise of the photos."""
MAX_OBSERVATIONS = WELL_OBSERVED
"""Of one part. With a quarter of them large matte walls passed for glossy in one draw and not in the next."""
ALL_OBSERVATIONS = 500_000
"""Of all parts: each has 88 rays, and thousands of parts would fill the memory. redkitchen has 330,000."""
ERRORS_NEEDED = 1.5
"""Standard errors by which a gloss must fit better than the rough dielectric."""
ERRORS_NEEDED_ALONE = 2.0
"""The same for a part whose neighbours of like albedo say otherwise: a white frame is polished on a white wall, and the
wall is matte beside it."""
METAL_GAIN_NEEDED = 0.135
"""Relative fall of the robust residual that a metal must bring over the best dielectric: well observed metals bring
0.16 and more, what is none 0.11 at most."""
MAX_METAL = 0.95
"""Brightest specular colour."""
FEW = 90
"""Observations by which the gain needed is doubled: chance explains a few."""


@dataclass(frozen=True)
class Gloss:
    """Material of each part id.

    Attributes:
        roughness, metallic: (n_parts,).
        specular: (n_parts, 3) reflectance at normal incidence: 4 %, or a metal's colour.
        decided: (n_parts,) bool, the photos decided; elsewhere the default stands.
        layered: whether dielectrics take their light off the diffuse light below them.
    """

    roughness: NDArray[np.float64]
    metallic: NDArray[np.float64]
    specular: NDArray[np.float64]
    decided: NDArray[np.bool_]
    layered: bool = False

    def of_parts(self, material: NDArray[np.integer]) -> Gloss:
        """The same for parts, each with the gloss of its ``material``, (n_parts,)."""
        m = material
        return Gloss(self.roughness[m], self.metallic[m], self.specular[m], self.decided[m], self.layered)

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
        return Gloss(a["roughness"], a["metallic"], a["specular"], a["decided"], bool(a["layered"]))


def rough_everywhere(n_parts: int) -> Gloss:
    """The null hypothesis."""
    specular = np.full((n_parts, 3), DIELECTRIC_F0)
    return Gloss(np.ones(n_parts), np.zeros(n_parts), specular, np.zeros(n_parts, bool))


def choose_observations(
    part: NDArray[np.integer], patch: NDArray[np.integer], weight: NDArray[np.floating], rng: np.random.Generator
) -> NDArray[np.int64]:
    """Indices of the observations to fit on, whole patches with all their views: per part up to MAX_OBSERVATIONS, and
    of many parts up to as many of each as keep all within ALL_OBSERVATIONS."""
    shuffle = rng.permutation(int(patch.max()) + 1)
    usable = np.flatnonzero(weight > 0)
    order = usable[np.lexsort((shuffle[patch[usable]], part[usable]))]
    rank = np.arange(len(order)) - np.searchsorted(part[order], part[order])
    most = min(MAX_OBSERVATIONS, _even_share(np.bincount(part[usable]), ALL_OBSERVATIONS))
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
        given: (n_parts,) what of the capture's own parts each part is a piece of; None if it brings none.
    """

    part: NDArray[np.integer]
    patch: NDArray[np.integer]
    weight: NDArray[np.floating]
    position: NDArray[np.floating]
    radiance: NDArray[np.floating]
    irradiance: NDArray[np.floating]
    diffuse: NDArray[np.floating]
    lobes: Sequence[LobeHalves]
    layer: NDArray[np.floating] | None = None
    given: NDArray[np.integer] | None = None


def fit_gloss(observed: GlossObservations, n_parts: int, forced: bool | None = None) -> Gloss:
    """Fit every part with enough observations.

    Args:
        forced: True takes the best material however little it gains, False none but the rough dielectric.
    """
    gloss = rough_everywhere(n_parts)
    costs, layered = (None, False) if forced is False else _layered_or_not(observed)
    if costs is not None:
        for k, (plastic, metal, error, count) in enumerate(zip(*costs.pooled(), strict=True)):
            label, own, own_error = int(costs.ids[k]), costs.plastic[k], costs.error[k]
            gain_of_metal = 0.0 if forced else (1.0 + FEW / count) * METAL_GAIN_NEEDED
            if metal.min() < (1 - gain_of_metal) * plastic.min():
                _make_metal(gloss, label, metal, costs.colour[k])
            elif forced or (
                _shows_highlight(plastic, error, ERRORS_NEEDED) and not _denies_highlight(own, own_error, plastic)
            ):
                gloss.roughness[label] = _interpolate_minimum(plastic)
            elif _shows_highlight(own, own_error, ERRORS_NEEDED_ALONE):
                gloss.roughness[label] = _interpolate_minimum(own)
            gloss.decided[label] = True
    return replace(gloss, layered=layered)


def _layered_or_not(observed: GlossObservations) -> tuple[PartCosts | None, bool]:
    """Costs with or without a layer over the diffuse light, whichever explains the room better, and whether with."""
    either = _part_costs(observed)
    if not either:
        return None, False
    plain = either[0]
    explains = [
        np.average(costs.pooled()[0].min(1) * costs.rough / plain.rough, weights=plain.count) for costs in either
    ]
    best = int(np.argmin(explains))
    return either[best], best == 1


def _part_costs(observed: GlossObservations) -> list[PartCosts]:
    """Costs without a layer over the diffuse light and, where there may be one, with; nothing without parts to fit."""
    o = observed
    order = np.argsort(o.part, kind="stable")
    ids, first, count = np.unique(o.part[order], return_index=True, return_counts=True)
    enough = count >= MIN_OBSERVATIONS
    if not enough.any():
        return []
    pieces = [order[start : start + n] for start, n in zip(first[enough], count[enough], strict=True)]
    rows = np.concatenate(pieces)
    _, one, patch = np.unique(o.patch[rows], return_index=True, return_inverse=True)
    part = np.repeat(np.arange(len(pieces)), count[enough])[one]
    fits = PartFits(patch, part, o.weight[rows], o.radiance[rows], np.maximum(o.irradiance[rows], 1e-5))
    lobes = [[(s0[rows], s1[rows]) for s0, s1 in halves] for halves in o.lobes]
    levels = range(len(LEVELS))
    metals = over_each(levels, lambda k: fits.metal(LEVELS[k], lobes[k]))
    metal, colour = np.stack([fits.mean(cost) for cost, _ in metals], 1), np.stack([colour for _, colour in metals], 1)
    centre = np.stack([o.position[rows].mean(0) for rows in pieces])
    log_albedo = np.log(np.maximum(o.radiance, 1e-4) / np.maximum(o.irradiance, 1e-4))
    log_albedo = np.stack([np.median(log_albedo[rows], axis=0) for rows in pieces])
    given = np.arange(int(ids.max()) + 1) if o.given is None else o.given

    def with_diffuse(factor: NDArray[np.floating]) -> PartCosts:
        dielectric = over_each(levels, lambda k: fits.dielectric(factor[k][rows], lobes[k]))
        plastic = np.stack([fits.mean(cost) for cost in dielectric], 1)
        error = np.stack([fits.standard_error(dielectric[-1] - cost) for cost in dielectric], 1)
        null = np.maximum(plastic[:, -1:], MIN_COST)
        said = plastic / null, metal / null, error / null
        seen = count[enough].astype(np.float64)
        return PartCosts(ids[enough], null[:, 0], *said, colour, seen, centre, log_albedo, given[ids[enough]])

    return [with_diffuse(o.diffuse), *([] if o.layer is None else [with_diffuse(o.diffuse * o.layer)])]


def _make_metal(gloss: Gloss, label: int, cost: NDArray[np.float64], colour: NDArray[np.float64]) -> None:
    gloss.metallic[label] = 1.0
    gloss.roughness[label] = _interpolate_minimum(cost)
    gloss.specular[label] = np.clip(colour[int(np.argmin(cost))], DIELECTRIC_F0, MAX_METAL)


def _best_traced(cost: NDArray[np.float64]) -> int:
    """The level that fits best of those whose lobes are narrow enough to be traced: no gloss from sheen alone."""
    return int(np.argmin(cost[: len(FIT_RAYS)]))


def _shows_highlight(cost: NDArray[np.float64], error: NDArray[np.float64], errors_needed: float) -> bool:
    """Whether a gloss fits better than the rough dielectric, and not by chance."""
    best = _best_traced(cost)
    return bool(cost[-1] - cost[best] > errors_needed * error[best])


def _denies_highlight(own: NDArray[np.float64], error: NDArray[np.float64], pooled: NDArray[np.float64]) -> bool:
    """Whether a part's own photos are sure against the gloss that it and its neighbours together show."""
    best = _best_traced(pooled)
    return bool(own[best] - own[-1] > ERRORS_NEEDED_ALONE * error[best])


def _interpolate_minimum(cost: NDArray[np.float64]) -> float:
    """Roughness at the vertex of a parabola through the best level and its neighbours, in log roughness."""
    x = np.log(LEVELS)
    k = int(np.argmin(cost))
    if k in (0, len(cost) - 1):
        return LEVELS[k]
    a, b, _ = np.polyfit(x[k - 1 : k + 2], cost[k - 1 : k + 2], 2)
    return float(np.exp(np.clip(-b / (2 * a), x[k - 1], x[k + 1]))) if a > 0 else LEVELS[k]
