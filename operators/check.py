"""Look before you wait: photo over mesh from each camera, and what was measured about it."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from .import_capture import start_import
from .polls import NeedsReader


class IRIS_OT_check(NeedsReader, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Measure clipping, exposure and alignment of every photo again"""

    bl_idname = "iris.check"
    bl_label = "Check Again"
    bl_options = {"REGISTER"}  # noqa: RUF012 - Blender's form

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is something to check and a Python to do it."""
        settings = context.scene.iris
        if settings.source == "CAPTURE" and not settings.capture:
            cls.poll_message_set("Import a capture first")
            return False
        return super().poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start it."""
        return start_import(self, context)


class IRIS_OT_step_photo(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Look through the camera of another photo, with the photo over the mesh"""

    bl_idname = "iris.step_photo"
    bl_label = "Photo"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    by: bpy.props.IntProperty(default=1, options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There are photos."""
        return len(context.scene.iris.views) > 0

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """What the button does."""
        return "Show this photo over the mesh" if not properties.by else cls.__doc__ or ""

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Go on to it, around the end."""
        settings = context.scene.iris
        if not self.by:
            settings.overlay = settings.overlay or 0.5  # asked to be shown, it must not stay hidden
        settings.view_index = (settings.view_index + self.by) % len(settings.views)
        return {"FINISHED"}
