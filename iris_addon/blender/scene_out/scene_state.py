"""What applying a result changes about a scene itself, kept on the scene so that it can be given back; and whether
its objects take changes now."""

from __future__ import annotations

import json
from collections.abc import Iterable

import bpy
import numpy as np

from ...base.errors import BadInput
from ...results.result import Result
from ..version import set_engine

STATE, WORLD = "iris_original_scene", "iris_original_world"


def require_object_mode(objects: Iterable[bpy.types.Object]) -> None:
    """Raise :class:`BadInput` if one is being edited: Blender then leaves it its mesh, and says nothing."""
    for thing in objects:
        if thing.mode == "EDIT":
            raise BadInput(f"the object '{thing.name}' is being edited", "leave edit mode (Tab)")


def keep_scene(scene: bpy.types.Scene) -> None:
    """Write down on ``scene`` its world, render engine and view settings."""
    view = scene.view_settings
    scene[STATE] = json.dumps(
        {
            "engine": scene.render.engine,
            "view_transform": view.view_transform,
            "look": view.look,
            "exposure": view.exposure,
        }
    )
    if scene.world is not None:
        scene[WORLD] = scene.world


def restore_scene(scene: bpy.types.Scene) -> None:
    """Give ``scene`` back what :func:`keep_scene` wrote down."""
    kept = json.loads(scene[STATE])
    scene.world = scene.get(WORLD)
    set_engine(scene, kept["engine"])
    view = scene.view_settings
    view.view_transform = kept["view_transform"]
    view.look, view.exposure = kept["look"], kept["exposure"]


def forget_scene(scene: bpy.types.Scene) -> None:
    """Remove what :func:`keep_scene` wrote."""
    for name in (STATE, WORLD):
        if name in scene:
            del scene[name]


def show_like_the_photos(result: Result, scene: bpy.types.Scene) -> None:
    """Cycles and the exposure of the photos' median in the Standard view: mid-brightness is as in the photos."""
    scene.render.engine = "CYCLES"
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    exposures = [float(np.mean(exposure)) for exposure in result.exposures.values()]
    scene.view_settings.exposure = float(np.clip(np.log2(np.median(exposures)), -32, 32)) if exposures else 0.0


# ---- Nodes that were put into somebody's tree, and out again --------------------------------------------------------


def remove_nodes(tree: bpy.types.NodeTree, names: Iterable[str]) -> None:
    """Remove the nodes of these ``names`` that are in ``tree``, and their node groups that nothing else uses."""
    nodes = [tree.nodes[name] for name in names if name in tree.nodes]
    groups = {node.node_tree for node in nodes if node.bl_idname == "CompositorNodeGroup"}
    for node in nodes:
        tree.nodes.remove(node)
    for group in groups:
        if not group.users:
            bpy.data.node_groups.remove(group)
