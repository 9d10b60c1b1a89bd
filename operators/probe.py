"""HDRI probe: all light that arrives at the 3D cursor, rendered by another Blender as a panorama."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from pathlib import Path

import bpy

from ..iris_addon.base.files import require_own_folder
from ..iris_addon.blender.insert.photo_composite import write_copy
from ..iris_addon.blender.insert.probe import load_probe
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import probe_command
from .editors import show_in_editor, view_shadings
from .folders import folder
from .polls import NeedsApplied
from .run_job import run_on_copy


class IRIS_OT_probe(NeedsApplied, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Render all light that arrives at the 3D cursor as an HDRI: an EXR panorama in the result's folder, a packed
    image, and the light of the Material Preview. Nothing may stand at the cursor. Another Blender renders it; 1024
    pixels take about a minute"""

    bl_idname = "iris.probe"
    bl_label = "HDRI Probe at Cursor"

    width: bpy.props.IntProperty(
        name="Width", description="Of the panorama, pixels; it is half as high", default=1024, min=64, max=16384
    )
    samples: bpy.props.IntProperty(name="Samples", description="Paths per pixel", default=64, min=2, soft_max=1024)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result is applied, and no probe is being rendered."""
        return super().poll(context) and jobs.running("probe", folder(context.scene)) is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write a copy of the scene and start the job."""
        scene, out = context.scene, folder(context.scene)
        copy, probes = out / "probe.blend", out / "probes"
        panorama = _free_name(probes)

        def prepare() -> list[str]:
            require_own_folder(probes)
            write_copy(scene, copy)
            at = tuple(scene.cursor.location)
            return probe_command(bpy.app.binary_path, copy, at, panorama, self.width // 2 * 2, self.samples)

        return run_on_copy(self, "probe", copy, prepare, lambda: _show(panorama))


def _free_name(folder: Path) -> Path:
    """The first name of a probe that is not taken: earlier ones light other places."""
    number = 1
    while (folder / f"probe-{number:02d}.exr").exists():
        number += 1
    return folder / f"probe-{number:02d}.exr"


def _show(panorama: Path) -> None:
    """Make the panorama an image and the light of Material Previews, and show it if an Image Editor is open."""
    image, light = load_probe(panorama)
    show_in_editor(bpy.context, "IMAGE_EDITOR", "image", image, only_open=True)
    for shading in view_shadings(bpy.context):
        shown = shading.type
        shading.type = "MATERIAL"  # a view has one studio light per kind of shading
        shading.studio_light = light
        shading.use_scene_world = shading.use_scene_lights = False
        shading.type = shown
