"""Operators that work in steps: the button starts them and Blender goes on drawing; a script gets all at once."""

from __future__ import annotations

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.stepwise import Steps, advance, finish
from .wait_cursor import wait_cursor

TICK_SECONDS, STEP_SECONDS = 0.01, 0.1
"""Between two turns of the operator, and for how long one goes on taking steps."""
PASSED_ON = ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "WINDOW_DEACTIVATE")
"""Events that reach the rest of Blender meanwhile. Others could change the scene that the steps are about."""


class InSteps:
    """Mixin of operators whose work is :meth:`steps`. Esc gives it up, and the scene is as it was before.

    Where the steps return {"RUNNING_MODAL"}, the operator goes on with a :meth:`modal` of its own.
    One step of undo is added at the end, as Blender does for an operator that takes its time.
    """

    _steps: Steps[set[str]] | None = None
    _timer: bpy.types.Timer | None = None
    _shown = ""

    def steps(self, context: bpy.types.Context) -> Steps[set[str]]:
        """The work, which returns the result of the operator. Closed, or with an exception, it undoes what it did."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do all at once."""
        try:
            with wait_cursor(context):
                return finish(self.steps(context))
        except IrisError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Start; each tick of a timer goes on."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        if _active:
            self.report({"ERROR"}, "Blender is busy in another window — wait for it")  # type: ignore[attr-defined]
            return {"CANCELLED"}
        _active.append(self)
        self._steps = self.steps(context)
        self._timer = context.window_manager.event_timer_add(TICK_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)  # type: ignore[arg-type]
        context.window.cursor_modal_set("WAIT")
        self._show(context, "starting")
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on, or give up."""
        assert self._steps is not None
        if event.type == "ESC":
            self.cancel(context)
            self.report({"INFO"}, "Cancelled; nothing was changed")  # type: ignore[attr-defined]
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"} if event.type in PASSED_ON else {"RUNNING_MODAL"}
        result = {"CANCELLED"}
        try:
            self._show(context, advance(self._steps, STEP_SECONDS))
            return {"RUNNING_MODAL"}
        except StopIteration as end:
            result = end.value
        except IrisError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
        except ReferenceError:  # undone or deleted from another window
            self.report({"ERROR"}, "what this is about is gone — do it again")  # type: ignore[attr-defined]
        except BaseException:
            self.cancel(context)
            raise
        self.cancel(context)
        return result

    def cancel(self, context: bpy.types.Context) -> None:
        """End; Blender calls this where another file is opened, or the window closes."""
        _active[:] = [other for other in _active if other is not self]
        if self._steps is not None:
            self._steps.close()
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
        self._steps = self._timer = None
        if context.window is not None:
            context.window.cursor_modal_restore()
            context.workspace.status_text_set(None)

    def _show(self, context: bpy.types.Context, what: str) -> None:
        text = f"{self.bl_label}: {what} …    Esc: cancel"  # type: ignore[attr-defined]
        if text != self._shown:
            self._shown = text
            context.workspace.status_text_set(text)


_active: list[InSteps] = []
"""The operator that is taking its steps."""


def busy() -> bool:
    """Whether an operator is taking its steps; what it works on should not change."""
    return bool(_active)
