"""Pixels of the photos: the values of those whose rays hit the mesh, and some of those whose rays miss it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.parallel import over_each
from ..base.progress import Progress
from ..capture.photos import load_photo, photos_at_once
from ..model.capture import Capture, View
from ..model.local_exposure import SmallPhotos, small_photo
from ..rays.tracer import Tracer
from .primary_rays import PixelSamples, all_pixels, trace_pixels

PIXEL_BUDGET = 6_500_000
"""Most pixels that light, response and gloss are solved from; larger photos are reduced."""
UNIT_MEDIAN = 0.2
"""Median radiance that HDR photos are scaled to: that of photos with exposures around 1, for which the solver's
thresholds were set."""
BACKDROP_STEP = 7
"""One pixel in so many is tested for missing the mesh: it shows the backdrop."""


@dataclass(frozen=True)
class BackdropPixels:
    """A sample of k pixels whose rays miss the mesh.

    Attributes:
        share: fraction of all pixels that miss the mesh, 0 to 1.
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
    """The n pixels of all photos that show the mesh.

    Attributes:
        samples: where each pixel meets the mesh.
        z: (n, 3) float32 display values in [0, 1], or scene-linear Rec.709 radiance for HDR input.
        hdr: whether ``z`` is radiance.
        backdrop: some of the pixels that miss the mesh.
        small: the photos at a small size.
    """

    samples: PixelSamples
    z: NDArray[np.float32]
    hdr: bool
    backdrop: BackdropPixels
    small: SmallPhotos

    def take(self, kept: NDArray[np.integer], photos: NDArray[np.bool_]) -> PhotoSamples:
        """The pixels ``kept`` (k,) on the mesh, which are those of some ``photos`` (V,), and what these show beyond."""
        beyond = self.backdrop
        rows = np.flatnonzero(photos[beyond.view])
        some = replace(
            beyond,
            view=beyond.view[rows],
            pixel=beyond.pixel[rows],
            direction=beyond.direction[rows],
            z=beyond.z[rows],
        )
        return replace(self, samples=self.samples.take(kept), z=self.z[kept], backdrop=some)

    @property
    def unit(self) -> float:
        """Power of two by which HDR photos are divided, so that absolute thresholds do not depend on their unit."""
        if not self.hdr:
            return 1.0
        lit = self.z[self.z > 0]
        return float(2.0 ** np.round(np.log2(np.median(lit) / UNIT_MEDIAN))) if len(lit) else 1.0


@dataclass(frozen=True)
class ShownPixels:
    """What photos show at each of n pixels.

    Attributes:
        luminance: (n,) float32 of the radiance, a lower bound where ``clipped``.
        clipped: (n,) bool.
        usable: (n,) bool, pixels that show one surface and are not black.
    """

    luminance: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    usable: NDArray[np.bool_]


class _Read(NamedTuple):
    """What is kept of one photo.

    Attributes:
        hdr: whether its values are radiance.
        tested: number of pixels tested for missing the mesh.
        missed: columns of :class:`BackdropPixels`, for those that do.
        small: the photo and its clipped pixels at a small size.
    """

    hdr: bool
    tested: int
    missed: tuple[NDArray, ...]
    small: tuple[NDArray, NDArray]


def within_budget(views: Sequence[View], budget: int = PIXEL_BUDGET) -> tuple[View, ...]:
    """The views, reduced by the smallest whole factor with which all have at most ``budget`` pixels together."""
    total = sum(view.camera.width * view.camera.height for view in views)
    factor = max(1, int(np.ceil(np.sqrt(total / budget) - 1e-9)))
    return tuple(view.reduced(factor) for view in views) if factor > 1 else tuple(views)


def sample_photos(capture: Capture, tracer: Tracer, hdr: bool, progress: Progress) -> PhotoSamples:
    """Trace the pixels of every training photo and read their values.

    Raises:
        BadInput: a photo cannot be read, or none shows the mesh.
    """
    cameras = [view.camera for view in capture.views]
    samples = trace_pixels(tracer, cameras, progress)
    z = np.empty((len(samples.view), 3), np.float32)
    valid = np.empty(len(samples.view), bool)
    ends = np.searchsorted(samples.view, np.arange(len(cameras) + 1))

    def read(index: int) -> _Read:
        photo, rows = load_photo(capture.views[index]), slice(ends[index], ends[index + 1])
        values, shown = photo.values.reshape(-1, 3), photo.valid.ravel()
        z[rows], valid[rows] = values[samples.pixel[rows]], shown[samples.pixel[rows]]
        lattice = all_pixels(cameras[index])[::BACKDROP_STEP]
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
    backdrop = BackdropPixels(len(columns[0]) / sum(photo.tested for photo in photos), *columns)
    sizes = np.array([(camera.height, camera.width) for camera in cameras])
    shown, clipped = (np.stack(pictures) for pictures in zip(*(photo.small for photo in photos), strict=True))
    return PhotoSamples(samples=samples, z=z, hdr=hdr, backdrop=backdrop, small=SmallPhotos(shown, clipped, sizes))
