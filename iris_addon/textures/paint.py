"""Paint of one colour, told from texture.

A texture takes a number per texel, and what it says of a painted wall are errors of the light: slow blotches of a few
percent, and tens of percent beside mouldings and in corners, where irradiance changes within a patch. So each region is
taken for a mixture of one paint, which departs from its colour by errors of the light alone, and detail, which departs
from it by anything. How much of a region is detail, its own texels tell (expectation and maximisation, Dempster, Laird
and Rubin 1977); texels that are paint by that get its colour, and wood, weaves and joints between tiles stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from ..base.group_by import MAD, group_medians, group_sums, stable_order
from ..base.parallel import filled
from ..surface.irradiance import IrradianceField
from .bake import DIM_ALBEDO

LIGHT_ERROR, ERROR_PER_SPREAD = 0.015, 0.7
"""Standard deviation of the log irradiance at a pixel: on even ground, and per spread of it over the patches around.
Of surfaces of one colour in four rooms, log albedo departs by 0.012 to 0.019 where that spread is below 0.03 and by
0.08 to 0.10 where it is 0.2 to 0.4."""
COLOUR = 0.5
"""Departure in colour over that in brightness, of both kinds: in those rooms 0.2 to 0.6."""
LEAST_DETAIL, FIRST_DETAIL = 0.05, 0.3
"""Standard deviation of the log albedo of detail, at least and as it is first taken to be."""
ENOUGH, MOST = 20, 4000
"""Texels of a region from which on it is asked, and how many of them are."""
ROUNDS = 12
PLAIN = 0.05
"""Share of detail below which a region is of one colour."""


@dataclass(frozen=True)
class Paint:
    """What each region is painted with.

    Attributes:
        level: (n_regions, 3) log of the paint's albedo + DIM_ALBEDO.
        detail: (n_regions,) share of the region that is no paint; 1 where there is none.
        spread: (n_regions,) standard deviation of the log albedo of detail, without errors of the light.
    """

    level: NDArray[np.float64]
    detail: NDArray[np.float64]
    spread: NDArray[np.float64]

    @property
    def plain_regions(self) -> int:
        """How many regions are paint but for a share of PLAIN: a colour is all that is to be said of them."""
        return int((self.detail < PLAIN).sum())

    @property
    def paints(self) -> int:
        """How many paints the regions that have one share."""
        return len(np.unique(self.level[self.detail < 1], axis=0))

    def of_regions(self, label: NDArray[np.integer]) -> Paint:
        """The same for regions, each with the paint of the one that stands for it, ``label`` (n_regions,)."""
        return Paint(self.level[label], self.detail[label], self.spread[label])

    def departure(self, log_albedo: NDArray[np.floating], region: NDArray[np.integer]) -> NDArray[np.floating]:
        """(n,) squared distance of log albedo (n, 3) from the paint, in colour as in brightness: the mean over the
        three is the variance of either kind."""
        off = log_albedo - self.level[region]
        grey = off.mean(1)
        return (grey**2 + ((off - grey[:, None]) ** 2).sum(1) / COLOUR**2) / 3

    def chance(
        self, departure: NDArray[np.floating], error: NDArray[np.floating], region: NDArray[np.integer]
    ) -> NDArray[np.floating]:
        """(n,) probability that texels of that :meth:`departure` are paint.

        Args:
            error: (n,) standard deviation of the log irradiance behind each.
        """
        paint, detail = error**2, self.spread[region] ** 2 + error**2
        narrower = np.log(detail / paint) - departure * (1 / paint - 1 / detail)
        return expit(logit(1 - self.detail[region]) + 1.5 * narrower)

    def evened(
        self, albedo: NDArray[np.floating], error: NDArray[np.floating], region: NDArray[np.integer]
    ) -> NDArray[np.float32]:
        """(n, 3) albedo with the colour of their paint for texels that are paint; the rest as they are."""

        def work(rows: slice) -> NDArray[np.floating]:
            log_albedo, own = np.log(albedo[rows] + DIM_ALBEDO), region[rows]
            share = self.chance(self.departure(log_albedo, own), error[rows], own)[:, None]
            mixed = np.exp(log_albedo + share * (self.level[own] - log_albedo)) - DIM_ALBEDO
            return np.where(share > 0, np.maximum(mixed, 0.0), albedo[rows])

        return filled(np.empty(albedo.shape, np.float32), work)

    def colour(self, mean: NDArray[np.floating]) -> NDArray[np.float64]:
        """(n_regions, 3) albedo that is expected of a region: of its paint, the less it has the more its ``mean``."""
        painted = np.maximum(np.exp(self.level) - DIM_ALBEDO, 0.0)
        return mean + (1 - self.detail[:, None]) * (painted - mean)


def light_error(spread: NDArray[np.floating]) -> NDArray[np.floating]:
    """Standard deviation of log irradiance from its ``spread`` over the patches around."""
    return np.hypot(LIGHT_ERROR, ERROR_PER_SPREAD * spread)


def best_lit(error: NDArray[np.floating], region: NDArray[np.integer], n_regions: int) -> NDArray[np.bool_]:
    """(T,) the half of each region's texels whose light is known best: they tell its colour."""
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
        part: (T,) part of each.
        painted: (n_regions,) regions that may have one; the others are all detail.
    """
    n_regions = len(painted)
    count = np.bincount(region, minlength=n_regions)
    asked = painted & (count >= ENOUGH)
    rows = _some_of_each(region, count)
    rows = rows[asked[region[rows]]]
    log_albedo = np.log(albedo[rows].astype(np.float64) + DIM_ALBEDO)
    error, region = error[rows].astype(np.float64), region[rows]
    sure = best_lit(error, region, n_regions)
    level = group_medians(log_albedo[sure], region[sure], n_regions)
    paint = Paint(level, np.where(asked, 0.5, 1.0), np.full(n_regions, FIRST_DETAIL))
    total = np.bincount(region, minlength=n_regions)
    for _ in range(ROUNDS):
        paint = _refined(paint, log_albedo, error, region, asked, total)
    return paint


def _some_of_each(region: NDArray[np.integer], count: NDArray[np.integer]) -> NDArray[np.int64]:
    """Indices of up to MOST texels of each region, evenly from all of them."""
    order = stable_order(region.astype(np.int64))
    rank = np.arange(len(region)) - (np.cumsum(count) - count)[region[order]]
    step = -(-count // MOST)
    return order[rank % step[region[order]] == 0]


def _refined(
    paint: Paint,
    log_albedo: NDArray[np.float64],
    error: NDArray[np.float64],
    region: NDArray[np.integer],
    asked: NDArray[np.bool_],
    total: NDArray[np.integer],
) -> Paint:
    """The paint of greatest likelihood once each texel is paint by the chance it has under ``paint``."""
    n = len(asked)
    departure = paint.departure(log_albedo, region)
    chance = paint.chance(departure, error, region)
    say, other = chance / error**2, 1 - chance
    sums = group_sums(
        np.column_stack([say[:, None] * log_albedo, say, other, other * (departure - error**2)]), region, n
    )
    level = np.where(sums[:, 3:4] > 0, sums[:, :3] / np.maximum(sums[:, 3:4], 1e-300), paint.level)
    # Half a texel of each kind more than there are, lest one of them can never come back.
    detail = np.where(asked, (sums[:, 4] + 0.5) / (total + 1), 1.0)
    variance = sums[:, 5] / np.maximum(sums[:, 4], 1e-9)
    return Paint(level, detail, np.sqrt(np.maximum(variance, LEAST_DETAIL**2)))


# ---- Regions that are painted alike ---------------------------------------------------------------------------------
#
# The slats of a blind, the mouldings of a window and its frame are regions of their own and one paint. What a small
# region says of its colour is what light, wrong by a tenth beside a moulding, says of it; the large ones of the same
# paint know better. So the regions of a room are joined as far as their colours agree within the errors of the light
# (DP-means, Kulis and Jordan, ICML 2012, with the largest regions first).


OF_REGIONS = 0.04
"""Standard deviation of the log albedo that a region of one colour is given, on even ground: its light is off as a
whole by more than it is from pixel to pixel."""
PER_TEXTURE = 0.25
"""Of the spread of its own texels, by which the median of a textured region is off."""
LEAST = 5
"""Texels of a region from which on it is asked."""


def painted_alike(
    albedo: NDArray[np.floating],
    error: NDArray[np.floating],
    region: NDArray[np.integer],
    painted: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """(n_regions,) a region that stands for all that are painted as each is; their own label where there is no other.

    Args:
        albedo: (T, 3) of texels that photos show well, NaN in channels that all photos clip.
        error: (T,) standard deviation of the log irradiance behind each.
        part: (T,) part of each.
        painted: (n_regions,) regions that may share their paint.
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
    variance = OF_REGIONS**2 + light**2 + (PER_TEXTURE * texture) ** 2
    enough = np.bincount(region, minlength=n_regions) >= LEAST
    asked = np.flatnonzero(enough)[np.argsort(-size[enough], kind="stable")]
    label[asked] = asked[_joined(level[asked], variance[asked])]
    return label


def _joined(level: NDArray[np.floating], variance: NDArray[np.floating]) -> NDArray[np.int64]:
    """(k,) for each of k colours the nearest of those before it that stand for others, if it is no further than one
    standard deviation of their difference, else itself."""
    stands = np.arange(len(level))
    own = np.zeros(len(level), bool)
    for k in range(len(level)):
        others = np.flatnonzero(own[:k])
        off = level[others] - level[k]
        grey = off.mean(1)
        square = grey**2 + ((off - grey[:, None]) ** 2).sum(1) / (2 * COLOUR**2)
        distance = square / (variance[others] + variance[k])
        own[k] = not (distance <= 1).any()
        if not own[k]:
            stands[k] = others[np.argmin(distance)]
    return stands


# ---- What errors of the irradiance leave in the albedo of even surfaces ---------------------------------------------
#
# Traced irradiance is right to a few percent, with errors that change slowly over a surface; divided by it, a wall has
# blotches of light for paint. Paint is even over a region or has detail, so a slow change of a few percent is taken for
# an error of the light, as far as the region shows no larger ones (after the retinex of Land and McCann, JOSA 1971).
# Where lamps stand outside the mesh the light is further off than that: by how much, the evenest surfaces tell.


RESIDUAL_LIGHT_ERROR, WORST_ERROR = 0.03, 0.15
"""Standard deviation of the log irradiance of patches, at least and at most."""
EVENEST, OVER_EVENEST = 0.1, 1.6
"""The error is so many times the spread of the region that this share of the patches lie on or on a more even one: the
ratio that it has where lamps are known."""
SLOW = 3.0
"""Patch sizes over which errors of the irradiance change."""
FEATURE = 10 / 3
"""Errors of the light from which a slow difference in log albedo is rather a stain."""


def residual_light(
    field: IrradianceField,
    region: NDArray[np.integer],
    even: NDArray[np.bool_],
    patch: NDArray[np.integer],
    albedo: NDArray[np.floating],
    weight: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(P, 3) factor by which each patch is brighter than its traced irradiance accounts for; near 1.

    Args:
        part: (P,) part of each patch.
        even: (n_regions,) regions that may be taken for even: no metals, whose base colour is no quotient of
            irradiance.
        patch: (n,) patch of each pixel.
        albedo, weight: (n, 3) of each pixel, and its say.
    """
    n_patches, n_regions = len(region), len(even)
    norm = group_sums(weight, patch, n_patches)
    level = group_sums(weight * np.log(albedo + DIM_ALBEDO), patch, n_patches) / np.maximum(norm, 1e-12)
    seen = norm.min(1) > 0
    off = np.zeros((n_patches, 3))
    off[seen] = level[seen] - group_medians(level[seen], region[seen], n_regions)[region[seen]]
    around = field.kernel(SLOW, group=region)
    say = np.where(seen, np.minimum(norm.mean(1), 1.0), 0.0)[:, None]
    # Twice, or detail as fine as a patch would be in the average of ten of them.
    slow = (around @ (around @ (say * off))) / np.maximum(around @ (around @ say), 1e-12)
    spread = MAD * group_medians(np.abs(slow[seen]), region[seen], n_regions).mean(1)
    error = _light_error(spread[region[seen & even[region]]])
    share = even / np.maximum(spread / error, 1.0) ** 2
    return np.exp(share[region][:, None] * slow / (1 + (slow / (FEATURE * error)) ** 4))


def _light_error(spread: NDArray[np.floating]) -> float:
    """Standard deviation of the log irradiance, from the slow spread (n,) within the region of each patch."""
    evenest = float(np.quantile(spread, EVENEST)) if len(spread) else 0.0
    return float(np.clip(OVER_EVENEST * evenest, RESIDUAL_LIGHT_ERROR, WORST_ERROR))
