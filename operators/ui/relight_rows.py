"""Rows of the Relight section: looks, the wipe, and the scale of the light."""

from __future__ import annotations

import bpy

from ...iris_addon.blender.apply.looks import offered_looks
from ..relight import all_looks
from .look_icons import BUILT_IN, OWN, has_shares, look_choices, look_icon
from .widgets import job_box
from .wipe import wiped_photo, wiped_picture


def wipe_row(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw the slider of the wipe and what it goes to, where the active camera has a photo or a look."""
    if wiped_photo(scene) is None and not has_shares(scene):
        return
    settings = scene.iris
    chosen = next((choice for choice in look_choices(settings, bpy.context) if choice[0] == settings.wipe_to), None)
    row = layout.row(align=True)
    row.prop(settings, "wipe", text=f"Wipe to {chosen[1] if chosen else 'Photo'}", slider=True)
    row.prop(settings, "wipe_to", text="", icon_only=True)
    if wiped_picture(scene) is None:
        why = "This look has no picture" if has_shares(scene) else "Picture the Looks of this view first"
        layout.label(text=why, icon="INFO")


def look_rows(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw a button per look, under its picture where there are light shares, and what makes these."""
    scene = context.scene
    grid = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    for key, look in offered_looks(scene).items():
        _look_cell(grid, scene, f"{BUILT_IN}{key}").operator("iris.look", text=look.label).look = key
    for name in all_looks(scene):
        row = _look_cell(grid, scene, f"{OWN}{name}").row(align=True)
        row.operator("iris.own_look", text=name).name = name
        row.operator("iris.forget_look", text="", icon="X").name = name
    row = layout.row(align=True)
    row.operator("iris.save_look", icon="ADD")
    row.operator("iris.look_pictures", icon="RENDERLAYERS")
    job_box(layout, "looks", context)


def _look_cell(grid: bpy.types.UILayout, scene: bpy.types.Scene, look: str) -> bpy.types.UILayout:
    column = grid.column(align=True)
    if shown := look_icon(scene, look):
        column.template_icon(shown, scale=4.0)
    return column


def scale_rows(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw what the lumens of all lamps were taken from, and the buttons that set them."""
    settings = context.scene.iris
    column = layout.column(align=True)
    row = column.row(align=True)
    if settings.lumens_per_unit:  # files of earlier versions do not say from what
        row.label(text=f"Scale: {settings.scale_anchor or 'lumens of a lamp'}", icon="LIGHT_DATA")
        row.operator("iris.forget_scale", text="", icon="X")
    else:
        row.label(text="Scale unknown: photos show ratios", icon="LIGHT_DATA")
    row = column.row(align=True)
    row.operator("iris.anchor")
    row.operator("iris.exif_scale")
    column.operator("iris.meter")
    job_box(layout, "meter", context)
