"""A response family that needs no measured table: f(x) = x^P(s) with s = x^0.35 and P a polynomial.

The family holds f(0) = 0, f(1) = 1 by construction, contains gamma curves (P constant) and reproduces the 201 measured
curves of DoRF (Grossberg & Nayar 2004) with a mean RMSE of 0.0025 with four coefficients, against 0.0057 for EMoR's
mean and three components. P is held by its values at fixed knots, in log: the knots are local exponents of the curve,
so that a prior over them is easy to state.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .curve import N_SAMPLES, Response

WARP = 0.35
PRIOR_MEAN = np.log([0.68, 0.60, 0.49, 0.39, 0.30])
PRIOR_STD = np.array([0.55, 0.45, 0.45, 0.55, 0.80])
"""Median and spread of log P at the knots over measured camera responses."""
_KNOT_POSITIONS = np.linspace(0.05, 1.0, len(PRIOR_MEAN))
_TO_COEFFICIENTS = np.linalg.inv(np.vander(_KNOT_POSITIONS, increasing=True))


def evaluate(log_knots: NDArray[np.floating], x: NDArray[np.floating]) -> NDArray[np.float64]:
    """f(x) for ``x`` in [0, 1] of any shape; ``log_knots`` (5,) is log P at the knots."""
    x = np.clip(x, 1e-9, 1.0)
    return x ** np.polynomial.polynomial.polyval(x**WARP, _TO_COEFFICIENTS @ np.exp(log_knots))


def prior_residual(log_knots: NDArray[np.floating]) -> NDArray[np.float64]:
    """(5,) distance from the median measured response in standard deviations."""
    return (log_knots - PRIOR_MEAN) / PRIOR_STD


def downhill(log_knots: NDArray[np.floating]) -> NDArray[np.float64]:
    """(255,) how far the curve falls from one point to the next; zero for a monotone curve. Dense near black."""
    return np.clip(-np.diff(evaluate(log_knots, np.linspace(0.0, 1.0, 256) ** 2)), 0.0, None)


def to_response(log_knots: list[NDArray[np.float64]], name: str = "power-polynomial") -> Response:
    """Table of the curve of each channel; one entry stands for all three channels."""
    x = np.linspace(0.0, 1.0, N_SAMPLES)
    rows = []
    for knots in log_knots:
        f = evaluate(knots, x)
        f[0] = 0.0
        rows.append(np.clip(np.maximum.accumulate(f), 0.0, 1.0))
    samples = np.stack(rows if len(rows) == 3 else rows * 3)
    return Response(samples, name, tuple(float(v) for v in np.concatenate(log_knots)))
