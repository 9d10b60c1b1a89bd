"""The least-squares problem behind the response: observations of patches in photos of different exposure.

Residuals are in display values; radiance, and exposures where they are unknown, are eliminated (variable projection).

The kernels at the end go observation by observation. Observations lie patch by patch, and ``first`` (n + 1,) is where
each of the n patches begins. A curve is a table per channel (3, 1024) over relative exposures in [0, 1], as in
:class:`iris_addon.model.response.Response`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..base.compiled import Integer, Real, inlined, kernel
from ..base.group_by import group_means
from ..base.parallel import over_each
from ..decide import Decisions
from ..model.response import Response
from . import family
from .observations import Observations

EXPONENT_WEIGHT = 300.0
"""Weight of the prior over contrast, which alone fixes the exponent where exposures are unknown."""
MIN_EXPOSURE_SPREAD, MIN_UNKNOWN_SPREAD = 0.5, 0.25
"""Stops (standard deviation) below which known and unknown exposures vary too little to fix the curve."""
AMPLE_EXPOSURE_SPREAD = 2.7
"""Stops from which unknown exposures fix the curve as well as known ones do."""
PRIOR_WEIGHT = 1.0
"""One standard deviation of the prior over curves counts as one observation that is off by ROBUST_SCALE."""
MONOTONICITY_WEIGHT = 1e4
"""Weight of a curve's descent from one point to the next, in display values: in effect a constraint."""
CURVE_TOLERANCE = 1e-5
"""Relative decrease of the loss in one step below which the curve has converged."""
UNLINKED_PULL = 1e-9
"""Pull of each photo's log exposure towards zero, relative to that of other photos: fixes photos without overlap."""
KNOT_STEP = 1e-7
"""Change of log P at a knot for numerical derivatives."""

CLIP_SCALE = 0.03
"""Log exposure by which an observation may lie on the wrong side of saturation before it starts to be an outlier."""
ROBUST_SCALE = 0.01
"""Display-value residual at which an observation starts to count as an outlier (a highlight, a moved object)."""
BLACK_EXPOSURE = 1e-5
"""Relative exposure that stands for black."""
BLACK_VALUE = 1.5 / 255
"""Display value up to which an observation only bounds the exposure from above."""
WEIGHT_FLOOR = 1e-12
"""Keeps weighted means defined where no observation has any weight."""

_COLUMNS = ("z", "share", "clipped", "weight", "view", "pixel", "log_gain")
"""Fields with an entry per observation, the patch aside."""


@dataclass(frozen=True)
class OverlapProblem:
    """m observations of n patches in V photos, patch by patch.

    Attributes:
        z: (m, 3) display values in [0, 1].
        share: (m, 3) of the pixels that are clipped.
        clipped: (m,) whether any pixel is clipped in any channel.
        weight: (m,) statistical weight.
        patch, view: (m,) indices; ``patch`` ascends.
        pixel: (m,) row-major place in the photo.
        log_gain: (m,) what the camera adds to the log exposure there (local exposure).
        log_t: (V, 3) log exposures, None where they are unknown.
        highlights: whether an observation may clip that other views show below saturation. Without, a curve that is far
            from the right one is led there.
    """

    z: NDArray[np.float64]
    share: NDArray[np.float64]
    clipped: NDArray[np.bool_]
    weight: NDArray[np.float64]
    patch: NDArray[np.int64]
    view: NDArray[np.int64]
    pixel: NDArray[np.int32]
    log_gain: NDArray[np.float64]
    n_patches: int
    n_views: int
    log_t: NDArray[np.float64] | None
    highlights: bool = True

    @staticmethod
    def build(
        o: Observations,
        index: NDArray[np.int64],
        exposures: NDArray[np.floating] | None,
        n_views: int,
    ) -> OverlapProblem:
        """The problem of the observations ``index``; ``exposures`` (V,) or None where they are unknown."""
        index = index[np.argsort(o.patch[index], kind="stable")]
        patches, patch = np.unique(o.patch[index], return_inverse=True)
        return OverlapProblem(
            z=np.clip(o.z[index].astype(np.float64) + 0.5 / 255, 0, 1),
            share=o.saturated[index].astype(np.float64),
            clipped=o.saturated[index].max(1) > 0,
            weight=np.minimum(o.count[index], 25.0).astype(np.float64) ** 0.25,
            patch=patch,
            view=o.view[index].astype(np.int64),
            pixel=o.pixel[index],
            log_gain=np.zeros(len(index)),
            n_patches=len(patches),
            n_views=n_views,
            log_t=None if exposures is None else np.repeat(np.log(np.asarray(exposures, np.float64))[:, None], 3, 1),
        )

    def restrict(self, keep: NDArray[np.bool_]) -> OverlapProblem:
        """The same problem over some of the patches."""
        rows = keep[self.patch]
        patches, patch = np.unique(self.patch[rows], return_inverse=True)
        columns = {name: getattr(self, name)[rows] for name in _COLUMNS}
        return replace(self, patch=patch, n_patches=len(patches), **columns)

    def solve_radiance(self, response: Response) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log exposures (V, 3) and radiance (n, 3) that fit best under a given curve."""
        log_t, exposure = self._exposed_under(response)
        return log_t, self._radiance(response, exposure)

    def _exposed_under(self, response: Response) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log exposures of photos (V, 3) and exposures of observations (m, 3): known, or the best under a curve."""
        if self.log_t is not None:
            return self.log_t, self._known_exposure
        log_t = self._chained(response)
        return log_t, self._exposure(log_t)

    @cached_property
    def _known_exposure(self) -> NDArray[np.float64]:
        assert self.log_t is not None
        return self._exposure(self.log_t)

    def _radiance(self, response: Response, exposure: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) that fits best under a given curve and exposures (m, 3)."""
        radiance, scratch = np.empty((self.n_patches, 3)), (np.empty_like(self.z), np.empty_like(self.z))
        data = self.z, self.clipped, self.weight, exposure
        project(response.samples, response.slopes, self._first, *data, *scratch, radiance)
        return radiance

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        """(n + 1,) where the observations of each patch begin."""
        return np.searchsorted(self.patch, np.arange(self.n_patches + 1))

    def _exposure(self, log_t: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m, 3) exposure of the observations under log exposures (V, 3) of the photos."""
        return np.exp(log_t[self.view] + self.log_gain[:, None])

    def _log_exposed(self, response: Response) -> NDArray[np.float64]:
        """(m, 3) log exposure of each observation without the local gain of its place."""
        return np.subtract(np.log(np.maximum(response.invert(self.z), BLACK_EXPOSURE)), self.log_gain[:, None])

    def exposure_spread(self) -> float:
        """Standard deviation of the exposures in stops, under the median measured response."""
        log_t, _ = self.solve_radiance(family.to_response([family.PRIOR_MEAN]))
        return float(np.std(log_t) / np.log(2))

    def exposures(self, response: Response, decisions: Decisions) -> NDArray[np.float64]:
        """(V, 3) exposure factors under a curve: the known ones, or those that fit the overlap best.

        A factor per channel (white balance) is taken where it explains the overlap clearly better than one per photo.
        """
        shared = self.solve_radiance(response)[0]
        if self.log_t is not None or decisions.forbids("white_balance"):
            return np.exp(shared)
        log_x, per_channel = self._log_exposed(response), self._chained(response, per_channel=True)
        smaller, larger = self._spread(log_x, shared), self._spread(log_x, per_channel)
        return np.exp(per_channel if decisions.accept("white_balance", smaller, larger) else shared)

    def corrected_exposures(self, response: Response, per_channel: bool) -> NDArray[np.float64]:
        """(V, 3) log exposures that fit the overlap best under a curve, on the scale of the known ones.

        The overlap fixes them up to an offset and a factor, the exponent of the curve. Both come from the regression of
        the known exposures, which have the errors, on those of the overlap. Photos without overlap keep theirs.
        """
        assert self.log_t is not None
        free = self._chained(response, per_channel)
        seen = np.bincount(self.view[~self.clipped], minlength=self.n_views) > 0
        known, free = self.log_t[seen], free[seen] - free[seen].mean(0)
        varied = known.std() > MIN_EXPOSURE_SPREAD * np.log(2)
        common = free.mean(1)
        factor = float(common @ known.mean(1) / (common @ common)) if varied else 1.0
        log_t = self.log_t.copy()
        log_t[seen] = known.mean(0) + factor * free
        return log_t

    def _chained(self, response: Response, per_channel: bool = False) -> NDArray[np.float64]:
        """(V, 3) log exposures on which the views of each patch agree under a curve.

        Observations that are black, or on the shoulder of the curve, hardly count; outliers count less in a second
        pass. The Laplacian of the graph of photos that share patches is inverted, because alternating patch means and
        view means would take thousands of iterations on a walk through a house, where each photo overlaps with the next
        few only. Photos that share nothing with the rest come out near the mean.
        """
        log_x, precision, scratch = (np.empty_like(self.z) for _ in range(3))
        data = self.z, self.clipped, self.weight, self.log_gain
        log_exposures(response.samples, response.slopes, *data, log_x, precision)
        log_t, n, channels = np.zeros((self.n_views, 3)), self.n_views, 3 if per_channel else 1
        for trusting in (True, False):
            half, pull = np.zeros((channels, n, n)), np.zeros((channels, n))
            add_links(self._first, self.view, log_x, precision, log_t, trusting, scratch, half, pull)
            laplacian = half + half.transpose(0, 2, 1)
            mean = np.trace(laplacian, axis1=1, axis2=2)[:, None, None] / n
            held = laplacian + np.maximum(UNLINKED_PULL * mean, 1e-30) * np.eye(n)
            log_t = np.ascontiguousarray(np.broadcast_to(np.linalg.solve(held, pull[..., None])[..., 0].T, (n, 3)))
        return log_t

    def _spread(self, log_x: NDArray[np.float64], log_t: NDArray[np.float64]) -> float:
        """Median disagreement of views about a patch's log radiance under given log exposures (V, 3)."""
        use = ~self.clipped
        log_l = (log_x - log_t[self.view])[use]
        patch = self.patch[use]
        mean = group_means(log_l, patch, self.n_patches)
        return float(np.median(np.abs(log_l - mean[patch])))

    def residual(self, parameters: NDArray[np.float64], n_curves: int) -> NDArray[np.float64]:
        """Display-value residuals, saturation hinges and prior, one flat vector."""
        knots = list(parameters.reshape(n_curves, -1))
        response = family.to_response(knots)
        _, exposure = self._exposed_under(response)
        radiance = self._radiance(response, exposure)
        mismatch, saturation = np.empty_like(self.z), np.empty_like(self.z)
        data = self.z, self.share, self.clipped, self.weight, exposure, radiance
        residuals(response.samples, self._first, *data, self.highlights, mismatch, saturation)
        prior = [self._prior_weight * family.prior_residual(k) for k in knots]
        bends = [MONOTONICITY_WEIGHT * family.downhill(k) for k in knots]
        # (f^g, t^g, L^g) fits as well for any g: without exposure times only the prior fixes the exponent, by contrast
        # as far as it leaves the curve free.
        held = np.zeros(0)
        if self.log_t is None:
            held = EXPONENT_WEIGHT / self._prior_weight * family.contrast_residual(response)
        return np.concatenate([mismatch.ravel(), saturation.ravel(), *prior, *bends, held])

    @cached_property
    def _prior_weight(self) -> float:
        """Of the prior over curves; larger for unknown exposures that differ little, which leave much of the curve to
        whatever else makes views disagree."""
        if self.log_t is not None:
            return PRIOR_WEIGHT
        return PRIOR_WEIGHT * max(1.0, (AMPLE_EXPOSURE_SPREAD / max(self.exposure_spread(), MIN_UNKNOWN_SPREAD)) ** 2)

    def minimise(self, start: list[NDArray[np.float64]], max_steps: int) -> list[NDArray[np.float64]]:
        """Knots of one or three curves; radiance and exposures are eliminated (variable projection)."""
        n_curves = len(start)
        fit = least_squares(
            self.residual,
            np.concatenate(start),
            self.jacobian,  # type: ignore[arg-type]
            args=(n_curves,),
            max_nfev=max_steps,
            x_scale=0.3,
            ftol=CURVE_TOLERANCE,
        )
        return list(fit.x.reshape(n_curves, -1))

    def jacobian(self, parameters: NDArray[np.float64], n_curves: int) -> NDArray[np.float64]:
        """(n, parameters) derivative of :meth:`residual` by forward differences.

        Under known exposures one knot of every curve is moved at once, because each residual depends on one curve only.
        Unknown exposures are shared by the channels and couple the curves.
        """
        n, base = parameters.size, self.residual(parameters, n_curves)
        tied = n_curves == 1 or self.log_t is None
        together = np.arange(n)[:, None] if tied else np.arange(n).reshape(n_curves, -1).T
        of_curve = None if tied else self._curve_of_residual(n_curves)
        jacobian = np.zeros((len(base), n))

        def move(columns: NDArray[np.int64]) -> None:
            moved = parameters.copy()
            moved[columns] += KNOT_STEP
            slope = (self.residual(moved, n_curves) - base) / KNOT_STEP
            for c, column in enumerate(columns):
                jacobian[:, column] = slope if of_curve is None else np.where(of_curve == c, slope, 0.0)

        over_each(list(together), move)
        return jacobian

    def _curve_of_residual(self, n_curves: int) -> NDArray[np.int64]:
        """(n,) index of the curve on which each residual depends, of several."""
        data = np.tile(np.arange(3), 2 * len(self.z))
        # Behind the data stand the priors of the curves, then their bends.
        each = [np.repeat(np.arange(n_curves), size) for size in (family.PRIOR_RESIDUALS, family.DOWNHILL_RESIDUALS)]
        return np.concatenate([data, *each])

    def disagreement(self, knots: list[NDArray[np.float64]]) -> float:
        """Median absolute residual of unclipped observations, display values, each as the robust loss takes it.

        NaN where all are clipped or there is none.
        """
        if self.clipped.all():
            return np.nan
        mismatch = self.residual(np.concatenate(knots), len(knots))[: self.z.size].reshape(-1, 3) / self.weight[:, None]
        return float(np.median(np.abs(mismatch[~self.clipped])) * ROBUST_SCALE)


# ---- Kernels --------------------------------------------------------------------------------------------------------


@inlined
def _at(table: NDArray[np.float64], channel: Integer, x: Real) -> Real:
    """Display value of a relative exposure."""
    place = min(max(x, 0.0), 1.0) * (table.shape[1] - 1)
    k = min(np.int64(place), table.shape[1] - 2)
    return table[channel, k] + (place - k) * (table[channel, k + 1] - table[channel, k])


@inlined
def _inverse(table: NDArray[np.float64], channel: Integer, z: Real) -> Real:
    """Relative exposure of a display value; the middle of a stretch where the curve is flat."""
    last = table.shape[1] - 1
    ramp = 1e-9 / last  # a vanishing slope, under which the inverse is unique
    at, step = np.int64(0), np.int64(last + 1) >> 1
    while step > 0:  # without branches that a processor would guess wrong: the table's length is a power of two
        at += step if table[channel, at + step] + ramp * (at + step) <= z else 0
        step >>= 1
    at = min(at, last - 1)
    left, right = table[channel, at] + ramp * at, table[channel, at + 1] + ramp * (at + 1)
    return (at + min(max((z - left) / (right - left), 0.0), 1.0)) / last


@kernel
def project(
    table: NDArray[np.float64],
    slope: NDArray[np.float64],
    first: NDArray[np.int64],
    z: NDArray[np.float64],
    clipped: NDArray[np.bool_],
    weight: NDArray[np.float64],
    exposure: NDArray[np.float64],
    found: NDArray[np.float64],
    precision: NDArray[np.float64],
    radiance: NDArray[np.float64],
) -> None:
    """Radiance (n, 3) of every patch that its m observations agree on under a curve.

    Args:
        table, slope: the curve and its derivative.
        z, exposure: (m, 3) display values and exposures, ``clipped`` and ``weight`` (m,).
        found, precision: (m, 3) overwritten with the radiance that each observation shows, and its precision.
    """
    for p in range(len(first) - 1):
        rows = range(first[p], first[p + 1])
        for c in range(3):
            total = norm = 0.0
            for j in rows:
                x, t = max(_inverse(table, c, z[j, c]), BLACK_EXPOSURE), exposure[j, c]
                found[j, c] = x / t
                # Quantisation noise is uniform in z, so the precision of x / t is (f'(x) t)^2.
                rate = _at(slope, c, x) * t
                unconstrained = clipped[j] or z[j, c] < BLACK_VALUE
                precision[j, c] = (0.0 if unconstrained else weight[j] * rate * rate) + WEIGHT_FLOOR
                total += precision[j, c] * found[j, c]
                norm += precision[j, c]
            radiance[p, c] = total / norm
            # An outlier would pull its patch along and so hide behind the others: the mean is taken once more without.
            for _ in range(2):
                total = norm = 0.0
                for j in rows:
                    off = (_at(table, c, radiance[p, c] * exposure[j, c]) - z[j, c]) / ROBUST_SCALE
                    trusted = precision[j, c] / (1 + off * off)
                    total += trusted * found[j, c]
                    norm += trusted
                radiance[p, c] = total / norm


@kernel
def log_exposures(
    table: NDArray[np.float64],
    slope: NDArray[np.float64],
    z: NDArray[np.float64],
    clipped: NDArray[np.bool_],
    weight: NDArray[np.float64],
    log_gain: NDArray[np.float64],
    log_x: NDArray[np.float64],
    precision: NDArray[np.float64],
) -> None:
    """Log exposure (m, 3) of each observation without the local gain of its place, and its precision.

    Noise is uniform in z, so the precision of log x is (f'(x) x)^2; 0 where clipped or black.
    """
    for j in range(len(z)):
        for c in range(3):
            x = max(_inverse(table, c, z[j, c]), BLACK_EXPOSURE)
            rate = _at(slope, c, x) * x
            log_x[j, c] = math.log(x) - log_gain[j]
            precision[j, c] = 0.0 if clipped[j] or z[j, c] < BLACK_VALUE else weight[j] * rate * rate


@kernel
def add_links(
    first: NDArray[np.int64],
    view: NDArray[np.int64],
    log_x: NDArray[np.float64],
    precision: NDArray[np.float64],
    log_t: NDArray[np.float64],
    trusting: bool,
    scaled: NDArray[np.float64],
    laplacian: NDArray[np.float64],
    pull: NDArray[np.float64],
) -> None:
    """Add up the normal equations of the log exposures under which all views of a patch agree.

    Args:
        log_x, precision: (m, 3) of :func:`log_exposures`; ``precision`` is overwritten.
        log_t: (V, 3) log exposures; unless ``trusting``, outliers under them count less.
        scaled: (m, 3) scratch.
        laplacian, pull: (3, V, V) and (3, V), or the sums over channels (1, V, V) and (1, V). The laplacian is filled
            on and below the diagonal, with half of the diagonal: the full one is its sum with its transpose.
    """
    each = len(pull) == 3
    for p in range(len(first) - 1):
        rows = range(first[p], first[p + 1])
        for c in range(3):
            k = c if each else 0
            if not trusting:
                total, norm = 0.0, WEIGHT_FLOOR
                for j in rows:
                    total += precision[j, c] * (log_x[j, c] - log_t[view[j], c])
                    norm += precision[j, c]
                for j in rows:
                    off = (log_x[j, c] - log_t[view[j], c] - total / norm) / ROBUST_SCALE
                    precision[j, c] /= 1 + precision[j, c] * off * off
            total, norm = 0.0, WEIGHT_FLOOR
            for j in rows:
                total += precision[j, c] * log_x[j, c]
                norm += precision[j, c]
            root = math.sqrt(norm)
            for j in rows:
                a, s = view[j], precision[j, c]
                scaled[j, c] = s / root
                laplacian[k, a, a] += 0.5 * (s - scaled[j, c] * scaled[j, c])
                pull[k, a] += s * (log_x[j, c] - total / norm)
        for j in rows:
            for i in range(first[p], j):
                a, b = max(view[i], view[j]), min(view[i], view[j])
                if each:
                    for c in range(3):
                        laplacian[c, a, b] -= scaled[i, c] * scaled[j, c]
                else:
                    laplacian[0, a, b] -= (
                        scaled[i, 0] * scaled[j, 0] + scaled[i, 1] * scaled[j, 1] + scaled[i, 2] * scaled[j, 2]
                    )


@inlined
def _cauchy(residual: Real) -> Real:
    """A residual whose square is Cauchy's loss."""
    return math.copysign(math.sqrt(math.log1p(residual * residual)), residual)


@kernel
def residuals(
    table: NDArray[np.float64],
    first: NDArray[np.int64],
    z: NDArray[np.float64],
    share: NDArray[np.float64],
    clipped: NDArray[np.bool_],
    weight: NDArray[np.float64],
    exposure: NDArray[np.float64],
    radiance: NDArray[np.float64],
    highlights: bool,
    mismatch: NDArray[np.float64],
    saturation: NDArray[np.float64],
) -> None:
    """Fill ``mismatch`` and ``saturation`` (m, 3) with the robust residuals of display values and of clipping.

    Args:
        share: (m, 3) of pixels clipped.
        highlights: whether the loss is bounded for an observation that clips where other views are below saturation.
    """
    for p in range(len(first) - 1):
        for j in range(first[p], first[p + 1]):
            for c in range(3):
                x = radiance[p, c] * exposure[j, c]
                off = 0.0 if clipped[j] else _at(table, c, x) - z[j, c]
                mismatch[j, c] = _cauchy(weight[j] * off / ROBUST_SCALE)
                # A byte of 255 means x >= 1 and any other means x < 1: the share of clipped pixels pins the scale.
                above = weight[j] * math.log(max(x, 1e-6)) / CLIP_SCALE
                if share[j, c] <= 0.5:
                    saturation[j, c] = _cauchy(max(above, 0.0))
                else:
                    # A highlight clips what other views show far below, and by any amount: all such count the same, by
                    # the loss of Geman and McClure, which ends at 1.
                    below = max(-above, 0.0)
                    saturation[j, c] = below / math.sqrt(1 + below * below) if highlights else _cauchy(below)
