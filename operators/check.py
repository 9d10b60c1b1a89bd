"""Check a capture before the solve: measure it again, and show each photo over the mesh."""
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
        """A capture is chosen and the solver's Python is set."""
        settings = context.scene.iris
        if settings.source == "CAPTURE" and not settings.capture:
            cls.poll_message_set("Import a capture first")
            return False
        return super().poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the check; an import that failed is forgotten."""
        context.scene.iris.importing = ""
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
        """The tooltip: the button with the name shows the photo, the others step."""
        return "Show this photo over the mesh" if not properties.by else cls.__doc__ or ""

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Step to the photo; after the last comes the first."""
        settings = context.scene.iris
        if not self.by:
            settings.overlay = settings.overlay or 0.5  # the button shows the photo, so it must be visible
        settings.view_index = (settings.view_index + self.by) % len(settings.views)
        return {"FINISHED"}
