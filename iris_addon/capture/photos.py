"""Pixels of a view: decoding, undistortion, and shrinking.

The distortion models are OpenCV's (https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html and, for the fisheye,
group__calib3d__fisheye.html). Both map a pinhole direction to its place in the photo, which is what resampling onto the
pinhole needs, so nothing has to be inverted. k4 of the perspective model multiplies r^8, as in nerfstudio, unless there
are k5 and k6: then the three are OpenCV's, of the denominator.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, zoom

from ..base.errors import BadInput
from ..model.capture import Camera, Distortion, FloatArray, Photo, View
from .photo_files import UPRIGHT, read_orientation, read_photo

PIXELS_AT_ONCE = 50_000_000
"""Over all photos that are decoded at one time; undistortion takes some 125 bytes per pixel."""

MASKED = 0.5
"""Value of a mask from which its photo may be used."""


def photos_at_once(views: Sequence[View]) -> int:
    """How many photos of ``views`` may be decoded at one time, at least 1."""
    largest = max((view.camera.width * view.camera.height for view in views), default=1)
    return max(1, PIXELS_AT_ONCE // largest)


def load_photo(view: View) -> Photo:
    """Decode and undistort the photo of ``view``.

    8-bit photos come as codes / 255 (the response adds half a quantisation step), EXR as linear radiance
    with negative values set to zero.

    Raises:
        BadInput: the file or its mask is missing, damaged, not RGB, or its size is not that of the camera.
        ValueError: the view has no photo.
    """
    if view.photo is None:
        raise ValueError(f"view {view.name} has no photo")
    pixels = read_photo(view.photo).turned(view.orientation)
    values, valid = pixels.values, pixels.valid
    check_photo_size(view, (values.shape[1], values.shape[0]))
    if view.mask is not None:
        valid = valid & _mask(view, view.mask)
    # What is no picture is often black, which would mix into its neighbours and read as an edge.
    values = np.where(valid[..., None], values, 0)
    if view.distortion is not None:
        values, valid = undistort(values, valid, view.camera, view.distortion)
    return Photo(values, valid, pixels.hdr)


def _mask(view: View, path: Path) -> NDArray[np.bool_]:
    """(H, W) where the mask of ``view`` lets the photo be used."""
    mask = read_photo(path).turned(view.orientation).values
    if mask.shape[:2] != (view.camera.height, view.camera.width):
        raise BadInput(
            f"is {mask.shape[1]}x{mask.shape[0]} pixels, its photo is {view.camera.width}x{view.camera.height}",
            "give the mask the size of its photo",
            path,
        )
    return mask[..., 0] > MASKED


def check_photo_size(view: View, size: tuple[int, int]) -> None:
    """Raise BadInput unless ``size`` (width, height) of the photo, as turned for the view, is that of the camera."""
    camera = view.camera
    if size == (camera.width, camera.height):
        return
    fix = "scale the intrinsics or the photo, so that both have one size"
    if view.photo is not None and size == (camera.height, camera.width):
        held = read_orientation(view.photo) != UPRIGHT
        fix = "its EXIF orientation was applied to one of the two: " if held else "the photo or its pose was turned: "
        fix += "export photos and poses from one program"
    raise BadInput(
        f"is {size[0]}x{size[1]} pixels, the intrinsics are for {camera.width}x{camera.height}", fix, view.photo
    )


def undistort(
    values: NDArray[np.float32], valid: NDArray[np.bool_], camera: Camera, distortion: Distortion
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Resample a distorted photo onto the pinhole ``camera``, bilinear.

    Args:
        values: (H, W, 3) pixels of the file.
        valid: (H, W) pixels that may be used.

    Returns:
        (H, W, 3) values and (H, W) valid, False where the lens saw nothing or an invalid pixel would mix in.
    """
    i, j = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    x, y = (i - camera.cx) / camera.fx, (j - camera.cy) / camera.fy
    x_distorted, y_distorted, unique = distort(x, y, distortion)
    u, v = x_distorted * camera.fx + camera.cx, y_distorted * camera.fy + camera.cy
    with np.errstate(invalid="ignore"):
        seen = unique & (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)

    # map_coordinates counts from pixel centres; its "nearest" mode serves the half pixel along the border.
    where = np.stack([np.where(seen, v, 0.5) - 0.5, np.where(seen, u, 0.5) - 0.5])
    resampled = np.stack([map_coordinates(values[..., c], where, order=1, mode="nearest") for c in range(3)], -1)
    invalid = map_coordinates((~valid).astype(np.float32), where, order=1, mode="nearest")
    seen &= invalid == 0
    return np.where(seen[..., None], resampled, 0).astype(np.float32), seen


def distort(x: FloatArray, y: FloatArray, lens: Distortion) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Where the lens puts pinhole coordinates x = X/Z, y = Y/Z (image axes: x right, y down).

    Returns:
        Distorted x and y, and whether the radial mapping is still one-to-one there: beyond its turning point a
        polynomial folds the image back and would show a second, false copy of its centre.
    """
    r = np.hypot(x, y)
    if lens.fisheye:
        # The angle takes the place of the radius, in the direction of the pixel.
        angle = np.arctan(r)
        scale = np.where(r > 1e-9, angle / np.maximum(r, 1e-9), 1.0)
        x, y, r = x * scale, y * scale, angle
    radial = np.where(r > 1e-9, _radial(r, lens) / np.maximum(r, 1e-9), 1.0)
    x_distorted = x * radial + 2 * lens.p1 * x * y + lens.p2 * (r**2 + 2 * x**2) + lens.sx1 * r**2
    y_distorted = y * radial + lens.p1 * (r**2 + 2 * y**2) + 2 * lens.p2 * x * y + lens.sy1 * r**2
    return x_distorted, y_distorted, r < _turning_point(lens, np.pi / 2 if lens.fisheye else float(r.max()) + 1.0)


def _radial(t: FloatArray, lens: Distortion) -> FloatArray:
    """t (1 + k1 t² + k2 t⁴ + k3 t⁶ + k4 t⁸) / (1 + d1 t² + d2 t⁴ + d3 t⁶), t the radius, or the angle of a fisheye."""
    t2 = t * t
    numerator = 1 + t2 * (lens.k1 + t2 * (lens.k2 + t2 * (lens.k3 + t2 * lens.k4)))
    return t * numerator / (1 + t2 * (lens.d1 + t2 * (lens.d2 + t2 * lens.d3)))


def _turning_point(lens: Distortion, limit: float) -> float:
    """First t in (0, limit] where the radial mapping stops growing; a little beyond ``limit`` when it never does."""
    t = np.linspace(0, limit, 4097)
    falling = np.flatnonzero(np.diff(_radial(t, lens)) <= 0)
    return float(t[falling[0]]) if len(falling) else limit * (1 + 1e-9)


def shrink(values: FloatArray, height: int, width: int) -> NDArray[np.float64]:
    """``values`` (H, W, C) low-pass filtered and resampled to (height, width, C)."""
    scale = values.shape[1] / width
    smooth = gaussian_filter(np.asarray(values, float), (0.4 * scale, 0.4 * scale, 0)) if scale > 1 else values
    factors = (height / values.shape[0], width / values.shape[1], 1)
    return np.asarray(zoom(smooth, factors, order=1, grid_mode=True, mode="nearest"))
