"""Pixels between numpy (row 0 on top) and Blender's images (row 0 at the bottom), without colour conversion."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..base.errors import BadInput
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
    path = Path(path)
    image = None
    try:
        image = bpy.data.images.load(str(path.absolute()), check_existing=False)
        # Set before the first access: 16-bit files are converted to scene linear when pixels are loaded.
        image.colorspace_settings.name = DATA
        width, height = image.size
        pixels = np.empty((height, width, image.channels), np.float32)
        image.pixels.foreach_get(pixels.ravel())
    except RuntimeError as error:
        raise BadInput("cannot be read as an image", "restore the file or solve again", path) from error
    finally:
        if image is not None:
            bpy.data.images.remove(image)
    if not pixels.size:
        raise BadInput("cannot be read as an image", "restore the file or solve again", path)
    return pixels[::-1]


def image_from_array(
    name: str, values: NDArray[np.floating], *, colorspace: str = DATA, float_buffer: bool = False
) -> bpy.types.Image:
    """A new image that holds ``values``, (H, W) or (H, W, 3), row 0 on top.

    A byte image keeps [0, 1] to 1/510; a float image keeps half precision when it is packed into a .blend.
    """
    height, width = values.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False, float_buffer=float_buffer)
    image.colorspace_settings.name = colorspace
    image.use_half_precision = True
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = values[::-1, :, None] if values.ndim == 2 else values[::-1]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    return image


def srgb_image(linear: bpy.types.Image) -> bpy.types.Image:
    """An 8-bit sRGB copy of a linear float image, for formats whose base colour is sRGB."""
    width, height = linear.size
    pixels = np.empty((height, width, 4), np.float32)
    linear.pixels.foreach_get(pixels.ravel())
    return image_from_array(linear.name, srgb(pixels[::-1, :, :3]), colorspace="sRGB")
