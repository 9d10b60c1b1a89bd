"""synth: a posed LDR capture with full ground truth out of a Blender scene, in FIPT's layout.

    scene.blend ─► scene.ply          what a scan would give
                 ─► train/, val/, cam/ photos: radiance · exposure through a response curve, 8 bits; poses
                 ─► relight/, insert/  jobs, with their references rendered under gt/
                 ─► gt/                radiance, Principled maps, emitters, response: for scoring only

Limits: perspective cameras of one focal length without lens shift; surfaces that are Principled, Diffuse, Glossy or
mixes of these, and clear panes (Transparent), through which the maps look; lamps that are meshes whose emission is
constant or a picture on their UV map. Light objects and the world contribute to the photos, but they are not in the
ground truth of emitters, and the relighting references switch them off; gt/meta_gt.json names the suns.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ...base.errors import BadInput
from ...base.progress import Progress
from ...model.capture import Mesh
from ...model.render_settings import RenderSettings
from ..camera import read_camera
from ..ply_writer import write_ply
from . import photos
from .lamp_switches import LIGHT_STATE, LampSwitches
from .references import write_references
from .renders import Studio, add_outputs, render_maps
from .scene import prepare, read_geometry
from .writer import CaptureWriter, Shot

LEVELS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Exposure levels; the brightest views get the lowest."""
TRUTH_RENDER = RenderSettings(samples=256, max_bounces=16)
STAGE_WEIGHTS = {"maps": 0.03, "views": 0.7, "references": 0.27}


@dataclass(frozen=True)
class SynthConfig:
    """What a synthetic capture is made of.

    Attributes:
        cameras: names of the camera objects to use, None for all, in the order of their names. Those whose name begins
            with "val" or whose custom property ``iris_split`` is "val" give the validation views.
        resolution: width and height in pixels.
        response: 'film', 'gamma', 'linear' or the path of a file
            (see :func:`~iris_addon.blender.synth.photos.read_response`).
        compact: leave out what no metric needs (constant exposure, radiance of training views, maps of validation
            views, BaseCol, Depth, Normal) and store pictures with lossy compression.
        render: of the radiance, before it becomes photos.
    """

    cameras: Sequence[str] | None = None
    resolution: tuple[int, int] = (320, 240)
    response: str | Path = "film"
    compact: bool = False
    render: RenderSettings = TRUTH_RENDER


def synth(scene_blend: Path, out: Path, config: SynthConfig | None = None, progress: Progress | None = None) -> None:
    """Render the capture folder ``out`` from ``scene_blend``.

    The folder appears once it is complete; until then work goes on in a hidden folder beside it.

    Raises:
        BadInput: ``out`` is not empty, or the scene is outside the limits above.
    """
    config, progress = config or SynthConfig(), progress or Progress(weights=STAGE_WEIGHTS)
    out = Path(out)
    if out.exists() and any(out.iterdir()):
        raise BadInput("is not empty", "choose another --out or remove the folder", out)
    curve = photos.read_response(config.response)
    scene = _open(Path(scene_blend), config.resolution)
    train, val = _shots(scene, config.cameras)
    prepare(scene)
    geometry = read_geometry(scene)
    switches = LampSwitches.of(scene, geometry.emitters)
    geometry = replace(geometry, materials=tuple(dict.fromkeys([*geometry.materials, *switches.unlit])))
    if not geometry.emitters and not any(thing.type == "LIGHT" and not thing.hide_render for thing in scene.objects):
        raise BadInput("neither a visible mesh nor a light object emits light", "light the scene", scene_blend)
    add_outputs(scene, geometry.materials)

    partial = out.with_name(f".{out.name}-partial")
    shutil.rmtree(partial, ignore_errors=True)
    writer = CaptureWriter(partial, config.compact, curve)
    studio = Studio(scene, config.render)
    with progress.stage("maps"):
        maps = []
        for k, shot in enumerate(train + val):
            with switches.in_state(shot.light_state):
                maps.append(render_maps(scene, shot.camera, shot.thing))
            progress.update((k + 1) / len(train + val))
    with progress.stage("views"):
        radiance = []
        for k, shot in enumerate(train + val):
            with switches.in_state(shot.light_state):
                radiance.append(studio.radiance(shot.camera))
            progress.update((k + 1) / len(train + val))

    mesh = geometry.mesh
    write_ply(partial / "scene.ply", Mesh(mesh.vertices.astype(np.float32), mesh.faces))  # what a scan gives
    writer.split("train", train, radiance[: len(train)], maps[: len(train)])
    writer.split("val", val, radiance[len(train) :], maps[len(train) :])
    scale = writer.photos(radiance, maps, len(train), LEVELS)
    writer.scene(geometry)
    writer.meta(Path(scene_blend).stem, train, val, scene, scale, config.render)
    if val:
        with progress.stage("references"):
            shots = train, val, switches
            write_references(partial, studio, geometry, *shots, lossy=config.compact, progress=progress)
    if out.exists():
        out.rmdir()
    partial.rename(out)


# ---- reading the scene ----------------------------------------------------------------------------------------------


def _open(path: Path, resolution: tuple[int, int]) -> bpy.types.Scene:
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.absolute()), use_scripts=False)
    except RuntimeError as error:
        raise BadInput(
            "cannot be opened by Blender", "give a .blend file of this or an earlier version", path
        ) from error
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = resolution
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0
    scene.render.film_transparent = scene.render.use_border = False
    return scene


def _shots(scene: bpy.types.Scene, names: Sequence[str] | None) -> tuple[list[Shot], list[Shot]]:
    """Training and validation views in the order of their names."""
    things = {thing.name: thing for thing in scene.objects if thing.type == "CAMERA"}
    missing = [name for name in names or () if name not in things]
    if missing:
        raise BadInput(
            f"no camera named {', '.join(missing)}", f"the scene has {', '.join(things) or 'none'}", bpy.data.filepath
        )
    chosen = [things[name] for name in sorted(names or things)]
    shots = [Shot(thing, read_camera(scene, thing), str(thing.get(LIGHT_STATE, ""))) for thing in chosen]
    train = [shot for shot in shots if not _is_validation(shot.thing)]
    if not train:
        raise BadInput(
            "no camera for training views", "add cameras whose names do not begin with 'val'", bpy.data.filepath
        )
    first = train[0].camera
    for shot in shots:
        c = shot.camera
        if not np.allclose([c.fx, c.fy, c.cx, c.cy], [first.fx, first.fx, c.width / 2, c.height / 2], rtol=1e-6):
            raise BadInput(
                f"camera '{shot.thing.name}' has another focal length or a lens shift",
                "give all cameras one focal length and no shift; the format stores a single angle",
                bpy.data.filepath,
            )
    return train, [shot for shot in shots if _is_validation(shot.thing)]


def _is_validation(thing: bpy.types.Object) -> bool:
    return thing.name.lower().startswith("val") or thing.get("iris_split") == "val"
