"""Pixels of a view: decoding, undistortion (:mod:`.lens`), and shrinking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, zoom

from ..base.compiled import Integer, kernel
from ..base.errors import BadInput
from ..base.parallel import over_blocks
from ..model.capture import Camera, Distortion, FloatArray, Photo, View
from ..model.response import SATURATED
from .lens import distort
from .photo_files import UPRIGHT, PhotoPixels, photo_size, read_orientation, read_photo, turned_size

PIXELS_AT_ONCE = 50_000_000
"""Over all photos that are decoded at one time; undistortion takes some 125 bytes per pixel."""

JPEG_SHRINKS = (1, 2, 4, 8)
"""Factors by which a JPEG decoder can shrink."""
MIN_BLOCK = 4
"""Decoded pixels along the side of a block, at least, if the decoder shrinks: in a mean over more of the photo nothing
tells that a part of it was clipped."""
MASKED = 0.5
"""Value of a mask from which its photo may be used."""


def photos_at_once(views: Sequence[View]) -> int:
    """How many photos of ``views`` may be decoded at one time, at least 1."""
    largest = max((view.camera.width * view.camera.height * view.reduction**2 for view in views), default=1)
    return max(1, PIXELS_AT_ONCE // largest)


def load_photo(view: View) -> Photo:
    """Decode and undistort the photo of ``view``.

    8-bit photos come as codes / 255 (the response adds half a quantisation step), EXR as linear radiance
    with negative values set to zero. With :attr:`View.reduction` above 1 a pixel is the mean over a block of the file.

    Raises:
        BadInput: the file or its mask is missing, damaged, not RGB, or its size is not that of the camera.
        ValueError: the view has no photo.
    """
    pixels = read_pixels(view)
    values, valid = pixels.values, pixels.valid
    # What is no picture is often black, which would mix into its neighbours and read as an edge.
    values = np.where(valid[..., None], values, 0)
    if view.distortion is not None:
        values, valid = undistort(values, valid, view.camera, view.distortion)
    return Photo(values, valid, pixels.hdr)


def read_pixels(view: View) -> PhotoPixels:
    """The pixels of the photo of ``view`` as its lens shows them, turned for its camera; masked ones are not valid.

    Raises:
        BadInput, ValueError: as :func:`load_photo`.
    """
    if view.photo is None:
        raise ValueError(f"view {view.name} has no photo")
    camera, reduction = view.camera, view.reduction
    shrink = max(s for s in JPEG_SHRINKS if reduction % s == 0 and (s == 1 or reduction // s >= MIN_BLOCK))
    if view.orientation != UPRIGHT:  # a part of a block at the end of a row would then begin it
        shrink = 1
    check_photo_size(view, turned_size(photo_size(view.photo), view.orientation))  # before it is allocated
    pixels = read_photo(view.photo, shrink).turned(view.orientation)
    if pixels.values.shape[1] >= camera.width * reduction:  # other formats are not shrunk
        shrink = 1
    check_photo_size(view, (pixels.values.shape[1] * shrink, pixels.values.shape[0] * shrink), shrink - 1)
    valid = _within(pixels.valid, view.margins, shrink)
    if reduction > 1:
        values = reduced(pixels.values, camera.height, camera.width, reduction // shrink, pixels.hdr)
        valid = _whole_blocks(valid, camera.height, camera.width, reduction // shrink)
        pixels = PhotoPixels(values, valid, pixels.hdr)
    return replace(pixels, valid=valid if view.mask is None else valid & _mask(view, view.mask))


def _within(valid: NDArray[np.bool_], margins: tuple[int, int, int, int], shrink: int) -> NDArray[np.bool_]:
    """``valid`` (H, W) without the margins, counted in pixels ``shrink`` times as fine."""
    if not any(margins):
        return valid
    left, top, right, bottom = (-(-margin // shrink) for margin in margins)
    inner = np.zeros_like(valid)
    rows, columns = slice(top, valid.shape[0] - bottom), slice(left, valid.shape[1] - right)
    inner[rows, columns] = valid[rows, columns]
    return inner


def _mask(view: View, path: Path) -> NDArray[np.bool_]:
    """(H, W) where the mask of ``view`` lets the photo be used."""
    mask = read_photo(path).turned(view.orientation).values
    camera, block = view.camera, view.reduction
    if (mask.shape[0] // block, mask.shape[1] // block) != (camera.height, camera.width):
        raise BadInput(
            f"is {mask.shape[1]}x{mask.shape[0]} pixels, its photo is {camera.width * block}x{camera.height * block}",
            "give the mask the size of its photo",
            path,
        )
    return _whole_blocks(mask[..., 0] > MASKED, camera.height, camera.width, block)


def check_photo_size(view: View, size: tuple[int, int], excess: int = 0) -> None:
    """Raise BadInput unless ``size`` (width, height) of the photo, as turned for the view, is that of the camera.

    ``size`` may be too large by ``excess``, and by what is left over of a block of a reduced view.
    """
    camera = view.camera
    spare = np.subtract(size, np.multiply((camera.width, camera.height), view.reduction))
    if spare.min() >= 0 and spare.max() <= view.reduction - 1 + excess:
        return
    fix = "scale the intrinsics or the photo, so that both have one size"
    if view.photo is not None and size == (camera.height, camera.width):
        held = read_orientation(view.photo) != UPRIGHT
        fix = "its EXIF orientation was applied to one of the two: " if held else "the photo or its pose was turned: "
        fix += "export photos and poses from one program"
    raise BadInput(
        f"is {size[0]}x{size[1]} pixels, the intrinsics are for {camera.width}x{camera.height}", fix, view.photo
    )


# ---- smaller photos ------------------------------------------------------------------------------------------------


def reduced(values: NDArray[np.float32], height: int, width: int, block: int, hdr: bool) -> NDArray[np.float32]:
    """(height, width, 3) means of ``values`` over blocks of ``block`` x ``block``.

    Display values are averaged as light under z = x^(1/2), about the curve of a display: the camera's is not known yet.
    A channel that is clipped somewhere in a block is clipped in it, because the mean would be too dark.
    """
    means = np.empty((height, width, 3), np.float32)

    def work(rows: slice) -> None:
        _average(values[rows.start * block : rows.stop * block], block, np.inf if hdr else SATURATED, means[rows])

    over_blocks(height, max(1, 256 // block), work)
    return means


@kernel
def _average(values: NDArray[np.float32], block: Integer, clipped: float, means: NDArray[np.float32]) -> None:
    for i in range(means.shape[0]):
        for j in range(means.shape[1]):
            for c in range(3):
                total, highest = 0.0, np.float32(0)
                for row in range(i * block, (i + 1) * block):
                    for column in range(j * block, (j + 1) * block):
                        value = values[row, column, c]
                        total += value * value if np.isfinite(clipped) else value
                        highest = max(highest, value)
                total /= block * block
                means[i, j, c] = 1 if highest >= clipped else total**0.5 if np.isfinite(clipped) else total


def _whole_blocks(valid: NDArray[np.bool_], height: int, width: int, block: int) -> NDArray[np.bool_]:
    """(height, width) blocks of ``block`` x ``block`` pixels that are all valid."""
    return valid[: height * block, : width * block].reshape(height, block, width, block).all((1, 3))


# ---- lenses --------------------------------------------------------------------------------------------------------


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


def shrink(values: FloatArray, height: int, width: int) -> NDArray[np.float64]:
    """``values`` (H, W, C) low-pass filtered and resampled to (height, width, C)."""
    scale = values.shape[1] / width
    smooth = gaussian_filter(np.asarray(values, float), (0.4 * scale, 0.4 * scale, 0)) if scale > 1 else values
    factors = (height / values.shape[0], width / values.shape[1], 1)
    return np.asarray(zoom(smooth, factors, order=1, grid_mode=True, mode="nearest"))
