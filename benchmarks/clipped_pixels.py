"""What clipped pixels of 8-bit photos hide, as darker photos of the same places show it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iris_addon.base.images import read_image
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Camera, View
from iris_addon.model.response import Response
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.primary_rays import trace_view

SAME_PLACE = 0.02
"""Metres between a point and what another photo shows where it should be; more, and it is hidden there."""
CLIPPED = 255

FloatArray = NDArray[np.float64]


def radiance_behind_clipping(root: Path, views: Sequence[View], response: Response) -> dict[str, FloatArray]:
    """(H, W, 3) radiance of the clipped pixels of each view of the capture in ``root``; NaN elsewhere.

    It is the median over the photos that show a place unclipped, which is what a matte surface sends to all of them;
    NaN too where there is none.
    """
    tracer = Tracer(read_capture(root).mesh)
    places, shown = [], []
    for k, view in enumerate(views):
        assert view.photo is not None and view.exposure is not None
        every = np.arange(view.camera.width * view.camera.height, dtype=np.int32)
        samples = trace_view(tracer, view.camera, k, every)
        place = np.full((len(every), 3), np.nan)
        place[samples.pixel] = samples.position
        byte = read_image(view.photo).reshape(-1, 3)
        places.append(place)
        shown.append(np.where(byte == CLIPPED, np.nan, response.invert((byte + 0.5) / 255) / view.exposure))
    found = {}
    for k, view in enumerate(views):
        clipped = np.flatnonzero(np.isnan(shown[k]).any(1) & np.isfinite(places[k]).all(1))
        seen = np.full((len(views), len(clipped), 3), np.nan)
        for j, other in enumerate(views):
            if j != k:
                pixel = _pixel_of(other.camera, places[k][clipped])
                there = pixel >= 0
                there[there] = np.linalg.norm(places[j][pixel[there]] - places[k][clipped[there]], axis=1) < _near(
                    other.camera, places[k][clipped[there]]
                )
                seen[j, there] = shown[j][pixel[there]]
        radiance = np.full(shown[k].shape, np.nan)
        some = np.isfinite(seen).any(0)
        radiance[clipped] = np.where(some, np.nanmedian(np.where(some, seen, 0.0), axis=0), np.nan)
        found[view.name] = np.where(np.isnan(shown[k]), radiance, np.nan).reshape(view.camera.height, -1, 3)
    return found


def _pixel_of(camera: Camera, points: NDArray[np.floating]) -> NDArray[np.int64]:
    """(n,) row-major pixel that shows points (n, 3), -1 outside the frame."""
    local = camera.local(points)
    ahead = local[:, 2] < -1e-6
    local[~ahead] = (0.0, 0.0, -1.0)
    column, row = np.floor(camera.project(local)).T
    inside = ahead & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return np.where(inside, row * camera.width + column, -1).astype(np.int64)


def _near(camera: Camera, points: NDArray[np.floating]) -> FloatArray:
    """(n,) metres within which two pixels show one place: a few of their footprints."""
    distance = np.linalg.norm(points - camera.position, axis=1)
    return np.maximum(SAME_PLACE, 3 * distance / camera.fx)
