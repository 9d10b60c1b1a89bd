"""The least-squares problem behind the response: observations of patches in photos of different exposure.

Residuals are in display values; radiance, and exposures where they are unknown, are eliminated (variable projection).
They are differentiable functions of the curve: what is eliminated carries its derivative along, that of the exposures
by the implicit function theorem.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..base.group_by import group_means
from ..base.minimise import gauss_newton, one_thread
from ..base.segments import Segments
from ..decide import Decisions
from ..surface.topology import component_labels
from . import family
from .clipping import Clipping
from .curve_table import Curves, DeviceCurves
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
CLIP_SCALE = 0.03
"""Log exposure by which an observation may lie on the wrong side of saturation before it starts to be an outlier."""
ROBUST_SCALE = 0.01
"""Display-value residual at which an observation starts to count as an outlier (a highlight, a moved object)."""
CLIPPED_QUANTILE = 0.9
"""Of the least exposures at which clipped observations clip: some clip for a highlight."""
MIN_COMMON = 1e-12
"""Sum of squares of log exposures below which the overlap says that they are all the same."""
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
    """m observations of n patches in V photos, patch by patch; C channels, three unless one is fitted alone.

    Attributes:
        z: (C, m) display values in [0, 1].
        share: (C, m) of the pixels that are clipped, as far as noise lets that be told.
        clipped: (m,) whether any pixel is clipped in any channel, or noise may hide that it is.
        weight: (m,) statistical weight.
        patch, view: (m,) indices; ``patch`` ascends.
        pixel: (m,) row-major place in the photo.
        log_gain: (m,) what the camera adds to the log exposure there (local exposure).
        log_t: (C, V) log exposures, None where they are unknown.
        highlights: whether an observation may clip that other views show below saturation. Without, a curve that is far
            from the right one is led there.
        device: (V,) which of D devices took each photo; each has a curve of its own, and a gain per channel over the
            first. None where one curve is fitted to all.
    """

    z: Tensor
    share: Tensor
    clipped: Tensor
    weight: Tensor
    patch: Tensor
    view: Tensor
    pixel: Tensor
    log_gain: Tensor
    n_patches: int
    n_views: int
    log_t: Tensor | None
    highlights: bool = True
    device: Tensor | None = None

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
        clipping = Clipping.of(o)
        log_t = None if exposures is None else torch.from_numpy(np.log(np.asarray(exposures, np.float64))).expand(3, -1)
        return OverlapProblem(
            z=torch.from_numpy(np.clip(o.z[index].T.astype(np.float64) + 0.5 / 255, 0, 1)),
            share=torch.from_numpy(clipping.share[index].T.astype(np.float64)),
            clipped=torch.from_numpy(~clipping.measured[index]),
            weight=torch.from_numpy(np.minimum(o.count[index], 25.0).astype(np.float64) ** 0.25),
            patch=torch.from_numpy(patch),
            view=torch.from_numpy(o.view[index].astype(np.int64)),
            pixel=torch.from_numpy(o.pixel[index]),
            log_gain=torch.zeros(len(index), dtype=torch.float64),
            n_patches=len(patches),
            n_views=n_views,
            log_t=log_t,
        )

    def restrict(self, keep: NDArray[np.bool_]) -> OverlapProblem:
        """The same problem over some of the patches."""
        rows = torch.from_numpy(keep)[self.patch]
        patches, patch = self.patch[rows].unique(return_inverse=True)
        columns = {name: getattr(self, name)[..., rows] for name in _COLUMNS}
        return replace(self, patch=patch, n_patches=len(patches), **columns)

    def of_channel(self, channel: int) -> OverlapProblem:
        """The same problem for one channel."""
        log_t = None if self.log_t is None else self.log_t[channel, None]
        return replace(self, z=self.z[channel, None], share=self.share[channel, None], log_t=log_t)

    # ---- The loss, equation (14) ----

    def residual(self, log_knots: Tensor) -> Tensor:
        """All terms as one flat vector, whose squares add up to the loss; ``log_knots`` flat, of :meth:`curves`."""
        knots = log_knots.reshape(-1, family.N_KNOTS)
        curves = self.curves(knots if self.device is None else knots.unflatten(0, (self.n_devices, -1)))
        x = self.exposed(curves)
        terms = [
            self.mismatch(curves, x),
            self.saturation(x),
            self._prior_weight * family.prior_residual(knots),
            MONOTONICITY_WEIGHT * family.downhill(knots),
        ]
        # (f^g, t^g, L^g) fits as well for any g: without exposure times only the prior fixes the exponent, by contrast
        # as far as it leaves the curve free.
        if self.log_t is None:
            contrast = torch.cat([family.contrast_residual(table) for table in curves.tables])
            terms.append(EXPONENT_WEIGHT / self._prior_weight * contrast)
        return torch.cat([term.reshape(-1) for term in terms])

    @property
    def n_devices(self) -> int:
        """D, the number of curves (or of triples of them)."""
        return 1 if self.device is None else int(self.device.max()) + 1

    @property
    def device_shares(self) -> list[float]:
        """Share of the observations that each device took."""
        if self.device is None:
            return [1.0]
        counts = torch.bincount(self.device[self.view], minlength=self.n_devices)
        return (counts / max(len(self.view), 1)).tolist()

    def curves(self, log_knots: Tensor) -> Curves:
        """The curves with knots (C, 9), or (D, C, 9) where devices have their own."""
        if self.device is None:
            return family.table(log_knots)
        return DeviceCurves(tuple(family.table(own) for own in log_knots), self.device[self.view])

    def with_shared(self, log_knots: Tensor) -> Tensor:
        """(1, 9) or (D, 1, 9) knots of which every curve has those given, (9,)."""
        return log_knots[None] if self.device is None else log_knots.expand(self.n_devices, 1, -1)

    def mismatch(self, curves: Curves, x: Tensor) -> Tensor:
        """(C, m) robust distance of unclipped display values from those of relative exposures ``x`` (C, m)."""
        off = torch.where(self.clipped, 0.0, curves.at(x) - self.z)
        return cauchy_root(self.weight * off / ROBUST_SCALE)

    def saturation(self, x: Tensor) -> Tensor:
        """(C, m) distance of relative exposures from the side of 1 on which most pixels of the observation lie."""
        above = self.weight * x.clamp(min=1e-6).log() / CLIP_SCALE
        # A highlight clips what other views show far below, and by any amount: all such count the same.
        of_clipped = geman_mcclure_root if self.highlights else cauchy_root
        return torch.where(self.share <= 0.5, cauchy_root(above.clamp(min=0)), of_clipped((-above).clamp(min=0)))

    # ---- What is eliminated ----

    def exposed(self, curves: Curves) -> Tensor:
        """(C, m) relative exposures x = t g L under the exposures and the radiance that fit best under a curve."""
        t = self._exposure(self.log_exposures(curves))
        return self._patches.spread(self.radiance(curves, t)) * t

    def log_exposures(self, curves: Curves) -> Tensor:
        """(C, V) log exposures of the photos: known, or the best under a curve; with the gain of each device."""
        log_t = self._chained(curves) if self.log_t is None else self.log_t
        return log_t if self.device is None else log_t + self._device_gains(curves, log_t)[:, self.device]

    def _device_gains(self, curves: Curves, log_t: Tensor) -> Tensor:
        """(C, D) logarithm of what devices expose by more than the first does at the same exposure (C, V).

        Devices differ in what they call ISO 100, and in white balance. It is the exposure of photos once more, all
        photos of a device being one.
        """
        gains = self._of_devices._chained(curves, per_channel=True, beside=self._views.spread(log_t))
        return gains - gains[:, :1]

    @cached_property
    def _of_devices(self) -> OverlapProblem:
        """The problem with devices in place of photos."""
        assert self.device is not None
        return replace(self, view=self.device[self.view], n_views=self.n_devices, log_t=None, device=None)

    def radiance(self, curves: Curves, t: Tensor) -> Tensor:
        """(C, n) radiance of every patch that its observations of exposure ``t`` (C, m) agree on under a curve."""
        x = self._seen(curves)
        precision = self._precision(curves.slope(x) * t) + WEIGHT_FLOOR
        radiance = self._patches.means(x / t, precision)
        # An outlier would pull its patch along and so hide behind the others: the mean is taken once more without.
        for _ in range(2):
            off = (curves.at(self._patches.spread(radiance) * t) - self.z) / ROBUST_SCALE
            radiance = self._patches.means(x / t, precision / (1 + off.square()))
        return radiance

    def _seen(self, curves: Curves) -> Tensor:
        """(C, m) relative exposures by the display values alone."""
        return curves.inverse(self.z).clamp(min=BLACK_EXPOSURE)

    def _precision(self, rate: Tensor) -> Tensor:
        """(C, m) inverse variance of what display values tell, which change with it by ``rate`` (C, m).

        Noise is uniform in z. What is clipped or black tells nothing.
        """
        return torch.where(self.clipped | (self.z < BLACK_VALUE), 0.0, self.weight * rate.square())

    def _exposure(self, log_t: Tensor) -> Tensor:
        """(C, m) exposure of the observations under log exposures (C, V) of the photos."""
        return (self._views.spread(log_t) + self.log_gain).exp()

    @cached_property
    def _patches(self) -> Segments:
        return Segments.of(self.patch, self.n_patches)

    @cached_property
    def _views(self) -> Segments:
        return Segments.of(self.view, self.n_views)

    def _chained(self, curves: Curves, per_channel: bool = False, beside: Tensor | float = 0.0) -> Tensor:
        """(C, V) log exposures on which the views of each patch agree under a curve, equation (15).

        ``beside`` (C, m) is the logarithm of what exposes the observations in addition.

        Observations that are black, or on the shoulder of the curve, hardly count; outliers count less in a second
        pass. Photos that share nothing with the rest come out near the mean.
        """
        x = self._seen(curves)
        log_x, precision = x.log() - self.log_gain - beside, self._precision(curves.slope(x) * x)
        log_t = self._agreed(log_x, precision, per_channel)
        off = (self._apart(log_x, precision, log_t)) / ROBUST_SCALE
        return self._agreed(log_x, precision / (1 + off.square()), per_channel)

    def _apart(self, log_x: Tensor, precision: Tensor, log_t: Tensor) -> Tensor:
        """(C, m) log radiance of each observation about the mean of its patch, under log exposures (C, V)."""
        log_l = log_x - self._views.spread(log_t)
        norm = self._patches.sums(precision) + WEIGHT_FLOOR
        return log_l - self._patches.spread(self._patches.sums(precision * log_l) / norm)

    def _agreed(self, log_x: Tensor, precision: Tensor, per_channel: bool) -> Tensor:
        """(C, V) log exposures that minimise (15) under given weights (C, m).

        The Laplacian of the graph of photos that share patches is inverted, because alternating patch means and view
        means would take thousands of iterations on a walk through a house, where each photo overlaps with the next few
        only.
        """
        laplacian = self._laplacian(precision.detach())
        laplacian = laplacian if per_channel else laplacian.sum(0, keepdim=True)
        mean = laplacian.diagonal(dim1=1, dim2=2).mean(1)[:, None]
        hold = (UNLINKED_PULL * mean).clamp(min=1e-30)
        held = laplacian + torch.diag_embed(hold.expand(-1, self.n_views))

        def newton(log_t: Tensor) -> Tensor:
            """One step from log exposures (1 or C, V) towards those where the derivative of (15) vanishes."""
            apart = self._apart(log_x, precision, log_t.expand(len(log_x), -1))
            pull = self._views.sums(precision * apart)
            pull = (pull if per_channel else pull.sum(0, keepdim=True)) - hold * log_t
            return log_t + torch.linalg.solve(held, pull[..., None])[..., 0]

        # The problem is quadratic: the first step is the solution, the second adds its derivative.
        start = torch.zeros((len(held), self.n_views), dtype=torch.float64)
        return newton(newton(start).detach()).expand(len(log_x), -1)

    def _laplacian(self, precision: Tensor) -> Tensor:
        """(C, V, V) second derivative of (15) in the log exposures of the photos, patches eliminated."""
        norm = self._patches.spread(self._patches.sums(precision) + WEIGHT_FLOOR)
        cell = self.patch * self.n_views + self.view
        own, shared = self._views.sums(precision), []
        for row in precision * norm.rsqrt():
            of_patch = row.new_zeros(self.n_patches * self.n_views).index_add(0, cell, row).reshape(-1, self.n_views)
            shared.append(of_patch.T @ of_patch)
        return torch.diag_embed(own) - torch.stack(shared)

    # ---- Exposures under a given curve ----

    def exposure_spread(self) -> float:
        """Standard deviation of the exposures in stops, under the median measured response."""
        return float(self.log_exposures(family.table(family.PRIOR_MEAN[None])).std(correction=0) / np.log(2))

    def exposures(self, curves: Curves, decisions: Decisions) -> NDArray[np.float64]:
        """(V, 3) exposure factors under a curve: the known ones, or those that fit the overlap best.

        A factor per channel (white balance) is taken where it explains the overlap clearly better than one per photo.
        """
        log_t = self.log_exposures(curves)
        if self.log_t is None and not decisions.forbids("white_balance"):
            per_channel = self._chained(curves, per_channel=True)
            smaller, larger = self._spread(curves, log_t), self._spread(curves, per_channel)
            log_t = per_channel if decisions.accept("white_balance", smaller, larger) else log_t
        if self.log_t is None:
            log_t = self._long_enough_to_clip(curves, log_t)
        return log_t.exp().T.numpy().copy()

    def _long_enough_to_clip(self, curves: Curves, log_t: Tensor) -> Tensor:
        """Log exposures (C, V), those of photos that show nothing unclipped raised until what they clip does clip.

        The brightest photo of a bracket may be of that kind. Its exposure is only bounded from below; too short a one
        would make all that it shows a lamp.
        """
        x = self._seen(curves)
        precision = self._precision(curves.slope(x) * x)
        told = self._views.sums(precision).sum(0) > 0
        known = (self._patches.sums(precision) > 0).all(0)[self.patch]
        radiance = self._patches.spread(self.radiance(curves, self._exposure(log_t)))
        least = -(radiance.clamp(min=WEIGHT_FLOOR).log() + self.log_gain)
        raised = log_t.clone()
        for view in torch.nonzero(~told)[:, 0].tolist():
            own = known & (self.view == view) & (self.share > 0.5).all(0)
            if own.any():
                bound = least[:, own].quantile(CLIPPED_QUANTILE, dim=1).amax()
                raised[:, view] = torch.maximum(raised[:, view], bound)
        return raised

    def corrected_exposures(self, curves: Curves, per_channel: bool) -> Tensor:
        """(3, V) log exposures that fit the overlap best under a curve, on the scale of the known ones.

        The overlap fixes them up to an offset and a factor, the exponent of the curve. Both come from the regression of
        the known exposures, which have the errors, on those of the overlap. Photos without overlap keep theirs, and of
        groups of photos without overlap between them, as those of two light states, each keeps its mean.
        """
        assert self.log_t is not None
        recorded = self.log_exposures(curves)
        seen = torch.bincount(self.view[~self.clipped], minlength=self.n_views) > 0
        if not seen.any():
            return recorded
        known, free = recorded[:, seen], self._chained(curves, per_channel)[:, seen]
        mean = torch.empty_like(known)
        for own in self._linked(seen):
            mean[:, own] = known[:, own].mean(1, keepdim=True)
            free[:, own] = free[:, own] - free[:, own].mean(1, keepdim=True)
        common = free.mean(0)
        varied = known.std(correction=0) > MIN_EXPOSURE_SPREAD * np.log(2)
        energy = common @ common  # zero where all photos look alike, whatever their exposures
        factor = (common @ known.mean(0)) / energy if varied and energy > MIN_COMMON else 1.0
        log_t = recorded.clone()
        log_t[:, seen] = mean + factor * free
        return log_t

    def _linked(self, seen: Tensor) -> list[Tensor]:
        """(k,) bool per group of the k photos ``seen`` (V,), those whose patches link them; all of them as a rule."""
        view, patch = self.view[~self.clipped].numpy(), self.patch[~self.clipped].numpy() + self.n_views
        group = torch.from_numpy(component_labels(self.n_views + self.n_patches, view, patch)[: self.n_views])[seen]
        return [group == label for label in group.unique()]

    def _spread(self, curves: Curves, log_t: Tensor) -> float:
        """Median disagreement of views about a patch's log radiance under given log exposures (C, V)."""
        log_l = self._seen(curves).log() - self.log_gain - self._views.spread(log_t)
        log_l, patch = log_l[:, ~self.clipped].T.numpy(), self.patch[~self.clipped].numpy()
        return float(np.median(np.abs(log_l - group_means(log_l, patch, self.n_patches)[patch])))

    # ---- The fit ----

    @cached_property
    def _prior_weight(self) -> float:
        """Of the prior over curves; larger for unknown exposures that differ little, which leave much of the curve to
        whatever else makes views disagree."""
        if self.log_t is not None:
            return PRIOR_WEIGHT
        return PRIOR_WEIGHT * max(1.0, (AMPLE_EXPOSURE_SPREAD / max(self.exposure_spread(), MIN_UNKNOWN_SPREAD)) ** 2)

    def minimise(self, start: Tensor, max_steps: int) -> Tensor:
        """Knots (C, 9) of one or three curves, or (D, C, 9) of those of devices.

        Radiance and exposures are eliminated (variable projection).
        """
        if start.shape[-2] > 1 and self.log_t is not None:  # nothing couples the channels
            of_channels = enumerate(start.split(1, dim=-2))
            return torch.cat([self.of_channel(c).minimise(knots, max_steps) for c, knots in of_channels], dim=-2)
        found = gauss_newton(self.residual, start.reshape(-1), max_steps, CURVE_TOLERANCE)
        return found.reshape(start.shape)

    def disagreement(self, log_knots: Tensor) -> float:
        """Median absolute residual of unclipped observations, display values, each as the robust loss takes it.

        NaN where all are clipped or there is none.
        """
        if self.clipped.all():
            return np.nan
        with one_thread():
            curves = self.curves(log_knots)
            off = self.mismatch(curves, self.exposed(curves)) / self.weight
        return float(np.median(off[:, ~self.clipped].abs().numpy()) * ROBUST_SCALE)


# ---- Robust norms ---------------------------------------------------------------------------------------------------


def cauchy_root(r: Tensor) -> Tensor:
    """What has Cauchy's loss log(1 + r^2) as its square, with the sign of r."""
    square = r.square().clamp(min=1e-12)  # r itself near 0, where the root has no derivative
    return r * (torch.log1p(square) / square).sqrt()


def geman_mcclure_root(r: Tensor) -> Tensor:
    """What has the loss of Geman and McClure as its square, r^2 / (1 + r^2), which ends at 1."""
    return r * (1 + r.square()).rsqrt()
