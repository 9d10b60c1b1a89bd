"""Compositing of a solved room: renders that look like the photo, and lights that are mixed afterwards."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.camera_look import MATCHED, kept_look, match_photo, stop_matching
from ..iris_addon.blender.render.light_mixing import start_mixing, stop_mixing
from ..iris_addon.model.response import Response
from .editors import show_in_editor
from .polls import NeedsApplied


class IRIS_OT_match_photo(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Let renders pass through the recovered camera: response, exposure and white balance of the current photo"""

    bl_idname = "iris.match_photo"
    bl_label = "Match Photo"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the camera at the end of the compositing, or remove it."""
        if not self.on:
            stop_matching(context.scene)
            return {"FINISHED"}
        try:
            match_photo(context.scene, *current_look(context.scene))
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class IRIS_OT_mix_lights(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """A slider per light that changes a finished render: each lamp becomes an object with a light group, mixed in
    compositing. Switching this off restores everything"""

    bl_idname = "iris.mix_lights"
    bl_label = "Mix Lights"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    on: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Separate the lamps, or restore them; the recovered camera stays last."""
        try:
            names = self._switch(context.scene)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if self.on:  # Blender updates the compositing only while an editor shows it
            self.report({"INFO"}, f"{len(names)} lights: render (F12), then turn them")
            show_in_editor(context, "NODE_EDITOR", "tree_type", "CompositorNodeTree")
        return {"FINISHED"}

    def _switch(self, scene: bpy.types.Scene) -> list[str]:
        look = current_look(scene) if MATCHED in scene else None  # read first, because it may be missing
        stop_matching(scene)
        try:
            if self.on:
                return start_mixing(scene)
            stop_mixing(scene)
            return []
        finally:
            if look is not None:
                match_photo(scene, *look)


def current_look(scene: bpy.types.Scene) -> tuple[Response, dict[str, NDArray[np.float64]], str]:
    """Response, exposures and name of the current photo of ``scene``; raises BadInput without one."""
    views = scene.iris.views
    photo = views[scene.iris.view_index].name if views else ""
    return *kept_look(scene, photo), photo
