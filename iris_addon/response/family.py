"""A response family that needs no measured table: f(x) = x^P(s) with s = x^0.35 and log P smooth.

The family has f(0) = 0 and f(1) = 1 by construction and contains gamma curves (P constant). P is a natural cubic spline
of s through nine values, which are local exponents of the curve, so a prior over them is easy to state. Fitted to every
third of 94 measured curves of DoRF (Grossberg & Nayar 2004), it approximates their tables of 3 x 1024 samples to a
median L2 distance of 0.023 (90th percentile 0.064). A polynomial P with five coefficients reaches no better than 0.09;
where it does not fit, it distorts the whole scale of radiance by up to 8 %, because only the bend near saturation fixes
that scale.
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
"""Exponent of s = x^WARP, which spaces the knots more densely near black."""
PRIOR_MEAN = np.array([-0.25, -0.34, -0.43, -0.54, -0.67, -0.79, -0.92, -1.05, -1.28])
"""Median of log P at the knots over measured camera responses."""
PRIOR_STD, BEND_STD = 0.7, 0.25
"""Standard deviations of log P about that median, and of its second differences, over the same curves."""
MIDTONES = (0.15, 0.6)
"""Display values between which contrast is measured."""
CONTRAST_MEAN, CONTRAST_STD = -0.41, 0.42
"""Of the log of the slope of log f over log x between the midtones, over the same curves."""
_KNOTS = np.linspace(0.0, 1.0, len(PRIOR_MEAN))
PRIOR_RESIDUALS, DOWNHILL_RESIDUALS = 2 * len(PRIOR_MEAN) - 2, 255
"""Residuals of :func:`prior_residual` and of :func:`downhill`."""


@dataclass(frozen=True)
class Family:
    """The curves of the family at fixed relative exposures (n,), prepared for many evaluations.

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

    It is the slope of log f over log x between two display values, independent of the scale of x and of a
    soft shoulder.
    """
    low, high = np.log(np.maximum(response.invert(np.repeat(MIDTONES, 3).reshape(2, 3)), 1e-6))
    slope = np.log(MIDTONES[1] / MIDTONES[0]) / np.maximum(high - low, 1e-3)
    return (np.log(slope) - CONTRAST_MEAN) / CONTRAST_STD


def downhill(log_knots: NDArray[np.floating]) -> NDArray[np.float64]:
    """(DOWNHILL_RESIDUALS,) descent of the curve from one point to the next, 0 where it rises; dense near black."""
    return np.clip(-np.diff(_DOWNHILL.evaluate(log_knots)), 0.0, None)


def to_response(log_knots: list[NDArray[np.float64]]) -> Response:
    """The response with the knots (9,) of each channel, or of all three."""
    rows = []
    for knots in log_knots:
        f = _TABLE.evaluate(knots)
        f[0] = 0.0
        rows.append(np.clip(np.maximum.accumulate(f), 0.0, 1.0))
    samples = np.stack(rows if len(rows) == 3 else rows * 3)
    return Response(samples, FITTED, tuple(float(v) for v in np.concatenate(log_knots)))


_TABLE = Family.at(np.linspace(0.0, 1.0, N_SAMPLES))
_DOWNHILL = Family.at(np.linspace(0.0, 1.0, DOWNHILL_RESIDUALS + 1) ** 2)
