"""Errors of the light removed from texture, as far as surfaces are painted evenly.

Albedo is a quotient of radiance and irradiance, so that a painted wall shows the errors of the light: slow blotches of
a few percent, and tens of percent beside mouldings and in corners, where irradiance changes within a patch.

- :func:`residual_light` takes slow changes over a region for errors of the light, before texels are fused.
- :func:`shared_paint` finds regions whose colours agree within the errors of the light.
- :func:`find_paint` models a region as a mixture of one paint, which departs from its colour by errors of the light
  alone, and detail, which departs from it freely. The share of detail is fitted to the texels by expectation and
  maximisation (Dempster, Laird and Rubin 1977). Texels that are paint get its colour; wood, weaves and joints between
  tiles stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from ..base.group_by import MAD, group_medians, group_sums, rank_in_group, stable_order
from ..base.parallel import filled
from ..surface.irradiance import IrradianceField
from .bake import DIM_ALBEDO

LIGHT_ERROR, LIGHT_ERROR_PER_SPREAD = 0.015, 0.7
"""Standard deviation of the log irradiance at a well-lit pixel: where irradiance is uniform, and per spread of log
irradiance over the neighbouring patches. Over surfaces of one colour in four rooms, log albedo departs by 0.012 to
0.019 where that spread is below 0.03, and by 0.08 to 0.10 where it is 0.2 to 0.4."""
LIGHT_ERROR_EVERYWHERE = 0.02
"""Standard deviation of the irradiance itself, in medians of the irradiance of all pixels: what reaches a dark corner
by several reflections is small, its error is not."""
CHROMA_RATIO = 0.5
"""Departure in colour over that in brightness, of paint and of detail: in those rooms 0.2 to 0.6."""
DETAIL_MIN_SPREAD, DETAIL_START_SPREAD = 0.05, 0.3
"""Standard deviation of the log albedo of detail: the least, and where the fit starts."""
PAINT_MIN_TEXELS, PAINT_MAX_TEXELS = 20, 4000
"""Texels that a region must have to be fitted, and texels of it that are used."""
PAINT_ROUNDS = 12
"""Rounds of expectation and maximisation."""
PLAIN_MAX_DETAIL = 0.05
"""Share of detail below which a region is of one colour."""
SHARED_BASE_ERROR = 0.04
"""Standard deviation of the log albedo of a whole region where irradiance is uniform: its light is off as a whole by
more than from pixel to pixel."""
SHARED_TEXTURE_ERROR = 0.25
"""Error of the median of a textured region, in spreads of its texels."""
SHARED_MIN_TEXELS = 5
"""Texels that a region must have to share a paint."""
RESIDUAL_ERROR = 0.03
"""Standard deviation of the log irradiance of patches, as far as it changes slowly over a region. Paints that differ by
more in one region, as ceiling and walls of one piece do, are kept apart."""
RESIDUAL_WIDTH = 3.0
"""Standard deviation, in patch sizes, of the kernel that keeps slow changes."""
RESIDUAL_STAIN = 10 / 3
"""Errors of the light from which on a slow difference of log albedo is taken for a stain."""


@dataclass(frozen=True)
class Paint:
    """The paint of each region.

    Attributes:
        level: (n_regions, 3) log of the paint's albedo + DIM_ALBEDO.
        detail: (n_regions,) share of the region that is detail; 1 for a region without paint.
        spread: (n_regions,) standard deviation of the log albedo of detail, without errors of the light.
    """

    level: NDArray[np.float64]
    detail: NDArray[np.float64]
    spread: NDArray[np.float64]

    @property
    def plain_regions(self) -> int:
        """Number of regions with a share of detail below PLAIN_MAX_DETAIL: of one colour."""
        return int((self.detail < PLAIN_MAX_DETAIL).sum())

    @property
    def paints(self) -> int:
        """Number of paints that the regions share."""
        return len(np.unique(self.level[self.detail < 1], axis=0))

    def of_regions(self, label: NDArray[np.integer]) -> Paint:
        """Each region with the paint of the region ``label`` (n_regions,) that represents it."""
        return Paint(self.level[label], self.detail[label], self.spread[label])

    def departure(self, log_albedo: NDArray[np.floating], region: NDArray[np.integer]) -> NDArray[np.floating]:
        """(n,) squared distance of log albedo (n, 3) from the paint of its region, mean over brightness and the two
        dimensions of colour, in units of the variance of brightness."""
        off = log_albedo - self.level[region]
        grey = off.mean(1)
        return (grey**2 + ((off - grey[:, None]) ** 2).sum(1) / CHROMA_RATIO**2) / 3

    def chance(
        self, departure: NDArray[np.floating], error: NDArray[np.floating], region: NDArray[np.integer]
    ) -> NDArray[np.floating]:
        """(n,) probability that texels of a :meth:`departure` (n,) are paint.

        Args:
            error: (n,) standard deviation of the log irradiance behind each.
        """
        paint, detail = error**2, self.spread[region] ** 2 + error**2
        narrower = np.log(detail / paint) - departure * (1 / paint - 1 / detail)
        return expit(logit(1 - self.detail[region]) + 1.5 * narrower)

    def evened(
        self, albedo: NDArray[np.floating], error: NDArray[np.floating], region: NDArray[np.integer]
    ) -> NDArray[np.float32]:
        """(n, 3) albedo, of texels that are paint replaced by the colour of their paint."""

        def work(rows: slice) -> NDArray[np.floating]:
            log_albedo, own = np.log(albedo[rows] + DIM_ALBEDO), region[rows]
            share = self.chance(self.departure(log_albedo, own), error[rows], own)[:, None]
            mixed = np.exp(log_albedo + share * (self.level[own] - log_albedo)) - DIM_ALBEDO
            return np.where(share > 0, np.maximum(mixed, 0.0), albedo[rows])

        return filled(np.empty(albedo.shape, np.float32), work)

    def colour(self, mean: NDArray[np.floating]) -> NDArray[np.float64]:
        """(n_regions, 3) expected albedo of a region: its paint and its ``mean`` (n_regions, 3), by the share of
        detail."""
        painted = np.maximum(np.exp(self.level) - DIM_ALBEDO, 0.0)
        return mean + (1 - self.detail[:, None]) * (painted - mean)


def light_error(spread: NDArray[np.floating], brightness: NDArray[np.floating]) -> NDArray[np.floating]:
    """Standard deviation of log irradiance.

    Args:
        spread: (n,) of the log irradiance over the neighbouring patches.
        brightness: (n,) irradiance in medians of that of all pixels.
    """
    everywhere = LIGHT_ERROR_EVERYWHERE / np.maximum(brightness, LIGHT_ERROR_EVERYWHERE)
    return np.sqrt(LIGHT_ERROR**2 + (LIGHT_ERROR_PER_SPREAD * spread) ** 2 + everywhere**2)


def best_lit(error: NDArray[np.floating], region: NDArray[np.integer], n_regions: int) -> NDArray[np.bool_]:
    """(T,) bool, the half of each region's texels whose light is known best, from which its colour is read."""
    return error <= group_medians(error[:, None], region, n_regions)[region, 0]


def find_paint(
    albedo: NDArray[np.floating],
    error: NDArray[np.floating],
    region: NDArray[np.integer],
    painted: NDArray[np.bool_],
) -> Paint:
    """The paint of every region that has enough texels.

    Args:
        albedo: (T, 3) of texels that photos show well.
        error: (T,) standard deviation of the log irradiance behind each.
        region: (T,) region of each.
        painted: (n_regions,) bool, regions that may have a paint; the others are all detail.
    """
    n_regions = len(painted)
    count = np.bincount(region, minlength=n_regions)
    fitted = painted & (count >= PAINT_MIN_TEXELS)
    rows = _some_of_each(region, count)
    rows = rows[fitted[region[rows]]]
    log_albedo = np.log(albedo[rows].astype(np.float64) + DIM_ALBEDO)
    error, region = error[rows].astype(np.float64), region[rows]
    sure = best_lit(error, region, n_regions)
    level = group_medians(log_albedo[sure], region[sure], n_regions)
    paint = Paint(level, np.where(fitted, 0.5, 1.0), np.full(n_regions, DETAIL_START_SPREAD))
    total = np.bincount(region, minlength=n_regions)
    for _ in range(PAINT_ROUNDS):
        paint = _refined(paint, log_albedo, error, region, fitted, total)
    return paint


def _some_of_each(region: NDArray[np.integer], count: NDArray[np.integer]) -> NDArray[np.int64]:
    """Indices of up to PAINT_MAX_TEXELS texels of each region, spread evenly over its ``count`` (n_regions,)."""
    order = stable_order(region.astype(np.int64))
    rank = rank_in_group(region[order])
    step = -(-count // PAINT_MAX_TEXELS)
    return order[rank % step[region[order]] == 0]


def _refined(
    paint: Paint,
    log_albedo: NDArray[np.float64],
    error: NDArray[np.float64],
    region: NDArray[np.integer],
    fitted: NDArray[np.bool_],
    total: NDArray[np.integer],
) -> Paint:
    """The paint of greatest likelihood if each texel is paint with its probability under ``paint``: one round."""
    n = len(fitted)
    departure = paint.departure(log_albedo, region)
    chance = paint.chance(departure, error, region)
    weight, other = chance / error**2, 1 - chance
    sums = group_sums(
        np.column_stack([weight[:, None] * log_albedo, weight, other, other * (departure - error**2)]), region, n
    )
    level = np.where(sums[:, 3:4] > 0, sums[:, :3] / np.maximum(sums[:, 3:4], 1e-300), paint.level)
    # Half a texel more of each kind: a share of exactly 0 or 1 could never change again.
    detail = np.where(fitted, (sums[:, 4] + 0.5) / (total + 1), 1.0)
    variance = sums[:, 5] / np.maximum(sums[:, 4], 1e-9)
    return Paint(level, detail, np.sqrt(np.maximum(variance, DETAIL_MIN_SPREAD**2)))


# ---- paint that several regions share ------------------------------------------------------------------------------


def shared_paint(
    albedo: NDArray[np.floating],
    error: NDArray[np.floating],
    region: NDArray[np.integer],
    painted: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(n_regions,) label of each region, the same for regions of one paint: the largest of them.

    The slats of a blind, the mouldings of a window and its frame are regions of their own but of one paint. The light
    beside a moulding is wrong by a tenth, and so is the colour of a small region there; large regions of the same paint
    are more reliable. Regions are joined as far as their colours agree within the errors of the light (DP-means, Kulis
    and Jordan, ICML 2012, with the largest regions first).

    Args:
        albedo: (T, 3) of texels that photos show well, NaN in channels that all photos clip.
        error: (T,) standard deviation of the log irradiance behind each.
        region: (T,) region of each.
        painted: (n_regions,) bool, regions that may share their paint.
    """
    n_regions = len(painted)
    label = np.arange(n_regions, dtype=np.int32)
    size = np.bincount(region, minlength=n_regions)
    whole = np.isfinite(albedo).all(1) & painted[region]
    log_albedo, error, region = np.log(albedo[whole] + DIM_ALBEDO), error[whole], region[whole]
    sure = best_lit(error, region, n_regions)
    log_albedo, error, region = log_albedo[sure], error[sure], region[sure]
    level = group_medians(log_albedo, region, n_regions)
    texture = group_medians(np.abs(log_albedo - level[region]), region, n_regions).max(1) * MAD
    light = group_medians(error[:, None], region, n_regions)[:, 0]
    variance = SHARED_BASE_ERROR**2 + light**2 + (SHARED_TEXTURE_ERROR * texture) ** 2
    enough = np.bincount(region, minlength=n_regions) >= SHARED_MIN_TEXELS
    by_size = np.flatnonzero(enough)[np.argsort(-size[enough], kind="stable")]
    label[by_size] = by_size[_joined(level[by_size], variance[by_size])]
    return label


def _joined(level: NDArray[np.floating], variance: NDArray[np.floating]) -> NDArray[np.int64]:
    """(k,) index of the colour that represents each of k: the nearest representative before it, if within one standard
    deviation of their difference, else itself.

    Args:
        level: (k, 3) log albedo.
        variance: (k,) of it.
    """
    represented_by = np.arange(len(level))
    own = np.zeros(len(level), bool)
    for k in range(len(level)):
        others = np.flatnonzero(own[:k])
        off = level[others] - level[k]
        grey = off.mean(1)
        square = grey**2 + ((off - grey[:, None]) ** 2).sum(1) / (2 * CHROMA_RATIO**2)
        distance = square / (variance[others] + variance[k])
        own[k] = not (distance <= 1).any()
        if not own[k]:
            represented_by[k] = others[np.argmin(distance)]
    return represented_by


# ---- slow errors of the irradiance ---------------------------------------------------------------------------------


def residual_light(
    field: IrradianceField,
    region: NDArray[np.integer],
    even: NDArray[np.bool_],
    patch: NDArray[np.integer],
    albedo: NDArray[np.floating],
    weight: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(P, 3) factor, near 1, by which each patch is brighter than its traced irradiance explains.

    Traced irradiance is accurate to a few percent, with errors that change slowly over a surface. A paint is even over
    a region or has detail, so that a slow change of a few percent is taken for an error of the light, unless the region
    shows larger ones (after the retinex of Land and McCann, JOSA 1971).

    Args:
        region: (P,) region of each patch.
        even: (n_regions,) bool, regions that may be even: no metals, whose base colour is no quotient of irradiance.
        patch: (n,) patch of each pixel.
        albedo, weight: (n, 3) of each pixel, linear Rec.709, and its statistical weight.
    """
    n_patches, n_regions = len(region), len(even)
    norm = group_sums(weight, patch, n_patches)
    level = group_sums(weight * np.log(albedo + DIM_ALBEDO), patch, n_patches) / np.maximum(norm, 1e-12)
    seen = norm.min(1) > 0
    off = np.zeros((n_patches, 3))
    off[seen] = level[seen] - group_medians(level[seen], region[seen], n_regions)[region[seen]]
    around = field.kernel(RESIDUAL_WIDTH, group=region)
    known = np.where(seen, np.minimum(norm.mean(1), 1.0), 0.0)[:, None]
    # The kernel is applied twice: once, detail as fine as a patch would remain in the mean over ten of them.
    slow = (around @ (around @ (known * off))) / np.maximum(around @ (around @ known), 1e-12)
    spread = MAD * group_medians(np.abs(slow[seen]), region[seen], n_regions).mean(1)
    share = even / np.maximum(spread / RESIDUAL_ERROR, 1.0) ** 2
    return np.exp(share[region][:, None] * slow / (1 + (slow / (RESIDUAL_STAIN * RESIDUAL_ERROR)) ** 4))
