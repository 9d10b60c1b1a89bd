"""The light balance: the radiance of emitters from the albedo it implies, equation (18).

For patches whose radiance L is known the balance reads ``a = L / (I + B e)``, with I the irradiance / pi from other
patches and B e that from the emitters. The right radiances e make the albedo constant within each region. The loss is a
robust norm of log albedo about one value per region, minimised over e and the albedos of all regions together. Every
pair of patches of a region is thereby compared, however far apart; comparing neighbours alone leaves e undetermined by
a factor e^1.3. The loss is smooth in log e, and L-BFGS takes about a second. What photos show of the emitters
themselves enters as a penalty, equation (20): a bound from clipped pixels, a measurement from unclipped ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ..base.group_by import group_sums
from ..decide import HeldOutLosses

MIN_PATCHES_PER_REGION = 12
"""Patches below which a region is left out of the balance."""
MAX_PATCHES = 15_000
"""Patches that enter the balance at most."""
HELD_OUT_EVERY = 8
"""One patch in so many is held out."""
MAX_ALBEDO = 0.95
"""Largest albedo of a region without a penalty."""
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
LAMP_TINT_STD = 0.25
"""Standard deviation of a channel's log radiance about the mean of a lamp's channels."""
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
    """

    radiance: NDArray[np.floating]
    indirect: NDArray[np.floating]
    form_factors: NDArray[np.floating]
    region: NDArray[np.integer]
    weight: NDArray[np.floating]


def solve_balance(
    patches: ShadedPatches,
    evidence: Evidence,
    start: NDArray[np.floating],
    robust_log: float = ROBUST_LOG,
    warm_start: bool = False,
) -> Balance:
    """Radiance of every emitter from the shading of everything else: the minimum of equation (18).

    Args:
        patches: the shading; at most MAX_PATCHES are used.
        evidence: what photos show of the emitters themselves.
        start: (E, 3) radiance to start from, > 0.
        robust_log: deviation of log albedo at which a patch starts to count as an outlier.
        warm_start: whether ``start`` solves a similar problem, so that no other level of light needs to be tried.
    """
    radiance, indirect, form_factors, weight = patches.radiance, patches.indirect, patches.form_factors, patches.weight
    rows, label, region_ids = _usable(radiance, patches.region, weight)
    n_tied = int(evidence.tie.max()) + 1
    first = np.array([np.flatnonzero(evidence.tie == k)[0] for k in range(n_tied)])
    whole = _Problem(
        log_radiance=np.ascontiguousarray(np.log(radiance[rows], dtype=np.float64).T),
        indirect=np.ascontiguousarray(np.maximum(indirect[rows], 1e-6, dtype=np.float64).T),
        form_factors=np.stack([form_factors[rows][:, evidence.tie == k].sum(1, np.float64) for k in range(n_tied)]),
        weight=weight[rows],
        region=label,
        n_regions=len(region_ids),
        direct=DirectEvidence.of(evidence, n_tied),
        scale=robust_log,
    )
    tested = np.arange(len(rows)) % HELD_OUT_EVERY == 0
    problem = whole.restrict(~tested)
    log_start = np.log(start[first])
    guess = _first_guess(problem, log_start, GUESS_LEVELS[:1] if warm_start else GUESS_LEVELS)
    unknowns = _minimise(problem, guess, ITERATIONS)
    log_e, log_albedo = problem.split(unknowns)
    held_out = whole.restrict(tested)
    return Balance(
        radiance=np.exp(log_e)[evidence.tie],
        log_std=problem.log_std(log_e)[evidence.tie],
        region_ids=region_ids,
        region_albedo=np.exp(log_albedo),
        held_out=held_out.shading_loss(log_e, log_albedo),
        losses=HeldOutLosses(
            rows[tested], held_out.shading_losses(log_e, log_albedo), held_out.weight, EFFECTIVE_PATCHES
        ),
    )


def noticeable_radiance(light: NDArray[np.floating], form_factors: NDArray[np.floating]) -> NDArray[np.float64]:
    """(E, 3) radiance with which each lamp brings START_SHARE of the light, the start for lamps without evidence.

    Args:
        light: (P, 3) approximate irradiance / pi.
        form_factors: (P, E) share of each lamp.
    """
    reach = form_factors.mean(0, dtype=np.float64)[:, None]
    return START_SHARE * light.mean(0, dtype=np.float64) / np.maximum(reach, 1e-9)


def _first_guess(problem: _Problem, log_e: NDArray[np.float64], levels: Sequence[float]) -> NDArray[np.float64]:
    """Unknowns to start from: of starts at several ``levels`` of light, the one with the least loss.

    For a lamp a hundred times too dark every patch is an outlier and the lamp's share of the light is nothing, so its
    gradient vanishes. Therefore the robust loss is wide at first, and one start is too bright. One patch in GUESS_EVERY
    is used.
    """
    coarse = problem.restrict(np.arange(len(problem.region)) % GUESS_EVERY == 0)
    wide = replace(coarse, scale=GUESS_ROBUST_LOG)
    ends = []
    for level in levels:
        ends.append(_minimise(wide, wide.joined(log_e + np.log(level)), GUESS_ITERATIONS))
    return min(ends, key=lambda unknowns: coarse.loss(unknowns)[0])


def _minimise(problem: _Problem, unknowns: NDArray[np.float64], iterations: int) -> NDArray[np.float64]:
    """Unknowns at the minimum of the loss, by L-BFGS from ``unknowns``.

    Each unknown is scaled by its curvature (:meth:`_Problem.units`). A wall counts far more than a book; without
    scaling L-BFGS spends hundreds of steps on the walls before it moves the books.
    """
    unit = problem.units(unknowns)

    def loss(scaled: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        value, gradient = problem.loss(scaled * unit)
        return value, gradient * unit

    options = {"maxiter": iterations, "maxcor": 20}
    return minimize(loss, unknowns / unit, jac=True, method="L-BFGS-B", options=options).x * unit


@dataclass(frozen=True)
class _Problem:
    """The loss of equation (18) and its gradient: P patches, E' tied emitters, n regions.

    Patches run along the last axis and arrays are changed in place: the loss is evaluated thousands of times, and
    allocating memory in each evaluation would take four times as long as the sums.
    """

    log_radiance: NDArray[np.float64]  # (3, P)
    indirect: NDArray[np.float64]  # (3, P)
    form_factors: NDArray[np.float64]  # (E', P)
    weight: NDArray[np.float64]  # (P,) sums to 1
    region: NDArray[np.int64]  # (P,)
    n_regions: int
    direct: DirectEvidence
    scale: float

    def restrict(self, keep: NDArray[np.bool_]) -> _Problem:
        """The problem of the patches ``keep`` (P,), their weights scaled to a sum of one."""
        return replace(
            self,
            log_radiance=self.log_radiance[:, keep],
            indirect=self.indirect[:, keep],
            form_factors=self.form_factors[:, keep],
            weight=self.weight[keep] / self.weight[keep].sum(),
            region=self.region[keep],
        )

    def incoming(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, P) irradiance / pi under emitters of log radiance (E', 3)."""
        incoming = np.exp(log_e).T @ self.form_factors
        incoming += self.indirect
        return incoming

    def deviation(self, incoming: NDArray[np.float64], albedo: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, P) deviation of log albedo from that of the region (n, 3), over the robust scale."""
        r = np.log(incoming)
        np.subtract(self.log_radiance, r, out=r)
        r -= albedo.T.take(self.region, 1)
        r /= self.scale
        return r

    def shading_loss(self, log_e: NDArray[np.float64], albedo: NDArray[np.float64]) -> float:
        """Robust deviation of log albedo from one value per region, mean over patches."""
        r = self.deviation(self.incoming(log_e), albedo)
        return float((np.log1p(r**2) @ self.weight).sum())

    def shading_losses(self, log_e: NDArray[np.float64], albedo: NDArray[np.float64]) -> NDArray[np.float64]:
        """(P,) loss of each patch, of which :meth:`shading_loss` is the weighted mean."""
        return np.log1p(self.deviation(self.incoming(log_e), albedo) ** 2).sum(0)

    @cached_property
    def share(self) -> NDArray[np.float64]:
        """(n, 1) weight of each region."""
        return group_sums(self.weight[:, None], self.region, self.n_regions)

    @property
    def n_effective(self) -> int:
        """Independent observations that the patches stand for."""
        return min(len(self.region), EFFECTIVE_PATCHES)

    def split(self, unknowns: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Log radiance (E', 3) and log albedo (n, 3) in the flat vector of unknowns."""
        n = 3 * len(self.form_factors)
        return np.clip(unknowns[:n], -MAX_LOG_RADIANCE, MAX_LOG_RADIANCE).reshape(-1, 3), unknowns[n:].reshape(-1, 3)

    def joined(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """The flat vector of unknowns: log radiance (E', 3) of the emitters and the log albedo that it implies."""
        return np.concatenate([log_e.ravel(), self.implied_albedo(log_e).ravel()])

    def implied_albedo(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) median log albedo of every region under emitters of log radiance (E', 3)."""
        implied = (self.log_radiance - np.log(self.incoming(log_e))).T
        order = np.argsort(self.region, kind="stable")
        per_region = np.split(implied[order], np.cumsum(np.bincount(self.region, minlength=self.n_regions))[:-1])
        return np.stack([np.median(rows, axis=0) if len(rows) else np.log(np.full(3, 0.5)) for rows in per_region])

    def loss(self, unknowns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Robust loss and its gradient in log radiance and log albedo."""
        log_e, albedo = self.split(unknowns)
        incoming = self.incoming(log_e)
        r = self.deviation(incoming, albedo)
        square = r**2
        value = float((np.log1p(square) @ self.weight).sum())
        square += 1
        r /= square
        r *= self.weight * (2 / self.scale)  # now the derivative of the loss in log albedo, negative
        grad_a = -group_sums(r.T, self.region, self.n_regions)
        r /= incoming
        grad_e = -(self.form_factors @ r.T) * np.exp(log_e)
        too_white = np.clip(albedo - np.log(MAX_ALBEDO), 0.0, None)
        share = self.share
        value += 50.0 * float((share * too_white**2).sum())
        grad_a += 100.0 * share * too_white
        level = ((share * albedo).sum(0) - np.log(ROOM_ALBEDO)) / ROOM_ALBEDO_STD
        value += float((level**2).sum()) / self.n_effective
        grad_a += share * (2 / ROOM_ALBEDO_STD / self.n_effective) * level
        penalty, grad_penalty = self.direct.penalty(log_e)
        value += penalty / self.n_effective
        grad_e += grad_penalty / self.n_effective
        return value, np.concatenate([grad_e.ravel(), grad_a.ravel()])

    def units(self, unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Scale of each unknown: 1 / sqrt of the diagonal curvature of the loss, outliers disregarded."""
        log_e = self.split(unknowns)[0]
        of_evidence = self.direct.precision(log_e) * (self.scale**2 / self.n_effective)
        of_light = self._share_of_light(log_e) + of_evidence
        curvature = np.concatenate([of_light.ravel(), self.share.repeat(3)])
        return 1.0 / np.sqrt(curvature + MIN_CURVATURE)

    def log_std(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(E',) standard deviation of log radiance that the shading alone leaves, from the curvature of the loss."""
        curvature = self._share_of_light(log_e).mean(1)
        return 1.0 / np.sqrt(np.maximum(curvature * self.n_effective / self.scale**2, 1e-6))

    def _share_of_light(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(E', 3) mean square share of each emitter in the light of the patches."""
        square = np.empty((len(log_e), 3))
        for channel, incoming in enumerate(self.incoming(log_e)):
            share = self.form_factors * np.exp(log_e[:, channel : channel + 1]) / incoming
            square[:, channel] = share**2 @ self.weight
        return square


def fitted_patches(radiance: NDArray[np.floating], weight: NDArray[np.floating]) -> NDArray[np.int64]:
    """Indices of the patches that enter the balance: of positive weight, not black, and at most MAX_PATCHES.

    Args:
        radiance: (P, 3).
        weight: (P,).
    """
    rows = np.flatnonzero((weight > 0) & (radiance.min(1) > 1e-5))
    if len(rows) > MAX_PATCHES:
        # A regular subset is deterministic and preserves the mix of regions.
        rows = rows[np.linspace(0, len(rows) - 1, MAX_PATCHES).astype(np.int64)]
    return rows


def _usable(
    radiance: NDArray[np.floating], region: NDArray[np.integer], weight: NDArray[np.floating]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows that take part, their regions as 0 ... n-1, and the ids (n,) of these; tiny regions are left out."""
    rows = fitted_patches(radiance, weight)
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

    log_bound: NDArray[np.float64]
    log_measured: NDArray[np.float64]  # NaN where nothing was measured
    log_expected: NDArray[np.float64]  # NaN where nothing is expected

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
        expected = np.log(np.maximum(evidence.expected[first], 1e-6))
        return DirectEvidence(np.log(bound), np.log(np.maximum(measured, 1e-6)), expected)

    def penalty(self, log_e: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Q of equation (20), a sum of squared deviations in standard deviations, and its gradient (E', 3)."""
        below = np.clip((self.log_bound - log_e) / LAMP_BOUND_STD, 0.0, None)
        off = np.nan_to_num((log_e - self.log_measured) / LAMP_MEASURED_STD)
        tint = (log_e - log_e.mean(1, keepdims=True)) / LAMP_TINT_STD
        doubt = self._doubt
        surprise = np.nan_to_num((log_e - self.log_expected) / doubt)
        value = float((below**2).sum() + (off**2).sum() + (tint**2).sum() + (surprise**2).sum())
        return value, 2 * (off / LAMP_MEASURED_STD - below / LAMP_BOUND_STD + tint / LAMP_TINT_STD + surprise / doubt)

    def precision(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(E', 3) inverse variance of each log radiance under all evidence: half the curvature of the penalty."""
        below = np.where(log_e <= self.log_bound, 1 / LAMP_BOUND_STD**2, 0.0)
        measured = np.where(np.isfinite(self.log_measured), 1 / LAMP_MEASURED_STD**2, 0.0)
        expected = np.where(np.isfinite(self.log_expected), 1 / self._doubt**2, 0.0)
        return below + measured + expected + 2 / 3 / LAMP_TINT_STD**2

    @property
    def _doubt(self) -> NDArray[np.float64]:
        """(E', 3) standard deviation about the expectation."""
        return np.where(self.log_bound > np.log(NO_BOUND), LAMP_CLIPPED_STD, OUTSIDE_EXPECTED_STD)
