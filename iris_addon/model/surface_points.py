"""Points spread evenly over triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PLASTIC = 1.324717957244746
"""The real root of x^3 = x + 1."""
R2 = (1 / PLASTIC, 1 / PLASTIC**2)
"""Steps of the sequence R2 along either side of the square."""


def even_points(area: NDArray[np.floating], count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """``count`` points over triangles with areas (F,): one in every equal share of the area, in the order of the faces.

    Within the triangles they follow the sequence R2, whose consecutive points are spread evenly over the unit square
    (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").

    Returns:
        Triangle (count,) and barycentric weights of its three corners (count, 3) of each point.
    """
    total, k = np.cumsum(area), np.arange(count) + 0.5
    face = np.minimum(np.searchsorted(total, k / count * total[-1], side="right"), len(total) - 1)
    a, b = k * R2[0] % 1, k * R2[1] % 1
    fold = a + b > 1
    a, b = np.where(fold, 1 - a, a), np.where(fold, 1 - b, b)
    return face, np.stack([1 - a - b, a, b], -1)


def interpolated(corners: NDArray[np.floating], weights: NDArray[np.floating]) -> NDArray[np.float64]:
    """(n, K) values at points: of the three corners of their triangles (n, 3, K), by the weights (n, 3)."""
    return np.einsum("nck,nc->nk", corners, weights)
