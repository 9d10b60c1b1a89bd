"""Preferences of the extension: the Python that solves, tested or made here."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import environment_command

ROOT_PACKAGE = str(__package__).rpartition(".")[0]


class IrisPreferences(bpy.types.AddonPreferences):
    """Where the solver's Python is."""

    bl_idname = ROOT_PACKAGE

    python: bpy.props.StringProperty(
        name="Solver Python",
        description="Python with torch and the other packages of the solver; Blender's own has none of them",
        subtype="FILE_PATH",
    )

    def draw(self, _context: bpy.types.Context) -> None:
        """The preferences as Blender shows them."""
        layout = self.layout
        layout.prop(self, "python")
        row = layout.row()
        row.operator("iris.test_python", icon="CHECKMARK")
        row.operator("iris.make_environment", icon="IMPORT")
        if not self.python:
            layout.label(text="Needed to read captures and to solve; applying a result works without", icon="INFO")
        _draw_job(layout, "environment", "Environment")
        _draw_job(layout, "test", "Test")


def _draw_job(layout: bpy.types.UILayout, name: jobs.JobName, title: str) -> None:
    folder = environment_folder()
    record = jobs.record(name, folder)
    job = jobs.running(name, folder)
    if job is not None:
        row = layout.row()
        row.progress(factor=job.worker.overall, text=f"{title}: {job.worker.stage or 'starting'}")
        row.operator("iris.cancel", text="", icon="CANCEL").job = name
    elif record.state == "failed":
        layout.label(text=f"{title}: {record.what}", icon="ERROR")
        layout.label(text=f"Mend: {record.fix}", icon="BLANK1")
        layout.operator("iris.copy_error", icon="COPYDOWN").job = name
    elif record.state in ("done", "cancelled", "interrupted"):
        icon = "CHECKMARK" if record.state == "done" else "INFO"
        layout.label(text=f"{title}: {record.state}. {record.what}", icon=icon)
    if record.state != "missing":
        layout.operator("iris.show_log", text=f"{title} Log", icon="TEXT").job = name


def environment_folder() -> Path:
    """Where the environment made here lies; nothing is written by asking."""
    return Path(bpy.utils.extension_path_user(ROOT_PACKAGE, path="environment"))


def environment_python(folder: Path) -> Path:
    """The Python of a virtual environment."""
    windows = folder / "venv" / "Scripts" / "python.exe"
    return windows if windows.is_file() else folder / "venv" / "bin" / "python"


def solver_python(context: bpy.types.Context) -> str:
    """Path of the solver's Python: the one chosen, or the one made here; empty where there is neither."""
    chosen = bpy.path.abspath(context.preferences.addons[ROOT_PACKAGE].preferences.python)
    if chosen:  # panels ask at every redraw: the disk is looked at only where nothing is chosen
        return chosen
    made = environment_python(environment_folder())
    return str(made) if made.is_file() and jobs.record("environment", environment_folder()).state == "done" else ""


class IRIS_OT_test_python(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Start the solver's Python and import everything that a solve needs"""

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
        from .watch import run

        folder = environment_folder()
        command = environment_command(folder, test_only=Path(solver_python(context)))
        return run(self, "test", folder, command)


class IRIS_OT_make_environment(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Make a Python environment for the solver and download its packages (torch among them) into it"""

    bl_idname = "iris.make_environment"
    bl_label = "Create Environment"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """Blender may go online, and none is being made."""
        if not bpy.app.online_access:
            cls.poll_message_set("Allow online access in Preferences > System first")
            return False
        return jobs.running("environment", environment_folder()) is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start it; the path is set when it is done."""
        from .watch import run

        folder = environment_folder()
        preferences = context.preferences.addons[ROOT_PACKAGE].preferences

        def ended(record: jobs.Record) -> None:
            if record.state == "done":
                preferences.python = str(environment_python(folder))
                context.preferences.is_dirty = True  # so that Blender writes it down when it ends

        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self.report({"ERROR"}, str(IrisError(f"cannot be made ({error.strerror})", "free some space", folder)))
            return {"CANCELLED"}
        return run(self, "environment", folder, environment_command(folder), ended)
