"""Icons of our own: swatches of one color, and small pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import bpy.utils.previews
import numpy as np
from numpy.typing import NDArray

SWATCH_SIDE = 16

_icons: bpy.utils.previews.ImagePreviewCollection | None = None


def swatch(color: Sequence[float]) -> int:
    """The icon of a square of ``color``, sRGB."""
    key = "swatch " + " ".join(f"{channel:.3f}" for channel in color)
    if _icons is None:
        return 0
    if key not in _icons:
        square = np.zeros((SWATCH_SIDE, SWATCH_SIDE, 4), np.float32)
        square[2:-2, 2:-2] = (*color, 1.0)
        icon = _icons.new(key)
        icon.icon_size = icon.image_size = (SWATCH_SIDE, SWATCH_SIDE)
        icon.icon_pixels_float = icon.image_pixels_float = square.ravel().tolist()
    return _icons[key].icon_id


def picture(path: Path) -> int:
    """The icon of the picture in the file ``path``; 0 where there is none. Blender reads it while it draws on."""
    try:
        key = f"{path}#{path.stat().st_mtime_ns}"
    except OSError:
        return 0
    if _icons is None:
        return 0
    if key not in _icons:
        _icons.load(key, str(path), "IMAGE")
    return _icons[key].icon_id


def drawn(key: str, draw: Callable[[], NDArray[np.floating] | None]) -> int:
    """The icon of the (H, W, 3) display values of ``draw``, which is called once for each ``key``; 0 for None."""
    if _icons is None:
        return 0
    if key not in _icons:
        values = draw()
        if values is None:
            return 0
        height, width = values.shape[:2]
        side = max(height, width)
        top, left = (side - height) // 2, (side - width) // 2
        square = np.zeros((side, side, 4), np.float32)  # row 0 at the bottom
        square[top : top + height, left : left + width, :3] = values[::-1]
        square[top : top + height, left : left + width, 3] = 1.0
        icon = _icons.new(key)
        icon.icon_size = icon.image_size = (side, side)
        icon.icon_pixels_float = icon.image_pixels_float = square.ravel().tolist()
    return _icons[key].icon_id


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
