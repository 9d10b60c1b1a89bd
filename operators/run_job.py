"""Run jobs from operators: a timer polls them on the main thread; operators cancel them and show their logs."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import atexit
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.base.untrusted import open_file
from ..iris_addon.blender.worker import jobs
from . import status_bar
from .editors import show_in_editor
from .folders import folder, job_folder
from .modal_steps import busy

TICK_SECONDS, STEP_TICK_SECONDS = 0.1, 0.01
"""Between two looks at the jobs; the second while one of them ends in steps."""
MAX_LOG_BYTES, SHOWN_LOG_BYTES = 1 << 40, 1_000_000


def run(
    operator: bpy.types.Operator,
    name: jobs.JobName,
    out: Path,
    command: list[str],
    on_end: jobs.OnEnd = lambda record: None,
) -> set[str]:
    """Start a job for ``operator``; with a window return at once, in background wait for its end.

    Args:
        out: the folder of the job.
        on_end: called once in any case, also for a job that cannot start; see :class:`jobs.Job`.

    Returns:
        The result of the operator.
    """

    def ended(record: jobs.Record) -> Iterator[object]:
        try:
            yield from on_end(record) or ()
        except IrisError as error:
            status_bar.ended(job, jobs.Record("failed", error.what, error.fix))
            raise
        status_bar.ended(job, record)

    try:
        job = jobs.start(name, out, command, ended)
    except IrisError as error:
        deque(on_end(jobs.Record("failed", error.what, error.fix)) or (), maxlen=0)
        operator.report({"ERROR"}, str(error))
        return {"CANCELLED"}
    if not bpy.app.background:
        if not bpy.app.timers.is_registered(_tick):
            bpy.app.timers.register(_tick, first_interval=TICK_SECONDS, persistent=True)
        redraw_sidebars()
        return {"FINISHED"}
    jobs.wait(job)
    record = jobs.record(name, out)
    if record.state == "done":
        operator.report({"INFO"}, status_bar.ended(job, record))
        return {"FINISHED"}
    operator.report({"ERROR"}, f"{record.what} — {record.fix}" if record.what else record.state)
    return {"CANCELLED"}


def run_on_copy(
    operator: bpy.types.Operator,
    name: jobs.JobName,
    copy: Path,
    prepare: Callable[[], list[str]],
    on_done: Callable[[], object] = lambda: None,
    *,
    also: tuple[Path, ...] = (),
) -> set[str]:
    """:func:`run` a job of the folder of ``copy``, a .blend that only that job reads.

    Args:
        prepare: writes ``copy`` and returns the command; may raise IrisError.
        on_done: called where the job succeeded; may raise IrisError.
        also: further files that are removed with ``copy`` when the job has ended, or cannot start.

    Returns:
        The result of the operator.
    """

    def remove() -> None:
        for path in (copy, *also):
            path.unlink(missing_ok=True)

    def ended(record: jobs.Record) -> None:
        try:
            if record.state == "done":
                on_done()
        finally:
            remove()

    try:
        command = prepare()
    except IrisError as error:
        remove()
        operator.report({"ERROR"}, str(error))
        return {"CANCELLED"}
    return run(operator, name, copy.parent, command, ended)


def scene_of(name: str, out: Path) -> bpy.types.Scene | None:
    """The scene ``name``, if its results still go to ``out``: when a job ends, another file may be open."""
    scene = bpy.data.scenes.get(name)
    return scene if scene is not None and folder(scene) == out else None


def _tick() -> float | None:
    if not busy() and jobs.poll():
        redraw_sidebars()
    changes = status_bar.redraw()
    running = list(jobs.all_running())
    if any(job.ending is not None for job in running):
        return STEP_TICK_SECONDS
    return TICK_SECONDS if changes or running else None


def redraw_sidebars() -> None:
    """Redraw the panels only, because a 3D view takes long."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if (area.type, region.type) in (("VIEW_3D", "UI"), ("PREFERENCES", "WINDOW")):
                    region.tag_redraw()


def register() -> None:
    """Make sure that no job outlives Blender."""
    status_bar.register()
    atexit.register(jobs.stop_all)


def unregister() -> None:
    """Stop all jobs."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    jobs.stop_all()
    status_bar.unregister()
    atexit.unregister(jobs.stop_all)


JOB_NAMES = tuple((name, name.title(), "") for name in get_args(jobs.JobName))


class IRIS_OT_cancel(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Stop; finished stages are kept and used the next time"""

    bl_idname = "iris.cancel"
    bl_label = "Cancel"

    job: bpy.props.EnumProperty(items=JOB_NAMES, options={"HIDDEN"})

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """A job runs."""
        return any(True for _ in jobs.all_running())

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask the process to stop; the timer notices its end, and kills it if it does not stop."""
        job = jobs.running(self.job, job_folder(self.job, context))
        if job is not None:
            job.worker.interrupt()
        return {"FINISHED"}


class IRIS_OT_copy_error(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Copy the reason and the last lines of the log, for a bug report"""

    bl_idname = "iris.copy_error"
    bl_label = "Copy"

    job: bpy.props.EnumProperty(items=JOB_NAMES, options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write to the clipboard."""
        out = job_folder(self.job, context)
        record = jobs.record(self.job, out)
        log = _log(out / f"{self.job}.log").splitlines()[-40:]
        context.window_manager.clipboard = "\n".join([f"error: {record.what} — {record.fix}", *log])
        self.report({"INFO"}, "Copied")
        return {"FINISHED"}


class IRIS_OT_show_log(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Open the output of the process in a text editor"""

    bl_idname = "iris.show_log"
    bl_label = "Log"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    job: bpy.props.EnumProperty(items=JOB_NAMES, options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the log to a text and show it."""
        name = f"IRIS {self.job} log"
        text = bpy.data.texts.get(name) or bpy.data.texts.new(name)
        text.from_string(_log(job_folder(self.job, context) / f"{self.job}.log"))
        show_in_editor(context, "TEXT_EDITOR", "text", text)
        return {"FINISHED"}


def _log(path: Path) -> str:
    try:
        with open_file(path, MAX_LOG_BYTES) as file:
            file.seek(max(0, path.stat().st_size - SHOWN_LOG_BYTES))
            return file.read(SHOWN_LOG_BYTES).decode("utf-8", "replace")
    except IrisError as error:
        return f"{error}\n"
