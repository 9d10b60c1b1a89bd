"""Everything about a Blender scene that a person would call its state, as plain values to compare."""

import hashlib
from typing import Any

import bpy
import numpy as np

from iris_addon.blender.version import composites, compositor_output, compositor_tree, own_compositor_tree

KINDS = ("meshes", "materials", "images", "worlds", "objects", "node_groups", "collections", "textures")


def snapshot(scene: bpy.types.Scene) -> dict[str, Any]:
    """Objects with data, slots, modifiers, transform and custom properties; the scene's settings; all datablocks."""
    view = scene.view_settings
    return {
        "objects": {thing.name: _object(thing) for thing in scene.objects},
        "scene": (
            scene.world.name if scene.world else None,
            scene.camera.name if scene.camera else None,
            scene.render.engine,
            (scene.render.resolution_x, scene.render.resolution_y),
            (view.view_transform, view.look, view.exposure),
            sorted(key for key in scene.keys() if key.startswith("iris_")),  # noqa: SIM118
        ),
        "compositing": (
            scene.render.use_compositing,
            scene.render.dither_intensity,
            _tree(compositor_tree(scene)) if composites(scene) else None,
        ),
        "blocks": {
            kind: sorted((block.name, block.use_fake_user) for block in getattr(bpy.data, kind) if not _is_shown(block))
            for kind in KINDS
        },
        "meshes": {mesh.name: _mesh(mesh) for mesh in bpy.data.meshes},
    }


def _is_shown(block: bpy.types.ID) -> bool:
    """Whether it is what Blender keeps a render or a viewer's picture in."""
    return isinstance(block, bpy.types.Image) and block.source == "VIEWER"


def _object(thing: bpy.types.Object) -> tuple:
    return (
        thing.data.name if thing.data else None,
        [(slot.link, slot.material.name if slot.material else None) for slot in thing.material_slots],
        [(m.name, m.type, m.show_viewport, m.show_render) for m in thing.modifiers],
        [list(row) for row in thing.matrix_world],
        (thing.hide_viewport, thing.hide_render, thing.active_material_index),
        sorted(thing.keys()),
        sorted(collection.name for collection in thing.users_collection),
    )


def _tree(tree: bpy.types.NodeTree) -> tuple:
    links = [(a.from_node.name, a.from_socket.identifier, a.to_node.name, a.to_socket.identifier) for a in tree.links]
    return sorted((node.name, node.bl_idname) for node in tree.nodes), sorted(links)


def _mesh(mesh: bpy.types.Mesh) -> tuple:
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    corners, slots = np.empty(len(mesh.loops), np.int32), np.empty(len(mesh.polygons), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    mesh.polygons.foreach_get("material_index", slots)
    digest = hashlib.sha1(points.tobytes() + corners.tobytes() + slots.tobytes())
    for layer in mesh.uv_layers:
        uv = np.empty(2 * len(mesh.loops), np.float32)
        layer.uv.foreach_get("vector", uv)
        digest.update(layer.name.encode() + uv.tobytes())
    return digest.hexdigest(), [material.name if material else None for material in mesh.materials]


def blurred(scene: bpy.types.Scene) -> bpy.types.Node:
    """A compositing of somebody's own: the render layers, blurred. The node that blurs them."""
    tree = own_compositor_tree(scene)
    layers, blur = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeBlur")
    tree.links.new(layers.outputs["Image"], blur.inputs["Image"])
    tree.links.new(blur.outputs["Image"], compositor_output(tree))
    return blur
