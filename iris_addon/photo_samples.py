"""Photos meet mesh: display values of the pixels whose rays hit the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .capture import load_photo
from .capture.types import Capture
from .errors import BadInput
from .progress import Progress
from .response.local_exposure import SmallPhotos, small_photo
from .surface.samples import PixelSamples, pixel_lattice, stride_for_budget, trace_pixels
from .transport.tracer import Tracer

PIXEL_BUDGET = 3_000_000
"""Pixels the solver looks at; beyond, one pixel of every n x n block is taken, another one in every photo."""
BEYOND_STEP = 7
"""One pixel in so many tells what lies beyond the mesh."""


@dataclass(frozen=True)
class BeyondMesh:
    """Pixels whose rays miss the mesh, k of them.

    Attributes:
        share: of all pixels that miss it.
        view: (k,) int16.
        pixel: (k,) int32 row-major in its photo.
        direction: (k, 3) unit, world space, away from the camera.
        z: (k, 3) float32 display values, or radiance.
    """

    share: float
    view: NDArray[np.int16]
    pixel: NDArray[np.int32]
    direction: NDArray[np.floating]
    z: NDArray[np.float32]


@dataclass(frozen=True)
class PhotoSamples:
    """Pixels on the mesh.

    Attributes:
        z: (n, 3) float32 display values in [0, 1], or radiance for HDR input.
        beyond: some of the pixels that miss the mesh.
        stride: one pixel of every stride x stride was looked at.
        small: the photos at a small size.
        mixed: (n,) bool pixels on an edge, see :mod:`.surface.mixed`; none before parts are known.
        outshone_by: (n,) int32 pixel beside each that may have lent it all its light, -1 for none.
    """

    samples: PixelSamples
    z: NDArray[np.float32]
    hdr: bool
    beyond: BeyondMesh
    stride: int
    small: SmallPhotos
    mixed: NDArray[np.bool_]
    outshone_by: NDArray[np.int32]


def sample_photos(capture: Capture, tracer: Tracer, hdr: bool, progress: Progress) -> PhotoSamples:
    """Trace a lattice of pixels of every training photo and read their values.

    Raises:
        BadInput: a photo cannot be read, or none shows the mesh.
    """
    cameras = [view.camera for view in capture.views]
    stride = stride_for_budget(cameras, PIXEL_BUDGET)
    samples = trace_pixels(tracer, cameras, stride, progress)
    z = np.empty((len(samples.view), 3), np.float32)
    valid = np.empty(len(samples.view), bool)
    missing: list[tuple[NDArray, ...]] = []
    looked, small = 0, []
    for index, view in enumerate(capture.views):
        photo = load_photo(view)
        small.append(small_photo(photo.values, photo.valid))
        hdr = hdr or photo.hdr
        rows = slice(*np.searchsorted(samples.view, [index, index + 1]))
        z[rows] = photo.values.reshape(-1, 3)[samples.pixel[rows]]
        valid[rows] = photo.valid.ravel()[samples.pixel[rows]]
        lattice = pixel_lattice(view.camera, stride, index)[::BEYOND_STEP]
        missed = np.setdiff1d(lattice[photo.valid.ravel()[lattice]], samples.pixel[rows])
        looked += len(lattice)
        missing.append(
            (
                np.full(len(missed), index, np.int16),
                missed,
                view.camera.rays(missed)[1],
                photo.values.reshape(-1, 3)[missed],
            )
        )
        progress.update((index + 1) / len(capture.views))
    if not valid.any():
        raise BadInput(
            "no pixel of any photo shows the mesh",
            "check that poses and mesh are of one scene, in one unit and one system of axes (inspect shows them)",
        )
    if not valid.all():
        samples, z = samples.take(np.flatnonzero(valid)), z[valid]
    columns = [np.concatenate(column) for column in zip(*missing, strict=True)]
    beyond = BeyondMesh(len(columns[0]) / looked, *columns)
    sizes = np.array([(camera.height, camera.width) for camera in cameras])
    shown, clipped = (np.stack(part) for part in zip(*small, strict=True))
    mixed, outshone_by = np.zeros(len(z), bool), np.full(len(z), -1, np.int32)
    return PhotoSamples(samples, z, hdr, beyond, stride, SmallPhotos(shown, clipped, sizes), mixed, outshone_by)
