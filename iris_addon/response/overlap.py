"""Response, exposures and local exposure from overlap: the same patch in photos of different exposure.

After Debevec & Malik 1997 and Mitsunaga & Nayar 1999. Unknowns are the curve, log radiance per patch and channel, and,
where they are not given, the exposures. The residual is taken in display values, ``z - f(L t)``, where quantisation
noise is uniform; saturated observations enter as the inequality ``L t >= 1``. With the exposures unknown the data fix
the curve only up to (f^g, t^g, L^g); that exponent is left at the prior's here and chosen later by light transport.

Local exposure is found from patches that photos show in different places: one beside a window in one photo and alone
in another tells how strongly contrast is compressed, one in the middle and in a corner tells the vignetting. What all
photos compress in the same way cannot be seen, but is described by the same parameters.

Where several devices took the photos, each may have a curve, a gain per channel and local exposure of its own; radiance
is common to all, and the patches that two devices show tie their curves together.

Every refinement (a curve per device or channel, local exposure, corrected exposures) is fitted on four fifths of the
patches and kept if it lowers the disagreement on the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..base.minimise import simplex
from ..decide import Decisions
from ..model.device import Devices
from ..model.local_exposure import UNIFORM, LocalExposure, LocalSettings, SmallPhotos
from ..model.response import Response
from . import family
from .clipping import FLAT_SPREAD
from .curve_table import CurveTable
from .observations import Observations
from .overlap_problem import MIN_EXPOSURE_SPREAD, MIN_UNKNOWN_SPREAD, OverlapProblem

MAX_PATCHES = 1_500
"""Of either kind: patches that fix the shape of the curve, and patches that fix its scale."""
MAX_STEPS, SEPARATE_STEPS = 60, 5
"""One curve starts from the prior and runs until it has converged; three start from there and go on if they gain."""
START_STEPS, START_EVERY, START_LEVELS = 12, 4, (0.0, 0.8, 1.6)
"""For the first guess: steps, one patch in so many, and log exponents of the powers that are tried."""
CORRECTION_STEPS, CORRECTION_ROUNDS = 10, 3
"""For corrected exposures: steps of the curve after each correction, and corrections."""

LOCAL_TRIAL = {"strength": 0.1, "falloff": 0.2}
LOCAL_MAX = {"strength": 0.9, "falloff": 2.0}
"""Of each parameter: the value tried first, which has to lower the disagreement, and the upper bound."""
LOCAL_SCALES, LOCAL_HEADROOMS = (1 / 24, 1 / 12, 1 / 6, 1 / 3), (1.0, 2.0, 4.0, 8.0)
"""Of :class:`LocalSettings`, the values that are tried."""
LOCAL_TOLERANCE = 0.01
"""Change of a parameter at which the search for it ends."""
LOCAL_CURVE_STEPS = 8
"""Steps of the curve after each search for parameters."""


@dataclass(frozen=True)
class OverlapFit:
    """Curve, exposures and how well they explain held-out patches.

    Attributes:
        response: that of all photos, or of the first device.
        exposures: (V, 3) factor per view and channel; the channels differ where white balance was found to drift.
        residual: median absolute residual of display values on held-out patches, each as the robust loss takes it.
        per_channel: whether each channel has its own curve.
        local: exposure by place within a photo, None where photos are uniformly exposed.
        others: responses of the further devices, empty where one response is that of all photos.
    """

    response: Response
    exposures: NDArray[np.float64]
    residual: float
    per_channel: bool
    local: LocalExposure | None = None
    others: tuple[Response, ...] = ()


def _select(observations: Observations, rng: np.random.Generator) -> NDArray[np.int64]:
    """Indices of flat observations: of patches that two views show unclipped, and of patches that clip in some views.

    The first fix the shape of the curve, the second its scale, which is the radiance at which x = 1.
    """
    o = observations
    n = int(o.patch.max()) + 1
    flat = (o.spread.max(1) < FLAT_SPREAD) & (o.count >= 2)
    clipped = o.saturated.max(1) > 0
    n_unclipped = np.bincount(o.patch[flat & ~clipped], minlength=n)
    n_clipped = np.bincount(o.patch[flat & clipped], minlength=n)
    shape = np.flatnonzero(n_unclipped >= 2)
    anchor = np.flatnonzero((n_unclipped >= 1) & (n_clipped >= 1))
    chosen = np.zeros(n, bool)
    index = np.flatnonzero(flat & (n_unclipped[o.patch] >= 1))
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
    decisions: Decisions | None = None,
    small: SmallPhotos | None = None,
    devices: Devices | None = None,
) -> OverlapFit:
    """Recover the response, and the exposures where ``exposures`` is None.

    Args:
        exposures: (V,) known factors, or None.
        n_views: V, photos of the capture.
        rng: selects and holds out patches.
        fixed: a given response; only exposures are then fitted.
        decisions: where refinements are decided on held-out patches and written down.
        small: the photos, for local exposure; None leaves that out.
        devices: what took the photos; None where that is one camera, or not known.
    """
    decisions = decisions or Decisions()
    index = _select(observations, rng)
    problem = OverlapProblem.build(observations, index, exposures, n_views)
    if fixed is not None:
        return OverlapFit(fixed, problem.exposures(CurveTable.of(fixed), decisions), np.nan, False)
    if _of_one_exposure(problem):
        # The curve is unconstrained: the most common one is taken.
        median = family.PRIOR_MEAN[None]
        exposures = problem.exposures(family.table(median), decisions)
        return OverlapFit(family.to_response(median), exposures, np.nan, False)
    held_out = rng.random(problem.n_patches) < 0.2
    training, testing = problem.restrict(~held_out), problem.restrict(held_out)
    knots, error = _fit_curves(training, testing, decisions)
    if devices is not None and not decisions.forbids("device_curves"):
        device = torch.from_numpy(devices.index)
        apart, unseen = (replace(p, device=device) for p in (training, testing))
        own, own_error = _fit_curves(apart, unseen, decisions)
        if decisions.accept("device_curves", error, own_error, subject=", ".join(devices.names)):
            problem, training, testing, knots, error = replace(problem, device=device), apart, unseen, own, own_error
    # Before exposures: four parameters for all photos are the smaller model than one per photo.
    local = None
    if small is not None and not decisions.forbids("local_exposure"):
        local = find_local_exposure(training, testing, small, knots, decisions)
    if local is not None:
        problem, training, testing = (with_local_exposure(p, local) for p in (problem, training, testing))
        knots, error = _fit_curves(training, testing, decisions)
    if exposures is not None and not decisions.forbids("corrected_exposures"):
        log_t = _corrected_exposures(training, testing, knots, decisions)
        if log_t is not None:
            problem, training, testing = (replace(p, log_t=log_t) for p in (problem, training, testing))
            knots, error = _fit_curves(training, testing, decisions)
    response, *others = _responses(knots)
    return OverlapFit(
        response=response,
        exposures=problem.exposures(problem.curves(knots), decisions),
        residual=error,
        per_channel=knots.shape[-2] == 3,
        local=local,
        others=tuple(others),
    )


def _responses(knots: Tensor) -> list[Response]:
    """The response with the knots (C, 9), or that of each device with (D, C, 9)."""
    return [family.to_response(own) for own in knots.reshape(-1, *knots.shape[-2:])]


def _of_one_exposure(problem: OverlapProblem) -> bool:
    """Whether all photos have one exposure, judged by their overlap and by the exposures that are known."""
    seen = replace(problem, log_t=None).exposure_spread()
    if problem.log_t is None:
        return seen < MIN_UNKNOWN_SPREAD
    return max(float(problem.log_t.std(correction=0) / np.log(2)), seen) < MIN_EXPOSURE_SPREAD


def _fit_curves(training: OverlapProblem, testing: OverlapProblem, decisions: Decisions) -> tuple[Tensor, float]:
    """Knots (C, 9) of one curve, or of three if held-out patches bear them out; and the disagreement of these.

    Knots (D, C, 9) where devices have their own.
    """
    shared = training.minimise(_first_guess(training), MAX_STEPS)
    error = testing.disagreement(shared)
    if decisions.forbids("channel_curves"):
        return shared, error
    leading = replace(training, highlights=False)
    separate = leading.minimise(shared.repeat_interleave(3, -2), SEPARATE_STEPS)
    # One curve is the null hypothesis: cameras apply the same curve to all channels far more often than not.
    separate_error = testing.disagreement(separate)
    if decisions.accept("channel_curves", error, separate_error):
        separate = training.minimise(leading.minimise(separate, MAX_STEPS), MAX_STEPS)
        return separate, testing.disagreement(separate)
    return shared, error


def _first_guess(problem: OverlapProblem) -> Tensor:
    """Knots (1, 9) or (D, 1, 9) to start from.

    The median measured response, or a power with a lower loss on a quarter of the patches.

    Started from the median alone, the fit of a curve that crushes the shadows ends in a poor local minimum.
    """
    coarse = replace(problem.restrict(np.arange(problem.n_patches) % START_EVERY == 0), highlights=False)
    starts = [family.PRIOR_MEAN, *(torch.full_like(family.PRIOR_MEAN, level) for level in START_LEVELS)]
    ends = [coarse.minimise(coarse.with_shared(start), START_STEPS) for start in starts]
    return min(ends, key=lambda knots: float(coarse.residual(knots).square().sum()))


def _corrected_exposures(
    training: OverlapProblem, testing: OverlapProblem, knots: Tensor, decisions: Decisions
) -> Tensor | None:
    """Log exposures (3, V) in place of the recorded ones, or None where those stand.

    Recorded exposures may be rounded, and white balance may drift. A correction per photo, then one per channel, is
    accepted where held-out patches disagree less under it.
    """
    best, found = testing.disagreement(knots), None
    for per_channel in (False,) if decisions.forbids("white_balance") else (False, True):
        tried, log_t = knots, training.log_t
        for round_ in range(CORRECTION_ROUNDS):
            log_t = training.corrected_exposures(training.curves(tried), per_channel)
            worse = replace(testing, log_t=log_t).disagreement(tried) > best
            if round_ == 0 and worse and not decisions.forces("corrected_exposures"):
                break
            tried = replace(training, log_t=log_t).minimise(tried, CORRECTION_STEPS)
        disagreement = replace(testing, log_t=log_t).disagreement(tried)
        subject = "per channel" if per_channel else "per photo"
        if decisions.accept("corrected_exposures", best, disagreement, subject=subject):
            best, found = disagreement, log_t
    return found


# ---- Local exposure -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Fit:
    """Settings by device, curves that go with them, and the disagreement of held-out patches under both."""

    settings: tuple[LocalSettings, ...]
    knots: Tensor
    error: float


def find_local_exposure(
    training: OverlapProblem, testing: OverlapProblem, small: SmallPhotos, knots: Tensor, decisions: Decisions
) -> LocalExposure | None:
    """The local tone mapping and vignetting that held-out patches bear out; None where they bear out neither.

    Args:
        training, testing: problems of fitted and of held-out patches.
        small: the photos.
        knots: of the curve for uniformly exposed photos.
        decisions: where each parameter is decided; if local exposure is forced, all of them are taken.
    """
    uniform = (UNIFORM,) * training.n_devices
    forced, fit = decisions.forces("local_exposure"), _Fit(uniform, knots, testing.disagreement(knots))
    if not np.isfinite(fit.error):  # no unclipped patch was held out
        return None
    for device, share in enumerate(training.device_shares):
        search = _Search(training, testing, small, device)
        untried = list(LOCAL_TRIAL)
        while untried:
            ends = {name: search.along((name,), fit, forced) for name in untried}
            name, best = min(ends.items(), key=lambda end: end[1].error)
            subject = name if len(uniform) == 1 else f"{name} of camera {device + 1}"
            if not decisions.accept("local_exposure", fit.error, best.error, share=share, subject=subject):
                break
            fit = best
            untried.remove(name)
        if not untried:  # both darken corners, and one at a time they would creep along a valley of the loss
            fit = search.along(tuple(LOCAL_TRIAL), fit, forced=True)
    if fit.settings == uniform:
        return None
    return _local_exposure(small, fit.settings, fit.knots, training)


@dataclass(frozen=True)
class _Search:
    """Minimises the disagreement of the patches ``training`` over curves and the settings of a device, in turns."""

    training: OverlapProblem
    testing: OverlapProblem
    small: SmallPhotos
    device: int = 0

    def along(self, names: tuple[str, ...], start: _Fit, forced: bool) -> _Fit:
        """The best fit that differs from ``start`` in the parameters ``names`` and in the curve.

        Returns ``start`` if their trial values do not lower the disagreement.
        """
        settings, knots = start.settings, start.knots
        mapped = "strength" in names
        scales = [{"scale": scale} for scale in LOCAL_SCALES] if mapped else [{}]
        headrooms = [{"headroom": height} for height in LOCAL_HEADROOMS] if mapped else [{}]
        trial = {name: LOCAL_TRIAL[name] for name in names}
        tried = min(self._error(self._with(settings, {**trial, **scale}), knots) for scale in scales)
        if not forced and tried >= self._error(settings, knots):
            return start
        for choices in (scales, scales, headrooms, headrooms):
            ends = [self._best(names, self._with(settings, choice), knots) for choice in choices]
            settings = min(ends, key=lambda end: end[1])[0]
            knots = self._exposed(self.training, settings, knots).minimise(knots, LOCAL_CURVE_STEPS)
        return _Fit(settings, knots, self._exposed(self.testing, settings, knots).disagreement(knots))

    def _with(self, settings: tuple[LocalSettings, ...], changed: Mapping[str, float]) -> tuple[LocalSettings, ...]:
        """``settings`` with some parameters of the device changed."""
        own = replace(settings[self.device], **changed)
        return (*settings[: self.device], own, *settings[self.device + 1 :])

    def _best(
        self, names: tuple[str, ...], start: tuple[LocalSettings, ...], knots: Tensor
    ) -> tuple[tuple[LocalSettings, ...], float]:
        """The parameters at which patches agree best under given curves, and how well."""

        def at(x: NDArray[np.float64]) -> tuple[LocalSettings, ...]:
            return self._with(start, dict(zip(names, x.tolist(), strict=True)))

        first = np.array([getattr(start[self.device], name) for name in names])
        corners = first + np.vstack([np.zeros(len(names)), np.diag([LOCAL_TRIAL[name] for name in names])])
        bounds = [(0.0, LOCAL_MAX[name]) for name in names]
        found, error = simplex(lambda x: self._error(at(x), knots), corners, LOCAL_TOLERANCE, bounds)
        return at(found), error

    def _error(self, settings: tuple[LocalSettings, ...], knots: Tensor) -> float:
        return self._exposed(self.training, settings, knots).disagreement(knots)

    def _exposed(self, problem: OverlapProblem, settings: tuple[LocalSettings, ...], knots: Tensor) -> OverlapProblem:
        return with_local_exposure(problem, _local_exposure(self.small, settings, knots, problem))


def _local_exposure(
    small: SmallPhotos, settings: tuple[LocalSettings, ...], knots: Tensor, problem: OverlapProblem
) -> LocalExposure:
    """The gains of all photos under the settings and the curve of the device of each."""
    if problem.device is None:
        return small.local_exposure(settings[0], family.to_response(knots))
    device = problem.device.numpy()
    log_gain = np.empty(small.clipped.shape, np.float32)
    for index, response in enumerate(_responses(knots)):
        own = device == index
        log_gain[own] = small.take(own).local_exposure(settings[index], response).log_gain
    return LocalExposure(settings=settings[0], log_gain=log_gain, sizes=small.sizes, others=settings[1:])


def with_local_exposure(problem: OverlapProblem, local: LocalExposure) -> OverlapProblem:
    """``problem`` with the gains of ``local`` at its observations."""
    return replace(problem, log_gain=torch.from_numpy(np.log(local.at(problem.view.numpy(), problem.pixel.numpy()))))
