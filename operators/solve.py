"""Solve the capture of the scene with the solver's Python."""

from __future__ import annotations

import bpy

from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import solve_command
from .folders import capture_path, folder, solver_python, unit_option
from .import_capture import write_scene
from .polls import NeedsCapture
from .run_job import run
from .ui import steps


class IRIS_OT_solve(NeedsCapture, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Recover materials, lights and camera response from the photos, outside Blender; resumes an earlier solve"""

    bl_idname = "iris.solve"
    bl_label = "Solve"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A capture is chosen, the solver's Python is set, and no solve runs."""
        if not super().poll(context):
            return False
        if not solver_python(context):
            cls.poll_message_set("Set the solver's Python in the preferences of IRIS first")
            return False
        return jobs.running("solve", folder(context.scene)) is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the worker."""
        settings, out = context.scene.iris, folder(context.scene)
        capture = capture_path(context.scene)
        assert capture is not None
        if not write_scene(self, context):
            return {"CANCELLED"}
        how = settings.preset, settings.device, settings.seed, steps.left_out(context.scene)
        others = steps.texture_options(settings) | unit_option(context.scene)
        command = solve_command(solver_python(context), capture, out, *how, others)
        return run(self, "solve", out, command)
