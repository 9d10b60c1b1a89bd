"""What photos say of lamps themselves, before the light they cast is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
