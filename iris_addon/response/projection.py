"""Residuals of a response, the radiance of every patch eliminated (variable projection), observation by observation.

Observations lie patch by patch; ``first`` (n + 1,) is where each of the n patches begins. A curve is a table per
channel (3, 1024) over relative exposures in [0, 1], as in :class:`iris_addon.response.curve.Response`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..kernels import Integer, Real, inlined, kernel

CLIP_SCALE = 0.03
"""Log exposure by which an observation may lie on the wrong side of saturation before it starts to be an outlier."""
ROBUST_SCALE = 0.01
"""Display-value residual at which an observation starts to count as an outlier (a highlight, a moved object)."""
LEAST = 1e-5
"""Relative exposure that black is taken for."""
BLACK = 1.5 / 255
"""Display value up to which it says only that less was exposed."""
NO_WEIGHT = 1e-12


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
    say: NDArray[np.float64],
    radiance: NDArray[np.float64],
) -> None:
    """Radiance (n, 3) of every patch that its m observations agree on under a curve.

    Args:
        table, slope: the curve and its derivative.
        z, exposure: (m, 3) display values and exposures, ``clipped`` and ``weight`` (m,).
        found, say: (m, 3) written over: the radiance that each observation shows, and its weight.
    """
    for p in range(len(first) - 1):
        rows = range(first[p], first[p + 1])
        for c in range(3):
            total = norm = 0.0
            for j in rows:
                x, t = max(_inverse(table, c, z[j, c]), LEAST), exposure[j, c]
                found[j, c] = x / t
                # Quantisation noise is uniform in z, so the precision of x / t is (f'(x) t)^2.
                rate = _at(slope, c, x) * t
                silent = clipped[j] or z[j, c] < BLACK
                say[j, c] = (0.0 if silent else weight[j] * rate * rate) + NO_WEIGHT
                total += say[j, c] * found[j, c]
                norm += say[j, c]
            radiance[p, c] = total / norm
            # An outlier would pull its patch along and so hide behind the others: the mean is taken once more without.
            for _ in range(2):
                total = norm = 0.0
                for j in rows:
                    off = (_at(table, c, radiance[p, c] * exposure[j, c]) - z[j, c]) / ROBUST_SCALE
                    trusted = say[j, c] / (1 + off * off)
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
    say: NDArray[np.float64],
) -> None:
    """Log of what each of m observations would have been exposed to if all places of its photo were alike, and the
    precision of that, (m, 3) both: noise is uniform in z, so it is (f'(x) x)^2; 0 where clipped."""
    for j in range(len(z)):
        for c in range(3):
            x = max(_inverse(table, c, z[j, c]), LEAST)
            rate = _at(slope, c, x) * x
            log_x[j, c] = math.log(x) - log_gain[j]
            say[j, c] = 0.0 if clipped[j] or z[j, c] < BLACK else weight[j] * rate * rate


@kernel
def add_links(
    first: NDArray[np.int64],
    view: NDArray[np.int64],
    log_x: NDArray[np.float64],
    say: NDArray[np.float64],
    log_t: NDArray[np.float64],
    trusting: bool,
    scaled: NDArray[np.float64],
    laplacian: NDArray[np.float64],
    pull: NDArray[np.float64],
) -> None:
    """Normal equations of log exposures whose views of every patch agree.

    Args:
        log_x, say: (m, 3) of :func:`log_exposures`; ``say`` is written over.
        log_t: (V, 3) log exposures; unless ``trusting``, what is an outlier under them counts less.
        scaled: (m, 3) written over.
        laplacian, pull: (3, V, V) and (3, V), or the sums over channels (1, V, V) and (1, V). Of the laplacian a half,
            on and below the diagonal, that gives the whole once its transpose is added.
    """
    each = len(pull) == 3
    for p in range(len(first) - 1):
        rows = range(first[p], first[p + 1])
        for c in range(3):
            k = c if each else 0
            if not trusting:
                total, norm = 0.0, NO_WEIGHT
                for j in rows:
                    total += say[j, c] * (log_x[j, c] - log_t[view[j], c])
                    norm += say[j, c]
                for j in rows:
                    off = (log_x[j, c] - log_t[view[j], c] - total / norm) / ROBUST_SCALE
                    say[j, c] /= 1 + say[j, c] * off * off
            total, norm = 0.0, NO_WEIGHT
            for j in rows:
                total += say[j, c] * log_x[j, c]
                norm += say[j, c]
            root = math.sqrt(norm)
            for j in rows:
                a, s = view[j], say[j, c]
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
    """What display values and clipping (m, 3) of the observations are off by, both as their losses take it.

    Args:
        share: (m, 3) of pixels clipped.
        highlights: whether what clips where other views show little counts by a loss that ends.
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
