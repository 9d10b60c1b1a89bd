"""A result applied to the objects it was solved from, and undone exactly by :func:`restore`.

Each object gets another mesh and keeps everything else. Where its own polygons can carry the result, that mesh is a
copy of its own with UVs and materials added; where they cannot (modifiers, instances, an n-gon cut by the atlas) it
consists of the triangles that were solved, and the modifiers are switched off. The original mesh is never changed.
Objects refer to it by custom properties, so that it is saved with the file and found without the add-on.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...edits.scene_edit import SceneEdit
from ...model.capture import Mesh
from ...results.result import Result
from ..render.light_mixing import has_separated_lamps, stop_mixing
from ..scene_out.backdrop import add_backdrop, follow_world
from ..scene_out.build import MAKING_MESH, face_material_steps, mesh_steps, set_material_slots, used_slots
from ..scene_out.lights import RECOVERED_TURN, add_sun
from ..scene_out.materials import MAKING, UV_MAP, confidence_steps, discarded_on_failure, images_of
from ..scene_out.scene_state import forget_scene, keep_scene, require_object_mode, restore_scene, show_like_the_photos
from ..scene_out.world import make_world
from ..stepwise import Steps, finish, in_thread
from ..version import set_corner_normals
from .applied_states import forget_light_states, has_light_states, keep_light_states
from .camera_look import LOOK, keep_look, stop_matching
from .photo_cameras import restore_given_poses

ORIGINAL_MESH, ORIGINAL, SLOT, MADE = "iris_original_mesh", "iris_original", "iris_slot_", "iris_made"
APPLIED = "iris_applied"
SAME_UV = 1e-5
OWN_NORMAL_COSINE = 1 - 1e-6
"""Cosine between the normal by which a face was solved and its own from which on they are one: files round them."""
NUMBERED = re.compile(r"\.\d{3,}$")
"""What Blender appends to a name that is taken."""


@dataclass(frozen=True)
class FaceRun:
    """The faces [start, stop) of the solved mesh that came from one object.

    Attributes:
        object: its name.
        instance: whether the faces are those of an object that this one instances.
        to_capture: (4, 4) from the space of the object's mesh to that of the capture.
    """

    object: str
    start: int
    stop: int
    instance: bool
    to_capture: NDArray[np.float64]


def apply_to_objects(result: Result, runs: Sequence[FaceRun], scene: bpy.types.Scene, key: str) -> bool:
    """Apply ``result`` to the objects of ``runs``, and its outside light to the world of ``scene``.

    Args:
        key: identifies the result; applying the same key again changes nothing.

    Returns:
        Whether anything was changed.

    Raises:
        BadInput: the scene has changed since it was solved. Nothing was changed then.
    """
    return finish(apply_steps(result, runs, scene, key))


def apply_steps(result: Result, runs: Sequence[FaceRun], scene: bpy.types.Scene, key: str) -> Steps[bool]:
    """:func:`apply_to_objects` in steps, of which only the last one changes what is in the scene."""
    if is_applied(scene, runs, key) and has_light_states(scene) == bool(result.light_states):
        return False
    objects = [_find(run, scene) for run in runs]
    require_object_mode(objects)
    if runs and runs[-1].stop != len(result.mesh.faces):
        raise BadInput("the result has other faces than the objects of this scene", "undo the edit, or solve again")
    own_uv = _kept_uv_map(result, runs, objects)
    yield MAKING
    materials, slot_of_face = yield from face_material_steps(result, SceneEdit(), own_uv or UV_MAP)
    made: list[bpy.types.ID] = [*materials]
    with discarded_on_failure(made):
        yield from confidence_steps(materials[0], result.textures)
        pairs = sorted(zip(runs, objects, strict=True), key=lambda pair: pair[0].instance)
        meshes = []
        for run, thing in pairs:
            used, slots = used_slots(slot_of_face[run.start : run.stop])
            data, as_solved = yield from _mesh_steps(result, run, thing, slots, own_uv)
            made.append(data)
            meshes.append((data, as_solved))
            for index in used:
                data.materials.append(materials[index])
        for image in images_of(materials):  # unpacked images are black after undo and reload
            image.pack()
            yield "packing the textures"
        if [_find(run, scene) for run in runs] != objects:  # Blender went on between the steps
            raise BadInput("the objects were replaced while the result was applied", "press Apply again")
        require_object_mode(objects)
        restore(scene)
    images = images_of(materials)
    for block in (*made, *images):  # those of an earlier result, which had the names, are gone
        block.name = NUMBERED.sub("", block.name)
        block[MADE] = key
    keep_scene(scene)
    scene[APPLIED] = key
    with _restored_on_failure(scene, key):
        for (run, thing), (data, as_solved) in zip(pairs, meshes, strict=True):
            _use_mesh(run, thing, data, as_solved)
        _light_up(result, runs, scene, key, materials)
    return True


@contextmanager
def _restored_on_failure(scene: bpy.types.Scene, key: str) -> Iterator[None]:
    """Take a result that could be applied only in part off ``scene`` again, with what was made for it inside."""
    kinds = "objects", "collections", "meshes", "lights", "worlds", "materials", "images"
    before = {block for kind in kinds for block in getattr(bpy.data, kind)}
    try:
        yield
    except BaseException:
        for block in {block for kind in kinds for block in getattr(bpy.data, kind)} - before:
            block[MADE] = key
        restore(scene)
        raise


def _light_up(
    result: Result, runs: Sequence[FaceRun], scene: bpy.types.Scene, key: str, materials: Sequence[bpy.types.Material]
) -> None:
    """World, backdrop, sun and view settings of ``scene``."""
    before = {*bpy.data.materials, *bpy.data.images}
    to_blender = np.array(scene.objects[runs[0].object].matrix_world) @ np.linalg.inv(runs[0].to_capture)
    scene.world = make_world(result.outside, 1.0, to_blender[:3, :3] / np.cbrt(np.linalg.det(to_blender[:3, :3])))
    if result.backdrop is not None:
        shell = add_backdrop(result.backdrop, 1.0, scene.collection)
        shell.matrix_world = Matrix(to_blender.tolist()) @ Matrix.Translation(shell.location)
        shell[MADE] = shell.data[MADE] = True
        follow_world(shell, scene.world)
    sun = add_sun(result.sun, scene.collection)
    if sun is not None:
        sun.matrix_world = Matrix(to_blender.tolist()).to_quaternion().to_matrix().to_4x4() @ sun.matrix_world
        sun[RECOVERED_TURN] = [float(value) for value in sun.matrix_world.to_quaternion()]
        sun[MADE] = sun.data[MADE] = True
    show_like_the_photos(result, scene)
    keep_look(scene, result.response, result.exposures, result.devices)
    rotation = np.array(Matrix(to_blender.tolist()).to_quaternion().to_matrix())
    skies = keep_light_states(scene, result, rotation, materials[0])
    made = {*bpy.data.materials, *bpy.data.images} - before
    for image in made.intersection(bpy.data.images):
        image.pack()
    for block in (*made, scene.world, *skies):
        block[MADE] = key


def is_applied(scene: bpy.types.Scene, runs: Sequence[FaceRun], key: str) -> bool:
    """Whether the result ``key`` is applied to the objects of ``runs`` already."""
    if scene.get(APPLIED) != key:
        return False
    objects = [scene.objects.get(run.object) for run in runs]
    return all(thing is not None and ORIGINAL in thing for thing in objects)


def restore(scene: bpy.types.Scene) -> int:
    """Restore the objects of ``scene`` and remove what was made for them; returns the number of objects.

    Raises:
        BadInput: one of them is being edited. Nothing was changed then.
    """
    require_object_mode(thing for thing in scene.objects if ORIGINAL in thing or has_separated_lamps(thing))
    stop_matching(scene)
    stop_mixing(scene)
    kept = [thing for thing in scene.objects if ORIGINAL in thing]
    for thing in kept:
        _restore_object(thing)
    restore_given_poses(scene)
    if APPLIED in scene:
        restore_scene(scene)
        forget_scene(scene)
        for name in (APPLIED, LOOK):
            scene.pop(name, None)
        forget_light_states(scene)
    _remove_made(scene)
    return len(kept)


# ---- one object ----------------------------------------------------------------------------------------------------


def _find(run: FaceRun, scene: bpy.types.Scene) -> bpy.types.Object:
    thing = scene.objects.get(run.object)
    if thing is None:
        raise BadInput(f"the object '{run.object}' is gone or renamed", "undo that, or solve again")
    if not thing.is_editable:
        raise BadInput(
            f"the object '{run.object}' is linked from another file", "make it local: Object > Relations > Make Local"
        )
    return thing


def _original_mesh(thing: bpy.types.Object) -> bpy.types.Mesh:
    """The mesh of ``thing`` without a result."""
    return thing.get(ORIGINAL_MESH, thing.data)


def _has_modifiers(thing: bpy.types.Object) -> bool:
    """Whether ``thing`` has modifiers that are on without a result."""
    kept = json.loads(thing[ORIGINAL])["modifiers"] if ORIGINAL in thing else {}
    return any(any(kept.get(m.name, (m.show_viewport, m.show_render))) for m in thing.modifiers)


def _mesh_steps(
    result: Result, run: FaceRun, thing: bpy.types.Object, slots: NDArray[np.integer], own_uv: str | None
) -> Steps[tuple[bpy.types.Mesh, bool]]:
    """The mesh that gives ``thing`` its share of ``result``, with ``slots`` (n,) and still without materials, and
    whether it has the triangles that were solved in place of polygons."""
    assert result.mesh.uv is not None
    uv = result.mesh.uv[run.start : run.stop]
    if np.linalg.det(run.to_capture[:3, :3]) < 0:  # the winding of a mirrored object was reversed
        uv = uv[:, ::-1]
    data = None if run.instance or thing.type != "MESH" else _textured_copy(thing, uv, slots, own_uv)
    if data is not None:
        with discarded_on_failure([data]):
            yield MAKING_MESH
            _shade_as_solved(data, result.mesh, run)
            yield MAKING_MESH
        return data, False
    yield MAKING_MESH
    local = yield from in_thread(lambda: _local_mesh(result.mesh, run), MAKING_MESH)
    data = yield from mesh_steps(local, f"{thing.name} IRIS")
    set_material_slots(data, slots)
    return data, True


def _shade_as_solved(data: bpy.types.Mesh, mesh: Mesh, run: FaceRun) -> None:
    """Shade faces of a scan by the surface behind its noise, as they were solved; others as the artist has them."""
    if mesh.normals is None:
        return
    corners, solved = mesh.vertices[mesh.faces[run.start : run.stop]], mesh.normals[run.start : run.stop]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    along = np.einsum("nk,nk->n", flat, solved)
    scanned = np.flatnonzero((along < OWN_NORMAL_COSINE * np.linalg.norm(flat, axis=1)) & solved.any(1))
    if not len(scanned):
        return
    shown = np.empty(3 * len(data.loops), np.float32)
    data.corner_normals.foreach_get("vector", shown)
    shown = shown.reshape(-1, 3)
    shown[triangles_of(data)[1][scanned]] = _local_normals(solved[scanned], run)[:, None]
    set_corner_normals(data, shown)


def _use_mesh(run: FaceRun, thing: bpy.types.Object, data: bpy.types.Mesh, as_solved: bool) -> None:
    """Give ``thing`` the mesh ``data`` of :func:`_mesh_steps`."""
    if run.instance or thing.type != "MESH":
        _stand_in(thing, data, run)
        return
    _keep_object(thing)
    thing.data = data
    for slot in thing.material_slots:
        slot.link = "DATA"
    if as_solved:
        for modifier in thing.modifiers:
            modifier.show_viewport = modifier.show_render = False


def _textured_copy(
    thing: bpy.types.Object, uv: NDArray[np.float32], slots: NDArray[np.integer], own_uv: str | None
) -> bpy.types.Mesh | None:
    """A copy of the object's mesh with UVs (F, 3, 2) and slots (F,) per triangle.

    Returns:
        None where its polygons cannot hold them.
    """
    if _has_modifiers(thing):
        return None
    data = _original_mesh(thing)
    polygon, loops = triangles_of(data)
    if len(polygon) != len(slots):
        return None
    slot_of_polygon = np.zeros(len(data.polygons), np.int32)
    slot_of_polygon[polygon] = slots
    per_loop = np.zeros((len(data.loops), 2), np.float32)
    per_loop[loops] = uv
    if (slot_of_polygon[polygon] != slots).any() or np.abs(per_loop[loops] - uv).max(initial=0) > SAME_UV:
        return None
    copy = data.copy()
    copy.name = f"{thing.name} IRIS"
    copy.materials.clear()
    set_material_slots(copy, slot_of_polygon)
    if own_uv is None:
        layer = copy.uv_layers.get(UV_MAP) or copy.uv_layers.new(name=UV_MAP, do_init=False)
        if layer is None:  # Blender allows eight UV maps
            bpy.data.meshes.remove(copy)
            return None
        layer.uv.foreach_set("vector", per_loop.ravel())
    return copy


def triangles_of(data: bpy.types.Mesh) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Polygon (F,) and loops (F, 3) of the triangles into which Blender divides ``data``."""
    if len(data.loops) == 3 * len(data.polygons):  # a polygon has three corners at least, so these are triangles
        return np.arange(len(data.polygons), dtype=np.int32), np.arange(len(data.loops), dtype=np.int32).reshape(-1, 3)
    n = len(data.loop_triangles)
    polygon, loops = np.empty(n, np.int32), np.empty(3 * n, np.int32)
    data.loop_triangles.foreach_get("polygon_index", polygon)
    data.loop_triangles.foreach_get("loops", loops)
    return polygon, loops.reshape(n, 3)


def _local_mesh(mesh: Mesh, run: FaceRun) -> Mesh:
    """The faces of ``run`` in the space of its object, with the vertices they use."""
    faces = mesh.faces[run.start : run.stop]
    used, corners = np.unique(faces, return_inverse=True)
    to_object = np.linalg.inv(run.to_capture)
    points = mesh.vertices[used] @ to_object[:3, :3].T + to_object[:3, 3]
    corners = corners.reshape(-1, 3)
    uv = None if mesh.uv is None else mesh.uv[run.start : run.stop]
    if np.linalg.det(to_object[:3, :3]) < 0:
        corners, uv = corners[:, ::-1], None if uv is None else uv[:, ::-1]
    normals = None if mesh.normals is None else _local_normals(mesh.normals[run.start : run.stop], run)
    return Mesh(points, corners, uv, normals=normals)


def _local_normals(normals: NDArray[np.floating], run: FaceRun) -> NDArray[np.float32]:
    """Unit ``normals`` (n, 3) of the capture in the space of the object of ``run``."""
    local = normals @ run.to_capture[:3, :3]  # the transposed matrix, as for planes
    return (local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def _stand_in(thing: bpy.types.Object, data: bpy.types.Mesh, run: FaceRun) -> None:
    """Replace an instance or a curve by a mesh object; the original is hidden."""
    stand_in = bpy.data.objects.new(f"{thing.name} IRIS", data)
    stand_in.matrix_world = Matrix(run.to_capture.tolist())
    stand_in[MADE] = True
    for collection in thing.users_collection:
        collection.objects.link(stand_in)
    if ORIGINAL not in thing:  # unset, unless the object has both a mesh and instances
        _keep_object(thing)
        thing.hide_render = thing.hide_viewport = True


def _keep_object(thing: bpy.types.Object) -> None:
    """Store on ``thing`` what :func:`_restore_object` needs."""
    slots = thing.material_slots
    thing[ORIGINAL] = json.dumps(
        {
            "links": [slot.link for slot in slots],
            "modifiers": {m.name: [m.show_viewport, m.show_render] for m in thing.modifiers},
            "hidden": [thing.hide_viewport, thing.hide_render],
            "active_slot": thing.active_material_index,
        }
    )
    if thing.type != "MESH":
        return
    thing[ORIGINAL_MESH] = thing.data
    for index, slot in enumerate(slots):
        if slot.link == "OBJECT" and slot.material is not None:
            thing[f"{SLOT}{index}"] = slot.material


def _restore_object(thing: bpy.types.Object) -> None:
    kept: dict[str, Any] = json.loads(thing[ORIGINAL])
    mesh = thing.get(ORIGINAL_MESH)
    if mesh is not None:
        thing.data = mesh
    for index, (slot, link) in enumerate(zip(thing.material_slots, kept["links"], strict=False)):
        slot.link = link
        if link == "OBJECT":
            slot.material = thing.get(f"{SLOT}{index}")
    for name, (viewport, render) in kept["modifiers"].items():
        modifier = thing.modifiers.get(name)
        if modifier is not None:
            modifier.show_viewport, modifier.show_render = viewport, render
    thing.hide_viewport, thing.hide_render = kept["hidden"]
    thing.active_material_index = kept["active_slot"]
    for name in (ORIGINAL, ORIGINAL_MESH, *(f"{SLOT}{index}" for index in range(len(kept["links"])))):
        if name in thing:
            del thing[name]


def _remove_made(scene: bpy.types.Scene) -> None:
    """Remove the stand-ins of ``scene``, and data that :func:`apply_to_objects` made and nothing uses any more."""
    bpy.data.batch_remove([thing for thing in scene.objects if MADE in thing])
    bpy.data.batch_remove([group for group in scene.collection.children if MADE in group and not group.all_objects])
    for kind in ("meshes", "lights", "cameras", "worlds", "materials", "images", "texts"):  # users before what they use
        made = [block for block in getattr(bpy.data, kind) if MADE in block]
        if kind == "materials":  # the list of lamps, which a scene has, does not use its material for anything
            users = bpy.data.user_map(subset=made)
            unused = [
                block
                for block in made
                if not block.use_fake_user and all(user.id_type == "SCENE" for user in users[block])
            ]
        else:
            unused = [block for block in made if not block.users]
        bpy.data.batch_remove(unused)


# ---- materials -----------------------------------------------------------------------------------------------------


def _kept_uv_map(result: Result, runs: Sequence[FaceRun], objects: Sequence[bpy.types.Object]) -> str | None:
    """Name of the objects' own UV map if the result uses it; None where the solver made an atlas."""
    names = set()
    for run, thing in zip(runs, objects, strict=True):
        if run.instance or thing.type != "MESH":
            return None
        data = _original_mesh(thing)
        layer = next((layer for layer in data.uv_layers if layer.active_render), None)
        _, loops = triangles_of(data)
        assert result.mesh.uv is not None
        if layer is None or len(loops) != run.stop - run.start:
            return None
        flat = np.empty(2 * len(data.loops), np.float32)
        layer.uv.foreach_get("vector", flat)
        difference = flat.reshape(-1, 2)[loops] - result.mesh.uv[run.start : run.stop]
        if np.abs(difference).max(initial=0) > SAME_UV:
            return None
        names.add(layer.name)
    return names.pop() if len(names) == 1 else None
