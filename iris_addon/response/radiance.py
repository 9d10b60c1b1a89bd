"""From display values to radiance: linearised observations, and their robust mean per patch within its bounds.

A clipped observation bounds radiance from below, a black one from above. All radiance is scene-linear Rec.709, in the
unit of the exposures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..base.group_by import group_sums
from ..model.response import Response
from .observations import Observations

MODEL_NOISE = 0.03
"""Relative noise of an observation that no photo byte explains: interpolation, misregistration."""
MAX_PRECISION = 1 / MODEL_NOISE**2
"""Precision of an observation that has no noise but that."""
OUTLIER_LOG = 0.2
"""Log distance from a patch's mean at which a view loses half its weight (a highlight that only it sees)."""
MAX_COUNTED_PIXELS = 25.0
"""Pixels up to which the weight of an observation grows with their number: beyond, they err together."""
TELLING_BOUND = 0.9
"""Bound of a clipped observation over the largest one of its patch from which it counts."""
CLIPPED_SHARE = 0.5
"""From this share of clipped pixels on, an observation is a lower bound, of black ones an upper bound."""


@dataclass(frozen=True)
class Linearised:
    """Observations in linear radiance.

    Attributes:
        radiance: (M, 3) float64; meaningless where not ``unclipped``.
        unclipped: (M, 3) bool, no pixel of the observation is clipped in that channel.
        bound: (M, 3) float64 lower bound on radiance where clipped, else 0.
        ceiling: (M, 3) float64 upper bound on radiance where black, else infinite.
        precision: (M, 3) float64 inverse relative variance.
    """

    radiance: NDArray[np.float64]
    unclipped: NDArray[np.bool_]
    bound: NDArray[np.float64]
    ceiling: NDArray[np.float64]
    precision: NDArray[np.float64]

    @property
    def well_exposed(self) -> NDArray[np.bool_]:
        """(M,) observations that are neither clipped nor black in any channel."""
        return (self.unclipped & np.isinf(self.ceiling)).all(1)

    def agreeing_with(self, expected: NDArray[np.floating]) -> Linearised:
        """The same with black observations at their ``expected`` radiance (M, 3), or at their ceiling if that is lower.

        A ceiling below the expected radiance contradicts it, and the observation counts with full precision; any other
        ceiling agrees with it, and the observation keeps the noise of its byte.
        """
        radiance = np.where(np.isfinite(self.ceiling), np.minimum(self.ceiling, expected), self.radiance)
        noise = self._noise * self.radiance / np.maximum(radiance, 1e-9)
        agreeing = 1 / (MODEL_NOISE**2 + noise**2)
        return replace(self, radiance=radiance, precision=np.where(self.ceiling < expected, MAX_PRECISION, agreeing))

    def precision_at(self, level: NDArray[np.floating]) -> NDArray[np.float64]:
        """(M, 3) inverse variance relative to the radiance ``level`` (M, 3) that is expected, not to that observed.

        Dark bytes are coarse relative to themselves. That a bright surface is seen dark they tell as well as others.
        """
        return 1 / (MODEL_NOISE**2 + (self._noise * self.radiance / np.maximum(level, 1e-9)) ** 2)

    @property
    def _noise(self) -> NDArray[np.float64]:
        """(M, 3) relative standard deviation that the photo's bytes explain."""
        return np.sqrt(np.maximum(1 / self.precision - MODEL_NOISE**2, 0.0))


@dataclass(frozen=True)
class GroupRadiance:
    """Radiance of patches (or faces) over all their views.

    Attributes:
        radiance: (P, 3) float64 robust mean; the lower bound where nothing else is known; 0 where nothing is.
        known: (P, 3) bool, at least one unclipped observation.
        bound: (P, 3) float64 largest lower bound that a clipped observation gave.
        weight: (P,) float64 effective number of pixels behind the mean, or the bound where nothing else is known.
    """

    radiance: NDArray[np.float64]
    known: NDArray[np.bool_]
    bound: NDArray[np.float64]
    weight: NDArray[np.float64]


def linearise(observations: Observations, response: Response, t: NDArray[np.floating]) -> Linearised:
    """Radiance of every observation, with its bounds.

    Args:
        t: (M, 3) exposure factor of each.
    """
    o = observations
    z = o.z.astype(np.float64)
    if response.family == "identity":
        return radiance_itself(z / t)
    # Pixels of one observation dither the quantisation step only where they differ; it counts once.
    return linearise_bytes(response, z, t, o.saturated, o.black)


def linearise_bytes(
    response: Response,
    z: NDArray[np.floating],
    t: NDArray[np.floating],
    saturated: NDArray[np.floating],
    black: NDArray[np.floating],
) -> Linearised:
    """Radiance behind display values (n, 3) that were kept as bytes, means over pixels or single ones.

    Args:
        t: (n, 3) exposure factors.
        saturated, black: (n, 3) share of the pixels that are clipped, and whose byte is 0.
    """
    x, noise = relative_exposure(response, z, black)
    bound = np.where(saturated > CLIPPED_SHARE, 1.0 / t, 0.0)
    ceiling = np.where(black > CLIPPED_SHARE, darkest(response) / t, np.inf)
    return Linearised(
        radiance=x / t,
        unclipped=saturated == 0,
        bound=bound,
        ceiling=ceiling,
        precision=1.0 / (MODEL_NOISE**2 + noise**2),
    )


def radiance_itself(radiance: NDArray[np.float64]) -> Linearised:
    """Observations (M, 3) of HDR photos, which neither clip nor turn black."""
    shape = radiance.shape
    return Linearised(
        radiance=radiance,
        unclipped=np.ones(shape, bool),
        bound=np.zeros(shape),
        ceiling=np.full(shape, np.inf),
        precision=np.full(shape, MAX_PRECISION),
    )


def darkest(response: Response) -> NDArray[np.float64]:
    """(1, 3) relative exposure up to which a byte is 0."""
    return response.invert(np.full((1, 3), 1 / 255))


def relative_exposure(
    response: Response, z: NDArray[np.floating], black: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Relative exposure behind display values that were kept as bytes, and its relative standard deviation.

    A byte of 0 means only that the exposure was less than that of the next byte. Under a curve that crushes the shadows
    this is a wide range, and its upper end, where the curve begins to rise, must not pass for a sharp value.

    Args:
        z: (n, 3) display values, means over pixels.
        black: (n, 3) share of those pixels whose byte is 0.
    """
    lit = 1.0 - black
    x = response.invert(np.clip(z / np.maximum(lit, 1e-6) + 0.5 / 255, 0, 1))
    step = (1 / 255) / np.maximum(response.slope(x), 1e-3)
    first = darkest(response)
    mean = lit * x + black * first / 2
    return mean, np.hypot(lit * step, black * first) / np.sqrt(12) / np.maximum(mean, 1e-5)


def exposure_noise(response: Response, exposure: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Relative standard deviation of means of :func:`relative_exposure` (n, 3) over single pixels, and whether all of
    their bytes are 0."""
    first = darkest(response)
    black = exposure <= first / 2 * (1 + 1e-4)
    step = np.where(black, first, (1 / 255) / np.maximum(response.slope(exposure), 1e-3))
    return step / np.sqrt(12) / np.maximum(exposure, 1e-5), black


def group_radiance(
    linear: Linearised,
    group: NDArray[np.integer],
    count: NDArray[np.floating],
    n_groups: int,
    subtract: NDArray[np.floating] | None = None,
    view_factor: NDArray[np.floating] | None = None,
) -> GroupRadiance:
    """Robust mean radiance per group of observations.

    Args:
        group: (M,) patch or face of each observation.
        count: (M,) pixels of each observation.
        subtract: (M, 3) specular radiance to take off first, or None.
        view_factor: (M,) of the diffuse lobe in each observation's direction, divided out; None for Lambert.
    """
    radiance, ceiling, lower = linear.radiance, linear.ceiling, linear.bound
    if subtract is not None:
        radiance, ceiling, lower = (without_specular(column, subtract) for column in (radiance, ceiling, lower))
    if view_factor is not None:
        radiance, lower, ceiling = (column / view_factor[:, None] for column in (radiance, lower, ceiling))
    weight = linear.unclipped * linear.precision * np.minimum(count, MAX_COUNTED_PIXELS)[:, None]

    norm = group_sums(weight, group, n_groups)
    robust = _robust(radiance, weight, _mean(radiance, weight, group, n_groups), group)
    if np.isfinite(ceiling).any():
        robust = _under_ceilings(robust, radiance, weight, ceiling, count, group)
    bound = np.zeros((n_groups, 3))
    np.maximum.at(bound, group, lower)
    known = norm > 0
    # Of clipped observations those count that tell most: a longer exposure knows no more of what clips in a short one.
    telling = (lower > 0) & (lower >= TELLING_BOUND * bound[group]) & ~known[group]
    pixels = np.minimum(count, MAX_COUNTED_PIXELS)[:, None]
    clipped = group_sums(np.where(telling, pixels, 0.0), group, n_groups)
    weight = np.where(known, norm * MODEL_NOISE**2, clipped).min(1)
    return GroupRadiance(np.where(known, robust, bound), known, bound, weight)


def without_specular(radiance: NDArray[np.floating], specular: NDArray[np.floating]) -> NDArray[np.float64]:
    """``radiance`` less ``specular``, of one shape; at least 2 % of it remain, since the latter is uncertain."""
    return np.maximum(radiance - specular, 0.02 * radiance)


def _mean(
    radiance: NDArray[np.float64], weight: NDArray[np.float64], group: NDArray[np.integer], n_groups: int
) -> NDArray[np.float64]:
    """(P, 3) weighted means over groups of observations (M, 3)."""
    norm = group_sums(weight, group, n_groups)
    return group_sums(weight * radiance, group, n_groups) / np.maximum(norm, 1e-12)


def _robust(
    radiance: NDArray[np.float64], weight: NDArray[np.float64], mean: NDArray[np.float64], group: NDArray[np.integer]
) -> NDArray[np.float64]:
    """(P, 3) means over groups without what is far from ``mean``."""
    distance = np.log(np.maximum(radiance, 1e-6) / np.maximum(mean[group], 1e-6)).mean(1, keepdims=True)
    return _mean(radiance, weight / (1 + (distance / OUTLIER_LOG) ** 2), group, len(mean))


def _under_ceilings(
    mean: NDArray[np.float64],
    radiance: NDArray[np.float64],
    weight: NDArray[np.float64],
    ceiling: NDArray[np.float64],
    count: NDArray[np.floating],
    group: NDArray[np.integer],
) -> NDArray[np.float64]:
    """(P, 3) ``mean``, lowered where black observations contradict it.

    A black observation agrees with any mean below its ceiling and pulls a higher one down to it: where only highlights
    lift a dark surface above black, the photos that show it black tell more about it than those that show it lit.
    """
    n = len(mean)
    black = np.isfinite(ceiling)
    lit = np.where(black, 0.0, weight)
    lowest = np.full(mean.shape, np.inf)
    np.minimum.at(lowest, group, ceiling)
    start = np.where(group_sums(lit, group, n) > 0, _mean(radiance, lit, group, n), lowest / 2)
    both = np.where(black, MAX_PRECISION * np.minimum(count, MAX_COUNTED_PIXELS)[:, None], lit)

    def agreeing(about: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(black, np.minimum(ceiling, about[group]), radiance)

    found = _mean(agreeing(start), both, group, n)
    for _ in range(2):
        found = _robust(agreeing(found), both, found, group)
    return np.where(np.isfinite(lowest), found, mean)


def raised_by_clipped(
    found: GroupRadiance,
    linear: Linearised,
    group: NDArray[np.integer],
    count: NDArray[np.floating],
    view_factor: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(P, 3) radiance of matte groups, raised where clipped observations contradict the mean of the unclipped ones.

    Beside a window some pixels of a patch clip even in the shortest exposure. Those that do not are its darker half, so
    an observation that clipped above their mean counts with its bound. (On a glossy patch it would be a highlight.)
    Arguments are those of :func:`group_radiance`.
    """
    bound = linear.bound / view_factor[:, None]
    weight, n = np.minimum(count, MAX_COUNTED_PIXELS)[:, None], len(found.radiance)
    above = np.where(bound > found.radiance[group], weight, 0.0)
    clipped = group_sums(above, group, n)
    unclipped = group_sums(np.where(linear.unclipped, weight, 0.0), group, n)
    reached = group_sums(above * bound, group, n) / np.maximum(clipped, 1e-12)
    share = np.where(found.known, clipped / np.maximum(unclipped + clipped, 1e-12), 0.0)
    return (1 - share) * found.radiance + share * reached
