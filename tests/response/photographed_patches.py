"""Patches of random radiance in photos of different exposure."""

from __future__ import annotations

import numpy as np

from iris_addon.model.response import Response
from iris_addon.response.observations import Observations
from tests.engine_room import observe_off_edges

EXPOSURES = 2.0 ** np.array([-2, -1, 0, 1, 2, -1.5, 0.5, 1.5, -0.5, 0, 1, -1])


def observations_of(
    response: Response, exposures: np.ndarray, rng: np.random.Generator, n: int = 300, outliers: float = 0.0
) -> tuple[Observations, np.ndarray]:
    """8-bit observations of ``n`` even patches in all views, and their radiance; some are anything at all.

    ``exposures`` is (V,) or (V, 3).
    """
    radiance = 10 ** rng.uniform(-2.2, 0.5, (n, 1)) * rng.uniform(0.6, 1.0, (n, 3))
    patch, view = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(len(exposures)), indexing="ij"))
    z = (
        np.floor(255 * response.apply(np.clip(radiance[patch] * exposures.reshape(len(exposures), -1)[view], 0, 1)))
        / 255
    )
    wrong = rng.random(len(patch)) < outliers
    z[wrong] = np.clip(z[wrong] + rng.uniform(-0.3, 0.3, (int(wrong.sum()), 1)), 0, 1)
    return observe_off_edges(patch, view, z, rng), radiance
