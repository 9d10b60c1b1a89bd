"""Icons of our own: swatches of one color, and small pictures."""

from __future__ import annotations

from collections.abc import Sequence

import bpy.utils.previews
import numpy as np
from numpy.typing import NDArray

SWATCH_SIDE = 16

_icons: bpy.utils.previews.ImagePreviewCollection | None = None


def swatch(color: Sequence[float]) -> int:
    """The icon of a square of ``color``, sRGB."""
    key = "swatch " + " ".join(f"{channel:.3f}" for channel in color)
    if _icons is None or key in _icons:
        return 0 if _icons is None else _icons[key].icon_id
    picture = np.zeros((SWATCH_SIDE, SWATCH_SIDE, 3), np.float32)
    picture[2:-2, 2:-2] = color
    alpha = picture.any(-1)
    return put(key, np.dstack([picture, alpha]))


def put(key: str, picture: NDArray[np.floating]) -> int:
    """The icon ``key``, made of or replaced by ``picture`` (H, W, 4), sRGB, row 0 on top; 0 where Blender has none."""
    if _icons is None:
        return 0
    icon = _icons[key] if key in _icons else _icons.new(key)
    height, width = picture.shape[:2]
    flat = np.ascontiguousarray(picture[::-1], np.float32).ravel()
    icon.icon_size = icon.image_size = (width, height)
    icon.icon_pixels_float = icon.image_pixels_float = flat.tolist()
    return icon.icon_id


def get(key: str) -> int:
    """The icon ``key``; 0 where there is none."""
    return _icons[key].icon_id if _icons is not None and key in _icons else 0


def register() -> None:
    """Create the collection of icons."""
    global _icons
    _icons = bpy.utils.previews.new()


def unregister() -> None:
    """Remove the collection of icons."""
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
    _icons = None
