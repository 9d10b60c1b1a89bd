"""Solve the capture of the scene in the solver's Python and apply the result."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.blender.apply import apply_to_scene
from ..iris_addon.blender.images import read_image
from ..iris_addon.blender.worker import Worker, solve_command
from ..iris_addon.errors import IrisError
from ..iris_addon.result.io import load_result
from .preferences import solver_python

ADDON = Path(__file__).resolve().parents[1]
TICK_SECONDS = 0.1

_worker: Worker | None = None


def current() -> Worker | None:
    """The solve that runs, if one does."""
    return _worker


def stop() -> None:
    """End the solve that runs, if one does, and wait until it is gone."""
    global _worker
    if _worker is not None:
        _worker.close()
        _worker = None


class IRIS_OT_solve(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Recover materials, lights and camera response from the photos, and add the room to this scene"""

    bl_idname = "iris.solve"
    bl_label = "Solve"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    _timer: bpy.types.Timer | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A capture is chosen, the solver's Python is set, nothing runs yet."""
        if not context.scene.iris.capture:
            cls.poll_message_set("Choose the folder of a capture first")
        elif not solver_python(context):
            cls.poll_message_set("Set the solver's Python in the preferences of IRIS first")
        else:
            return _worker is None
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the worker; in background wait for it, with a window watch it from a timer."""
        global _worker
        settings = context.scene.iris
        capture = Path(bpy.path.abspath(settings.capture)).resolve()
        self._scene = context.scene.name
        self._out = Path(bpy.path.abspath(settings.result or f"{capture}-iris"))
        command = solve_command(solver_python(context), ADDON, capture, self._out, settings.preset)
        try:
            _worker = Worker(command)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if bpy.app.background:
            _worker.wait()
            return self._finish()
        self._timer = context.window_manager.event_timer_add(TICK_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take the worker's messages at each tick; leave every other event to Blender."""
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if _worker is not None and _worker.poll():
            _redraw_sidebars(context)
        if _worker is not None and _worker.running:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        _redraw_sidebars(context)
        return self._finish()

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator: another file is loaded, or Blender closes."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
        stop()

    def _finish(self) -> set[str]:
        global _worker
        worker, _worker = _worker, None
        scene = bpy.data.scenes.get(self._scene)
        if worker is None or scene is None:
            return {"CANCELLED"}
        worker.close()
        try:
            worker.raise_if_failed()
            apply_to_scene(load_result(self._out, read_image=read_image), scene)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Solved {self._out}")
        return {"FINISHED"}


class IRIS_OT_cancel(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Stop the solve; what is finished is kept and used the next time"""

    bl_idname = "iris.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """Something runs."""
        return _worker is not None

    def execute(self, _context: bpy.types.Context) -> set[str]:
        """Ask the worker to stop; its end is noticed by the solve that watches it."""
        if _worker is not None:
            _worker.interrupt()
        return {"FINISHED"}


def _redraw_sidebars(context: bpy.types.Context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()
