"""What the open editors show: data in a text, image or node editor, and a photo in the 3D views."""

from __future__ import annotations

import bpy

from ..iris_addon.blender.apply.camera_look import follow_photo
from ..iris_addon.blender.camera import set_frame
from ..iris_addon.blender.scene_in.capture_objects import photo_of

KEPT_AREAS = ("VIEW_3D", "OUTLINER", "PREFERENCES")
"""Editors that are never changed into others."""


def show_in_editor(
    context: bpy.types.Context, area_type: str, attribute: str, shown: bpy.types.ID | str, *, only_open: bool = False
) -> None:
    """Show ``shown`` in an editor of ``area_type``: an open one, else the largest editor beside the 3D view is changed.

    Does nothing in background.
    """
    if context.screen is None:
        return
    areas = [area for area in context.screen.areas if area.type == area_type]
    others = [] if only_open else [area for area in context.screen.areas if area.type not in KEPT_AREAS]
    candidates = areas or others
    if not candidates:
        return
    area = max(
        candidates, key=lambda area: min(area.width, area.height)
    )  # by the shorter side: timelines are wide but low
    area.type = area_type
    setattr(area.spaces.active, attribute, shown)


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


def view_shadings(context: bpy.types.Context) -> list[bpy.types.View3DShading]:
    """Shading of each open 3D view; empty in background."""
    areas = context.screen.areas if context.screen is not None else ()
    return [area.spaces.active.shading for area in areas if area.type == "VIEW_3D"]
