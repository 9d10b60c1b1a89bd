"""A response family that needs no measured table: f(x) = x^P(s) with s = x^0.35 and log P smooth.

The family has f(0) = 0 and f(1) = 1 by construction and contains gamma curves (P constant). P is a natural cubic spline
of s through nine values, which are local exponents of the curve, so a prior over them is easy to state. Fitted to every
third of 94 measured curves of DoRF (Grossberg & Nayar 2004), it approximates their tables of 3 x 1024 samples to a
median L2 distance of 0.023 (90th percentile 0.064). A polynomial P with five coefficients reaches no better than 0.09;
where it does not fit, it distorts the whole scale of radiance by up to 8 %, because only the bend near saturation fixes
that scale.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from torch import Tensor

from ..model.response import N_SAMPLES, Response
from .curve_table import CurveTable

FITTED = "power-spline"
"""Name of the family in a response."""
WARP = 0.35
"""Exponent of s = x^WARP, which spaces the knots more densely near black."""
PRIOR_MEAN = torch.tensor([-0.25, -0.34, -0.43, -0.54, -0.67, -0.79, -0.92, -1.05, -1.28], dtype=torch.float64)
"""Median of log P at the knots over measured camera responses."""
PRIOR_STD, BEND_STD = 0.7, 0.25
"""Standard deviations of log P about that median, and of its second differences, over the same curves."""
MIDTONES = (0.15, 0.6)
"""Display values between which contrast is measured."""
CONTRAST_MEAN, CONTRAST_STD = -0.41, 0.42
"""Of the log of the slope of log f over log x between the midtones, over the same curves."""
N_KNOTS, DOWNHILL_POINTS = len(PRIOR_MEAN), 256
"""Knots of a curve, and places at which it is watched for a descent."""


class Family:
    """The curves of the family at fixed relative exposures (n,) in [0, 1], prepared for many evaluations."""

    def __init__(self, x: NDArray[np.floating]) -> None:
        x = np.clip(x, 1e-9, 1.0)
        knots = np.linspace(0.0, 1.0, N_KNOTS)
        self.log_x = torch.from_numpy(np.log(x))
        """(n,) logarithm of the exposures."""
        self.spline = torch.from_numpy(CubicSpline(knots, np.eye(N_KNOTS), bc_type="natural")(x**WARP).T.copy())
        """(9, n) values there of the natural splines that are 1 at one knot and 0 at all others."""

    def evaluate(self, log_knots: Tensor) -> Tensor:
        """f(x) = x^P(s), (C, n); ``log_knots`` (C, 9) is log P at the knots of each curve."""
        return (self.log_x * (log_knots.exp() @ self.spline)).exp()


def table(log_knots: Tensor) -> CurveTable:
    """The curves with the knots (C, 9) as tables that rise from 0 to 1."""
    inner = _TABLE.evaluate(log_knots)[:, 1:]
    return CurveTable(torch.nn.functional.pad(inner.cummax(1).values.clamp(0.0, 1.0), (1, 0)))


def to_response(log_knots: Tensor) -> Response:
    """The response with the knots (3, 9) of each channel, or (1, 9) of all three."""
    samples = table(log_knots).samples.expand(3, -1).numpy().copy()
    return Response(samples, FITTED, tuple(log_knots.reshape(-1).tolist()))


def prior_residual(log_knots: Tensor) -> Tensor:
    """Distance of the knots (C, 9) from the median measured response and its bends, in standard deviations."""
    offset = log_knots - PRIOR_MEAN
    return torch.cat([offset.reshape(-1) / PRIOR_STD, offset.diff(2).reshape(-1) / BEND_STD])


def contrast_residual(curves: CurveTable) -> Tensor:
    """(C,) distance of the curves' exponents in the midtones from the median measured one, in standard deviations.

    It is the slope of log f over log x between two display values, independent of the scale of x and of a
    soft shoulder.
    """
    midtones = torch.tensor(MIDTONES, dtype=torch.float64).expand(len(curves.samples), -1)
    low, high = curves.inverse(midtones).clamp(min=1e-6).log().unbind(1)
    slope = np.log(MIDTONES[1] / MIDTONES[0]) / (high - low).clamp(min=1e-3)
    return (slope.log() - CONTRAST_MEAN) / CONTRAST_STD


def downhill(log_knots: Tensor) -> Tensor:
    """(C, DOWNHILL_POINTS - 1) descent of the curves (C, 9) from one point to the next, 0 where they rise."""
    return (-_DOWNHILL.evaluate(log_knots).diff()).clamp(min=0)


_TABLE = Family(np.linspace(0.0, 1.0, N_SAMPLES))
_DOWNHILL = Family(np.linspace(0.0, 1.0, DOWNHILL_POINTS) ** 2)  # dense near black
