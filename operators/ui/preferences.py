"""Preferences of the extension: the solver's Python, with its test and its creation."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy

from ...iris_addon.blender.worker import jobs
from ..folders import ROOT_PACKAGE, environment_folder


class IrisPreferences(bpy.types.AddonPreferences):
    """Where the solver's Python is."""

    bl_idname = ROOT_PACKAGE

    python: bpy.props.StringProperty(
        name="Solver Python",
        description="Python with torch and the other packages of the solver; Blender's own has none of them",
        subtype="FILE_PATH",
    )

    fold_steps: bpy.props.BoolProperty(
        name="Only Current Step Open",
        description="Fold the sections of the sidebar but that of the current step; a click on a heading unfolds one",
        default=True,
    )

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw the preferences."""
        layout = self.layout
        layout.prop(self, "python")
        row = layout.row()
        row.operator("iris.test_python", icon="CHECKMARK")
        row.operator("iris.make_environment", icon="IMPORT")
        if not self.python:
            layout.label(text="Needed to read captures and to solve; applying a result works without", icon="INFO")
        layout.prop(self, "fold_steps")
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
        layout.label(text=f"Try: {record.fix}", icon="BLANK1")
        layout.operator("iris.copy_error", icon="COPYDOWN").job = name
    elif record.state in ("done", "cancelled", "interrupted"):
        done = record.state == "done"
        said = (record.what or "done") if done else f"{record.state}. {record.what}"
        layout.label(text=f"{title}: {said}", icon="CHECKMARK" if done else "INFO")
    if record.state != "missing":
        layout.operator("iris.show_log", text=f"{title} Log", icon="TEXT").job = name
