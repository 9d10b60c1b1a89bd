"""Emission from the albedo it implies.

For patches whose radiance L is known, the light balance says ``a = L / (I + B e)`` with I the irradiance / pi that
comes from other patches and B e that of the emitters. The right radiances e make the albedo constant within each
region. Minimised is a robust norm of log albedo about one value per region, over e and the regions' albedos together:
every pair of patches of a region is thereby compared, however far apart (comparing neighbours alone leaves e
undetermined by e^1.3). It is smooth in log e, so LBFGS takes a second. Saturated lamp pixels enter as ``e >= bound``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ..base.group_by import group_sums

MIN_PATCHES_PER_REGION = 12
MAX_PATCHES = 15_000
HELD_OUT_EVERY = 8
MAX_ALBEDO = 0.95
ROOM_ALBEDO, ROOM_ALBEDO_STD = 0.45, 0.5
"""What the geometric mean of a room's albedo is about, and its standard deviation in log: lighting is planned for
ceilings of 0.7 to 0.9, walls of 0.5 to 0.8 and floors of 0.2 to 0.4 (EN 12464-1), and furniture is darker."""
LOG_RANGE = 30.0
"""A lamp that lights nothing is free to take any radiance; a trial step of the optimiser must not overflow."""
ROBUST_LOG = 0.15
"""Log-albedo deviation at which a patch starts to count as an outlier (texture, a contact shadow, a highlight)."""
ITERATIONS = 80
LEAST_CURVATURE = 1e-4
"""Of the loss in an unknown: what brings nothing must not be moved without end."""
FIRST_LOG, FIRST_ITERATIONS, FIRST_EVERY, FIRST_LEVELS = 1.0, 20, 4, (1.0, 30.0)
"""The same for the first guess; iterations, one patch in so many, and factors on the start."""
EFFECTIVE_PATCHES = 500
"""Neighbouring patches err together; the shading counts as at most this many independent observations."""
NOTICEABLE = 0.1
"""Share of the light that a lamp nobody saw brings at first: to one that brings nothing no patch objects."""


@dataclass(frozen=True)
class Balance:
    """A solved light balance.

    Attributes:
        radiance: (E, 3) per emitter.
        log_std: (E,) standard deviation of log radiance from the curvature of the loss.
        part_albedo: (n_regions, 3); ``region_ids`` (n_regions,) names the rows.
        held_out: mean robust loss of patches that were not fitted.
    """

    radiance: NDArray[np.float64]
    log_std: NDArray[np.float64]
    region_ids: NDArray[np.int64]
    region_albedo: NDArray[np.float64]
    held_out: float


@dataclass(frozen=True)
class ShadedPatches:
    """Patches whose radiance and light are compared, P of them.

    Attributes:
        radiance: (P, 3) diffuse radiance, scene-linear Rec.709; rows with weight 0 are ignored.
        indirect: (P, 3) ``G L`` (+ outside light), irradiance / pi.
        form_factors: (P, E) ``B``.
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
    """Radiance of every emitter from the shading of everything else.

    Args:
        start: (E, 3) radiance to start from, > 0.
        robust_log: deviation of log albedo at which a patch starts to count as an outlier.
        warm_start: whether ``start`` is the solution of a similar problem, so that no other level needs to be tried.
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
    guess = _first_guess(problem, log_start, FIRST_LEVELS[:1] if warm_start else FIRST_LEVELS)
    unknowns = _minimise(problem, guess, ITERATIONS)
    log_e, log_albedo = problem.split(unknowns)
    return Balance(
        radiance=np.exp(log_e)[evidence.tie],
        log_std=problem.log_std(log_e)[evidence.tie],
        region_ids=region_ids,
        region_albedo=np.exp(log_albedo),
        held_out=whole.restrict(tested).shading_loss(log_e, log_albedo),
    )


def noticeable(light: NDArray[np.floating], form_factors: NDArray[np.floating]) -> NDArray[np.float64]:
    """(E, 3) radiance to start from for lamps of which photos say nothing: with it each brings NOTICEABLE of ``light``.

    Args:
        light: (P, 3) about the irradiance / pi there is.
        form_factors: (P, E).
    """
    reach = form_factors.mean(0, dtype=np.float64)[:, None]
    return NOTICEABLE * light.mean(0, dtype=np.float64) / np.maximum(reach, 1e-9)


def _first_guess(problem: _Problem, log_e: NDArray[np.float64], levels: Sequence[float]) -> NDArray[np.float64]:
    """Unknowns to start from: of starts at different levels the one that leads lowest, on a region of the patches.

    To a lamp a hundred times too dark every patch is an outlier and its own share of the light is nothing, so that all
    would be left as it is. The robust loss is wide at first, and lamps that are too bright find their way down.
    """
    coarse = problem.restrict(np.arange(len(problem.region)) % FIRST_EVERY == 0)
    wide = replace(coarse, scale=FIRST_LOG)
    ends = []
    for level in levels:
        ends.append(_minimise(wide, wide.joined(log_e + np.log(level)), FIRST_ITERATIONS))
    return min(ends, key=lambda unknowns: coarse.loss(unknowns)[0])


def _minimise(problem: _Problem, unknowns: NDArray[np.float64], iterations: int) -> NDArray[np.float64]:
    """Unknowns of least loss near ``unknowns``.

    Each is measured in the change that the loss feels: a wall counts far more than a book, and without that L-BFGS
    would be at the walls for hundreds of steps before it came to the books.
    """
    unit = problem.units(unknowns)

    def loss(scaled: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        value, gradient = problem.loss(scaled * unit)
        return value, gradient * unit

    options = {"maxiter": iterations, "maxcor": 20}
    return minimize(loss, unknowns / unit, jac=True, method="L-BFGS-B", options=options).x * unit


@dataclass(frozen=True)
class _Problem:
    """The loss and its gradient: P patches, E' tied emitters, n regions.

    Patches run along the last axis and arrays are changed in place: the loss is taken thousands of times, and fresh
    memory for each step of it takes four times as long as the sums.
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
        """Some of the patches, their weights scaled to sum to one."""
        return replace(
            self,
            log_radiance=self.log_radiance[:, keep],
            indirect=self.indirect[:, keep],
            form_factors=self.form_factors[:, keep],
            weight=self.weight[keep] / self.weight[keep].sum(),
            region=self.region[keep],
        )

    def incoming(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, P) irradiance / pi."""
        incoming = np.exp(log_e).T @ self.form_factors
        incoming += self.indirect
        return incoming

    def deviation(self, incoming: NDArray[np.float64], albedo: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3, P) of log albedo from that of the region, in units of the robust loss."""
        r = np.log(incoming)
        np.subtract(self.log_radiance, r, out=r)
        r -= albedo.T.take(self.region, 1)
        r /= self.scale
        return r

    def shading_loss(self, log_e: NDArray[np.float64], albedo: NDArray[np.float64]) -> float:
        """Robust deviation of log albedo from one value per region, mean over patches."""
        r = self.deviation(self.incoming(log_e), albedo)
        return float((np.log1p(r**2) @ self.weight).sum())

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
        return np.clip(unknowns[:n], -LOG_RANGE, LOG_RANGE).reshape(-1, 3), unknowns[n:].reshape(-1, 3)

    def joined(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """The flat vector of unknowns: given emitters, and the albedo that they imply."""
        return np.concatenate([log_e.ravel(), self.implied_albedo(log_e).ravel()])

    def implied_albedo(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) median log albedo of every region under given emitters."""
        implied = (self.log_radiance - np.log(self.incoming(log_e))).T
        order = np.argsort(self.region, kind="stable")
        pieces = np.split(implied[order], np.cumsum(np.bincount(self.region, minlength=self.n_regions))[:-1])
        return np.stack([np.median(piece, axis=0) if len(piece) else np.log(np.full(3, 0.5)) for piece in pieces])

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
        """For each unknown the change that matters to the loss, from the diagonal of its curvature without outliers."""
        log_e = self.split(unknowns)[0]
        evident = self.direct.precision(log_e) * (self.scale**2 / self.n_effective)
        of_light = self._share_of_light(log_e) + evident
        curvature = np.concatenate([of_light.ravel(), self.share.repeat(3)])
        return 1.0 / np.sqrt(curvature + LEAST_CURVATURE)

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
    """Patches that have a say in the balance: seen, not black, and no more than MAX_PATCHES."""
    rows = np.flatnonzero((weight > 0) & (radiance.min(1) > 1e-5))
    if len(rows) > MAX_PATCHES:
        # A regular subset is deterministic and keeps the mix of regions.
        rows = rows[np.linspace(0, len(rows) - 1, MAX_PATCHES).astype(np.int64)]
    return rows


def _usable(
    radiance: NDArray[np.floating], region: NDArray[np.integer], weight: NDArray[np.floating]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows that take part, their part as 0 ... n-1, and the regions' ids; tiny regions say nothing about light."""
    rows = fitted_patches(radiance, weight)
    ids, label, count = np.unique(region[rows], return_inverse=True, return_counts=True)
    big = count >= min(MIN_PATCHES_PER_REGION, count.max())
    rows, label = rows[big[label]], label[big[label]]
    kept, label = np.unique(label, return_inverse=True)
    return rows, label, ids[kept].astype(np.int64)


# ---- What photos say of lamps themselves, before the light they cast is looked at -----------------------------------


TINT_STD = 0.25
MEASURED_STD = 0.03
BOUND_STD = 0.02
EXPECTED_STD, CLIPPED_STD = 1.5, 4.0
"""Of log radiance about what is expected: of a source nobody saw, and of a lamp that is clipped. The light of all but a
speck says more than the latter."""
NOTHING = 1e-6


@dataclass(frozen=True)
class Evidence:
    """What photos say about the emitters themselves.

    Attributes:
        bound: (E, 3) lower bound on radiance from saturated pixels, 0 where there is none.
        measured: (E, 3) radiance from unsaturated pixels, NaN where there are none.
        tie: (E,) fixtures with the same label share one radiance.
        expected: (E, 3) radiance expected before the shading is looked at, NaN where nothing is.
    """

    bound: NDArray[np.float64]
    measured: NDArray[np.float64]
    tie: NDArray[np.int64]
    expected: NDArray[np.float64]


@dataclass(frozen=True)
class DirectEvidence:
    """Bounds, measurements and a weak prior on colour, for tied emitters (E', 3)."""

    log_bound: NDArray[np.float64]
    log_measured: NDArray[np.float64]  # NaN where nothing was measured
    log_expected: NDArray[np.float64]  # NaN where nothing is expected

    @staticmethod
    def of(evidence: Evidence, n_tied: int) -> DirectEvidence:
        """What lamps that share one radiance have been seen to be, together."""
        bound = np.full((n_tied, 3), NOTHING)
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
        """Sum of squared deviations in standard deviations, and its gradient."""
        below = np.clip((self.log_bound - log_e) / BOUND_STD, 0.0, None)
        off = np.nan_to_num((log_e - self.log_measured) / MEASURED_STD)
        tint = (log_e - log_e.mean(1, keepdims=True)) / TINT_STD
        doubt = self._doubt
        surprise = np.nan_to_num((log_e - self.log_expected) / doubt)
        value = float((below**2).sum() + (off**2).sum() + (tint**2).sum() + (surprise**2).sum())
        return value, 2 * (off / MEASURED_STD - below / BOUND_STD + tint / TINT_STD + surprise / doubt)

    def precision(self, log_e: NDArray[np.float64]) -> NDArray[np.float64]:
        """(E', 3) inverse variance that all of it leaves to each log radiance: half the penalty's curvature."""
        below = np.where(log_e <= self.log_bound, 1 / BOUND_STD**2, 0.0)
        measured = np.where(np.isfinite(self.log_measured), 1 / MEASURED_STD**2, 0.0)
        expected = np.where(np.isfinite(self.log_expected), 1 / self._doubt**2, 0.0)
        return below + measured + expected + 2 / 3 / TINT_STD**2

    @property
    def _doubt(self) -> NDArray[np.float64]:
        """(E', 3) standard deviation about what is expected."""
        return np.where(self.log_bound > np.log(NOTHING), CLIPPED_STD, EXPECTED_STD)
