"""A solved room as a Blender scene: mesh, materials, lamps, world, and what an edit adds.

Everything is made from the arrays of a :class:`~iris_addon.results.result.Result`, in a scene of its
own, so that the user's scene does not change; :meth:`BuiltScene.free` removes all of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...edits.scene_edit import SceneEdit, Sphere, lamp_name
from ...model.capture import Mesh
from ...results.result import Result
from ..images import LINEAR, image_from_array
from ..stepwise import Steps, finish, in_thread
from ..version import set_corner_normals
from .backdrop import add_backdrop
from .lights import add_light, add_sun
from .materials import (
    LAMP_ID,
    MAKING,
    PATTERN,
    RECOVERED,
    UV_MAP,
    black_material,
    discarded_on_failure,
    lamp_material,
    pane_material,
    sphere_material,
    surface_steps,
)
from .placing import Room, add_object
from .world import make_world


@dataclass
class BuiltScene:
    """What :func:`build_scene` made.

    Attributes:
        room: the room's mesh, faces in the order of the result; without the lamps if those were kept apart.
        lamps: the recovered lamps as objects of their own, in the order of the result; empty if they are in ``room``.
        backdrop: the shell that shows through holes of the mesh; None where the result has none.
        sun: the recovered sun, as the edit changed it; None where none shines.
        lights: lights added by the edit.
        inserted: balls and objects added by the edit.
        owned: every datablock made for the scene.
    """

    scene: bpy.types.Scene
    room: bpy.types.Object
    lamps: list[bpy.types.Object]
    backdrop: bpy.types.Object | None
    sun: bpy.types.Object | None
    lights: list[bpy.types.Object]
    inserted: list[bpy.types.Object]
    owned: set[bpy.types.ID]

    def free(self) -> None:
        """Remove the scene and every datablock that was made for it."""
        # Data that the renderer keeps between renders would outlive its scene, and Blender follows its pointers when
        # the next scene is built: sometimes into memory that has been freed.
        self.scene.render.use_persistent_data = False
        bpy.data.batch_remove(self.owned)
        self.owned.clear()


def build_scene(result: Result, edit: SceneEdit | None = None, *, lamps_apart: bool = False) -> BuiltScene:
    """A new scene with the room of ``result`` as changed by ``edit``, in the capture's axes and metres.

    Args:
        result: ``mesh.uv`` must be set.
        edit: None leaves the room as recovered.
        lamps_apart: every recovered lamp is an object of its own.
    """
    edit = edit or SceneEdit()
    before = set(datablocks())
    try:
        scene = bpy.data.scenes.new("IRIS")
        room, *lamps = add_room(result, edit, scene.collection, lamps_apart=lamps_apart)
        scene.world = make_world(result.outside, edit.outside_scale, np.eye(3), edit.panoramas, result.up)
        backdrop = None
        if result.backdrop is not None:
            backdrop = add_backdrop(result.backdrop, edit.outside_scale, scene.collection)
        sun = add_sun(result.sun, scene.collection, edit.sun)
        lights = [add_light(light, f"IRIS Light {k:02d}", scene.collection) for k, light in enumerate(edit.lights)]
        inserted = [add_sphere(ball, f"IRIS Ball {k:02d}", scene.collection) for k, ball in enumerate(edit.spheres)]
        ground = Room(result.mesh, result.up)
        for number, thing in enumerate(edit.objects):
            inserted += add_object(thing, f"IRIS Object {number:02d}", ground, scene.collection)
    except BaseException:
        bpy.data.batch_remove(set(datablocks()) - before)
        raise
    return BuiltScene(
        scene=scene,
        room=room,
        lamps=lamps,
        backdrop=backdrop,
        sun=sun,
        lights=lights,
        inserted=inserted,
        owned=set(datablocks()) - before,
    )


def add_room(
    result: Result, edit: SceneEdit, collection: bpy.types.Collection, *, lamps_apart: bool = False
) -> list[bpy.types.Object]:
    """The room as a mesh object named "IRIS Room Mesh": UV map "IRIS", a material slot per lamp.

    With ``lamps_apart`` the recovered lamps are objects "IRIS Lamp 00" … of their own, children of that one.
    """
    slots, slot_of_face = finish(face_material_steps(result, edit))
    every_face = np.arange(len(slot_of_face))
    lamps = [(lamp_name(lamp.id), lamp.faces) for lamp in result.emitters] if lamps_apart else []
    rest = np.setdiff1d(every_face, np.concatenate([faces for _, faces in lamps])) if lamps else every_face
    made = []
    for name, faces in [("IRIS Room Mesh", rest), *lamps]:
        data = room_mesh(_submesh(result.mesh, faces) if lamps else result.mesh, name)
        used, own_slot = used_slots(slot_of_face[faces])
        for slot in used:
            data.materials.append(slots[slot])
        set_material_slots(data, own_slot)
        made.append(bpy.data.objects.new(name, data))
        collection.objects.link(made[-1])
        if len(made) > 1:
            made[-1].parent = made[0]
    return made


def _submesh(mesh: Mesh, faces: NDArray[np.integer]) -> Mesh:
    """Some ``faces`` of ``mesh`` with the vertices they use."""
    used, corners = np.unique(mesh.faces[faces], return_inverse=True)
    uv = None if mesh.uv is None else mesh.uv[faces]
    normals = None if mesh.normals is None else mesh.normals[faces]
    return Mesh(vertices=mesh.vertices[used], faces=corners.reshape(-1, 3), uv=uv, normals=normals)


def room_mesh(mesh: Mesh, name: str) -> bpy.types.Mesh:
    """``mesh`` as a Blender mesh with face order kept, ``mesh.uv`` as UV map "IRIS", shaded flat or by its normals."""
    if mesh.uv is None:
        raise ValueError("the mesh of a result must have UVs")
    return plain_mesh(mesh, name)


def plain_mesh(mesh: Mesh, name: str) -> bpy.types.Mesh:
    """Like :func:`room_mesh`, but without a UV map where ``mesh`` has none."""
    return finish(mesh_steps(mesh, name))


def mesh_steps(mesh: Mesh, name: str) -> Steps[bpy.types.Mesh]:
    """:func:`plain_mesh` in steps.

    Attributes take an array at once; the properties of loops and polygons of the same meaning are copied one by one.
    """
    vertices, faces = yield from in_thread(lambda: _separate_invalid_faces(mesh), MAKING_MESH)
    n = len(faces)
    data = bpy.data.meshes.new(name)
    with discarded_on_failure([data]):
        data.vertices.add(len(vertices))
        data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
        data.loops.add(3 * n)
        corners = data.attributes.get(CORNER_VERTEX) or data.attributes.new(CORNER_VERTEX, "INT", "CORNER")
        corners.data.foreach_set("value", faces.astype(np.int32).ravel())
        data.polygons.add(n)
        data.polygons.foreach_set("loop_start", np.arange(0, 3 * n, 3, dtype=np.int32))
        if mesh.uv is not None:
            layer = data.uv_layers.new(name=UV_MAP, do_init=False)
            layer.uv.foreach_set("vector", np.ascontiguousarray(mesh.uv, np.float32).ravel())
        if mesh.normals is None:
            flat = data.attributes.get(SHARP_FACE) or data.attributes.new(SHARP_FACE, "BOOLEAN", "FACE")
            flat.data.foreach_set("value", np.ones(n, bool))
        yield MAKING_MESH
        data.update(calc_edges=True)
        yield MAKING_MESH
        if mesh.normals is not None:
            set_corner_normals(data, np.repeat(mesh.normals, 3, axis=0))
            yield MAKING_MESH
    return data


MAKING_MESH = "making the mesh"
CORNER_VERTEX, SHARP_FACE, MATERIAL_INDEX = ".corner_vert", "sharp_face", "material_index"
"""Attributes in which Blender keeps the vertex of a corner, whether a face is shaded flat, and its material slot."""


def corner_vertices(data: bpy.types.Mesh) -> NDArray[np.int32]:
    """The vertex (L,) of each corner of ``data``."""
    corners = np.empty(len(data.loops), np.int32)
    if len(corners):
        data.attributes[CORNER_VERTEX].data.foreach_get("value", corners)
    return corners


def material_slots(data: bpy.types.Mesh) -> NDArray[np.int32]:
    """The material slot (P,) of each polygon of ``data``."""
    slots, held = np.zeros(len(data.polygons), np.int32), data.attributes.get(MATERIAL_INDEX)
    if held is not None and (held.data_type, held.domain) == ("INT", "FACE"):  # as Blender looks it up
        held.data.foreach_get("value", slots)
    return slots


def used_slots(slots: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The numbers that are among ``slots`` (n,), ascending, and the place (n,) of each slot among them."""
    used = np.flatnonzero(np.bincount(slots))
    return used, np.searchsorted(used, slots)


def set_material_slots(data: bpy.types.Mesh, slots: NDArray[np.integer]) -> None:
    """Give the polygons of ``data`` the material ``slots`` (P,)."""
    held = data.attributes.get(MATERIAL_INDEX) or data.attributes.new(MATERIAL_INDEX, "INT", "FACE")
    held.data.foreach_set("value", slots.astype(np.int32))
    data.update_tag()


def add_sphere(sphere: Sphere, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """A smooth ball; its facets deviate from the sphere by 0.03 % of the radius."""
    data = bpy.data.meshes.new(name)
    mesh = bmesh.new()
    bmesh.ops.create_uvsphere(mesh, u_segments=128, v_segments=64, radius=sphere.radius)
    mesh.to_mesh(data)
    mesh.free()
    data.shade_smooth()
    data.materials.append(sphere_material(name, sphere))
    ball = bpy.data.objects.new(name, data)
    ball.matrix_world = Matrix.Translation(tuple(sphere.center))
    collection.objects.link(ball)
    return ball


def face_material_steps(
    result: Result, edit: SceneEdit, uv_map: str = UV_MAP
) -> Steps[tuple[list[bpy.types.Material], NDArray[np.int32]]]:
    """The materials of the room's slots, and (F,) the slot of each face: 0 the surface, then lamps, panes, black."""
    slot_of_face = np.zeros(len(result.mesh.faces), np.int32)
    slots = [(yield from surface_steps(result.textures, uv_map, result.diffuse_lobe))]
    with discarded_on_failure(slots):
        _add_lamps(result, edit, uv_map, slots, slot_of_face)
        if len(result.panes):
            slot_of_face[result.panes] = len(slots)
            slots.append(pane_material())
        if edit.black_faces is not None:
            black = edit.black_faces & (slot_of_face == 0)  # lamps are black already, panes invisible
            if black.any():
                slot_of_face[black] = len(slots)
                slots.append(black_material())
        yield MAKING
    return slots, slot_of_face


def _add_lamps(
    result: Result,
    edit: SceneEdit,
    uv_map: str,
    slots: list[bpy.types.Material],
    slot_of_face: NDArray[np.int32],
) -> None:
    """Append the materials of lamps to ``slots`` and enter them in ``slot_of_face`` (F,)."""
    emission = result.face_emission() if edit.face_emission is None else np.asarray(edit.face_emission, float)
    # A lamp that is off in the first light state is one that can be switched on; in an edited room it is a surface.
    switched = result.switched_faces & (edit.face_emission is None)
    lit = np.flatnonzero((emission.max(axis=1) > 0) | switched)
    emitter_of_face = np.full(len(emission), -1)
    for emitter in result.emitters:
        emitter_of_face[emitter.faces] = emitter.id
    lamps, lamp_of_face = np.unique(np.c_[emitter_of_face[lit], emission[lit]], axis=0, return_inverse=True)
    slot_of_face[lit] = len(slots) + lamp_of_face.ravel()
    patterned, image = {emitter.id for emitter in result.emitters if emitter.patterned}, None
    if patterned.intersection(lamps[:, 0]) and result.textures.lamp_pattern is not None:
        image = image_from_array(PATTERN, result.textures.lamp_pattern, colorspace=LINEAR, float_buffer=True)
    profiles = {emitter.id: emitter.profile for emitter in result.emitters}
    for emitter_id, *radiance in lamps:
        name = lamp_name(int(emitter_id)) if emitter_id >= 0 else "IRIS Lamp"
        pattern, profile = image if emitter_id in patterned else None, profiles.get(int(emitter_id))
        slots.append(lamp_material(name, radiance, pattern, uv_map, profile))
        slots[-1][LAMP_ID], slots[-1][RECOVERED] = int(emitter_id), [float(value) for value in radiance]


def _separate_invalid_faces(mesh: Mesh) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """``mesh`` with separate vertices for faces that Blender calls invalid: corners repeated, or those of another face.

    Blender would drop them, which would shift the face indices that emitters refer to.
    """
    faces = mesh.faces
    corners = np.sort(faces, axis=1)
    invalid = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2])
    order = np.lexsort(corners.T)  # stable: of faces with the same corners the first one stays
    ordered = corners[order]
    invalid[order[1:][(ordered[1:] == ordered[:-1]).all(1)]] = True
    own = mesh.vertices[faces[invalid]].reshape(-1, 3)
    faces = faces.copy()
    faces[invalid] = len(mesh.vertices) + np.arange(len(own)).reshape(-1, 3)
    return np.concatenate([mesh.vertices, own]), faces


BLOCK_KINDS = (
    *("scenes", "collections", "objects", "meshes", "curves", "cameras", "lights", "armatures", "actions"),
    *("materials", "node_groups", "images", "worlds"),
)


def datablocks() -> Iterator[bpy.types.ID]:
    """All datablocks of the session, of the kinds that building or importing a scene adds."""
    for kind in BLOCK_KINDS:
        yield from getattr(bpy.data, kind)
