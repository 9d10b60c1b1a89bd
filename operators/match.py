"""Renders that look like the photo."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from ..iris_addon.blender.onto_objects import APPLIED
from ..iris_addon.blender.photo_look import match_photo, stop_matching
from ..iris_addon.errors import IrisError
from ..iris_addon.result.io import read_response
from .polls import NeedsResult
from .project import folder


class IRIS_OT_match_photo(NeedsResult, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Let renders pass through the recovered camera: response, exposure and white balance of the photo looked at"""

    bl_idname = "iris.match_photo"
    bl_label = "Match Photo"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is a recovered camera, and the room is lit by the recovered light."""
        if APPLIED not in context.scene:
            cls.poll_message_set("Apply a result first")
            return False
        return super().poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Put the camera at the end of the compositing, or take it out."""
        scene = context.scene
        if not self.on:
            stop_matching(scene)
            return {"FINISHED"}
        views = scene.iris.views
        try:
            response, exposures = read_response(folder(scene))
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        match_photo(scene, response, exposures, views[scene.iris.view_index].name if views else "")
        return {"FINISHED"}
