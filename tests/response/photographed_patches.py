"""Patches of random radiance in photos of different exposure."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from PIL import Image, ImageFilter

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


def by_phone(response: Response, exposures: np.ndarray, rng: np.random.Generator, noise: float) -> Observations:
    """Photos of 12 x 16 patches of 8 x 8 pixels, their order another in each, with blur, noise and JPEG of 4:2:0.

    ``noise`` is its standard deviation over display values, added before what clips is cut off; 0 leaves photos as
    they are rendered.
    """
    rows, columns, side = 12, 16, 8
    n = rows * columns
    radiance = 10 ** rng.uniform(-1.8, 0.3, (n, 1)) * rng.uniform(0.7, 1, (n, 3))
    within = np.arange(max(rows, columns) * side) % side
    inner = (within > 0) & (within < side - 1)
    inner = inner[: rows * side, None] & inner[: columns * side]
    patches, views, values = [], [], []
    for view, exposure in enumerate(exposures):
        order = np.argsort(np.log(radiance[:, 1]) + rng.normal(0, 0.5, n)).reshape(rows, columns)
        patch = np.kron(order, np.ones((side, side), int))
        photo = Image.fromarray(np.floor(255 * response.apply(radiance[patch] * exposure)).astype(np.uint8))
        if noise:
            z = np.asarray(photo.filter(ImageFilter.GaussianBlur(0.5)), np.float32)
            noisy = np.where(z >= 254.5, 255, z + rng.normal(size=z.shape) * (1 + noise * z))
            stored = BytesIO()
            Image.fromarray(np.clip(noisy + 0.5, 0, 255).astype(np.uint8)).save(stored, "JPEG", quality=88)
            photo = Image.open(stored)
        shown = inner & (rng.random(patch.shape) < 0.5)
        patches.append(patch[shown])
        views.append(np.full(int(shown.sum()), view))
        values.append(np.asarray(photo)[shown] / 255)
    return observe_off_edges(np.concatenate(patches), np.concatenate(views), np.concatenate(values), rng)
