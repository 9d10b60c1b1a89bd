"""Paint of one colour, told from texture.

A texture takes a number per texel, and what it says of a painted wall are errors of the light: slow blotches of a few
percent, and tens of percent beside mouldings and in corners, where irradiance changes within a patch. So each part is
taken for a mixture of one paint, which departs from its colour by errors of the light alone, and detail, which departs
from it by anything. How much of a part is detail, its own texels tell (expectation and maximisation, Dempster, Laird
and Rubin 1977); texels that are paint by that get its colour, and wood, weaves and joints between tiles stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from ..grouping import group_medians, group_sums, stable_order
from ..parallel import filled
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
"""Texels of a part from which on it is asked, and how many of them are."""
ROUNDS = 12
PLAIN = 0.05
"""Share of detail below which a part is of one colour."""


@dataclass(frozen=True)
class Paint:
    """What each part is painted with.

    Attributes:
        level: (n_parts, 3) log of the paint's albedo + DIM_ALBEDO.
        detail: (n_parts,) share of the part that is no paint; 1 where there is none.
        spread: (n_parts,) standard deviation of the log albedo of detail, without errors of the light.
    """

    level: NDArray[np.float64]
    detail: NDArray[np.float64]
    spread: NDArray[np.float64]

    @property
    def plain_parts(self) -> int:
        """How many parts are paint but for a share of PLAIN: a colour is all that is to be said of them."""
        return int((self.detail < PLAIN).sum())

    @property
    def paints(self) -> int:
        """How many paints the parts that have one share."""
        return len(np.unique(self.level[self.detail < 1], axis=0))

    def of_parts(self, label: NDArray[np.integer]) -> Paint:
        """The same for parts, each with the paint of the one that stands for it, ``label`` (n_parts,)."""
        return Paint(self.level[label], self.detail[label], self.spread[label])

    def departure(self, log_albedo: NDArray[np.floating], part: NDArray[np.integer]) -> NDArray[np.floating]:
        """(n,) squared distance of log albedo (n, 3) from the paint, in colour as in brightness: the mean over the
        three is the variance of either kind."""
        off = log_albedo - self.level[part]
        grey = off.mean(1)
        return (grey**2 + ((off - grey[:, None]) ** 2).sum(1) / COLOUR**2) / 3

    def chance(
        self, departure: NDArray[np.floating], error: NDArray[np.floating], part: NDArray[np.integer]
    ) -> NDArray[np.floating]:
        """(n,) probability that texels of that :meth:`departure` are paint.

        Args:
            error: (n,) standard deviation of the log irradiance behind each.
        """
        paint, detail = error**2, self.spread[part] ** 2 + error**2
        narrower = np.log(detail / paint) - departure * (1 / paint - 1 / detail)
        return expit(logit(1 - self.detail[part]) + 1.5 * narrower)

    def evened(
        self, albedo: NDArray[np.floating], error: NDArray[np.floating], part: NDArray[np.integer]
    ) -> NDArray[np.float32]:
        """(n, 3) albedo with the colour of their paint for texels that are paint; the rest as they are."""

        def work(rows: slice) -> NDArray[np.floating]:
            log_albedo, own = np.log(albedo[rows] + DIM_ALBEDO), part[rows]
            share = self.chance(self.departure(log_albedo, own), error[rows], own)[:, None]
            mixed = np.exp(log_albedo + share * (self.level[own] - log_albedo)) - DIM_ALBEDO
            return np.where(share > 0, np.maximum(mixed, 0.0), albedo[rows])

        return filled(np.empty(albedo.shape, np.float32), work)

    def colour(self, mean: NDArray[np.floating]) -> NDArray[np.float64]:
        """(n_parts, 3) albedo that is expected of a part: of its paint, the less it has the more its ``mean``."""
        painted = np.maximum(np.exp(self.level) - DIM_ALBEDO, 0.0)
        return mean + (1 - self.detail[:, None]) * (painted - mean)


def light_error(spread: NDArray[np.floating]) -> NDArray[np.floating]:
    """Standard deviation of log irradiance from its ``spread`` over the patches around."""
    return np.hypot(LIGHT_ERROR, ERROR_PER_SPREAD * spread)


def best_lit(error: NDArray[np.floating], part: NDArray[np.integer], n_parts: int) -> NDArray[np.bool_]:
    """(T,) the half of each part's texels whose light is known best: they tell its colour."""
    return error <= group_medians(error[:, None], part, n_parts)[part, 0]


def find_paint(
    albedo: NDArray[np.floating],
    error: NDArray[np.floating],
    part: NDArray[np.integer],
    painted: NDArray[np.bool_],
) -> Paint:
    """The paint of every part that has enough texels.

    Args:
        albedo: (T, 3) of texels that photos show well.
        error: (T,) standard deviation of the log irradiance behind each.
        part: (T,) part of each.
        painted: (n_parts,) parts that may have one; the others are all detail.
    """
    n_parts = len(painted)
    count = np.bincount(part, minlength=n_parts)
    asked = painted & (count >= ENOUGH)
    rows = _some_of_each(part, count)
    rows = rows[asked[part[rows]]]
    log_albedo = np.log(albedo[rows].astype(np.float64) + DIM_ALBEDO)
    error, part = error[rows].astype(np.float64), part[rows]
    sure = best_lit(error, part, n_parts)
    level = group_medians(log_albedo[sure], part[sure], n_parts)
    paint = Paint(level, np.where(asked, 0.5, 1.0), np.full(n_parts, FIRST_DETAIL))
    total = np.bincount(part, minlength=n_parts)
    for _ in range(ROUNDS):
        paint = _refined(paint, log_albedo, error, part, asked, total)
    return paint


def _some_of_each(part: NDArray[np.integer], count: NDArray[np.integer]) -> NDArray[np.int64]:
    """Indices of up to MOST texels of each part, evenly from all of them."""
    order = stable_order(part.astype(np.int64))
    rank = np.arange(len(part)) - (np.cumsum(count) - count)[part[order]]
    step = -(-count // MOST)
    return order[rank % step[part[order]] == 0]


def _refined(
    paint: Paint,
    log_albedo: NDArray[np.float64],
    error: NDArray[np.float64],
    part: NDArray[np.integer],
    asked: NDArray[np.bool_],
    total: NDArray[np.integer],
) -> Paint:
    """The paint of greatest likelihood once each texel is paint by the chance it has under ``paint``."""
    n = len(asked)
    departure = paint.departure(log_albedo, part)
    chance = paint.chance(departure, error, part)
    say, other = chance / error**2, 1 - chance
    sums = group_sums(np.column_stack([say[:, None] * log_albedo, say, other, other * (departure - error**2)]), part, n)
    level = np.where(sums[:, 3:4] > 0, sums[:, :3] / np.maximum(sums[:, 3:4], 1e-300), paint.level)
    # Half a texel of each kind more than there are, lest one of them can never come back.
    detail = np.where(asked, (sums[:, 4] + 0.5) / (total + 1), 1.0)
    variance = sums[:, 5] / np.maximum(sums[:, 4], 1e-9)
    return Paint(level, detail, np.sqrt(np.maximum(variance, LEAST_DETAIL**2)))
