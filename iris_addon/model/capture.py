"""A capture that has been read and checked: cameras, photos by reference, a mesh.

Conventions of the whole engine: metres, scene-linear Rec.709, camera-to-world matrices as Blender and nerfstudio have
them (columns x right, y up, z backward). Pixel (i, j) of a camera has its centre at (i + 0.5, j + 0.5) and its ray
direction is ``R @ [(i + 0.5 - cx) / fx, -(j + 0.5 - cy) / fy, -1]``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput

FloatArray = NDArray[np.floating]
HitDistance = Callable[[FloatArray, FloatArray], FloatArray]
"""Distance (n,) along rays, origins and unit directions (n, 3), to the first surface; infinite where there is none."""

Split = Literal["train", "val"]
POSE_PIXELS, POSE_DISTANCE = 0.5, 1.0
"""Pixels by which photos of one pose may differ, and metres to what they show, at which their places tell as much."""
DEGENERATE_AREA = 1e-12
"""Square metres up to which a face counts as degenerate."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. Lengths in pixels, ``c2w`` in metres.

    Attributes:
        c2w: (4, 4) camera to world, columns x right, y up, z backward.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    c2w: FloatArray

    @property
    def position(self) -> FloatArray:
        """(3,) centre of projection in world space."""
        return self.c2w[:3, 3]

    def rays(self, pixel: NDArray[np.integer] | None = None) -> tuple[FloatArray, FloatArray]:
        """Origins and unit directions through pixel centres, each (n, 3), world space.

        Args:
            pixel: (n,) row-major indices, by default all.
        """
        row, column = np.divmod(np.arange(self.width * self.height) if pixel is None else pixel, self.width)
        i, j = column + 0.5, row + 0.5
        local = np.stack([(i - self.cx) / self.fx, -(j - self.cy) / self.fy, -np.ones_like(i)], -1)
        directions = local @ self.c2w[:3, :3].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(self.position, directions.shape), directions

    def shrunk(self, width: int) -> Camera:
        """The camera with at most ``width`` pixels in a row and the same field of view."""
        scale = min(1.0, width / self.width)
        w, h = max(2, round(self.width * scale)), max(2, round(self.height * scale))
        return self.resized(w, h)

    def resized(self, width: int, height: int) -> Camera:
        """The camera with the same field of view in ``width`` x ``height`` pixels."""
        x, y = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y)

    def reduced(self, factor: int) -> Camera:
        """The camera whose pixels are blocks of ``factor`` x ``factor`` pixels of this one; what is left over at the
        right and at the bottom is cut off."""
        return replace(
            self,
            width=self.width // factor,
            height=self.height // factor,
            fx=self.fx / factor,
            fy=self.fy / factor,
            cx=self.cx / factor,
            cy=self.cy / factor,
        )

    def local(self, points: NDArray[np.floating]) -> FloatArray:
        """(..., 3) world-space points in the frame of the camera: x right, y up, z backward."""
        return (points - self.position) @ self.c2w[:3, :3]

    def project(self, local: NDArray[np.floating]) -> FloatArray:
        """(..., 2) image coordinates, right and down in pixels, of points (..., 3) ahead in the camera's frame."""
        depth = -local[..., 2]
        u = self.cx + self.fx * local[..., 0] / depth
        v = self.cy - self.fy * local[..., 1] / depth
        return np.stack([u, v], -1)


def first_of_pose(cameras: Sequence[Camera]) -> NDArray[np.intp]:
    """(V,) the first camera that sees the same from the same place within half a pixel, itself mostly.

    Poses of a bracket differ a little where they were found, or corrected, photo by photo.
    """
    first = np.arange(len(cameras))
    axes = np.array([camera.c2w[:3, :3] for camera in cameras]).reshape(-1, 9)
    places = np.array([camera.position for camera in cameras])
    for k, camera in enumerate(cameras):
        turn = POSE_PIXELS / camera.fx
        near = np.abs(axes[:k] - axes[k]).max(1, initial=0.0) < turn
        near &= np.linalg.norm(places[:k] - places[k], axis=1) < turn * POSE_DISTANCE
        lens = (camera.width, camera.height, camera.fx)
        for j in np.flatnonzero(near & (first[:k] == np.arange(k))):
            if (cameras[j].width, cameras[j].height, cameras[j].fx) == lens:
                first[k] = j
                break
    return first


@dataclass(frozen=True)
class Distortion:
    """Lens distortion of the photo on disk, by the models of OpenCV and COLMAP; the camera is that without it.

    Attributes:
        k1, k2, k3, k4: radial, of r², r⁴, r⁶, r⁸; of the angle for a fisheye.
        p1, p2: tangential.
        d1, d2, d3: of r², r⁴, r⁶ in the denominator of the radial factor (OpenCV's k4, k5, k6).
        sx1, sy1: thin prism, of r².
        omega: field of view of the FOV model in radians, which has no other coefficient; 0 for other models.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    d1: float = 0.0
    d2: float = 0.0
    d3: float = 0.0
    sx1: float = 0.0
    sy1: float = 0.0
    fisheye: bool = False
    omega: float = 0.0


@dataclass(frozen=True)
class View:
    """One photo: its file, camera and exposure.

    Attributes:
        name: unique within the capture and its split, safe as a file name.
        photo: image file, or None for a view that is only rendered.
        exposure: factor from scene radiance to the argument of the response, ``z = f(radiance * exposure)``; None when
            unknown.
        distortion: of the file on disk; :func:`iris_addon.capture.photos.load_photo` removes it.
        orientation: EXIF's, under which the stored photo is turned to fit its camera; 1 where it is taken as stored.
        mask: picture of the same size, above the middle grey where the photo may be used.
        device: maker and model of the camera, "" where the photo does not record them.
        light_state: name of the set of lamps that are on, "" where the capture names none: then one set is in all.
        margins: pixels of the file left, above, right and below, as turned for the camera, that are no picture.
        reduction: a pixel of ``camera`` is the mean over a block of so many rows and columns of the file.
    """

    name: str
    camera: Camera
    photo: Path | None
    exposure: float | None = None
    distortion: Distortion | None = None
    split: Split = "train"
    orientation: int = 1
    mask: Path | None = None
    reduction: int = 1
    margins: tuple[int, int, int, int] = (0, 0, 0, 0)
    device: str = ""
    light_state: str = ""

    def reduced(self, factor: int) -> View:
        """The view at a size smaller by a whole ``factor``: :meth:`Camera.reduced`."""
        return replace(self, camera=self.camera.reduced(factor), reduction=self.reduction * factor)

    def reduced_to(self, width: int) -> View:
        """The view reduced as far as it keeps ``width`` pixels in a row."""
        return self.reduced(max(1, self.camera.width // width))


@dataclass(frozen=True)
class Photo:
    """Pixels of one photo, undistorted.

    Attributes:
        values: (H, W, 3) float32; display values z in [0, 1] for LDR, linear radiance for HDR.
        valid: (H, W) bool; False where undistortion saw past the border, or a pixel is transparent, masked or not
            finite.
        hdr: whether ``values`` are linear radiance.
    """

    values: NDArray[np.float32]
    valid: NDArray[np.bool_]
    hdr: bool


@dataclass(frozen=True)
class Mesh:
    """Triangles of the room. Face order is that of the file and never changes: emitters refer to it.

    Attributes:
        vertices: (V, 3) float64, metres.
        faces: (F, 3) int64.
        uv: (F, 3, 2) float32 per corner in [0, 1], or None.
        regions: (F,) int32 region label per face when the file has regions (objects, materials), or None.
        normals: (F, 3) float32 unit normals by which faces are shaded, where they are not the faces' own: those of the
            surface behind a scan.
    """

    vertices: FloatArray
    faces: NDArray[np.int64]
    uv: NDArray[np.float32] | None = None
    regions: NDArray[np.int32] | None = None
    normals: NDArray[np.float32] | None = None

    def with_uv(self, uv: NDArray[np.float32]) -> Mesh:
        """The same mesh with other texture coordinates."""
        return replace(self, uv=uv)

    def without(self, faces: NDArray[np.integer]) -> Mesh:
        """The mesh less some of its faces."""
        columns = {"faces": self.faces, "uv": self.uv, "regions": self.regions, "normals": self.normals}
        return replace(
            self, **{name: np.delete(column, faces, axis=0) for name, column in columns.items() if column is not None}
        )


def in_metres(view: View, metres_per_unit: float) -> View:
    """The view, its pose multiplied by ``metres_per_unit``."""
    pose = view.camera.c2w.copy()
    pose[:3, 3] *= metres_per_unit
    return replace(view, camera=replace(view.camera, c2w=pose))


def moved_by(view: View, similarity: FloatArray) -> View:
    """The view, its pose moved by the (4, 4) ``similarity``."""
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    pose = similarity @ view.camera.c2w
    pose[:3, :3] /= scale
    return replace(view, camera=replace(view.camera, c2w=pose))


@dataclass(frozen=True)
class Capture:
    """A capture folder, read and checked.

    Attributes:
        views: the photos the solver may look at (split ``train``).
        val_views: held-out photos; the solver never opens them.
        up: unit vector that points away from the floor; (0, 0, 1) where the capture does not give it.
        warnings: what a user should know before waiting for a solve.
        mismatch: what a solve raises, where photos and mesh do not belong together.
        metres_per_unit: what poses and mesh of the files were multiplied by.
        excluded: names of photos that the user has left out.
        poses_to_mesh: (4, 4) similarity that took the poses of the files to their mesh before that, or None.
        mended_poses: how the poses of the files were taken, for :func:`iris_addon.capture.mended_poses.mended_like`;
            None where they are as in the files.
        map_origin: what was taken off the ``mesh`` and the ``poses`` of files in map coordinates before all that, each
            (3,) in their unit, or None.
    """

    name: str
    root: Path
    views: tuple[View, ...]
    val_views: tuple[View, ...]
    mesh: Mesh
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    warnings: tuple[str, ...] = field(default=())
    mismatch: BadInput | None = None
    metres_per_unit: float = 1.0
    excluded: tuple[str, ...] = ()
    poses_to_mesh: FloatArray | None = None
    mended_poses: Mapping[str, Any] | None = None
    map_origin: Mapping[str, list[float]] | None = None

    @property
    def exposures_known(self) -> bool:
        """Whether every training photo comes with its exposure."""
        return all(view.exposure is not None for view in self.views)
