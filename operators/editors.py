"""What the open editors show: data in a text, image or node editor, and a photo in the 3D views."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import bpy

from ..iris_addon.blender.apply.camera_look import follow_photo
from ..iris_addon.blender.camera import set_frame
from ..iris_addon.blender.scene_in.capture_objects import photo_of

KEPT_AREAS = ("VIEW_3D", "OUTLINER", "PROPERTIES", "DOPESHEET_EDITOR", "PREFERENCES")
"""Editors that are never changed into others: artists work with them. The timeline is too low to show anything else."""
OWN_WINDOW = "iris_shows"
"""Custom property of the screen of the window that was opened to show data."""


def show_in_editor(
    context: bpy.types.Context, area_type: str, attribute: str, shown: bpy.types.ID | str, *, only_open: bool = False
) -> None:
    """Show ``shown`` in an editor of ``area_type``: an open one, else another that may be changed, else a new window.

    The new window is opened once: later calls show what they have in it, before any other editor is changed. In
    background no window is opened.

    Args:
        attribute: of the editor's space, to which ``shown`` is assigned.
        only_open: do nothing unless an editor of ``area_type`` is open.
    """
    if context.screen is None:
        return
    here, own = list(context.screen.areas), _areas_of_own_window(context)
    areas = [area for area in (*here, *own) if area.type == area_type]
    for others in () if only_open else (own, here):
        areas = areas or [area for area in others if area.type not in KEPT_AREAS]
    if areas:
        _show(areas, area_type, attribute, shown)
    elif not only_open and not bpy.app.background:
        # Blender 4.3 crashes where the operator of a button opens a window, so that this waits until it has ended.
        bpy.app.timers.register(partial(_show_in_new_window, context.window, area_type, attribute, shown))


def _show(areas: Sequence[bpy.types.Area], area_type: str, attribute: str, shown: bpy.types.ID | str) -> None:
    """Show ``shown`` in the largest of ``areas``, by the shorter side: some editors are wide but low."""
    area = max(areas, key=lambda area: min(area.width, area.height))
    area.type = area_type
    setattr(area.spaces.active, attribute, shown)


def _show_in_new_window(window: bpy.types.Window, area_type: str, attribute: str, shown: bpy.types.ID | str) -> None:
    """Open a window with one editor, from ``window``, and show ``shown`` there."""
    manager = bpy.context.window_manager
    before = set(manager.windows)
    with bpy.context.temp_override(window=window):
        bpy.ops.wm.window_new()
    (opened,) = set(manager.windows) - before
    opened.screen[OWN_WINDOW] = True
    _show(opened.screen.areas, area_type, attribute, shown)


def is_in_editor(context: bpy.types.Context, area_type: str, attribute: str, shown: bpy.types.ID) -> bool:
    """Whether an editor of ``area_type`` in any window shows ``shown``; see :func:`show_in_editor`."""
    areas = [area for window in context.window_manager.windows for area in window.screen.areas]
    return any(area.type == area_type and getattr(area.spaces.active, attribute) == shown for area in areas)


def _areas_of_own_window(context: bpy.types.Context) -> list[bpy.types.Area]:
    """Editors in the window that :func:`_show_in_new_window` opened, as long as it is open."""
    screens = [window.screen for window in context.window_manager.windows]
    return [area for screen in screens if OWN_WINDOW in screen for area in screen.areas]


def look_at_photo(context: bpy.types.Context, index: int) -> None:
    """Make the camera of photo ``index`` active, set the frame to its size and look through it."""
    scene = context.scene
    if not 0 <= index < len(scene.iris.views):
        return
    follow_photo(scene, scene.iris.views[index].name)
    camera = scene.iris.views[index].camera
    if camera is None or camera.name not in scene.objects:
        return
    scene.camera = camera
    show_cameras(context)
    image = photo_of(camera)
    if scene.iris.source == "CAPTURE" and image is not None and image.size[0]:
        width, height = image.size
        set_frame(scene, width, height, scene.iris.views[index].aspect)
    for area in context.screen.areas if context.screen is not None else ():
        if area.type == "VIEW_3D":
            area.spaces.active.region_3d.view_perspective = "CAMERA"
            area.tag_redraw()


def fade_photos(scene: bpy.types.Scene, alpha: float) -> None:
    """Set the opacity of the photos of an imported capture; those of the artist's own scene stay as they are."""
    if scene.iris.source == "CAPTURE":
        scene.iris.overlay = alpha


def show_cameras(context: bpy.types.Context) -> None:
    """Show the camera of the current photo in 3D views and hide those of the others, unless all are to be seen.

    Cameras of the artist's own scene stay as they are.
    """
    settings, present = context.scene.iris, context.view_layer.objects
    if settings.source != "CAPTURE":
        return
    for view in settings.views:
        if view.camera is not None and view.camera.name in present:
            view.camera.hide_set(not settings.all_cameras and view.camera != context.scene.camera)


def redraw_views() -> None:
    """Draw the 3D views again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def view_shadings(context: bpy.types.Context) -> list[bpy.types.View3DShading]:
    """Shading of each open 3D view; empty in background."""
    areas = context.screen.areas if context.screen is not None else ()
    return [area.spaces.active.shading for area in areas if area.type == "VIEW_3D"]
