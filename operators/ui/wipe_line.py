"""The line of the wipe as something to drag: in the camera's view, with the mouse."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from .wipe import Point, shown_wipe, wiped

GRIP_PIXELS = 8.0
"""On either side of the line the mouse takes hold of it; times the scale of Blender's interface."""
LEAST_SHARE = 0.01
"""The line is not dragged further to the left: a wipe of 0 is off, and has no line to drag back."""


def share_at(corners: Sequence[Point], x: float) -> float:
    """The share of a frame's width at ``x``, as far as the line may be dragged.

    Args:
        corners: of the frame, bottom left, bottom right, top right, top left.
        x: in the region, pixels.
    """
    left, right = corners[0][0], corners[1][0]
    return min(max((x - left) / (right - left), LEAST_SHARE), 1.0) if right > left else LEAST_SHARE


def is_near(corners: Sequence[Point], share: float, at: Point, within: float) -> bool:
    """Whether the point ``at`` is ``within`` so many pixels of the line that stands at ``share``."""
    (x, bottom), (_, top) = wiped(corners, share)[2]
    return abs(at[0] - x) <= within and bottom <= at[1] <= top


class IRIS_GT_wipe_line(bpy.types.Gizmo):  # noqa: N801 - Blender's naming
    """The line; its handler in :mod:`.wipe` draws it."""

    bl_idname = "IRIS_GT_wipe_line"
    __slots__ = ("before",)

    def setup(self) -> None:
        """Let the drag be seen while it lasts."""
        self.use_draw_modal = True

    def draw(self, context: bpy.types.Context) -> None:
        """Nothing: the wipe draws the line with the photo."""

    def test_select(self, context: bpy.types.Context, location: Sequence[float]) -> int:
        """0 where the mouse is on the line, else -1."""
        shown = shown_wipe(context)
        grip = GRIP_PIXELS * context.preferences.system.ui_scale
        return (
            0
            if shown is not None and is_near(shown[1], context.scene.iris.wipe, (location[0], location[1]), grip)
            else -1
        )

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Take hold of it."""
        self.before = context.scene.iris.wipe
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event, _tweak: set[str]) -> set[str]:
        """Follow the mouse."""
        shown = shown_wipe(context)
        if shown is not None:
            context.scene.iris.wipe = share_at(shown[1], event.mouse_region_x)
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        """Leave it there, or put it back where it was."""
        if cancel:
            context.scene.iris.wipe = self.before


class IRIS_GGT_wipe(bpy.types.GizmoGroup):  # noqa: N801 - Blender's naming
    """The line of the wipe, while it is shown."""

    bl_idname = "IRIS_GGT_wipe"
    bl_label = "Wipe"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT", "SHOW_MODAL_ALL"}  # noqa: RUF012 - Blender's form

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The view shows a wipe."""
        return shown_wipe(context) is not None

    def setup(self, _context: bpy.types.Context) -> None:
        """The line is all there is."""
        self.gizmos.new(IRIS_GT_wipe_line.bl_idname)
