"""The light balance: the radiance of emitters from the albedo it implies, equation (18).

For patches whose radiance L is known the balance reads ``a = L / (I + B e)``, with I the irradiance / pi from other
patches and B e that from the emitters. The right radiances e make the albedo constant within each region. The loss is a
robust norm of log albedo about one value per region, minimised over e and the albedos of all regions together. Every
pair of patches of a region is thereby compared, however far apart; comparing neighbours alone leaves e undetermined by
a factor e^1.3. The loss is smooth in log e, and L-BFGS takes about a second. What photos show of the emitters
themselves enters as a penalty, equation (20): a bound from clipped pixels, a measurement from unclipped ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..base.group_by import group_medians
from ..base.minimise import lbfgs, one_thread
from ..decide import HeldOutLosses

MIN_PATCHES_PER_REGION = 12
"""Patches below which a region is left out of the balance."""
MAX_PATCHES = 15_000
"""Patches that enter the balance at most."""
HELD_OUT_EVERY = 8
"""One patch in so many is held out."""
MAX_ALBEDO, TOO_WHITE_WEIGHT = 0.95, 50.0
"""Largest albedo of a region without a penalty, and weight of that penalty."""
UNKNOWN_ALBEDO = 0.5
"""Albedo from which a region without patches starts."""
ROOM_ALBEDO, ROOM_ALBEDO_STD = 0.45, 0.5
"""Expected geometric mean of a room's albedo and its standard deviation in log: lighting is planned for ceilings of 0.7
to 0.9, walls of 0.5 to 0.8 and floors of 0.2 to 0.4 (EN 12464-1), and furniture is darker."""
MAX_LOG_RADIANCE = 30.0
"""Bound on the absolute log radiance, which keeps a trial step of the optimiser from overflowing: a lamp that lights
nothing may take any radiance."""
ROBUST_LOG = 0.15
"""Log-albedo deviation at which a patch starts to count as an outlier (texture, a contact shadow, a highlight)."""
ITERATIONS = 80
"""Iterations of L-BFGS at most."""
MIN_CURVATURE = 1e-4
"""Least curvature assumed of the loss in an unknown, which bounds the step of unknowns without influence."""
GUESS_ROBUST_LOG, GUESS_ITERATIONS, GUESS_EVERY, GUESS_LEVELS = 1.0, 20, 4, (1.0, 30.0)
"""Of the first guess: robust scale, iterations, one patch in so many, and factors on the start."""
EFFECTIVE_PATCHES = 500
"""Independent observations that the shading counts as at most, because neighbouring patches err together."""
START_SHARE = 0.1
"""Share of the light that a lamp without evidence brings at the start; at zero it would have no gradient."""
LAMP_TINT_STD, OUTSIDE_TINT_STD = 0.35, 0.25
"""Standard deviation of a channel's log radiance about the mean of the channels, of a lamp and of light from outside; a
black body of 4000 K lies 0.40 from white, one of 10 000 K 0.21."""
LAMP_MEASURED_STD = 0.03
"""Standard deviation of log radiance about a measurement from unclipped pixels."""
LAMP_BOUND_STD = 0.02
"""Standard deviation of log radiance below a bound from clipped pixels."""
OUTSIDE_EXPECTED_STD, LAMP_CLIPPED_STD = 1.5, 4.0
"""Standard deviation of log radiance about the expectation: of outside light, and of a lamp that is clipped. The latter
is so weak that the light of all but a speck outweighs it."""
NO_BOUND = 1e-6
"""Radiance that stands for the absence of a bound."""


@dataclass(frozen=True)
class Balance:
    """A solved light balance.

    Attributes:
        radiance: (E, 3) per emitter, scene-linear Rec.709.
        log_std: (E,) standard deviation of log radiance from the curvature of the loss.
        region_ids: (n,) regions that took part.
        region_albedo: (n, 3) of these regions.
        held_out: mean robust loss of the held-out patches.
        losses: of each of them, by its row among the patches given.
    """

    radiance: NDArray[np.float64]
    log_std: NDArray[np.float64]
    region_ids: NDArray[np.int64]
    region_albedo: NDArray[np.float64]
    held_out: float
    losses: HeldOutLosses


@dataclass(frozen=True)
class ShadedPatches:
    """Patches whose radiance and light are compared, P of them.

    Attributes:
        radiance: (P, 3) diffuse radiance, scene-linear Rec.709; rows with weight 0 are ignored.
        indirect: (P, 3) irradiance / pi from other patches and through holes, ``G L + T`` of equation (1).
        form_factors: (P, E) shares of the emitters, ``B`` and ``C`` of equation (1).
        region: (P,) region of each patch.
        weight: (P,) statistical weight, >= 0.
        bounded: (P, 3) bool, where ``radiance`` is no more than a lower bound, because all photos clip there; by
            default nowhere.
    """

    radiance: NDArray[np.floating]
    indirect: NDArray[np.floating]
    form_factors: NDArray[np.floating]
    region: NDArray[np.integer]
    weight: NDArray[np.floating]
    bounded: NDArray[np.bool_] | None = None


def solve_balance(
    patches: ShadedPatches,
    evidence: Evidence,
    start: NDArray[np.floating],
    robust_log: float = ROBUST_LOG,
    warm_start: bool = False,
    iterations: int = ITERATIONS,
) -> Balance:
    """Radiance of every emitter from the shading of everything else: the minimum of equation (18).

    Args:
        patches: the shading; at most MAX_PATCHES are used.
        evidence: what photos show of the emitters themselves.
        start: (E, 3) radiance to start from, > 0.
        robust_log: deviation of log albedo at which a patch starts to count as an outlier.
        warm_start: whether ``start`` solves a similar problem, so that no other level of light needs to be tried.
        iterations: of L-BFGS at most.
    """
    radiance, indirect, form_factors, weight = patches.radiance, patches.indirect, patches.form_factors, patches.weight
    bounded = np.zeros(radiance.shape, bool) if patches.bounded is None else patches.bounded
    rows, label, region_ids = _usable(radiance, patches.region, weight, bounded)
    n_tied = int(evidence.tie.max()) + 1
    first = np.array([np.flatnonzero(evidence.tie == k)[0] for k in range(n_tied)])
    whole = LightBalance(
        log_radiance=_columns(np.log(radiance[rows])),
        bounded=torch.from_numpy(np.ascontiguousarray(bounded[rows].T)),
        indirect=_columns(np.maximum(indirect[rows], 1e-6)),
        form_factors=_columns(
            np.stack([form_factors[rows][:, evidence.tie == k].sum(1, np.float64) for k in range(n_tied)], 1)
        ),
        weight=torch.from_numpy(weight[rows].astype(np.float64)),
        region=torch.from_numpy(label),
        n_regions=len(region_ids),
        direct=DirectEvidence.of(evidence, n_tied),
        scale=robust_log,
    )
    tested = _held_out(bounded[rows].any(1))
    problem, held_out = (whole.restrict(torch.from_numpy(some)) for some in (~tested, tested))
    log_start = torch.from_numpy(np.log(start[first], dtype=np.float64))
    with one_thread():
        guess = problem.joined(log_start) if warm_start else _first_guess(problem, log_start)
        log_e, log_albedo = problem.split(_minimise(problem, guess, iterations))
        losses = held_out.shading_losses(log_e, log_albedo)
        log_std = problem.log_std(log_e)
    return Balance(
        radiance=log_e.exp().numpy()[evidence.tie],
        log_std=log_std.numpy()[evidence.tie],
        region_ids=region_ids,
        region_albedo=log_albedo.exp().numpy(),
        held_out=float(held_out.weight @ losses),
        losses=HeldOutLosses(rows[tested], losses.numpy(), held_out.weight.numpy(), EFFECTIVE_PATCHES),
    )


def _columns(rows: NDArray[np.floating]) -> Tensor:
    """(C, n) float64 tensor of values (n, C)."""
    return torch.from_numpy(np.ascontiguousarray(rows.T, np.float64))


def noticeable_radiance(light: NDArray[np.floating], form_factors: NDArray[np.floating]) -> NDArray[np.float64]:
    """(E, 3) radiance with which each lamp brings START_SHARE of the light, the start for lamps without evidence.

    Args:
        light: (P, 3) approximate irradiance / pi.
        form_factors: (P, E) share of each lamp.
    """
    reach = form_factors.mean(0, dtype=np.float64)[:, None]
    return START_SHARE * light.mean(0, dtype=np.float64) / np.maximum(reach, 1e-9)


def _first_guess(problem: LightBalance, log_e: Tensor) -> Tensor:
    """Unknowns to start from: of starts at GUESS_LEVELS of light, the one with the least loss.

    For a lamp a hundred times too dark every patch is an outlier and the lamp's share of the light is nothing, so its
    gradient vanishes. Therefore the robust loss is wide at first, and one start is too bright. One patch in GUESS_EVERY
    is used.
    """
    coarse = problem.restrict(torch.arange(len(problem.region)) % GUESS_EVERY == 0)
    wide = replace(coarse, scale=GUESS_ROBUST_LOG)
    ends = [_minimise(wide, wide.joined(log_e + float(np.log(level))), GUESS_ITERATIONS) for level in GUESS_LEVELS]
    return min(ends, key=lambda unknowns: float(coarse.loss(unknowns)))


def _minimise(problem: LightBalance, unknowns: Tensor, iterations: int) -> Tensor:
    """Unknowns at the minimum of the loss, by L-BFGS from ``unknowns``.

    Each unknown is scaled by its curvature (:meth:`LightBalance.units`). A wall counts far more than a book; without
    scaling L-BFGS spends hundreds of steps on the walls before it moves the books.
    """
    unit = problem.units(unknowns)
    return lbfgs(lambda scaled: problem.loss(scaled * unit), unknowns / unit, iterations) * unit


@dataclass(frozen=True)
class LightBalance:
    """The loss of equation (18): P patches, E' tied emitters, n regions. Patches run along the last axis."""

    log_radiance: Tensor  # (3, P)
    bounded: Tensor  # (3, P) bool
    indirect: Tensor  # (3, P)
    form_factors: Tensor  # (E', P)
    weight: Tensor  # (P,) sums to 1
    region: Tensor  # (P,)
    n_regions: int
    direct: DirectEvidence
    scale: float

    # ---- The loss, term by term ----

    def loss(self, unknowns: Tensor) -> Tensor:
        """Equation (18) at the flat vector of unknowns."""
        log_e, log_albedo = self.split(unknowns)
        of_priors = self.room_albedo(log_albedo) + self.direct.penalty(log_e)
        return self.shading(log_e, log_albedo) + self.too_white(log_albedo) + of_priors / self.n_effective

    def shading(self, log_e: Tensor, log_albedo: Tensor) -> Tensor:
        """Robust deviation of log albedo from one value per region, mean over patches."""
        return (torch.log1p(self.deviation(log_e, log_albedo).square()) @ self.weight).sum()

    def shading_losses(self, log_e: Tensor, log_albedo: Tensor) -> Tensor:
        """(P,) loss of each patch, of which :meth:`shading` is the weighted mean."""
        return torch.log1p(self.deviation(log_e, log_albedo).square()).sum(0)

    def deviation(self, log_e: Tensor, log_albedo: Tensor) -> Tensor:
        """r (3, P): log albedo of each patch about that of its region (n, 3), over the robust scale.

        A patch that clips in all photos may be brighter than its bound, but not darker (Tobin 1958).
        """
        of_region = log_albedo.reshape(-1).index_select(0, self._entry).reshape(3, -1)
        r = (self.log_radiance - self.incoming(log_e).log() - of_region) / self.scale
        return torch.where(self.bounded, r.clamp(min=0), r)

    def incoming(self, log_e: Tensor) -> Tensor:
        """(3, P) irradiance / pi, equation (1), under emitters of log radiance (E', 3)."""
        return self.indirect + log_e.exp().T @ self.form_factors

    def too_white(self, log_albedo: Tensor) -> Tensor:
        """Penalty on regions (n, 3) whiter than anything is."""
        return TOO_WHITE_WEIGHT * (self.share @ (log_albedo - np.log(MAX_ALBEDO)).clamp(min=0).square()).sum()

    def room_albedo(self, log_albedo: Tensor) -> Tensor:
        """Squared deviation of the room's albedo from that of rooms, in standard deviations."""
        return ((self.measured_share * (log_albedo - np.log(ROOM_ALBEDO))).sum(0) / ROOM_ALBEDO_STD).square().sum()

    # ---- Unknowns ----

    def split(self, unknowns: Tensor) -> tuple[Tensor, Tensor]:
        """Log radiance (E', 3) and log albedo (n, 3) in the flat vector of unknowns."""
        n = 3 * len(self.form_factors)
        return unknowns[:n].clamp(-MAX_LOG_RADIANCE, MAX_LOG_RADIANCE).reshape(-1, 3), unknowns[n:].reshape(-1, 3)

    def joined(self, log_e: Tensor) -> Tensor:
        """The flat vector of unknowns: log radiance (E', 3) of the emitters and the log albedo that it implies."""
        return torch.cat([log_e.reshape(-1), self.implied_albedo(log_e).reshape(-1)])

    def implied_albedo(self, log_e: Tensor) -> Tensor:
        """(n, 3) median log albedo of every region under emitters of log radiance (E', 3)."""
        implied = (self.log_radiance - self.incoming(log_e).log()).T.numpy()
        region, measured = self.region.numpy(), ~self.bounded.any(0).numpy()
        albedo = np.full((self.n_regions, 3), np.log(UNKNOWN_ALBEDO))
        for rows in (np.ones(len(region), bool), measured):  # what clips counts only where nothing else does
            seen = np.bincount(region[rows], minlength=self.n_regions) > 0
            albedo[seen] = group_medians(implied[rows], region[rows], self.n_regions)[seen]
        return torch.from_numpy(albedo)

    def units(self, unknowns: Tensor) -> Tensor:
        """Scale of each unknown: 1 / sqrt of the diagonal curvature of the loss, outliers disregarded."""
        log_e = self.split(unknowns)[0]
        of_evidence = self.direct.precision(log_e) * (self.scale**2 / self.n_effective)
        of_light = self._share_of_light(log_e) + of_evidence
        return (torch.cat([of_light.reshape(-1), self.share.repeat_interleave(3)]) + MIN_CURVATURE).rsqrt()

    # ---- Patches ----

    def restrict(self, keep: Tensor) -> LightBalance:
        """The problem of the patches ``keep`` (P,), their weights scaled to a sum of one."""
        return replace(
            self,
            log_radiance=self.log_radiance[:, keep],
            bounded=self.bounded[:, keep],
            indirect=self.indirect[:, keep],
            form_factors=self.form_factors[:, keep],
            weight=self.weight[keep] / self.weight[keep].sum(),
            region=self.region[keep],
        )

    @cached_property
    def _entry(self) -> Tensor:
        """(3 P,) entry of log albedo (n, 3) that each patch and channel takes.

        Gradients come back as a sum over single numbers, in this order; over rows of three it takes a hundred times as
        long.
        """
        return (3 * self.region + torch.arange(3)[:, None]).reshape(-1)

    @cached_property
    def share(self) -> Tensor:
        """(n,) weight of each region."""
        return torch.zeros(self.n_regions, dtype=torch.float64).index_add_(0, self.region, self.weight)

    @cached_property
    def measured_share(self) -> Tensor:
        """(n, 3) share of each region in the weight of all that is measured, in each channel."""
        of_patch = torch.where(self.bounded, 0.0, self.weight)
        total = torch.zeros(3 * self.n_regions, dtype=torch.float64).index_add_(0, self._entry, of_patch.reshape(-1))
        total = total.reshape(-1, 3)
        return total / total.sum(0).clamp(min=1e-12)

    @property
    def n_effective(self) -> int:
        """Independent observations that the patches stand for."""
        return min(len(self.region), EFFECTIVE_PATCHES)

    def log_std(self, log_e: Tensor) -> Tensor:
        """(E',) standard deviation of log radiance that the shading alone leaves, from the curvature of the loss."""
        curvature = self._share_of_light(log_e).mean(1)
        return (curvature * self.n_effective / self.scale**2).clamp(min=1e-6).rsqrt()

    def _share_of_light(self, log_e: Tensor) -> Tensor:
        """(E', 3) mean square share of each emitter in the light of the patches."""
        incoming = self.incoming(log_e)
        shares = [(self.form_factors / channel).square() @ self.weight for channel in incoming]
        return torch.stack(shares, 1) * (2 * log_e).exp()


def fitted_patches(
    radiance: NDArray[np.floating], weight: NDArray[np.floating], bounded: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Indices of the patches that enter the balance: of positive weight, not black, and at most MAX_PATCHES of those
    that are measured and of those that clip.

    Args:
        radiance: (P, 3).
        weight: (P,).
        bounded: (P, 3) bool, where radiance is no more than a lower bound.
    """
    usable, clips = (weight > 0) & (radiance.min(1) > 1e-5), bounded.any(1)
    return np.sort(np.concatenate([_evenly(np.flatnonzero(usable & some)) for some in (~clips, clips)]))


def _evenly(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most MAX_PATCHES of ``rows``: a regular subset is deterministic and preserves the mix of regions."""
    if len(rows) <= MAX_PATCHES:
        return rows
    return rows[np.linspace(0, len(rows) - 1, MAX_PATCHES).astype(np.int64)]


def _held_out(clips: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) rows that are held out: one in HELD_OUT_EVERY of those that are measured and of those that clip (n,)."""
    number = np.where(clips, np.cumsum(clips), np.cumsum(~clips)) - 1
    return number % HELD_OUT_EVERY == 0


def _usable(
    radiance: NDArray[np.floating],
    region: NDArray[np.integer],
    weight: NDArray[np.floating],
    bounded: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows that take part, their regions as 0 ... n-1, and the ids (n,) of these; tiny regions are left out."""
    rows = fitted_patches(radiance, weight, bounded)
    ids, label, count = np.unique(region[rows], return_inverse=True, return_counts=True)
    big = count >= min(MIN_PATCHES_PER_REGION, count.max())
    rows, label = rows[big[label]], label[big[label]]
    kept, label = np.unique(label, return_inverse=True)
    return rows, label, ids[kept].astype(np.int64)


# ---- Evidence on the emitters themselves, equation (20) -------------------------------------------------------------


@dataclass(frozen=True)
class Evidence:
    """What photos show of the emitters themselves.

    Attributes:
        bound: (E, 3) lower bound on radiance from clipped pixels, 0 where there is none.
        measured: (E, 3) radiance from unclipped pixels, NaN where there are none.
        tie: (E,) label; emitters with the same label share one radiance.
        expected: (E, 3) radiance expected before the shading is considered, NaN without an expectation.
    """

    bound: NDArray[np.float64]
    measured: NDArray[np.float64]
    tie: NDArray[np.int64]
    expected: NDArray[np.float64]


@dataclass(frozen=True)
class DirectEvidence:
    """Bounds, measurements and expectations for tied emitters, in log radiance (E', 3), with a weak prior on colour."""

    log_bound: Tensor
    log_measured: Tensor  # NaN where nothing was measured
    log_expected: Tensor  # NaN where nothing is expected

    @staticmethod
    def of(evidence: Evidence, n_tied: int) -> DirectEvidence:
        """The evidence on emitters that share one radiance, combined; ``n_tied`` is the number of labels."""
        bound = np.full((n_tied, 3), NO_BOUND)
        np.maximum.at(bound, evidence.tie, evidence.bound)
        measured = np.full((n_tied, 3), np.nan)
        for k in range(n_tied):
            values = evidence.measured[evidence.tie == k]
            have = np.isfinite(values).any(0)
            measured[k, have] = np.nanmedian(values[:, have], axis=0)
        first = np.array([np.flatnonzero(evidence.tie == k)[0] for k in range(n_tied)])
        values = bound, np.maximum(measured, 1e-6), np.maximum(evidence.expected[first], 1e-6)
        return DirectEvidence(*(torch.from_numpy(np.log(value, dtype=np.float64)) for value in values))

    def penalty(self, log_e: Tensor) -> Tensor:
        """Q of equation (20), a sum of squared deviations in standard deviations."""
        below = (self.log_bound - log_e).clamp(min=0).square().sum() / LAMP_BOUND_STD**2
        tint = ((log_e - log_e.mean(1, keepdim=True)) / self._tint).square().sum()
        mean, precision, rest = self._known
        return below + tint + rest + (precision * (log_e - mean).square()).sum()

    def precision(self, log_e: Tensor) -> Tensor:
        """(E', 3) inverse variance of each log radiance under all evidence: half the curvature of the penalty."""
        below = (log_e <= self.log_bound) / LAMP_BOUND_STD**2
        return below + self._known[1] + 2 / 3 / self._tint**2

    @cached_property
    def _known(self) -> tuple[Tensor, Tensor, float]:
        """Mean and precision (E', 3) of what was measured and expected of each log radiance, and their disagreement.

        Two squared deviations are one about their weighted mean, and a constant.
        """
        doubt = torch.where(self._clipped, LAMP_CLIPPED_STD, OUTSIDE_EXPECTED_STD).to(torch.float64)
        measured, expected = torch.nan_to_num(self.log_measured), torch.nan_to_num(self.log_expected)
        of_measured = self.log_measured.isfinite() / LAMP_MEASURED_STD**2
        of_expected = self.log_expected.isfinite() / doubt**2
        precision = of_measured + of_expected
        mean = (of_measured * measured + of_expected * expected) / precision.clamp(min=1e-12)
        rest = of_measured * (measured - mean).square() + of_expected * (expected - mean).square()
        return mean, precision, float(rest.sum())

    @cached_property
    def _clipped(self) -> Tensor:
        """(E', 3) whether clipped pixels bound a radiance; light from outside has an expectation and no bound."""
        return self.log_bound > np.log(NO_BOUND)

    @cached_property
    def _tint(self) -> Tensor:
        """(E', 1) standard deviation of each log radiance about the mean of its channels."""
        outside = (self.log_expected.isfinite() & ~self._clipped).all(1, keepdim=True)
        return torch.where(outside, OUTSIDE_TINT_STD, LAMP_TINT_STD).to(torch.float64)
