"""Export the solved room to a file."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.blender.apply.ies_files import IesLamp, write_ies_files
from ..iris_addon.blender.apply.lighten import Limits
from ..iris_addon.blender.apply.scene_files import apply, export_textures
from ..iris_addon.blender.images import read_image
from ..iris_addon.results.camera_luts import write_luts
from ..iris_addon.results.folder import load_result
from ..iris_addon.results.records import read_response
from .folders import folder
from .polls import NeedsApplied, NeedsResult
from .relight import lamp_flux
from .wait_cursor import wait_cursor

FORMATS = (
    ("BLEND", ".blend", "Room, lamps and world with textures packed"),
    ("GLB", ".glb", "glTF with KHR_materials_emissive_strength"),
    ("LIGHT", ".glb, Light", "glTF with fewer faces and smaller textures, for game engines and browsers"),
    ("USD", ".usdc", "USD with its textures beside it"),
    ("TEXTURES", "Textures", "Base color and emission as EXR; roughness, metallic and confidence as 16-bit PNG"),
)
SUFFIX = {"BLEND": ".blend", "GLB": ".glb", "LIGHT": ".glb", "USD": ".usdc", "TEXTURES": ""}


class IRIS_OT_export(NeedsResult, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Write the solved room to a file; this scene does not change"""

    bl_idname = "iris.export"
    bl_label = "Export"

    format: bpy.props.EnumProperty(name="Format", description="What is written", items=FORMATS)
    faces: bpy.props.IntProperty(
        name="Faces",
        description="Of a light .glb, at most. A scan of a million faces takes about 15 seconds",
        default=Limits.faces,
        min=1000,
        soft_max=1_000_000,
    )
    side: bpy.props.EnumProperty(
        name="Textures",
        description="Pixels along a side of the textures of a light .glb, at most",
        items=[(str(side), str(side), f"{side} by {side} pixels") for side in (1024, 2048, 4096, 8192)],
        default=str(Limits.side),
    )
    filepath: bpy.props.StringProperty(subtype="FILE_PATH")
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        name = {"TEXTURES": "room-textures", "LIGHT": "room-light.glb"}.get(self.format, f"room{SUFFIX[self.format]}")
        self.filepath = str(folder(context.scene) / name)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw the limits of a light file beside the file browser."""
        if self.format == "LIGHT":
            self.layout.use_property_split = True
            self.layout.prop(self, "faces")
            self.layout.prop(self, "side")

    def check(self, _context: bpy.types.Context) -> bool:
        """Complete the name while it is chosen, so that the browser asks before it replaces that file."""
        typed = self.filepath
        self.filepath = self._named()
        return self.filepath != typed

    def _named(self) -> str:
        """The path with the suffix of the format; unchanged if it names no file."""
        name = Path(self.filepath).name if self.filepath and not self.filepath.endswith(("/", os.sep)) else ""
        return bpy.path.ensure_ext(self.filepath, SUFFIX[self.format]) if name else self.filepath

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the file."""
        if not self.filepath:
            self.report({"ERROR"}, "no file is named — give a file path")
            return {"CANCELLED"}
        self.filepath = self._named()
        path, source = Path(bpy.path.abspath(self.filepath)), folder(context.scene)
        try:
            if self.format == "TEXTURES":
                export_textures(source, path)
            else:
                blend, usd = (path if self.format == kind else None for kind in ("BLEND", "USD"))
                glb = path if self.format in ("GLB", "LIGHT") else None
                light = Limits(self.faces, int(self.side)) if self.format == "LIGHT" else None
                with wait_cursor(context):
                    apply(load_result(source, read_image=read_image), blend, glb=glb, usd=usd, light=light)
        except IrisError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Wrote {path}")
        return {"FINISHED"}


class _IntoFolder:
    """Mixin of operators that write several files."""

    directory: bpy.props.StringProperty(subtype="DIR_PATH")
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    into = ""  # in the result's folder, what is offered

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Ask for a folder."""
        self.directory = str(folder(context.scene) / self.into)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the files."""
        if not self.directory:
            self.report({"ERROR"}, "no folder is named — give a folder")  # type: ignore[attr-defined]
            return {"CANCELLED"}
        try:
            said = self.write(context, Path(bpy.path.abspath(self.directory)))
        except IrisError as error:
            self.report({"ERROR"}, str(error))  # type: ignore[attr-defined]
            return {"CANCELLED"}
        self.report({"INFO"}, said)  # type: ignore[attr-defined]
        return {"FINISHED"}

    def write(self, context: bpy.types.Context, out: Path) -> str:
        """Write the files into ``out``; what is to be said of it."""
        raise NotImplementedError


class IRIS_OT_export_ies(_IntoFolder, NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Write each lamp that is on as a photometric file (.ies, LM-63), which renderers and lighting programs read: what
    it sends in every direction, in lumens once the scale is set"""

    bl_idname = "iris.export_ies"
    bl_label = "Export Lamps"

    def write(self, context: bpy.types.Context, out: Path) -> str:
        """Write a file for each lamp."""
        scene = context.scene
        lamps = [
            IesLamp(lamp.material, lamp_flux(lamp))
            for lamp in scene.iris.lamps
            if lamp.material is not None and lamp.on
        ]
        with wait_cursor(context):  # the first ray builds the search tree of the room
            written = write_ies_files(scene, lamps, out, scene.iris.lumens_per_unit)
        if not written:
            raise IrisError("no lamp shines", "switch one on")
        relative = "" if scene.iris.lumens_per_unit else ", lumens relative: set the scale under Relight first"
        return f"Wrote {len(written)} lamp{'s' if written[1:] else ''}{relative}"


class IRIS_OT_export_camera(_IntoFolder, NeedsResult, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Write the camera of the photos for other programs: its response as .cube tables, and an OpenColorIO configuration
    with the look of each photo as a view, by which linear renders and EXR layers look as the photos do"""

    bl_idname = "iris.export_camera"
    bl_label = "Camera (.cube, OpenColorIO)"

    into = "camera"

    def write(self, context: bpy.types.Context, out: Path) -> str:
        """Write the tables and the configuration."""
        camera = read_response(folder(context.scene))
        written = write_luts(out, camera.response, camera.exposures, camera.devices)
        return f"Wrote {len(written)} files to {out}"
