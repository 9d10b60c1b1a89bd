"""Interface elements that several panels draw."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap

import bpy

from ...iris_addon.blender.worker import jobs
from ..folders import folder, job_folder
from . import solve_preview
from .steps import duration

WROTE_FOLDER = ("plate", "farm")
"""Jobs whose folder the artist has chosen: a button opens it afterwards."""


def paragraph(layout: bpy.types.UILayout, text: str, context: bpy.types.Context, icon: str = "NONE") -> None:
    """Draw ``text``, wrapped to the width of the region."""
    pixels = 7 * context.preferences.system.ui_scale
    width = max(20, int((context.region.width if context.region else 300) / pixels) - 6)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(wrap(text, width)):
        column.label(text=line, icon=icon if number == 0 else "BLANK1" if icon != "NONE" else "NONE")


def sentence(text: str) -> str:
    """``text`` with a capital letter first, as the command line has none; names in it keep theirs."""
    return text[:1].upper() + text[1:]


def job_box(layout: bpy.types.UILayout, name: jobs.JobName, context: bpy.types.Context) -> None:
    """Progress bars and Cancel while a job runs; reason, fix, Copy and Log if it failed; the folder of frames or
    of a bundle that it wrote; nothing without a job."""
    where = job_folder(name, context)
    job, record = jobs.running(name, where), jobs.record(name, where)
    if job is not None:
        worker = job.worker
        column = layout.column(align=True)
        stage = "Stopping" if worker.stopping else (worker.stage or "starting").capitalize()
        column.progress(factor=worker.fraction, text=stage)
        column.progress(factor=worker.overall, text=f"{worker.overall:.0%}{time_left(worker.seconds_left)}")
        row = layout.row(align=True)
        row.operator("iris.cancel", icon="CANCEL").job = name
        row.operator("iris.show_log", icon="TEXT").job = name
        return
    if record.state in ("failed", "interrupted"):
        box = layout.box()
        paragraph(box, record.what, context, "ERROR")
        paragraph(box, f"Try: {record.fix}", context, "INFO")
        row = box.row(align=True)
        row.operator("iris.copy_error", icon="COPYDOWN").job = name
        row.operator("iris.show_log", icon="TEXT").job = name
    elif record.state == "cancelled":
        kept = "; finished stages are kept" if name == "solve" else ""
        layout.label(text=f"Cancelled{kept}", icon="INFO")
    elif record.state == "done" and name == "solve":
        layout.operator("iris.show_log", icon="TEXT").job = name
    elif name in WROTE_FOLDER and (wrote := jobs.ended_here(name, where)).state == "done" and wrote.what:
        if wrote.fix:
            paragraph(layout, sentence(wrote.fix), context, "ERROR")
        opened = layout.operator("wm.path_open", text=f"Open {Path(wrote.what).name}", icon="FILE_FOLDER")
        opened.filepath = wrote.what


def preview_box(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The preview of the running solve; nothing before the first one."""
    settings = context.scene.iris
    picture = solve_preview.picture(folder(context.scene), settings.preview)
    if picture is None:
        return
    layout.row(align=True).prop(settings, "preview", expand=True)
    width = context.region.width / (20 * context.preferences.system.ui_scale)  # in interface units
    layout.template_icon(picture.icon_id, scale=max(6.0, min(14.0, width - 4)))


def time_left(seconds: float | None) -> str:
    """The estimated time left as text."""
    if seconds is None:
        return ""
    return f", {duration(seconds)} left"
