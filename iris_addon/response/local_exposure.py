"""Whether a camera exposes places of a photo differently, found from overlap: patches that photos show in other places.

A patch beside a window in one photo and alone in another tells how strongly contrast is compressed; one in the middle
and in a corner tells the vignetting. What all photos compress alike is invisible to them, but has the same parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ..model.local_exposure import ALIKE, LocalExposure, LocalSettings, SmallPhotos
from . import family
from .overlap_problem import OverlapProblem

LOCAL_GAIN = 0.95
"""Disagreement of held-out patches, relative to that without, at which a parameter earns its place."""
A_LITTLE = {"strength": 0.1, "falloff": 0.2}
MOST = {"strength": 0.9, "falloff": 2.0}
"""Of each parameter: what is tried first, which has to help, and its upper bound."""
SCALES, HEADROOMS = (1 / 24, 1 / 12, 1 / 6, 1 / 3), (1.0, 2.0, 4.0, 8.0)
TOLERANCE = 0.01
STEPS = 8
"""Of the curve, each time that parameters were found under it."""

Knots = list[NDArray[np.float64]]


@dataclass(frozen=True)
class _Fit:
    """Settings, the curve that goes with them, and the disagreement of held-out patches under both."""

    settings: LocalSettings
    knots: Knots
    error: float


def find_local_exposure(
    training: OverlapProblem, testing: OverlapProblem, small: SmallPhotos, knots: Knots, forced: bool
) -> LocalExposure | None:
    """The local tone mapping and vignetting that held-out patches bear out; None where they do not.

    Args:
        knots: of the curve under which places are alike.
        forced: whether all parameters are taken, whatever held-out patches say.
    """
    search = _Search(training, testing, small)
    fit = _Fit(ALIKE, knots, testing.disagreement(knots))
    if not np.isfinite(fit.error):  # no patch was held out: nothing could be borne out
        return None
    untried = list(A_LITTLE)
    while untried:
        ends = {name: search.along((name,), fit, forced) for name in untried}
        name, best = min(ends.items(), key=lambda end: end[1].error)
        if not forced and best.error > LOCAL_GAIN * fit.error:
            break
        fit = best
        untried.remove(name)
    if not untried:  # corners are dark for one reason or the other: one by one they would creep along a valley
        fit = search.along(tuple(A_LITTLE), fit, forced=True)
    if fit.settings == ALIKE:
        return None
    return small.local_exposure(fit.settings, family.to_response(fit.knots))


@dataclass(frozen=True)
class _Search:
    training: OverlapProblem
    testing: OverlapProblem
    small: SmallPhotos

    def along(self, names: tuple[str, ...], start: _Fit, forced: bool) -> _Fit:
        """The best fit that differs from ``start`` in some parameters and in the curve; ``start`` where a little of
        them does not help."""
        settings, knots = start.settings, start.knots
        mapped = "strength" in names
        scales = [{"scale": scale} for scale in SCALES] if mapped else [{}]
        headrooms = [{"headroom": height} for height in HEADROOMS] if mapped else [{}]
        little = {name: A_LITTLE[name] for name in names}
        tried = min(self._error(replace(settings, **little, **scale), knots) for scale in scales)
        if not forced and tried >= self._error(settings, knots):
            return start
        for choices in (scales, scales, headrooms, headrooms):
            ends = [self._best(names, replace(settings, **choice), knots) for choice in choices]
            settings = min(ends, key=lambda end: end[1])[0]
            knots = self._exposed(self.training, settings, knots).minimise(knots, STEPS)
        return _Fit(settings, knots, self._exposed(self.testing, settings, knots).disagreement(knots))

    def _best(self, names: tuple[str, ...], start: LocalSettings, knots: Knots) -> tuple[LocalSettings, float]:
        """The parameters at which patches agree best under a given curve, and how well."""
        at = np.array([getattr(start, name) for name in names])
        found = minimize(
            lambda x: self._error(replace(start, **dict(zip(names, x.tolist(), strict=True))), knots),
            at,
            method="Nelder-Mead",
            bounds=[(0.0, MOST[name]) for name in names],
            options={
                "initial_simplex": np.vstack([at, at + np.diag([A_LITTLE[name] for name in names])]),
                "xatol": TOLERANCE,
                "fatol": np.inf,  # steps decide: at a distance errors hardly differ
            },
        )
        return replace(start, **dict(zip(names, found.x.tolist(), strict=True))), float(found.fun)

    def _error(self, settings: LocalSettings, knots: Knots) -> float:
        return self._exposed(self.training, settings, knots).disagreement(knots)

    def _exposed(self, problem: OverlapProblem, settings: LocalSettings, knots: Knots) -> OverlapProblem:
        return exposed(problem, self.small.local_exposure(settings, family.to_response(knots)))


def exposed(problem: OverlapProblem, local: LocalExposure) -> OverlapProblem:
    """``problem`` of photos whose places are exposed differently."""
    return replace(problem, log_gain=np.log(local.at(problem.view, problem.pixel)))
