"""Open the demo room as it was solved: all from Review on works without a solver."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.scene_in.solved_demo import CAPTURE, unpack_solved_demo
from ..iris_addon.blender.worker import jobs
from .folders import ROOT_PACKAGE
from .import_capture import reported, source_kept_on_failure
from .wait_cursor import wait_cursor


class IRIS_OT_open_demo(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Open the small room that comes with the extension, already solved and applied: review, relight, insert and export
    at once, without a solver and without a download"""

    bl_idname = "iris.open_demo"
    bl_label = "Open Solved Demo"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Unpack it, add its photos and its mesh, and apply its result."""
        settings = context.scene.iris
        out = Path(bpy.utils.extension_path_user(ROOT_PACKAGE, path="solved_demo"))
        if jobs.running("solve", out) is not None:
            self.report({"ERROR"}, "the demo is being solved again — wait for it, or cancel it")
            return {"CANCELLED"}
        try:
            with wait_cursor(context), source_kept_on_failure(settings):
                unpack_solved_demo(out)
                settings.source, settings.importing = "CAPTURE", ""
                settings.capture, settings.result = str(CAPTURE), str(out)
                bpy.ops.iris.add_capture()
                bpy.ops.iris.apply()
        except (IrisError, RuntimeError) as error:
            self.report({"ERROR"}, reported(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(settings.views)} photos, {len(settings.lamps)} lamps: change them under Relight")
        return {"FINISHED"}
