"""Primary rays: where the pixels of the photos meet the mesh, traced once; :class:`Lattice` finds the neighbours of a
pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ..base.parallel import over_each
from ..base.progress import Progress
from ..model.capture import Camera
from ..rays.sampling import dot
from ..rays.tracer import Tracer, points_on_faces


@dataclass(frozen=True)
class PixelSamples:
    """Pixels that see the mesh, all views one after the other.

    Attributes:
        view: (n,) int16 index of the view.
        pixel: (n,) int32 row-major pixel index in the photo.
        face: (n,) int32 face of the mesh.
        barycentric: (n, 2) float32.
        position: (n, 3) float32 metres.
        normal: (n, 3) float32 geometric normal on the camera's side.
        direction: (n, 3) float32 unit vector from the surface to the camera.
        footprint: (n,) float32 metres on the surface spanned by one pixel, without foreshortening.
    """

    view: NDArray[np.int16]
    pixel: NDArray[np.int32]
    face: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    direction: NDArray[np.float32]
    footprint: NDArray[np.float32]

    @cached_property
    def cosine(self) -> NDArray[np.float32]:
        """(n,) cosine between the normal and the direction to the camera, in (0, 1]."""
        return np.clip(dot(self.normal, self.direction), 1e-3, 1.0).astype(np.float32)

    def seen_faces(self, n_faces: int) -> NDArray[np.bool_]:
        """(n_faces,) faces that a pixel shows."""
        return np.bincount(self.face, minlength=n_faces) > 0

    def take(self, rows: slice | NDArray[np.integer]) -> PixelSamples:
        """Some of the pixels."""
        return PixelSamples(*(getattr(self, column.name)[rows] for column in fields(self)))


def as_picture(
    values: NDArray[np.floating], pixel: NDArray[np.integer], camera: Camera, step: int = 1
) -> NDArray[np.float32]:
    """(H, W, 3) picture of ``values`` (n, 3) at row-major pixels (n,); other pixels repeat the nearest of these.

    With ``step`` above 1 the picture has one of every ``step`` rows and columns of the photo.
    """
    side = (-(-camera.height // step), -(-camera.width // step))
    row, column = pixel // camera.width // step, pixel % camera.width // step
    known = np.zeros(side, bool)
    picture = np.zeros((*side, 3), np.float32)
    known[row, column] = True
    picture[row, column] = values
    if not known.any():
        return picture
    nearest = np.asarray(distance_transform_edt(~known, return_distances=False, return_indices=True))
    return picture[nearest[0], nearest[1]]


def trace_pixels(tracer: Tracer, cameras: Sequence[Camera], progress: Progress) -> PixelSamples:
    """Primary rays through the centres of all pixels of every camera."""
    views = over_each(
        range(len(cameras)),
        lambda index: trace_view(tracer, cameras[index], index, all_pixels(cameras[index])),
        progress.update,
    )
    names = [column.name for column in fields(PixelSamples)]
    return PixelSamples(*(np.concatenate([getattr(view, name) for view in views]) for name in names))


def all_pixels(camera: Camera) -> NDArray[np.int32]:
    """(H * W,) row-major indices of the pixels of ``camera``."""
    return np.arange(camera.height * camera.width, dtype=np.int32)


def trace_view(tracer: Tracer, camera: Camera, index: int, pixel: NDArray[np.int32]) -> PixelSamples:
    """Primary rays through the centres of pixels (k,) of view ``index``; those that miss the mesh are left out."""
    origin, direction = camera.rays(pixel)
    hits = tracer.closest(origin, direction)
    kept = np.flatnonzero(hits.face >= 0)
    face, barycentric = hits.face[kept], hits.barycentric[kept]
    toward = -direction[kept].astype(np.float32)
    normal = tracer.normals[face]
    normal *= np.where((normal * toward).sum(1, keepdims=True) < 0, -1, 1).astype(np.float32)
    return PixelSamples(
        view=np.full(len(kept), index, np.int16),
        pixel=pixel[kept],
        face=face,
        barycentric=barycentric,
        position=points_on_faces(tracer.corners, face, barycentric).astype(np.float32),
        normal=normal,
        direction=toward,
        footprint=hits.distance[kept] / np.float32(np.sqrt(camera.fx * camera.fy)),
    )


# ---- neighbours ----------------------------------------------------------------------------------------------------


NO_PIXEL = -1
"""In place of a pixel: one that is not in the set."""
OUTSIDE_PHOTO = -2
"""In place of a pixel: a place beyond the edge of the photo."""


@dataclass(frozen=True)
class Lattice:
    """The pixels of all photos in one flat array, with a margin around each photo.

    Attributes:
        slot: (n,) index of each pixel in that array.
        pitch: (n,) length of a row of its photo there.
        occupant: (m,) the array: index of the pixel at each place, :data:`NO_PIXEL` or :data:`OUTSIDE_PHOTO`.
    """

    slot: NDArray[np.int64]
    pitch: NDArray[np.int64]
    occupant: NDArray[np.int32]

    @staticmethod
    def of(view: NDArray[np.integer], pixel: NDArray[np.integer], cameras: Sequence[Camera], margin: int) -> Lattice:
        """The lattice of row-major pixels (n,) of views (n,), for neighbours up to ``margin`` rows or columns away."""
        wide = np.array([camera.width + 2 * margin for camera in cameras])
        high = np.array([camera.height + 2 * margin for camera in cameras])
        first = np.concatenate([[0], np.cumsum(wide * high)])
        row, column = np.divmod(pixel, np.array([camera.width for camera in cameras])[view])
        pitch = wide[view]
        slot = first[view] + (row + margin) * pitch + column + margin
        occupant = np.full(first[-1], OUTSIDE_PHOTO, np.int32)
        for start, stop, width in zip(first[:-1], first[1:], wide, strict=True):
            occupant[start:stop].reshape(-1, width)[margin:-margin, margin:-margin] = NO_PIXEL
        occupant[slot] = np.arange(len(slot), dtype=np.int32)
        return Lattice(slot, pitch, occupant)

    def pixel_at(self, own: slice | NDArray[np.integer], down: int, across: int) -> NDArray[np.int32]:
        """The pixel ``down`` rows below and ``across`` columns right of each of ``own``, negative where none is."""
        return self.occupant[self.slot[own] + down * self.pitch[own] + across]
