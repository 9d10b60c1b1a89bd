"""A solved room as a .blend, .glb or .usd of its own, or as a folder of textures.

The room, its lamps and the cameras of the photos are children of the empty "IRIS Room", which rotates the capture's up
axis to Blender's +Z; their own transforms stay those of the capture. The world is laid out in Blender's axes. In USD
files lamps are UsdLux lights: meshes that shine as their material glows.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from ...base.errors import BadInput, IrisError
from ...base.files import replace_when_free
from ...edits.scene_edit import SceneEdit
from ...model.capture import View
from ...model.render_settings import RenderSettings
from ...results.files import LAMP_PATTERN, MATERIAL_FILES, result_file
from ...results.records import median_exposure
from ...results.result import Result
from ..camera import add_camera, look_through
from ..images import srgb_image
from ..render.cycles import set_cycles
from ..scene_out.backdrop import add_backdrop, is_backdrop
from ..scene_out.build import add_room, datablocks
from ..scene_out.lamp_profile_nodes import profile_of
from ..scene_out.lights import add_sun, lamp_materials, reset, set_strength, strength
from ..scene_out.materials import remove_burley
from ..scene_out.scene_state import show_like_the_photos
from ..scene_out.world import make_world
from ..version import require_build_option, require_gltf, usd_library
from .camera_look import add_compositing
from .lighten import Limits, lighten
from .looks import keep_states


def apply(
    result: Result,
    blend: Path | None,
    *,
    views: Sequence[View] = (),
    glb: Path | None = None,
    usd: Path | None = None,
    light: Limits | None = None,
) -> None:
    """Write ``result`` as ``blend``, ``glb`` and ``usd``, each where given; the open scene does not change.

    Files appear whole or not at all. Textures are packed into the .blend, the radiance of lamps is their
    emission strength (KHR_materials_emissive_strength in glTF), and cameras of ``views`` are included. With ``light``
    the .glb has fewer faces and smaller pictures, as JPEG.

    Raises:
        IrisError: a file cannot be written, or this Blender lacks the exporter.
    """
    if usd is not None:
        require_build_option("usd", "USD export")
    if glb is not None:
        require_gltf()
    before = set(datablocks())
    scene = bpy.data.scenes.new("IRIS")
    try:
        anchor = apply_to_scene(result, scene, views, lamps_apart=True)
        lamps = [thing for thing in anchor.children_recursive if thing.name.startswith("IRIS Lamp")]
        add_compositing(scene, lamps, result.response, median_exposure(result.exposures))
        with _in_window(scene):
            if blend is not None:
                write_whole(blend, lambda path: bpy.data.libraries.write(str(path), {scene}, compress=True))
            if glb is not None or usd is not None:
                bpy.data.batch_remove([thing for thing in scene.objects if is_backdrop(thing)])
                _use_srgb_colors(scene)
                _leave_out_burley(scene)
            if usd is not None:
                with lamps_as_lights(), _even_lamps(scene):
                    write_whole(usd, lambda path: bpy.ops.wm.usd_export(filepath=str(path)))
            if glb is not None:
                form = "AUTO"
                if light is not None:
                    lighten(scene, light)
                    form = "JPEG"
                with _even_lamps(scene, but_for_patterns=True):
                    write_whole(
                        glb,
                        lambda path: bpy.ops.export_scene.gltf(
                            filepath=str(path), use_active_scene=True, export_image_format=form
                        ),
                    )
    finally:
        bpy.data.batch_remove(set(datablocks()) - before)


def apply_to_scene(
    result: Result, scene: bpy.types.Scene, views: Sequence[View] = (), *, lamps_apart: bool = False
) -> bpy.types.Object:
    """Add the room to ``scene`` in a collection "IRIS", with its world, its cameras and suitable settings.

    The view exposure is the median of the photos' in the Standard view transform: mid-tones of the photos are mid-tones
    in the viewport.

    Args:
        lamps_apart: every lamp becomes an object of its own, child of the room's mesh.

    Returns:
        The empty "IRIS Room", parent of everything that was added.
    """
    collection = bpy.data.collections.new("IRIS")
    scene.collection.children.link(collection)
    anchor = bpy.data.objects.new("IRIS Room", None)
    upright = Vector(result.up).rotation_difference(Vector((0.0, 0.0, 1.0))).to_matrix()
    anchor.matrix_world = upright.to_4x4()
    collection.objects.link(anchor)

    add_room(result, SceneEdit(), collection, lamps_apart=lamps_apart)[0].parent = anchor
    cameras = [add_camera(view.camera, f"IRIS {view.name}", collection) for view in views]
    for camera_object in cameras:
        camera_object.parent = anchor
    if cameras:
        look_through(scene, views[0].camera, cameras[0])
    scene.world = make_world(result.outside, 1.0, np.array(upright))
    if result.backdrop is not None:
        add_backdrop(result.backdrop, 1.0, collection).parent = anchor
    sun = add_sun(result.sun, collection)
    if sun is not None:
        sun.parent = anchor
    for image in bpy.data.images:
        if image.name.startswith("IRIS ") and image.source == "GENERATED":
            image.pack()
    set_cycles(scene, RenderSettings(samples=128))
    show_like_the_photos(result, scene)
    keep_states(scene, result)
    return anchor


def export_textures(result: Path, folder: Path) -> None:
    """Copy the texture set and the mesh of the result folder ``result`` to ``folder``.

    Raises:
        IrisError: there are no textures, or they cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        pattern = [LAMP_PATTERN] if result_file(result, LAMP_PATTERN).is_file() else []
        for name in (*MATERIAL_FILES, *pattern):
            source = result_file(result, name)
            shutil.copy2(source, folder / source.name)
    except (OSError, shutil.Error) as error:
        what = f"the textures cannot be copied ({getattr(error, 'strerror', None) or error})"
        raise IrisError(what, "free disk space or choose another place", folder) from error


def _use_srgb_colors(scene: bpy.types.Scene) -> None:
    # Exporters write the pixels of a linear float image as if they were sRGB codes.
    materials = {slot.material for thing in scene.objects for slot in thing.material_slots}
    copies: dict[bpy.types.Image, tuple[bpy.types.Image, float]] = {}
    for material in materials:
        for node in material.node_tree.nodes:
            if node.bl_idname == "ShaderNodeTexImage" and node.image.is_float:
                if node.image not in copies:
                    copies[node.image] = srgb_image(node.image)
                node.image, peak = copies[node.image]
                if peak > 1:  # the pattern of a lamp
                    set_strength(material, peak * strength(material))


@contextmanager
def _even_lamps(scene: bpy.types.Scene, but_for_patterns: bool = False) -> Iterator[None]:
    """Inside, lamps are evenly bright: the exporter of USD would keep the picture on a lamp, and drop the color and the
    strength that multiply it. No exporter knows profiles."""
    left_out = []
    for material in lamp_materials(scene.objects):
        if but_for_patterns and profile_of(material) is None:
            continue
        shader = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
        for link in list(shader.inputs["Emission Color"].links):
            left_out.append((material, link.from_socket, shader.inputs["Emission Color"], strength(material)))
            material.node_tree.links.remove(link)
            reset(material)
    try:
        yield
    finally:
        for material, pattern, socket, level in left_out:
            material.node_tree.links.new(pattern, socket)
            set_strength(material, level)


def _leave_out_burley(scene: bpy.types.Scene) -> None:
    # Exporters expect the texture directly behind the base colour, and their formats have only Lambert's lobe.
    materials = {slot.material for thing in scene.objects for slot in thing.material_slots}
    for material in materials:
        remove_burley(material.node_tree)


@contextmanager
def _in_window(scene: bpy.types.Scene) -> Iterator[None]:
    # Exporters use the scene of the window, and that of glTF leaves it set although the scene is removed afterwards.
    # Blender 5.2 crashes when it writes a scene that no window has shown.
    window = bpy.context.window
    before, window.scene = window.scene, scene
    try:
        yield
    finally:
        window.scene = before


# ---- USD -----------------------------------------------------------------------------------------------------------


@contextmanager
def lamps_as_lights() -> Iterator[None]:
    """Inside, USD files get lamps as lights; without USD's Python modules lamps stay emissive meshes."""
    library = usd_library()
    if library is None:
        yield
        return
    hook = _hook(library)
    bpy.utils.register_class(hook)
    try:
        yield
    finally:
        bpy.utils.unregister_class(hook)


def _hook(library: ModuleType) -> type:
    """The class that Blender calls; made on demand because a build without USD lacks its base class."""

    class LampsAsLights(bpy.types.USDHook):
        """Applies MeshLightAPI to lamps, so that renderers sample them as lights."""

        bl_idname = "iris_lamps_as_lights"
        bl_label = "IRIS lamps as lights"

        @staticmethod
        def on_export(context: Any) -> bool:
            """Called by Blender with the stage before it is saved."""
            for prim in context.get_stage().Traverse():
                if prim.IsA(library.UsdGeom.Mesh) and prim.GetParent().GetName().startswith("IRIS_Lamp"):
                    library.UsdLux.MeshLightAPI.Apply(prim)
                    light = library.UsdLux.LightAPI(prim)
                    # The radiance that the material emits, neither tinted nor scaled by the area.
                    light.CreateMaterialSyncModeAttr(library.UsdLux.Tokens.materialGlowTintsLight)
                    light.CreateIntensityAttr(1.0)
                    light.CreateNormalizeAttr(False)
            return True

    return LampsAsLights


# ---- files in and out ----------------------------------------------------------------------------------------------


def open_blend(blend: Path, fix: str) -> None:
    """Open ``blend`` without its scripts; raises BadInput with ``fix`` if it cannot be opened."""
    try:
        bpy.ops.wm.open_mainfile(filepath=str(blend.absolute()), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise BadInput("cannot be opened", fix, blend) from error


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file, and textures beside it, in a temporary folder, then move all to ``path``.

    For files that Blender writes itself: they appear whole or not at all.

    Raises:
        IrisError: it cannot be written.
    """
    path = Path(path).absolute()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".iris-", dir=path.parent) as folder:
            write(Path(folder) / path.name)
            made = sorted(file for file in Path(folder).rglob("*") if file.is_file())
            for file in sorted(made, key=lambda file: file.name == path.name):  # the file itself last
                target = path.parent / file.relative_to(folder)
                target.parent.mkdir(exist_ok=True)
                replace_when_free(file, target)
    except (RuntimeError, OSError) as error:
        what = f"cannot be written ({str(error).strip()})"
        raise IrisError(what, "free disk space or choose another place", path) from error
