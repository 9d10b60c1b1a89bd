"""Place an object in the room: it follows the mouse over the surfaces until it is dropped."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import bpy
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

from ..iris_addon.base.errors import BadInput
from ..iris_addon.blender.insert.dragging import SHAPES, DraggedObject
from ..iris_addon.blender.stepwise import Steps, finish
from .modal_steps import InSteps
from .polls import NeedsApplied

SELECTED = "SELECTED"
PLACEABLE = (
    *((key, name, "A new one, 30 cm wide") for key, (name, *_rest) in SHAPES.items()),
    (SELECTED, "Selected Object", "The active object with its children"),
)

NOTCH, NOTCH_DEGREES = 1.1, 15.0
"""One notch of the mouse wheel: factor on the size, and rotation."""
BLOCKED_KEYS = ("Z", "X", "DEL")
"""Keys that would undo or delete the dragged object. All others reach the view, so that it can be navigated."""
HELP = "Click: leave it there    Wheel: size (× {size:.2f})    Shift Wheel: turn ({turn:.0f}°)    Esc: cancel"


class IRIS_OT_place(NeedsApplied, InSteps, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Place an object on the surface under the mouse. Wheel: size; Shift and wheel: turn; click: leave it there"""

    bl_idname = "iris.place"
    bl_label = "Place Object"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    thing: bpy.props.EnumProperty(name="Object", items=PLACEABLE)
    size: bpy.props.FloatProperty(
        name="Size",
        description="Factor on the size of the object",
        default=1.0,
        min=0.01,
        soft_max=10.0,
        options={"SKIP_SAVE"},
    )
    turn: bpy.props.FloatProperty(
        name="Turn", description="Rotation about the normal of the surface, degrees", options={"SKIP_SAVE"}
    )
    origin: bpy.props.FloatVectorProperty(
        name="From", description="Origin of the line of sight", options={"HIDDEN", "SKIP_SAVE"}
    )
    direction: bpy.props.FloatVectorProperty(
        name="Towards",
        description="Direction of the line of sight, which ends at the first surface",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Place the object where the line of sight meets the room."""
        try:
            dragged = finish(self._pick_up(context))
        except BadInput as error:
            return self._refuse(error)
        try:
            dragged.move(self.origin, self.direction, self.size, self.turn)
        except BadInput as error:
            dragged.cancel()
            return self._refuse(error)
        dragged.drop(context)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Pick the object up; from here on it follows the mouse."""
        if context.area is None or context.area.type != "VIEW_3D":
            return self._refuse(BadInput("there is no 3D view here", "press the button in the sidebar of one"))
        self._region = next(region for region in context.area.regions if region.type == "WINDOW")
        self._view = context.area.spaces.active.region_3d
        self._on_surface = False
        return super().invoke(context, event)

    def steps(self, context: bpy.types.Context) -> Steps[set[str]]:
        """Pick the object up, for which the room is read; it is dragged afterwards."""
        self._dragged = yield from self._pick_up(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on picking up; after that, handle one event of mouse or keyboard."""
        if self._steps is not None:
            result = super().modal(context, event)
            if result == {"RUNNING_MODAL"} and self._steps is None:
                self._show_help(context)
            return result
        try:
            return self._handle(context, event)
        except ReferenceError:  # a menu has undone or deleted the dragged object
            self.cancel(context)
            return {"CANCELLED"}

    def _handle(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        x, y = event.mouse_x - self._region.x, event.mouse_y - self._region.y
        inside = 0 <= x < self._region.width and 0 <= y < self._region.height
        if event.type in ("ESC", "RIGHTMOUSE"):
            return self._end(context, keep=False)
        if event.type == "LEFTMOUSE" and event.value == "PRESS" and inside:
            return self._end(context, keep=True)
        if event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE") and inside:
            self._notch(up=event.type == "WHEELUPMOUSE", turn=event.shift)
            self._show_help(context)
        elif event.type != "MOUSEMOVE":
            return {"RUNNING_MODAL"} if event.type in BLOCKED_KEYS else {"PASS_THROUGH"}
        if inside:
            self._follow(x, y)
        return {"RUNNING_MODAL"}

    def _pick_up(self, context: bpy.types.Context) -> Steps[DraggedObject]:
        if self.thing != SELECTED:
            return DraggedObject.from_shape(self.thing, context)
        thing = context.active_object
        if thing is None:
            raise BadInput("no object is selected", "select the object that is to be placed")
        if thing == context.scene.iris.room:
            raise BadInput(f"'{thing.name}' is the room", "select the object that is to be placed in it")
        return DraggedObject.pick_up(thing, context)

    def _refuse(self, error: BadInput) -> set[str]:
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
            self._dragged.move(self.origin, self.direction, self.size, self.turn)
            self._on_surface = True
        except BadInput:
            self._on_surface = False  # the mouse points past the room: the object stays where it was

    def _show_help(self, context: bpy.types.Context) -> None:
        context.workspace.status_text_set(HELP.format(size=self.size, turn=self.turn))

    def _end(self, context: bpy.types.Context, keep: bool) -> set[str]:
        context.workspace.status_text_set(None)
        if keep and self._on_surface:
            self._dragged.drop(context)
            return {"FINISHED"}
        self._dragged.cancel()
        return {"CANCELLED"}
