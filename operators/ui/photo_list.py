"""The list of photos: which are used, which to look at, and in which order they stand."""

from __future__ import annotations

import bpy

COLUMNS = 0.58, 0.5
"""Share of the name in a row, and of the fit in what is left of it."""


class IRIS_UL_views(bpy.types.UIList):  # noqa: N801 - Blender's naming
    """Photos with a box that takes them in, their alignment and their share of saturated pixels."""

    def draw_item(self, _context, layout, _data, item, _icon, _active, _name) -> None:  # noqa: ANN001 - Blender's
        """One photo."""
        icon = {"aligned": "CHECKMARK", "shifted": "ERROR", "unclear": "QUESTION"}[item.verdict]
        name, fit, clipped = columns(layout)
        name.prop(item, "use", text="")
        name.label(text=item.name, icon="ERROR" if item.problem else icon)
        for column, text in ((fit, f"{item.score:.2f}"), (clipped, f"{item.saturated:.0%}")):
            column.active = item.use
            column.label(text=text)

    def filter_items(self, _context, data, name) -> tuple[list[int], list[int]]:  # noqa: ANN001 - Blender's
        """Those whose name contains the text below the list, only problems where asked, in the chosen order."""
        items, helper = getattr(data, name), bpy.types.UI_UL_list
        shown = helper.filter_items_by_name(self.filter_name, self.bitflag_filter_item, items, "name")
        shown = shown or [self.bitflag_filter_item] * len(items)
        if data.problems_only:
            shown = [flag if item.problem else 0 for flag, item in zip(shown, items, strict=True)]
        key = {"SCORE": lambda item: item.score, "SATURATED": lambda item: -item.saturated}.get(data.photo_order)
        if key is None:
            return shown, []
        return shown, helper.sort_items_helper([(k, key(item)) for k, item in enumerate(items)], lambda row: row[1])


class IRIS_OT_next_problem(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Look through the camera of the next photo that should be looked at, with the photo over the mesh"""

    bl_idname = "iris.next_problem"
    bl_label = "Next Problem"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender's form

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is one."""
        return any(view.problem for view in context.scene.iris.views)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Step to it; after the last comes the first."""
        settings = context.scene.iris
        with_problem = [k for k, view in enumerate(settings.views) if view.problem]
        later = [k for k in with_problem if k > settings.view_index]
        settings.overlay = settings.overlay or 0.5
        settings.view_index = (later or with_problem)[0]
        return {"FINISHED"}


def columns(layout: bpy.types.UILayout) -> tuple[bpy.types.UILayout, bpy.types.UILayout, bpy.types.UILayout]:
    """The name, fit and clipped pixels of a row."""
    split = layout.split(factor=COLUMNS[0], align=True)
    name, rest = split.row(align=True), split.split(factor=COLUMNS[1], align=True)
    return name, rest.row(), rest.row()


def draw_list(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """The list with its headings, its order and the number of photos that are left out."""
    row = layout.row(align=True)
    row.prop(settings, "photo_order", text="")
    row.prop(settings, "problems_only", text="", icon="FILTER")
    row.operator("iris.next_problem", text="", icon="ERROR")
    for column, text in zip(columns(layout.row()), ("Use, Photo", "Fit", "Clipped"), strict=True):
        column.label(text=text)
    layout.template_list("IRIS_UL_views", "", settings, "views", settings, "view_index", rows=4)
    left_out = sum(not view.use for view in settings.views)
    if left_out:
        layout.label(text=f"{left_out} of {len(settings.views)} photos left out", icon="INFO")
