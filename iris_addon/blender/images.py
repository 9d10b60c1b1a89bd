"""Pixels between numpy (row 0 on top) and Blender's images (row 0 at the bottom), without colour conversion."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
from ..base.image_headers import announced_size
from ..base.untrusted import MEND
from ..model.response import srgb

LINEAR = "Linear Rec.709"
DATA = "Non-Color"


def read_image(path: Path) -> NDArray[np.float32]:
    """The stored values of an image file, (H, W, 3) float32, row 0 on top.

    EXR gives its floats, PNG gives code values divided by their maximum; a grey file gives three equal channels.
    Works in every Blender, which need not have OpenEXR or Pillow beside it.

    Raises:
        BadInput: the file is missing or is no image.
    """
    pixels = read_pixels(path)
    return np.ascontiguousarray(pixels[..., :3]) if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)


def read_pixels(path: Path) -> NDArray[np.float32]:
    """Like :func:`read_image`, with all channels (H, W, C) that Blender reads."""
    image = load_image(Path(path), MEND, colorspace=DATA)
    try:
        width, height = image.size
        pixels = np.empty((height, width, image.channels), np.float32)
        image.pixels.foreach_get(pixels.ravel())
    finally:
        bpy.data.images.remove(image)
    return pixels[::-1]


def load_image(path: Path, mend: str, *, colorspace: str | None = None) -> bpy.types.Image:
    """The EXR, PNG, JPEG or HDR file ``path`` as an image whose pixels are there.

    Blender itself reads a file when its pixels are first needed, and shows a damaged one as black.

    Args:
        mend: advice if it cannot be read.
        colorspace: of the file; None for what Blender takes its format to have.

    Raises:
        BadInput: missing, damaged, of another format or too large.
    """
    size = announced_size(path)
    image = None
    try:
        image = bpy.data.images.load(str(path.absolute()), check_existing=False)
        if colorspace is not None:
            # Set before the first access: 16-bit files are converted to scene linear when pixels are loaded.
            image.colorspace_settings.name = colorspace
        whole = tuple(image.size) == size and len(image.pixels) > 0 and image.has_data
    except RuntimeError as error:
        raise BadInput("cannot be read as an image", mend, path) from error
    if not whole:
        bpy.data.images.remove(image)
        raise BadInput("cannot be read as an image", mend, path)
    return image


def image_from_array(
    name: str, values: NDArray[np.floating], *, colorspace: str = DATA, float_buffer: bool = False
) -> bpy.types.Image:
    """A new image that holds ``values``, (H, W) or (H, W, 3), row 0 on top.

    A byte image keeps [0, 1] to 1/510; a float image keeps half precision when it is packed into a .blend.
    """
    return image_from_pixels(name, pixels_of(values), colorspace=colorspace, float_buffer=float_buffer)


def pixels_of(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """(H, W, 4) as Blender keeps them, row 0 at the bottom, of ``values`` (H, W) or (H, W, 3); does not use bpy."""
    pixels = np.ones((*values.shape[:2], 4), np.float32)
    pixels[..., :3] = values[::-1, :, None] if values.ndim == 2 else values[::-1]
    return pixels


def image_from_pixels(
    name: str, pixels: NDArray[np.float32], *, colorspace: str = DATA, float_buffer: bool = False
) -> bpy.types.Image:
    """Like :func:`image_from_array`, from what :func:`pixels_of` gives."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=float_buffer)
    image.colorspace_settings.name = colorspace
    image.use_half_precision = True
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    return image


def srgb_image(linear: bpy.types.Image) -> tuple[bpy.types.Image, float]:
    """An 8-bit sRGB copy of a linear float image, for formats whose colours are sRGB; and its brightest value, by which
    the copy is divided, where that exceeds 1."""
    width, height = linear.size
    pixels = np.empty((height, width, 4), np.float32)
    linear.pixels.foreach_get(pixels.ravel())
    shown = pixels[::-1, :, :3]
    peak = max(1.0, float(shown.max(initial=0.0)))
    return image_from_array(linear.name, srgb(shown / peak), colorspace="sRGB"), peak
