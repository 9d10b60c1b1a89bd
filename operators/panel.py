"""The tab "IRIS" in the sidebar of the 3D view."""

from __future__ import annotations

import bpy

from . import solve
from .preferences import solver_python


class IRIS_PT_solve(bpy.types.Panel):  # noqa: N801 - Blender's naming
    """Capture, preset, solve, progress."""

    bl_label = "Solve"
    bl_idname = "IRIS_PT_solve"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRIS"

    def draw(self, context: bpy.types.Context) -> None:
        """The panel as Blender shows it."""
        layout, settings = self.layout, context.scene.iris
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.enabled = solve.current() is None
        column.prop(settings, "capture")
        column.prop(settings, "result")
        column.prop(settings, "preset")
        if not solver_python(context):
            layout.label(text="Set the solver's Python in the preferences", icon="ERROR")
        worker = solve.current()
        if worker is None:
            layout.operator("iris.solve", icon="LIGHT_SUN")
            return
        text = worker.stage or "Starting"
        if worker.seconds_left is not None:
            text += f", {worker.seconds_left:.0f} s left"
        layout.progress(factor=worker.overall, text=text)
        layout.operator("iris.cancel", icon="CANCEL")
