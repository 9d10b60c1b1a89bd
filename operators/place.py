"""Put something into the room by pointing at where it is to stand."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

from ..iris_addon.base.errors import BadInput
from ..iris_addon.blender.insert.carry import Carried
from .polls import NeedsApplied
from .settings import PLACEABLE, SELECTED

NOTCH, NOTCH_DEGREES = 1.1, 15.0
"""A notch of the wheel: factor on the size, and turn."""
TAKING_AWAY = ("Z", "X", "DEL")
"""Keys that undo or delete what is carried; all others go on to the view, which can be turned meanwhile."""
HELP = "Click: leave it there    Wheel: size (× {size:.2f})    Shift Wheel: turn ({turn:.0f}°)    Esc: cancel"


class IRIS_OT_place(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Set something onto the surface under the mouse. Wheel: size; Shift and wheel: turn; click: leave it there"""

    bl_idname = "iris.place"
    bl_label = "Place Object"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    thing: bpy.props.EnumProperty(name="Object", items=PLACEABLE)
    size: bpy.props.FloatProperty(
        name="Size", description="Factor on its size", default=1.0, min=0.01, soft_max=10.0, options={"SKIP_SAVE"}
    )
    turn: bpy.props.FloatProperty(name="Turn", description="Degrees about the normal", options={"SKIP_SAVE"})
    origin: bpy.props.FloatVectorProperty(
        name="From", description="Where the line of sight begins", options={"HIDDEN", "SKIP_SAVE"}
    )
    direction: bpy.props.FloatVectorProperty(
        name="Towards", description="Where it goes, to the first surface", options={"HIDDEN", "SKIP_SAVE"}
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Place it where the line of sight meets the room."""
        try:
            carried = self._taken_up(context)
        except BadInput as error:
            return self._refused(error)
        try:
            carried.move(self.origin, self.direction, self.size, self.turn)
        except BadInput as error:
            carried.take_back()
            return self._refused(error)
        carried.leave(context)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Take it up; from here on it follows the mouse."""
        if context.area is None or context.area.type != "VIEW_3D":
            return self._refused(BadInput("there is no 3D view here", "press it in the sidebar of one"))
        self._region = next(part for part in context.area.regions if part.type == "WINDOW")
        self._view = context.area.spaces.active.region_3d
        context.window.cursor_set("WAIT")  # the room is read once: seconds for a million triangles
        try:
            self._carried = self._taken_up(context)
        except BadInput as error:
            return self._refused(error)
        finally:
            context.window.cursor_set("DEFAULT")
        self._stands = False
        self._say(context)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One event of mouse or keys."""
        try:
            return self._take(context, event)
        except ReferenceError:  # a menu has undone or deleted what is carried
            self.cancel(context)
            return {"CANCELLED"}

    def _take(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        x, y = event.mouse_x - self._region.x, event.mouse_y - self._region.y
        inside = 0 <= x < self._region.width and 0 <= y < self._region.height
        if event.type in ("ESC", "RIGHTMOUSE"):
            return self._end(context, keep=False)
        if event.type == "LEFTMOUSE" and event.value == "PRESS" and inside:
            return self._end(context, keep=True)
        if event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE") and inside:
            self._notch(up=event.type == "WHEELUPMOUSE", turn=event.shift)
            self._say(context)
        elif event.type != "MOUSEMOVE":
            return {"RUNNING_MODAL"} if event.type in TAKING_AWAY else {"PASS_THROUGH"}
        if inside:
            self._follow(x, y)
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends it: another file is opened, or the window closes."""
        context.workspace.status_text_set(None)

    # ---- pieces ------------------------------------------------------------------------------------------------------

    def _taken_up(self, context: bpy.types.Context) -> Carried:
        if self.thing != SELECTED:
            return Carried.made(self.thing, context)
        thing = context.active_object
        if thing is None:
            raise BadInput("no object is selected", "select the one that is to be placed")
        if thing == context.scene.iris.room:
            raise BadInput(f"'{thing.name}' is the room", "select what is to be placed in it")
        return Carried(thing, context)

    def _refused(self, error: BadInput) -> set[str]:
        self.report({"ERROR"}, str(error))
        return {"CANCELLED"}

    def _notch(self, up: bool, turn: bool) -> None:
        if turn:
            self.turn += NOTCH_DEGREES if up else -NOTCH_DEGREES
        else:
            self.size *= NOTCH if up else 1 / NOTCH

    def _follow(self, x: int, y: int) -> None:
        self.origin = region_2d_to_origin_3d(self._region, self._view, (x, y))
        self.direction = region_2d_to_vector_3d(self._region, self._view, (x, y))
        try:
            self._carried.move(self.origin, self.direction, self.size, self.turn)
            self._stands = True
        except BadInput:
            self._stands = False  # the mouse is beside the room; what is carried waits where it was

    def _say(self, context: bpy.types.Context) -> None:
        context.workspace.status_text_set(HELP.format(size=self.size, turn=self.turn))

    def _end(self, context: bpy.types.Context, keep: bool) -> set[str]:
        context.workspace.status_text_set(None)
        if keep and self._stands:
            self._carried.leave(context)
            return {"FINISHED"}
        self._carried.take_back()
        return {"CANCELLED"}
