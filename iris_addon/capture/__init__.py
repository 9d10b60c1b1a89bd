"""Capture room: photos, poses, exposures and the mesh come in here, and nowhere else.

Readers are imported on first use: the types are needed inside Blender, whose Python lacks what decodes images.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .types import Camera, Capture, Distortion, Mesh, Photo, View

if TYPE_CHECKING:
    from .photos import load_photo, photos_at_once
    from .reader import read_capture, read_views

__all__ = [
    "Camera",
    "Capture",
    "Distortion",
    "Mesh",
    "Photo",
    "View",
    "load_photo",
    "photos_at_once",
    "read_capture",
    "read_views",
]

_LAZY = {"load_photo": ".photos", "photos_at_once": ".photos", "read_capture": ".reader", "read_views": ".reader"}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
