"""Progress of jobs in Blender's status bar, and for a while what the last one ended with."""

from __future__ import annotations

import time

import bpy

from ..iris_addon.blender.worker import jobs
from .ui.steps import duration, solved_line

DOING = {
    "inspect": "Checking the Capture",
    "solve": "Solving",
    "composite": "Putting onto the Photo",
    "plate": "Putting onto the Plate",
    "probe": "Rendering the HDRI Probe",
    "meter": "Reading the Light at the Cursor",
    "looks": "Picturing the Looks",
    "farm": "Exporting the Farm Job",
    "environment": "Creating the Environment",
    "test": "Testing the Environment",
}
SHOWN_SECONDS = 20.0
"""For which the end of a job is shown."""
REDRAW_SECONDS = 0.5

_last = {"redraw": 0.0, "ended": 0.0}
_end = {"text": "", "icon": "NONE"}


def ended(job: jobs.Job, record: jobs.Record) -> str:
    """Remember how ``job`` has ended; returns the sentence that the status bar shows."""
    doing, spent = DOING[job.name], duration(time.monotonic() - job.began)
    if record.state == "done":
        text = (job.name == "solve" and solved_line(job.folder)) or f"{doing}: done in {spent}"
    elif record.state == "failed":
        text = f"{doing} failed: {record.what}"
    else:
        text = f"{doing}: {record.state}"
    icon = {"done": "CHECKMARK", "failed": "ERROR"}.get(record.state, "INFO")
    _end.update(text=text, icon=icon)
    _last.update(ended=time.monotonic(), redraw=0.0)
    return text


def lines() -> list[tuple[str, float]]:
    """Text and finished share of every job that runs."""
    running = []
    for job in jobs.all_running():
        left = job.worker.seconds_left
        # Cycles alone, which renders a probe, says nothing on its way.
        text = f"{DOING[job.name]} {job.worker.overall:.0%}" if job.worker.overall else DOING[job.name]
        running.append((text if left is None else f"{text}, {duration(left)} left", job.worker.overall))
    return running


def draw(self: bpy.types.Header, _context: bpy.types.Context) -> None:
    """What is added to the status bar."""
    for text, share in lines():
        row = self.layout.row()
        row.ui_units_x = 14
        row.progress(factor=share, text=text)
    if time.monotonic() - _last["ended"] < SHOWN_SECONDS:
        self.layout.label(text=_end["text"], icon=_end["icon"])


def redraw() -> bool:
    """Redraw the status bar from time to time; returns whether it has something that will change."""
    now = time.monotonic()
    shown = now - _last["ended"] < SHOWN_SECONDS + 1
    if now - _last["redraw"] > REDRAW_SECONDS:
        _last["redraw"] = now
        register()
        for window in bpy.context.window_manager.windows:
            # Setting no text is the one call that redraws it; while a tool runs, the bar has that tool's text.
            if not len(window.modal_operators):
                with bpy.context.temp_override(window=window):  # a timer has no window
                    window.workspace.status_text_set_internal(None)
    return shown


def register() -> None:
    """Add to the status bar, unless that is done: setting its text, as any tool may, removes what was added."""
    if draw not in getattr(bpy.types.STATUSBAR_HT_header.draw, "_draw_funcs", ()):
        bpy.types.STATUSBAR_HT_header.prepend(draw)


def unregister() -> None:
    """Remove it."""
    if draw in getattr(bpy.types.STATUSBAR_HT_header.draw, "_draw_funcs", ()):
        bpy.types.STATUSBAR_HT_header.remove(draw)
