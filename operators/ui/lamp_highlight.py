"""The lamp that is chosen in the list, drawn over the 3D view for a moment."""

from __future__ import annotations

import time

import bpy
import numpy as np
from numpy.typing import NDArray

from ...iris_addon.blender.scene_in.scene_capture import read_triangles
from ..editors import redraw_views

SECONDS = 2.0
COLOR = (1.0, 0.6, 0.1, 0.6)


class _Shown:
    """What is drawn now; there is one list of lamps, and so one highlight."""

    triangles: NDArray[np.float32] | None = None
    until = 0.0
    handler: object = None


def highlight(scene: bpy.types.Scene, lamp: bpy.types.Material) -> None:
    """Draw the faces of ``lamp`` for some seconds. Does nothing in background."""
    if bpy.app.background:
        return
    _Shown.triangles, _Shown.until = lamp_triangles(scene, lamp), time.monotonic() + SECONDS
    redraw_views()
    if not bpy.app.timers.is_registered(_end):
        bpy.app.timers.register(_end, first_interval=SECONDS)


def lamp_triangles(scene: bpy.types.Scene, lamp: bpy.types.Material) -> NDArray[np.float32]:
    """(n, 3) corners in world space, three per triangle, of all faces in ``scene`` with the material ``lamp``."""
    found = [np.zeros((0, 3), np.float32)]
    for thing in scene.objects:
        if thing.type != "MESH" or lamp.name not in thing.data.materials:
            continue
        points, corners, _, slots = read_triangles(thing.data)
        used = corners[slots == thing.data.materials.find(lamp.name)].ravel()
        matrix = np.array(thing.matrix_world, np.float32)
        found.append(points[used].astype(np.float32) @ matrix[:3, :3].T + matrix[:3, 3])
    return np.concatenate(found)


def _draw() -> None:
    if _Shown.triangles is None or time.monotonic() > _Shown.until:
        return
    import gpu  # absent where Blender draws nothing
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    batch = batch_for_shader(shader, "TRIS", {"pos": _Shown.triangles})
    gpu.state.blend_set("ALPHA")
    shader.uniform_float("color", COLOR)
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def _end() -> float | None:
    left = _Shown.until - time.monotonic()
    if left > 0:  # another lamp was chosen meanwhile
        return left
    _Shown.triangles = None
    redraw_views()
    return None


def register() -> None:
    """Start to draw."""
    if not bpy.app.background:
        _Shown.handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    """Stop drawing."""
    if bpy.app.timers.is_registered(_end):
        bpy.app.timers.unregister(_end)
    if _Shown.handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_Shown.handler, "WINDOW")
        _Shown.handler = None
