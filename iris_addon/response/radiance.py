"""From display values to radiance: linearised observations, and their mean per patch with what saturation hides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grouping import group_sums
from .curve import Response
from .observations import Observations

MODEL_NOISE = 0.03
"""Relative noise of an observation that no photo byte explains: interpolation, misregistration."""
OUTLIER_LOG = 0.2
"""Log distance from a patch's mean at which a view loses half its say (a highlight that only it sees)."""
MOST_PIXELS = 25.0
"""Pixels of one observation beyond which it says no more: they err together."""
CLIPPED_SHARE = 0.5
"""From this share of clipped pixels on, an observation is a lower bound."""


@dataclass(frozen=True)
class Linearised:
    """Observations in linear radiance.

    Attributes:
        radiance: (M, 3) float64; meaningless where not ``open``.
        open: (M, 3) bool, no pixel of the observation is clipped in that channel.
        bound: (M, 3) float64 lower bound on radiance where clipped, else 0.
        precision: (M, 3) float64 inverse relative variance.
    """

    radiance: NDArray[np.float64]
    open: NDArray[np.bool_]
    bound: NDArray[np.float64]
    precision: NDArray[np.float64]


@dataclass(frozen=True)
class GroupRadiance:
    """Radiance of patches (or faces) over all their views.

    Attributes:
        radiance: (P, 3) float64 robust mean; the lower bound where nothing else is known; 0 where nothing is.
        known: (P, 3) bool, at least one open observation.
        bound: (P, 3) float64 largest lower bound that a clipped observation gave.
        weight: (P,) float64 effective number of pixels behind the mean.
    """

    radiance: NDArray[np.float64]
    known: NDArray[np.bool_]
    bound: NDArray[np.float64]
    weight: NDArray[np.float64]


def linearise(observations: Observations, response: Response, t: NDArray[np.floating]) -> Linearised:
    """Radiance of every observation.

    Args:
        t: (M, 3) exposure factor of each.
    """
    o = observations
    hdr = response.family == "identity"
    z = o.z.astype(np.float64)
    if hdr:
        shape = z.shape
        return Linearised(z / t, np.ones(shape, bool), np.zeros(shape), np.full(shape, 1 / MODEL_NOISE**2))
    x = response.invert(np.clip(z + 0.5 / 255, 0, 1))
    # Pixels of one observation dither the quantisation step only where they differ; count it once.
    precision = 1.0 / (MODEL_NOISE**2 + quantisation_noise(response, x) ** 2)
    clipped = o.saturated > CLIPPED_SHARE
    return Linearised(x / t, o.saturated == 0, np.where(clipped, 1.0 / t, 0.0), precision)


def quantisation_noise(response: Response, x: NDArray[np.floating]) -> NDArray[np.float64]:
    """Relative standard deviation of relative exposures ``x`` (n, 3) that were kept as bytes."""
    return (1 / 255 / np.sqrt(12)) / (np.maximum(response.slope(x), 1e-3) * np.maximum(x, 1e-5))


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
    radiance = linear.radiance if subtract is None else np.maximum(linear.radiance - subtract, 0.02 * linear.radiance)
    lower = linear.bound
    if view_factor is not None:
        radiance, lower = radiance / view_factor[:, None], lower / view_factor[:, None]
    weight = linear.open * linear.precision * np.minimum(count, MOST_PIXELS)[:, None]

    def mean(w: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        norm = group_sums(w, group, n_groups)
        return group_sums(w * radiance, group, n_groups) / np.maximum(norm, 1e-12), norm

    first, norm = mean(weight)
    distance = np.log(np.maximum(radiance, 1e-6) / np.maximum(first[group], 1e-6)).mean(1, keepdims=True)
    robust, _ = mean(weight / (1 + (distance / OUTLIER_LOG) ** 2))
    bound = np.zeros((n_groups, 3))
    np.maximum.at(bound, group, lower)
    known = norm > 0
    return GroupRadiance(np.where(known, robust, bound), known, bound, norm.min(1) * MODEL_NOISE**2)


def raised_by_clipped(
    found: GroupRadiance,
    linear: Linearised,
    group: NDArray[np.integer],
    count: NDArray[np.floating],
    view_factor: NDArray[np.floating],
) -> NDArray[np.float64]:
    """(P, 3) radiance of matte groups, raised where clipped observations contradict the mean of the open ones.

    Beside a window some pixels of a patch clip in the shortest exposure and others do not. Those that do not are its
    darker half; an observation that clipped above their mean counts with its bound. (On a glossy patch it would be a
    highlight.) Arguments are those of :func:`group_radiance`.
    """
    bound = linear.bound / view_factor[:, None]
    say, n = np.minimum(count, MOST_PIXELS)[:, None], len(found.radiance)
    above = np.where(bound > found.radiance[group], say, 0.0)
    clipped, open_ = group_sums(above, group, n), group_sums(np.where(linear.open, say, 0.0), group, n)
    reached = group_sums(above * bound, group, n) / np.maximum(clipped, 1e-12)
    share = np.where(found.known, clipped / np.maximum(open_ + clipped, 1e-12), 0.0)
    return (1 - share) * found.radiance + share * reached
