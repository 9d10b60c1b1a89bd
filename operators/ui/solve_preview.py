"""Preview pictures of a running solve, as icons for the panel."""

from __future__ import annotations

from pathlib import Path

import bpy.utils.previews

from ...iris_addon.results.files import preview_path

_pictures: bpy.utils.previews.ImagePreviewCollection | None = None


def picture(folder: Path, kind: str) -> bpy.types.ImagePreview | None:
    """The current preview ``kind`` of the solve into ``folder``; None where there is none yet."""
    path = preview_path(folder, kind)
    try:
        key = f"{path}#{path.stat().st_mtime_ns}"
    except OSError:
        return None
    assert _pictures is not None
    if key not in _pictures:
        _pictures.clear()  # only one is shown at a time
        _pictures.load(key, str(path), "IMAGE")
    return _pictures[key]


def register() -> None:
    """Create the collection of pictures."""
    global _pictures
    _pictures = bpy.utils.previews.new()


def unregister() -> None:
    """Remove the collection of pictures."""
    global _pictures
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
    _pictures = None
