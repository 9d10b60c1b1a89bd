"""HDRI probes: all light that arrives at one point of a room, as an equirectangular picture of radiance.

The picture is as Blender's environment textures read it: +z on top, and +x of the scene in its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...edits.scene_edit import SceneEdit
from ...model.render_settings import RenderSettings
from ...results.result import Result
from ..apply.on_objects import APPLIED
from ..apply.scene_files import open_blend, write_whole
from ..camera import set_frame
from ..images import LINEAR, load_image
from ..render.cycles import render_exr, set_cycles
from ..scene_out.build import build_scene
from ..version import set_panoramic, single_layer_exr

CLIP_START = 1e-3
"""Metres: what is nearer is not seen."""


def probe_result(
    result: Result,
    at: Sequence[float],
    out: Path,
    *,
    width: int,
    settings: RenderSettings,
    edit: SceneEdit | None = None,
) -> None:
    """Write the probe of ``result`` at the point ``at`` of the capture as the EXR ``out``, ``width`` by half as many.

    The top of the picture is the ``up`` of the capture, as for the panoramas that light it.

    Raises:
        IrisError: ``out`` cannot be written.
    """
    built = build_scene(result, edit)
    try:
        upright = Vector((0.0, 0.0, 1.0)).rotation_difference(Vector(result.up)).to_matrix().to_4x4()
        owned = _look_around(built.scene, Matrix.Translation(Vector(at)) @ upright, width, settings)
        built.owned |= owned
        _save(built.scene, out)
    finally:
        built.free()


def probe_file(blend: Path, at: Sequence[float], out: Path, *, width: int, settings: RenderSettings) -> None:
    """Write the probe of the room in ``blend`` at the point ``at`` of its scene as the EXR ``out``. Opens ``blend``.

    Raises:
        BadInput: ``blend`` cannot be read.
        IrisError: ``out`` cannot be written.
    """
    open_blend(blend, "give a .blend with a solved room, or the folder of a result")
    scenes = [scene for scene in bpy.data.scenes if APPLIED in scene] or list(bpy.data.scenes)
    _look_around(scenes[0], Matrix.Translation(Vector(at)), width, settings)
    _save(scenes[0], out)


def load_probe(panorama: Path) -> tuple[bpy.types.Image, str]:
    """The probe as a packed image that is kept with the file, and the name of a studio light with it.

    Raises:
        BadInput: it cannot be read.
    """
    image = load_image(panorama, "render the probe again", colorspace=LINEAR)
    image.name = f"IRIS {panorama.stem}"
    image.pack()
    image.use_fake_user = True
    return image, bpy.context.preferences.studio_lights.load(str(panorama), "WORLD").name


def _look_around(scene: bpy.types.Scene, place: Matrix, width: int, settings: RenderSettings) -> set[bpy.types.ID]:
    """Make a panoramic camera at ``place`` the active one of ``scene``; returns what was made."""
    data = bpy.data.cameras.new("IRIS Probe")
    set_panoramic(data)
    data.clip_start, data.clip_end = CLIP_START, 1e4
    eye = bpy.data.objects.new("IRIS Probe", data)
    # A camera looks along its -Z with Y up; the middle of the picture is +X.
    eye.matrix_world = place @ Matrix.Rotation(-np.pi / 2, 4, "Z") @ Matrix.Rotation(np.pi / 2, 4, "X")
    scene.collection.objects.link(eye)
    scene.camera = eye
    render = scene.render
    render.resolution_percentage, render.use_border, render.film_transparent = 100, False, False
    set_frame(scene, width, width // 2, 1.0)
    set_cycles(scene, settings)
    return {eye, data}


def _save(scene: bpy.types.Scene, path: Path) -> None:
    settings = scene.render.image_settings
    single_layer_exr(settings)
    settings.color_mode, settings.exr_codec = "RGB", "ZIP"
    write_whole(path, lambda part: render_exr(scene, part))
