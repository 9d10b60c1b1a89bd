"""Photos meet mesh: display values of the pixels whose rays hit the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.parallel import over_each
from ..base.progress import Progress
from ..capture.photos import load_photo, photos_at_once
from ..model.capture import Capture
from ..model.local_exposure import SmallPhotos, small_photo
from ..rays.tracer import Tracer
from .primary_rays import PixelSamples, pixel_lattice, stride_for_budget, trace_pixels

PIXEL_BUDGET = 6_500_000
"""Pixels the solver looks at; beyond, one pixel of every n x n block is taken, another one in every photo."""
MIDDLE = 0.2
"""Radiance about which the thresholds of the solver were set: that of photos with exposures around 1."""
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
        mixed: (n,) bool pixels on an edge, see :mod:`.surface.mixed`; none before regions are known.
        scanned: (n,) bool pixels on a scan, whose regions end where its colour changes; none before regions are known.
        outshone_by: (n,) int32 pixel beside each that may have lent it all its light, -1 for none.
    """

    samples: PixelSamples
    z: NDArray[np.float32]
    hdr: bool
    beyond: BeyondMesh
    stride: int
    small: SmallPhotos
    mixed: NDArray[np.bool_]
    scanned: NDArray[np.bool_]
    outshone_by: NDArray[np.int32]

    @property
    def unit(self) -> float:
        """What photos of radiance are divided by, a power of two: what is small must not depend on their unit."""
        if not self.hdr:
            return 1.0
        lit = self.z[self.z > 0]
        return float(2.0 ** np.round(np.log2(np.median(lit) / MIDDLE))) if len(lit) else 1.0


class _Read(NamedTuple):
    """One photo: how many pixels were looked at beyond the mesh, the columns of :class:`BeyondMesh` of those that miss
    it, and the photo at a small size."""

    hdr: bool
    looked: int
    missed: tuple[NDArray, ...]
    small: tuple[NDArray, NDArray]


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
    ends = np.searchsorted(samples.view, np.arange(len(cameras) + 1))

    def read(index: int) -> _Read:
        photo, rows = load_photo(capture.views[index]), slice(ends[index], ends[index + 1])
        values, shown = photo.values.reshape(-1, 3), photo.valid.ravel()
        z[rows], valid[rows] = values[samples.pixel[rows]], shown[samples.pixel[rows]]
        lattice = pixel_lattice(cameras[index], stride, index)[::BEYOND_STEP]
        missed = np.setdiff1d(lattice[shown[lattice]], samples.pixel[rows])
        columns = np.full(len(missed), index, np.int16), missed, cameras[index].rays(missed)[1], values[missed]
        return _Read(photo.hdr, len(lattice), columns, small_photo(photo.values, photo.valid))

    photos = over_each(range(len(cameras)), read, progress.update, photos_at_once(capture.views))
    hdr = hdr or any(photo.hdr for photo in photos)
    if not valid.any():
        raise BadInput(
            "no pixel of any photo shows the mesh",
            "check that poses and mesh are of one scene, in one unit and one system of axes (inspect shows them)",
        )
    if not valid.all():
        samples, z = samples.take(np.flatnonzero(valid)), z[valid]
    columns = [np.concatenate(column) for column in zip(*(photo.missed for photo in photos), strict=True)]
    beyond = BeyondMesh(len(columns[0]) / sum(photo.looked for photo in photos), *columns)
    sizes = np.array([(camera.height, camera.width) for camera in cameras])
    shown, clipped = (np.stack(region) for region in zip(*(photo.small for photo in photos), strict=True))
    none, outshone_by = np.zeros(len(z), bool), np.full(len(z), -1, np.int32)
    return PhotoSamples(
        samples=samples,
        z=z,
        hdr=hdr,
        beyond=beyond,
        stride=stride,
        small=SmallPhotos(shown, clipped, sizes),
        mixed=none,
        scanned=none,
        outshone_by=outshone_by,
    )
