"""What one photo shows of the texels, at its own resolution.

Texels are projected into the photo through its lens, tested by a ray each, and read from the photo where they lie:
by cubic interpolation where a texel is finer than a pixel, from means over blocks of pixels where it is coarser. No
pixel of the photo is resampled on the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import inlined, kernel
from ..base.parallel import BLOCK, over_blocks
from ..capture.photos import distort
from ..model.capture import Camera, View
from ..rays.tracer import Tracer, points_on_faces
from ..surface.mixed_pixels import CREASE_COSINE
from .texel_points import TexelPoints

Scalar = TypeVar("Scalar", bound=np.generic)
LEAST_COSINE = 0.03
"""Cosine between normal and direction to the camera below which a texel is not read."""
EDGE_DISTANCE = 1.5
"""Pixels by which what a pixel beside it shows may lie off the plane of a texel."""
FINER_LEVEL = 1.5
"""Pixels per texel up to which texels are read from the photo itself; beyond, from blocks of 2, 4, 8 ... pixels."""
PIXELS_AROUND = [(down, across) for down in (-1, 0, 1) for across in (-1, 0, 1)]


@dataclass(frozen=True)
class SeenTexels:
    """The k texels that a photo shows.

    Attributes:
        row: (k,) index of each among the texel points, ascending.
        place: (k, 2) float32 where the undistorted photo shows it, pixels right and down.
        file_place: (k, 2) float32 the same in the photo as it is on file.
        toward: (k, 3) float32 unit vector to the camera.
        cosine: (k,) float32 between the normal and that.
        footprint: (k,) float32 metres on the surface spanned by a pixel, without foreshortening.
    """

    row: NDArray[np.int64]
    place: NDArray[np.float32]
    file_place: NDArray[np.float32]
    toward: NDArray[np.float32]
    cosine: NDArray[np.float32]
    footprint: NDArray[np.float32]


def seen_texels(tracer: Tracer, points: TexelPoints, view: View) -> SeenTexels:
    """The texels that lie within the photo of ``view``, face its camera and are not hidden from it."""
    camera = view.camera
    inside = np.zeros(len(points.texel), bool)
    place = np.empty((len(points.texel), 2), np.float32)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height])
    pose = camera.c2w.astype(np.float64)

    def project(rows: slice) -> None:
        _project(points.position[rows], points.normal[rows], pose, lens, place[rows], inside[rows])

    over_blocks(len(inside), BLOCK, project)
    row = np.flatnonzero(inside)
    place = place[row]
    file_place = place
    if view.distortion is not None:
        x, y = (place[:, 0] - camera.cx) / camera.fx, (place[:, 1] - camera.cy) / camera.fy
        x, y, unique = distort(x.astype(np.float64), y.astype(np.float64), view.distortion)
        file_place = np.stack([x * camera.fx + camera.cx, y * camera.fy + camera.cy], -1).astype(np.float32)
        shown = unique & (file_place >= 0).all(1) & (file_place <= (camera.width, camera.height)).all(1)
        row, place, file_place = row[shown], place[shown], file_place[shown]
    toward = camera.position - points.position[row].astype(np.float64)
    distance = np.linalg.norm(toward, axis=1)
    toward /= np.maximum(distance, 1e-9)[:, None]
    clear = tracer.unoccluded(np.broadcast_to(camera.position, toward.shape), -toward, distance)
    row, place, file_place, distance = row[clear], place[clear], file_place[clear], distance[clear]
    toward = toward[clear].astype(np.float32)
    return SeenTexels(
        row=row,
        place=place,
        file_place=file_place,
        toward=toward,
        cosine=np.abs((toward * points.normal[row]).sum(1)),
        footprint=(distance / np.sqrt(camera.fx * camera.fy)).astype(np.float32),
    )


@kernel
def _project(
    position: NDArray[np.float32],
    normal: NDArray[np.float32],
    pose: NDArray[np.float64],
    lens: NDArray[np.float64],
    place: NDArray[np.float32],
    inside: NDArray[np.bool_],
) -> None:
    """Write where points appear, and whether they lie ahead, within the photo and not edge-on."""
    for i in range(len(position)):
        x = y = z = facing = length = 0.0
        for a in range(3):
            offset = position[i, a] - pose[a, 3]
            x += offset * pose[a, 0]
            y += offset * pose[a, 1]
            z -= offset * pose[a, 2]
            facing += offset * normal[i, a]
            length += offset * offset
        if z > 0 and abs(facing) > LEAST_COSINE * length**0.5:
            place[i, 0] = lens[2] + lens[0] * x / z
            place[i, 1] = lens[3] - lens[1] * y / z
            inside[i] = 0 <= place[i, 0] <= lens[4] and 0 <= place[i, 1] <= lens[5]


def on_edges(
    tracer: Tracer,
    points: TexelPoints,
    seen: SeenTexels,
    candidate: NDArray[np.bool_],
    regions: NDArray[np.integer],
    camera: Camera,
) -> NDArray[np.bool_]:
    """(k,) texels in mixed pixels: this one or one beside it shows another region, a crease, a surface off their plane
    or none.

    Args:
        candidate: (k,) bool, texels that may be on an edge; the others are not tested.
        regions: (F,) region of each face.
        camera: of the photo.
    """
    at = np.flatnonzero(candidate)
    edge = np.zeros(len(candidate), bool)
    row = seen.row[at]
    face, position, normal = points.face[row], points.position[row].astype(np.float64), points.normal[row]
    reach = EDGE_DISTANCE * seen.footprint[at]
    centre = np.floor(seen.place[at]) + 0.5
    found = np.zeros(len(at), bool)
    for down, across in PIXELS_AROUND:
        left = np.flatnonzero(~found)
        place = centre[left] + np.array([across, down])
        local = np.stack(
            [(place[:, 0] - camera.cx) / camera.fx, (camera.cy - place[:, 1]) / camera.fy, -np.ones(len(left))], -1
        )
        direction = local @ camera.c2w[:3, :3].T
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        hits = tracer.closest(np.broadcast_to(camera.position, direction.shape), direction)
        other = np.maximum(hits.face, 0)
        offset = points_on_faces(tracer.corners, other, hits.barycentric) - position[left]
        near, far = normal[left], tracer.normals[other]
        off_plane = np.maximum(np.abs((offset * near).sum(1)), np.abs((offset * far).sum(1)))
        found[left] = (
            (hits.face < 0)
            | (regions[other] != regions[face[left]])
            | (np.abs((near * far).sum(1)) < CREASE_COSINE)
            | (off_plane > reach[left])
        )
    edge[at] = found
    return edge


# ---- reading the photo ---------------------------------------------------------------------------------------------


def read_texels(
    photo: NDArray[np.float32],
    seen: SeenTexels,
    pixels_per_texel: NDArray[np.floating],
    near_edge: NDArray[np.bool_],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What a photo shows at the texels.

    Args:
        photo: (H, W, 3) linear values as on file, NaN where a pixel tells nothing.
        pixels_per_texel: (k,) side of each texel in pixels.
        near_edge: (k,) bool, texels that are read from the pixel over them alone; those beside it may be mixed.

    Returns:
        (k, 3) values, NaN where pixels that tell nothing would mix in; and (k,) pixels along the side of what was
        averaged for each.
    """
    value = np.empty((len(seen.row), 3), np.float32)
    level = np.maximum(np.ceil(np.log2(np.maximum(pixels_per_texel, 1e-6) / FINER_LEVEL)), 0).astype(np.int64)
    if len(level):
        level = np.minimum(level, max(0, int(np.log2(min(photo.shape[:2]) / 4))))
    level[near_edge] = 0
    value[near_edge] = own_pixel(photo, seen.file_place[near_edge])
    for k in range(int(level.max(initial=0)) + 1):
        rows = np.flatnonzero((level == k) & ~near_edge)
        place = seen.file_place[rows] / np.float32(2**k)
        value[rows] = interpolated(photo, place)
        if k < level.max(initial=0):
            photo = halved(photo)
    return value, (2.0**level).astype(np.float32)


def own_pixel(photo: NDArray[Scalar], place: NDArray[np.float32]) -> NDArray[Scalar]:
    """(k, 3) the pixel of a photo (H, W, 3) that covers each place (k, 2)."""
    column = np.clip(place[:, 0].astype(np.int64), 0, photo.shape[1] - 1)
    return photo[np.clip(place[:, 1].astype(np.int64), 0, photo.shape[0] - 1), column]


def interpolated(photo: NDArray[np.float32], place: NDArray[np.float32]) -> NDArray[np.float32]:
    """(k, 3) values of a photo (H, W, 3) at places (k, 2) right and down, the first pixel's centre at (0.5, 0.5).

    Cubic interpolation; linear where one of the sixteen pixels is NaN, and NaN where one of the nearest four is.
    """
    value = np.empty((len(place), 3), np.float32)
    over_blocks(len(place), BLOCK // 4, lambda block: _interpolate(photo, place[block], value[block]))
    return value


def halved(photo: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H // 2, W // 2, 3) means of 2 x 2 pixels; NaN where one of them is."""
    small = np.empty((photo.shape[0] // 2, photo.shape[1] // 2, 3), np.float32)
    over_blocks(len(small), 64, lambda rows: _halve(photo[2 * rows.start : 2 * rows.stop], small[rows]))
    return small


@kernel
def _halve(photo: NDArray[np.float32], small: NDArray[np.float32]) -> None:
    for i in range(small.shape[0]):
        for j in range(small.shape[1]):
            for c in range(3):
                total = photo[2 * i, 2 * j, c] + photo[2 * i, 2 * j + 1, c]
                total += photo[2 * i + 1, 2 * j, c] + photo[2 * i + 1, 2 * j + 1, c]
                small[i, j, c] = np.float32(0.25) * total


@inlined
def _cubic(t: float, k: int) -> float:
    """Weight of pixel ``k`` of four (-1, 0, 1, 2) at ``t`` in [0, 1] after pixel 0 (Keys 1981, a = -1/2)."""
    if k == 0:
        return ((-0.5 * t + 1.0) * t - 0.5) * t
    if k == 1:
        return (1.5 * t - 2.5) * t * t + 1.0
    if k == 2:
        return ((-1.5 * t + 2.0) * t + 0.5) * t
    return (0.5 * t - 0.5) * t * t


@kernel
def _interpolate(photo: NDArray[np.float32], place: NDArray[np.float32], value: NDArray[np.float32]) -> None:
    height, width = photo.shape[0], photo.shape[1]
    for n in range(len(place)):
        x, y = place[n, 0] - 0.5, place[n, 1] - 0.5
        j, i = int(np.floor(x)), int(np.floor(y))
        s, t = x - j, y - i
        for c in range(3):
            cubic = linear = 0.0
            for a in range(4):
                row = min(max(i + a - 1, 0), height - 1)
                down, down_linear = _cubic(t, a), (1.0 - t if a == 1 else t if a == 2 else 0.0)
                for b in range(4):
                    column = min(max(j + b - 1, 0), width - 1)
                    pixel = photo[row, column, c]
                    cubic += down * _cubic(s, b) * pixel
                    if down_linear > 0 and 1 <= b <= 2:
                        linear += down_linear * (1.0 - s if b == 1 else s) * pixel
            value[n, c] = linear if np.isnan(cubic) else max(cubic, 0.0)
