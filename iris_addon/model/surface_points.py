"""Points spread evenly over triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def even_points(area: NDArray[np.floating], count: int, seed: int = 0) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """``count`` points over triangles with areas (F,): one in every equal share of the area, in the order of the faces.

    Returns:
        Triangle (count,) and barycentric weights of its three corners (count, 3) of each point.
    """
    random = np.random.default_rng(seed)
    total = np.cumsum(area)
    at = (np.arange(count) + 0.5) / count * total[-1]
    face = np.minimum(np.searchsorted(total, at, side="right"), len(total) - 1)
    a, b = random.random((2, count))
    fold = a + b > 1
    a, b = np.where(fold, 1 - a, a), np.where(fold, 1 - b, b)
    return face, np.stack([1 - a - b, a, b], -1)


def interpolated(corners: NDArray[np.floating], weights: NDArray[np.floating]) -> NDArray[np.float64]:
    """(n, K) values at points: of the three corners of their triangles (n, 3, K), by the weights (n, 3)."""
    return np.einsum("nck,nc->nk", corners, weights)
