"""Sliders for the lights of the artist's scene that change a finished render: light groups mixed in compositing.

Light groups are per object in Cycles, and a lamp of the room is a few of its faces. While lights are mixed, lamps are
objects of their own, and the objects they belong to have meshes without them. The previous state is stored on the scene
and restored by :func:`stop_mixing`.
"""

from __future__ import annotations

import json
from typing import Any

import bmesh
import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...edits.scene_edit import OUTSIDE
from ..scene_out.materials import LAMP_ID
from ..scene_out.scene_state import remove_nodes, require_object_mode
from ..version import (
    composites,
    compositor_output,
    compositor_tree,
    leave_compositor_tree,
    own_compositor_tree,
    remove_lightgroup,
)
from .light_groups import MIX_GROUP, group_lights, mixed_picture

MIXED = "iris_mixed"
"""Custom property of a scene whose lights are mixed: its state before."""
WHOLE_MESH, APART = "iris_whole_mesh", "iris_apart"
"""Custom properties: of an object without its lamps, the complete mesh; of a separated lamp, a mark."""


def start_mixing(scene: bpy.types.Scene) -> list[str]:
    """Give every light of ``scene`` a group and a slider in its compositing; returns their names.

    Renders must not pass through the recovered camera yet: that must be the last node. Call
    :func:`iris_addon.blender.apply.camera_look.stop_matching` first.

    Raises:
        BadInput: nothing in the scene emits light, or an object with lamps is in edit mode.
    """
    require_object_mode(thing for thing in scene.objects if _has_lamps(thing))
    stop_mixing(scene)
    layer, render = scene.view_layers[0], scene.render
    before: dict[str, Any] = {
        "composites": composites(scene),
        "use_compositing": render.use_compositing,
        "denoising_passes": layer.cycles.denoising_store_passes,
        "groups": [group.name for group in layer.lightgroups],
        "lightgroups": {thing.name: thing.lightgroup for thing in scene.objects if thing.lightgroup},
        "world": "" if scene.world is None else scene.world.lightgroup,
    }
    for thing in [thing for thing in scene.objects if thing.type == "MESH" and _has_lamps(thing)]:
        _separate_lamps(thing)
    scene[MIXED] = json.dumps(before)
    # Objects whose lamps were separated still have the material, but no face with it.
    names = group_lights(scene, [t for t in scene.objects if not t.hide_render and WHOLE_MESH not in t])
    if not names:
        stop_mixing(scene)
        raise BadInput("nothing in the scene emits light", "switch a lamp on or add one")
    before |= _add_mix(scene, names)
    scene[MIXED] = json.dumps(before)
    return names


def stop_mixing(scene: bpy.types.Scene) -> None:
    """Restore compositing, light groups and objects of ``scene``; does nothing where it was not changed.

    Raises:
        BadInput: one of the objects is in edit mode. Nothing was changed then.
    """
    if MIXED not in scene:
        return
    require_object_mode(thing for thing in scene.objects if has_separated_lamps(thing))
    before, tree = json.loads(scene[MIXED]), compositor_tree(scene)
    if tree is not None and "made" in before:
        _remove_mix(tree, before)
    if not before["composites"]:
        leave_compositor_tree(scene)
    scene.render.use_compositing = before["use_compositing"]
    layer = scene.view_layers[0]
    layer.cycles.denoising_store_passes = before["denoising_passes"]
    for thing in scene.objects:
        thing.lightgroup = before["lightgroups"].get(thing.name, "")
    if scene.world is not None:
        scene.world.lightgroup = before["world"]
    for name in [group.name for group in layer.lightgroups if group.name not in before["groups"]]:
        remove_lightgroup(scene, layer, name)
    _restore_lamps(scene)
    del scene[MIXED]


def has_separated_lamps(thing: bpy.types.Object) -> bool:
    """Whether ``thing`` is a separated lamp, or an object whose lamps are separated."""
    return WHOLE_MESH in thing or APART in thing


def mixer(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """The node whose inputs are the sliders, None where lights are not mixed."""
    tree = compositor_tree(scene) if MIXED in scene else None
    return None if tree is None else tree.nodes.get(MIX_GROUP)


def sliders(node: bpy.types.Node) -> list[tuple[str, bpy.types.NodeSocket, bpy.types.NodeSocket]]:
    """Name, strength and colour of every light of a :func:`mixer`; the light from outside comes last."""
    names = [socket.name for socket in node.inputs if f"{socket.name} Strength" in node.inputs]
    names.sort(key=lambda name: name == OUTSIDE)
    return [(name, node.inputs[f"{name} Strength"], node.inputs[f"{name} Color"]) for name in names]


# ---- separated lamps -----------------------------------------------------------------------------------------------


def _has_lamps(thing: bpy.types.Object) -> bool:
    return any(slot.material is not None and LAMP_ID in slot.material for slot in thing.material_slots)


def _separate_lamps(thing: bpy.types.Object) -> None:
    whole = thing.data
    slot_of_face = np.empty(len(whole.polygons), np.int32)
    whole.polygons.foreach_get("material_index", slot_of_face)
    lamps = [k for k, material in enumerate(whole.materials) if material is not None and LAMP_ID in material]
    for slot in lamps:
        material = whole.materials[slot]
        apart = bpy.data.objects.new(material.name, _only_faces(whole, np.flatnonzero(slot_of_face == slot), material))
        apart[APART] = True
        apart.matrix_world = thing.matrix_world
        for collection in thing.users_collection:
            collection.objects.link(apart)
    thing[WHOLE_MESH] = whole
    thing.data = _without_faces(whole, np.flatnonzero(np.isin(slot_of_face, lamps)))


def _only_faces(whole: bpy.types.Mesh, faces: NDArray[np.integer], material: bpy.types.Material) -> bpy.types.Mesh:
    """A mesh of some ``faces`` of ``whole`` with one ``material``, without UVs."""
    corners = [list(whole.polygons[int(face)].vertices) for face in faces]
    used = sorted({vertex for face in corners for vertex in face})
    index = {vertex: k for k, vertex in enumerate(used)}
    data = bpy.data.meshes.new(material.name)
    data.from_pydata(
        [tuple(whole.vertices[vertex].co) for vertex in used], [], [[index[v] for v in face] for face in corners]
    )
    data.materials.append(material)
    return data


def _without_faces(whole: bpy.types.Mesh, faces: NDArray[np.integer]) -> bpy.types.Mesh:
    """A copy of ``whole`` without ``faces``."""
    data = whole.copy()
    mesh = bmesh.new()
    mesh.from_mesh(data)
    mesh.faces.ensure_lookup_table()
    bmesh.ops.delete(mesh, geom=[mesh.faces[int(face)] for face in faces], context="FACES")
    mesh.to_mesh(data)
    mesh.free()
    return data


def _restore_lamps(scene: bpy.types.Scene) -> None:
    apart = [thing for thing in scene.objects if APART in thing]
    spare = [thing.data for thing in apart]
    for thing in scene.objects:
        if WHOLE_MESH in thing:
            spare.append(thing.data)
            thing.data = thing[WHOLE_MESH]
            del thing[WHOLE_MESH]
    bpy.data.batch_remove([*apart, *spare])


# ---- compositing ---------------------------------------------------------------------------------------------------


def _add_mix(scene: bpy.types.Scene, names: list[str]) -> dict[str, Any]:
    """Replace the rendered picture by the mix wherever the scene's compositing uses it."""
    tree = own_compositor_tree(scene)
    present = {node.name for node in tree.nodes}
    picture = mixed_picture(scene, tree, names)
    replaced = []
    for link in list(tree.links):
        source = link.from_node
        if source.name in present and source.bl_idname == "CompositorNodeRLayers" and link.from_socket.name == "Image":
            replaced.append([source.name, link.to_node.name, link.to_socket.identifier])
            tree.links.new(picture, link.to_socket)
    output = compositor_output(tree)
    if not output.links:
        tree.links.new(picture, output)
    scene.render.use_compositing = True
    made = [node.name for node in tree.nodes if node.name not in present]
    for column, name in enumerate(made):
        tree.nodes[name].location = (-900.0 + 300.0 * column, 400.0)
    return {"made": made, "replaced": replaced}


def _remove_mix(tree: bpy.types.NodeTree, before: dict[str, Any]) -> None:
    remove_nodes(tree, before["made"])
    for source, target, identifier in before["replaced"]:
        if source in tree.nodes and target in tree.nodes:
            sockets = {socket.identifier: socket for socket in tree.nodes[target].inputs}
            tree.links.new(tree.nodes[source].outputs["Image"], sockets[identifier])
