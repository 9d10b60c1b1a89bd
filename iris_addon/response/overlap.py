"""The response from overlap: the same patch in photos of different exposure.

After Debevec & Malik 1997 and Mitsunaga & Nayar 1999. Unknowns are the curve, log radiance per patch and channel, and,
where they are not given, the exposures. The residual is taken in display values, ``z - f(L t)``, where quantisation
noise is uniform; saturated observations enter as the inequality ``L t >= 1``. With the exposures unknown the data fix
the curve only up to (f^g, t^g, L^g); that exponent is left at the prior's here and chosen later by light transport.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..config import AUTO, Refinements
from ..model.local_exposure import LocalExposure, SmallPhotos
from ..model.response import Response
from . import family
from .local_exposure import exposed, find_local_exposure
from .observations import Observations
from .overlap_problem import MIN_EXPOSURE_SPREAD, MIN_UNKNOWN_SPREAD, OverlapProblem

MAX_PATCHES = 1_500
FLAT = 0.04
"""Largest standard deviation of display values within an observation that still counts as one value."""
MAX_STEPS, SEPARATE_STEPS = 60, 5
"""One curve starts from the prior and runs until it has converged; three start from there and go on if they gain."""
START_STEPS, START_EVERY, START_LEVELS = 12, 4, (0.0, 0.8, 1.6)
"""For the first guess: steps, one patch in so many, and log exponents of the powers that are tried."""
CORRECTION_STEPS, CORRECTION_ROUNDS = 10, 3
EXPOSURE_GAIN = 0.8
"""Disagreement of held-out patches, relative to that under the known exposures, from which those are put right."""


@dataclass(frozen=True)
class OverlapFit:
    """Curve, exposures and how well they explain held-out patches.

    Attributes:
        exposures: (V, 3) factor per view and channel; the channels differ where white balance was found to drift.
        residual: median absolute residual of display values on held-out patches, each as the robust loss takes it.
        per_channel: whether three curves earned their place over one.
        local: exposure by place where that earned its place, else None.
    """

    response: Response
    exposures: NDArray[np.float64]
    residual: float
    per_channel: bool
    local: LocalExposure | None = None


def _select(observations: Observations, rng: np.random.Generator) -> NDArray[np.int64]:
    """Indices of flat observations: of patches that two views show unclipped, and of patches on the verge of clipping.

    The first give the shape of the curve, the second its scale: all that fixes the radiance at which x = 1.
    """
    o = observations
    n = int(o.patch.max()) + 1
    flat = (o.spread.max(1) < FLAT) & (o.count >= 2)
    clipped = o.saturated.max(1) > 0
    n_open = np.bincount(o.patch[flat & ~clipped], minlength=n)
    n_clipped = np.bincount(o.patch[flat & clipped], minlength=n)
    shape = np.flatnonzero(n_open >= 2)
    anchor = np.flatnonzero((n_open >= 1) & (n_clipped >= 1))
    chosen = np.zeros(n, bool)
    index = np.flatnonzero(flat & (n_open[o.patch] >= 1))
    for patches in (shape, anchor):
        if len(patches) > MAX_PATCHES:
            patches = rng.choice(patches, MAX_PATCHES, replace=False, p=_spread_over_brightness(o, index, patches))
        chosen[patches] = True
    return index[chosen[o.patch[index]]]


def _spread_over_brightness(
    o: Observations, index: NDArray[np.int64], patches: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Probability per patch that evens out display values, so that a white wall does not crowd out the shadows."""
    level = np.zeros(int(o.patch.max()) + 1)
    np.maximum.at(level, o.patch[index], o.z[index].mean(1))
    bins = np.minimum((level[patches] * 16).astype(int), 15)
    weight = 1.0 / np.bincount(bins, minlength=16)[bins]
    return weight / weight.sum()


def fit_overlap(
    observations: Observations,
    exposures: NDArray[np.floating] | None,
    n_views: int,
    rng: np.random.Generator,
    fixed: Response | None = None,
    refinements: Refinements = AUTO,
    small: SmallPhotos | None = None,
) -> OverlapFit:
    """Recover the response, and the exposures where ``exposures`` is None.

    Args:
        exposures: (V,) known factors, or None.
        fixed: a response that is given; only exposures are then looked for.
        refinements: whether curves and exposures per channel and exposure by place are forced, forbidden or have to
            earn their place.
        small: the photos, for exposure by place; None leaves that out.
    """
    index = _select(observations, rng)
    problem = OverlapProblem.build(observations, index, exposures, n_views, refinements.white_balance)
    if fixed is not None:
        return OverlapFit(fixed, problem.exposures(fixed), np.nan, False)
    if _of_one_exposure(problem):
        # They say nothing about the curve: the most common one stands.
        median = family.to_response([family.PRIOR_MEAN])
        return OverlapFit(median, problem.exposures(median), np.nan, False)
    held_out = rng.random(problem.n_patches) < 0.2
    training, testing = problem.restrict(~held_out), problem.restrict(held_out)
    knots, error = _fit_curves(training, testing, refinements)
    # Before exposures: four numbers for all photos ask for less belief than one for each of them.
    local = None
    if small is not None and refinements.local_exposure is not False:
        local = find_local_exposure(training, testing, small, knots, refinements.local_exposure is True)
    if local is not None:
        problem, training, testing = (exposed(region, local) for region in (problem, training, testing))
        knots, error = _fit_curves(training, testing, refinements)
    if exposures is not None and refinements.corrected_exposures is not False:
        gain = np.inf if refinements.corrected_exposures else EXPOSURE_GAIN
        log_t = _right_exposures(training, testing, knots, gain)
        if log_t is not None:
            problem, training, testing = (replace(region, log_t=log_t) for region in (problem, training, testing))
            knots, error = _fit_curves(training, testing, refinements)
    response = family.to_response(knots)
    return OverlapFit(
        response=response,
        exposures=problem.exposures(response),
        residual=error,
        per_channel=len(knots) == 3,
        local=local,
    )


def _of_one_exposure(problem: OverlapProblem) -> bool:
    """Whether photos were taken alike, by their own account and by that of the exposures that are known."""
    seen = replace(problem, log_t=None).exposure_spread()
    if problem.log_t is None:
        return seen < MIN_UNKNOWN_SPREAD
    return max(float(problem.log_t.std() / np.log(2)), seen) < MIN_EXPOSURE_SPREAD


def _fit_curves(
    training: OverlapProblem, testing: OverlapProblem, refinements: Refinements
) -> tuple[list[NDArray[np.float64]], float]:
    """Knots of one curve, or of three if they earn it, and the disagreement of held-out patches under them."""
    shared = training.minimise([_first_guess(training)], MAX_STEPS)
    error = testing.disagreement(shared)
    if refinements.channel_curves is False:
        return shared, error
    leading = replace(training, highlights=False)
    separate = leading.minimise(shared * 3, SEPARATE_STEPS)
    # One curve is the null hypothesis: cameras apply the same curve to all channels far more often than not.
    separate_error = testing.disagreement(separate)
    if refinements.channel_curves or separate_error < 0.97 * error:
        separate = training.minimise(leading.minimise(separate, MAX_STEPS), MAX_STEPS)
        return separate, testing.disagreement(separate)
    return shared, error


def _first_guess(problem: OverlapProblem) -> NDArray[np.float64]:
    """Knots to start from: the median measured response, or a power that leads lower on a region of the patches.

    From the median alone a curve that crushes the shadows ends where it fits neither those nor the lights.
    """
    coarse = replace(problem.restrict(np.arange(problem.n_patches) % START_EVERY == 0), highlights=False)
    starts = [family.PRIOR_MEAN, *(np.full(len(family.PRIOR_MEAN), level) for level in START_LEVELS)]
    ends = [coarse.minimise([start], START_STEPS)[0] for start in starts]
    return min(ends, key=lambda knots: float((coarse.residual(knots, 1) ** 2).sum()))


def _right_exposures(
    training: OverlapProblem, testing: OverlapProblem, knots: list[NDArray[np.float64]], gain: float
) -> NDArray[np.float64] | None:
    """Log exposures (V, 3) in place of the known ones, or None unless the overlap speaks clearly against those.

    Recorded exposures may be rounded, and white balance may drift. A correction of every photo, then one of every
    channel, is taken where patches that it was not fitted to disagree less than ``gain`` times as much under it.
    """
    best, found = testing.disagreement(knots), None
    for per_channel in (False, True) if training.white_balance is not False else (False,):
        tried, log_t = knots, training.log_t
        for round_ in range(CORRECTION_ROUNDS):
            log_t = training.corrected_exposures(family.to_response(tried), per_channel)
            if round_ == 0 and replace(testing, log_t=log_t).disagreement(tried) > max(1.0, gain) * best:
                break
            tried = replace(training, log_t=log_t).minimise(tried, CORRECTION_STEPS)
        disagreement = replace(testing, log_t=log_t).disagreement(tried)
        if disagreement < gain * best:
            best, found = disagreement, log_t
    return found
