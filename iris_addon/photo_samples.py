"""Photos meet mesh: display values of the pixels whose rays hit the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .capture import load_photo
from .capture.types import Capture
from .progress import Progress
from .surface.samples import PixelSamples, stride_for_budget, trace_pixels
from .transport.tracer import Tracer

PIXEL_BUDGET = 3_000_000
"""Pixels the solver looks at; beyond, one pixel of every n x n block is taken, another one in every photo."""


@dataclass(frozen=True)
class PhotoSamples:
    """Pixels on the mesh.

    Attributes:
        z: (n, 3) float32 display values in [0, 1], or radiance for HDR input.
    """

    samples: PixelSamples
    z: NDArray[np.float32]
    hdr: bool


def sample_photos(capture: Capture, tracer: Tracer, hdr: bool, progress: Progress) -> PhotoSamples:
    """Trace a lattice of pixels of every training photo and read their values.

    Raises:
        BadInput: a photo cannot be read.
    """
    cameras = [view.camera for view in capture.views]
    stride = stride_for_budget(cameras, PIXEL_BUDGET)
    samples = trace_pixels(tracer, cameras, stride, progress)
    z = np.empty((len(samples.view), 3), np.float32)
    valid = np.empty(len(samples.view), bool)
    for index, view in enumerate(capture.views):
        photo = load_photo(view)
        hdr = hdr or photo.hdr
        rows = slice(*np.searchsorted(samples.view, [index, index + 1]))
        z[rows] = photo.values.reshape(-1, 3)[samples.pixel[rows]]
        valid[rows] = photo.valid.ravel()[samples.pixel[rows]]
        progress.update((index + 1) / len(capture.views))
    if not valid.all():
        samples, z = samples.take(np.flatnonzero(valid)), z[valid]
    return PhotoSamples(samples, z, hdr)
