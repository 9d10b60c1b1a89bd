"""Renders that look like the photo."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from ..iris_addon.blender.photo_look import match_photo, stop_matching
from ..iris_addon.errors import IrisError
from ..iris_addon.result.io import read_response
from .polls import NeedsApplied
from .project import folder


class IRIS_OT_match_photo(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Let renders pass through the recovered camera: response, exposure and white balance of the photo looked at"""

    bl_idname = "iris.match_photo"
    bl_label = "Match Photo"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

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
