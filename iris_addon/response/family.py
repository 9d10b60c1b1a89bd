"""A response family that needs no measured table: f(x) = x^P(s) with s = x^0.35 and log P smooth.

The family holds f(0) = 0, f(1) = 1 by construction and contains gamma curves (P constant). P is a natural cubic spline
of s through nine values, which are local exponents of the curve, so that a prior over them is easy to state. Fitted to
every third of 94 measured curves of DoRF (Grossberg & Nayar 2004) the table of 3 x 1024 samples is met with a median L2
distance of 0.023 (90th percentile 0.064). A polynomial P with five coefficients stops at 0.09, and where it does not
fit, the data distort the whole scale of radiance by up to 8 %, because only the bend near saturation anchors it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..model.response import N_SAMPLES, Response

FITTED = "power-spline"
"""Name of the family in a response."""
WARP = 0.35
PRIOR_MEAN = np.array([-0.25, -0.34, -0.43, -0.54, -0.67, -0.79, -0.92, -1.05, -1.28])
"""Median of log P at the knots over measured camera responses."""
PRIOR_STD = 0.7
BEND_STD = 0.25
"""Spread about the median, and of its second differences."""
MIDTONES = (0.15, 0.6)
CONTRAST_MEAN, CONTRAST_STD = -0.41, 0.42
"""Log of the slope of log f over log x between those display values, over the same curves."""
_KNOTS = np.linspace(0.0, 1.0, len(PRIOR_MEAN))
PRIOR_RESIDUALS, DOWNHILL_RESIDUALS = 2 * len(PRIOR_MEAN) - 2, 255


@dataclass(frozen=True)
class Family:
    """The curves of the family at relative exposures (n,) that many of them are asked for at.

    Attributes:
        log_x: (n,) logarithm of the exposures.
        spline: (n, 9) values there of the natural splines that are 1 at one knot and 0 at all others.
    """

    log_x: NDArray[np.float64]
    spline: NDArray[np.float64]

    @staticmethod
    def at(x: NDArray[np.floating]) -> Family:
        """At exposures in [0, 1]."""
        x = np.clip(x, 1e-9, 1.0)
        return Family(np.log(x), CubicSpline(_KNOTS, np.eye(len(_KNOTS)), bc_type="natural")(x**WARP))

    def evaluate(self, log_knots: NDArray[np.floating]) -> NDArray[np.float64]:
        """f(x) (n,); ``log_knots`` (9,) is log P at the knots."""
        return np.exp(self.log_x * np.einsum("nk,k->n", self.spline, np.exp(log_knots)))


def prior_residual(log_knots: NDArray[np.floating]) -> NDArray[np.float64]:
    """(PRIOR_RESIDUALS,) distance from the median measured response and its bends, in standard deviations."""
    offset = log_knots - PRIOR_MEAN
    return np.concatenate([offset / PRIOR_STD, np.diff(offset, 2) / BEND_STD])


def contrast_residual(response: Response) -> NDArray[np.float64]:
    """(3,) distance of the curves' exponents in the midtones from the median measured one, in standard deviations.

    It is the slope of log f over log x between two display values, which no scale of x moves, nor a soft shoulder.
    """
    low, high = np.log(np.maximum(response.invert(np.repeat(MIDTONES, 3).reshape(2, 3)), 1e-6))
    slope = np.log(MIDTONES[1] / MIDTONES[0]) / np.maximum(high - low, 1e-3)
    return (np.log(slope) - CONTRAST_MEAN) / CONTRAST_STD


def downhill(log_knots: NDArray[np.floating]) -> NDArray[np.float64]:
    """(DOWNHILL_RESIDUALS,) how far the curve falls from one point to the next, 0 where it rises. Dense near black."""
    return np.clip(-np.diff(_DOWNHILL.evaluate(log_knots)), 0.0, None)


def to_response(log_knots: list[NDArray[np.float64]]) -> Response:
    """Table of the curve of each channel; one entry stands for all three channels."""
    rows = []
    for knots in log_knots:
        f = _TABLE.evaluate(knots)
        f[0] = 0.0
        rows.append(np.clip(np.maximum.accumulate(f), 0.0, 1.0))
    samples = np.stack(rows if len(rows) == 3 else rows * 3)
    return Response(samples, FITTED, tuple(float(v) for v in np.concatenate(log_knots)))


_TABLE = Family.at(np.linspace(0.0, 1.0, N_SAMPLES))
_DOWNHILL = Family.at(np.linspace(0.0, 1.0, DOWNHILL_RESIDUALS + 1) ** 2)
