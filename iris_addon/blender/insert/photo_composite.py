"""The artist's additions to a solved room, composited onto the photo of the active camera.

The artist's own scene is rendered, so that everything Blender renders can be inserted: modifiers, hair, glass, other
lights, dimmed lamps. The room as it was photographed is the same scene without these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.color_spaces import ColorSpace
from ...base.errors import BadInput
from ...model.device import Device
from ...model.render_settings import RenderSettings
from ...model.response import Response
from ..apply.applied_states import in_light_state
from ..apply.on_objects import APPLIED, MADE, ORIGINAL
from ..apply.scene_files import open_blend, write_whole
from ..images import LINEAR, image_from_array, read_image
from ..render.light_mixing import APART
from ..scene_out.lights import as_recovered, lamp_materials
from ..scene_out.world import is_gray, set_gray, sky_strength
from ..version import single_layer_exr
from .differential import ChangedPhoto, Differential, change_photo, render_differential, render_halves, write_layers

RENDERED = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "LIGHT")
"""Types of objects that one sees in a render."""
RENDERS = 2
"""Steps of the work: the room alone, and the room with the additions."""


def composite(
    scene: bpy.types.Scene,
    photo: NDArray[np.floating],
    response: Response,
    exposure: NDArray[np.floating],
    settings: RenderSettings,
    light_state: str | None = None,
    on_step: Callable[[int], None] = lambda done: None,
) -> ChangedPhoto:
    """``photo`` with the objects added to the room and the changes of its lamps.

    Changes the render settings of ``scene``: pass a copy. Its active camera must be that of the photo.

    Args:
        photo: (H, W, 3) display values in [0, 1].
        exposure: factor from radiance to the argument of the response, broadcastable to the photo.
        light_state: of the photo, in a room that was photographed in several.
        on_step: called with the number of finished RENDERS; may raise to stop.

    Raises:
        BadInput: as :func:`additions`.
    """
    changed = additions(scene, photo.shape, settings, light_state, on_step)
    return change_photo(photo, changed, response, exposure)


def additions(
    scene: bpy.types.Scene,
    shape: tuple[int, ...],
    settings: RenderSettings,
    light_state: str | None = None,
    on_step: Callable[[int], None] = lambda done: None,
) -> Differential:
    """What the objects added to the room and the changes of its lamps do to a picture of ``shape`` (H, W, 3).

    Changes the render settings of ``scene``, whose active camera is that of the picture.

    Args:
        light_state: of the picture, in a room that was photographed in several: the lights of the room shine as they
            did then, but for those that were changed.

    Raises:
        BadInput: no result is applied to the objects of ``scene``, or none of that light state, or it has no camera.
    """
    if APPLIED not in scene:
        raise BadInput("no result is applied to the scene", "apply one first")
    if scene.camera is None:
        raise BadInput("the scene has no active camera", "look at the photo first")
    render = scene.render
    render.resolution_y, render.resolution_x = shape[:2]
    render.resolution_percentage, render.use_border = 100, False
    with in_light_state(scene, light_state, everything=True), as_photographed(scene):
        without = render_halves(scene, settings)
    on_step(1)
    room = [thing for thing in scene.objects if _belongs_to_room(thing)]
    with in_light_state(scene, light_state):
        changed = render_differential(scene, room, without, settings)
    on_step(2)
    return changed


@contextmanager
def as_photographed(scene: bpy.types.Scene) -> Iterator[None]:
    """Inside, the room alone renders, with its lamps and the light from outside as they were recovered."""
    added = [thing for thing in scene.objects if not _belongs_to_room(thing) and not thing.hide_render]
    recovered = scene.world is not None and MADE in scene.world
    sky = sky_strength(scene.world) if recovered else None  # the artist may use another world
    strength, gray = 1.0 if sky is None else sky.default_value, is_gray(scene.world)
    try:
        for thing in added:
            thing.hide_render = True
        if sky is not None:
            sky.default_value = 1.0
            set_gray(scene.world, False)
        with as_recovered(lamp_materials(scene.objects), scene.objects):
            yield
    finally:
        for thing in added:
            thing.hide_render = False
        if sky is not None:
            sky.default_value = strength
            set_gray(scene.world, gray)


def has_additions(scene: bpy.types.Scene) -> bool:
    """Whether anything that renders or shines was added to the room of ``scene``."""
    return any(
        (thing.type in RENDERED or thing.instance_type != "NONE")
        and not thing.hide_render
        and not _belongs_to_room(thing)
        for thing in scene.objects
    )


def _belongs_to_room(thing: bpy.types.Object) -> bool:
    return ORIGINAL in thing or MADE in thing or APART in thing


# ---- as a job ------------------------------------------------------------------------------------------------------


def write_copy(scene: bpy.types.Scene, path: Path) -> None:
    """Write ``scene`` as a .blend for the command ``composite``; raises IrisError if that fails."""
    write_whole(path, lambda part: bpy.data.libraries.write(str(part), {scene}, path_remap="ABSOLUTE", compress=True))


def write_room_copy(scene: bpy.types.Scene, path: Path) -> None:
    """Write the room of ``scene`` by its recovered light, without what was added to it; raises IrisError."""
    with as_photographed(scene):
        write_copy(scene, path)


@dataclass(frozen=True)
class CompositeFiles:
    """What a composite is read from and written to.

    Attributes:
        blend: the artist's scene.
        photo: undistorted, as the camera saw it.
        out: the PNG.
        layers: the EXR of layers (:func:`~.differential.write_layers`); None for none.
        space: of these; None for Rec.709.
    """

    blend: Path
    photo: Path
    out: Path
    layers: Path | None = None
    space: ColorSpace | None = None


def composite_file(
    files: CompositeFiles,
    device: Device,
    exposure: NDArray[np.floating],
    settings: RenderSettings,
    light_state: str | None = None,
    on_step: Callable[[int], None] = lambda done: None,
) -> None:
    """:func:`composite` of ``files``; opens their scene.

    Args:
        device: the camera that took the photo.
        exposure: (3,) of the photo.
        light_state: of the photo, as for :func:`composite`.

    Raises:
        BadInput: a file cannot be read, or for the reasons of :func:`composite`.
        IrisError: a picture cannot be written.
    """
    scene = open_scene(files.blend)
    pixels = read_image(files.photo)
    exposure = exposure * device.gain(pixels)
    photo = composite(scene, pixels, device.response, exposure, settings, light_state, on_step)
    if files.layers is not None:
        write_layers(files.layers, photo, files.space)
    write_photo(files.out, photo, scene)


def open_scene(blend: Path) -> bpy.types.Scene:
    """Open ``blend``; its scene with a solved room. Raises BadInput if there is none."""
    open_blend(blend, "give a .blend with a solved room")
    scenes = [scene for scene in bpy.data.scenes if APPLIED in scene]
    if not scenes:
        raise BadInput("has no scene with a result on its objects", "apply a result and save", blend)
    return scenes[0]


def write_photo(path: Path, photo: ChangedPhoto, scene: bpy.types.Scene) -> None:
    """Write ``photo`` as a PNG, or as an EXR where it holds radiance; that changes the output settings of ``scene``."""
    if photo.display is None:
        write_radiance(path, photo.radiance, scene)
    else:
        write_png(path, photo.display)


def write_radiance(path: Path, radiance: NDArray[np.floating], scene: bpy.types.Scene) -> None:
    """Write (H, W, 3) linear radiance as a 32-bit EXR; changes the output settings of ``scene``."""
    image = image_from_array(path.stem, radiance, colorspace=LINEAR, float_buffer=True)
    single_layer_exr(scene.render.image_settings)
    scene.render.image_settings.color_mode = "RGB"
    try:
        write_whole(path, lambda part: image.save_render(str(part), scene=scene))
    finally:
        bpy.data.images.remove(image)


def write_png(path: Path, display: NDArray[np.floating]) -> None:
    """Write (H, W, 3) display values as an 8-bit PNG; raises IrisError if that fails."""
    image = image_from_array(path.stem, display)
    image.file_format = "PNG"
    try:
        write_whole(path, lambda part: image.save(filepath=str(part)))
    finally:
        bpy.data.images.remove(image)
