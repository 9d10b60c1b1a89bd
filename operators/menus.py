"""Menus: File > Import and Export, and Object > IRIS, which is also what makes the search (F3) find the operators."""

from __future__ import annotations

from typing import Any

import bpy

from ..iris_addon.blender.apply.looks import LOOKS

Entry = tuple[str, dict[str, Any], str]
"""Operator, its properties, and the text in the menu; empty for its own name."""
ENTRIES: tuple[tuple[Entry, ...], ...] = (
    (
        ("iris.import_capture", {}, ""),
        ("iris.use_scene", {}, ""),
        ("iris.import_demo", {}, "Import Demo Room"),
        ("iris.open_demo", {}, ""),
        ("iris.check", {}, "Check Capture Again"),
        ("iris.solve", {}, "Solve Capture"),
    ),
    (
        ("iris.apply", {}, "Apply Result"),
        ("iris.restore", {}, ""),
        ("iris.confidence", {"on": True}, "Show Confidence"),
        ("iris.confidence", {"on": False}, "Hide Confidence"),
        ("iris.next_photos", {}, ""),
    ),
    (
        ("iris.preview", {}, "Preview Relit Room"),
        *(("iris.look", {"look": key}, f"Look: {look.label}") for key, look in LOOKS.items()),
        ("iris.save_look", {}, ""),
        ("iris.look_pictures", {}, ""),
        ("iris.solo", {}, "Solo Lamp"),
        ("iris.anchor", {}, "Set Lumens of Lamp"),
        ("iris.meter", {}, ""),
        ("iris.exif_scale", {}, "Set Scale by EXIF"),
        ("iris.area_lamp", {"kind": "AREA"}, "Replace Lamp by Area Light"),
        ("iris.area_lamp", {"kind": "POINT"}, "Replace Lamp by Bulb"),
        ("iris.area_lamp", {"kind": "IES"}, "Replace Lamp by IES Light"),
        ("iris.hide_lights", {}, ""),
        ("iris.match_photo", {"on": True}, "Match Photo"),
        ("iris.mix_lights", {"on": True}, "Mix Lights"),
    ),
    (
        ("iris.place", {}, "Place Object on Surface"),
        ("iris.onto_photo", {}, "Put Onto Photo"),
        ("iris.onto_plate", {}, "Put Onto Plate"),
        ("iris.probe", {}, ""),
    ),
)
EXPORTS = (
    ("BLEND", "IRIS Room (.blend)"),
    ("GLB", "IRIS Room (.glb)"),
    ("LIGHT", "IRIS Light Room (.glb)"),
    ("USD", "IRIS Room (.usdc)"),
    ("TEXTURES", "IRIS Textures"),
)


class IRIS_MT_object(bpy.types.Menu):  # noqa: N801 - Blender's naming
    """All that can be done with a captured room"""

    bl_idname = "IRIS_MT_object"
    bl_label = "IRIS"

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw the operators in the order of work."""
        for number, group in enumerate(ENTRIES):
            if number:
                self.layout.separator()
            for operator, properties, text in group:
                entry = self.layout.operator(operator, text=text) if text else self.layout.operator(operator)
                for name, value in properties.items():
                    setattr(entry, name, value)


def draw_import(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    """The entry of File > Import."""
    self.layout.operator("iris.import_capture", text="IRIS Capture (transforms.json, COLMAP, Metashape …)")


def draw_export(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    """The entries of File > Export."""
    for kind, text in EXPORTS:
        if kind != "USD" or bpy.app.build_options.usd:
            self.layout.operator("iris.export", text=text).format = kind
    self.layout.operator("iris.export_ies", text="IRIS Lamps (.ies)")
    self.layout.operator("iris.export_camera", text="IRIS Camera (.cube, OpenColorIO)")
    self.layout.operator("iris.export_farm", text="IRIS Farm Job")


def draw_object(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    """The entry of the 3D view's Object menu."""
    self.layout.separator()
    self.layout.menu(IRIS_MT_object.bl_idname)


PLACES = (
    ("TOPBAR_MT_file_import", draw_import),
    ("TOPBAR_MT_file_export", draw_export),
    ("VIEW3D_MT_object", draw_object),
)


def register() -> None:
    """Add the entries."""
    for menu, draw in PLACES:
        getattr(bpy.types, menu).append(draw)


def unregister() -> None:
    """Remove them."""
    for menu, draw in PLACES:
        getattr(bpy.types, menu).remove(draw)
