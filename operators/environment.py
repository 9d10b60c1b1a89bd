"""The solver's Python environment: test it, or create one."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import environment_command
from .folders import ROOT_PACKAGE, environment_folder, environment_python, solver_python
from .run_job import run


class IRIS_OT_test_python(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Start the solver's Python and import all packages that a solve needs"""

    bl_idname = "iris.test_python"
    bl_label = "Test"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A Python is chosen and is not being tested."""
        if not solver_python(context):
            cls.poll_message_set("Choose a Python first")
            return False
        return jobs.running("test", environment_folder()) is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the test."""
        folder = environment_folder()
        command = environment_command(folder, test_only=Path(solver_python(context)))
        return run(self, "test", folder, command)


class IRIS_OT_make_environment(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Create a Python environment for the solver and download its packages (torch among them)"""

    bl_idname = "iris.make_environment"
    bl_label = "Create Environment"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """Online access is allowed, and no environment is being created."""
        if not bpy.app.online_access:
            cls.poll_message_set("Allow online access in Preferences > System first")
            return False
        return jobs.running("environment", environment_folder()) is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the job; it sets the preference when it ends."""
        folder = environment_folder()
        preferences = context.preferences.addons[ROOT_PACKAGE].preferences

        def ended(record: jobs.Record) -> None:
            if record.state == "done":
                preferences.python = str(environment_python(folder))
                context.preferences.is_dirty = True  # so that Blender saves it on exit

        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self.report({"ERROR"}, str(IrisError(f"cannot be created ({error.strerror})", "free some space", folder)))
            return {"CANCELLED"}
        return run(self, "environment", folder, environment_command(folder), ended)
