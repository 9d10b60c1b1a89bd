"""The state of a scene around a result: whether it can be changed, what applying changes, and how that is undone."""

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
    """Raise :class:`BadInput` if an object is in edit mode: Blender would silently keep its mesh."""
    for thing in objects:
        if thing.mode == "EDIT":
            raise BadInput(f"the object '{thing.name}' is being edited", "leave edit mode (Tab)")


def keep_scene(scene: bpy.types.Scene) -> None:
    """Store world, render engine and view settings of ``scene`` on it."""
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
    """Restore what :func:`keep_scene` stored."""
    kept = json.loads(scene[STATE])
    scene.world = scene.get(WORLD)
    set_engine(scene, kept["engine"])
    view = scene.view_settings
    view.view_transform = kept["view_transform"]
    view.look, view.exposure = kept["look"], kept["exposure"]


def forget_scene(scene: bpy.types.Scene) -> None:
    """Remove what :func:`keep_scene` stored."""
    for name in (STATE, WORLD):
        if name in scene:
            del scene[name]


def show_like_the_photos(result: Result, scene: bpy.types.Scene) -> None:
    """Cycles, and the median exposure of the photos in the Standard view: mid-tones look as in the photos."""
    scene.render.engine = "CYCLES"
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    exposures = [float(np.mean(exposure)) for exposure in result.exposures.values()]
    scene.view_settings.exposure = float(np.clip(np.log2(np.median(exposures)), -32, 32)) if exposures else 0.0


def remove_nodes(tree: bpy.types.NodeTree, names: Iterable[str]) -> None:
    """Remove the nodes of these ``names`` that are in ``tree``, and their node groups that nothing else uses."""
    nodes = [tree.nodes[name] for name in names if name in tree.nodes]
    groups = {node.node_tree for node in nodes if node.bl_idname == "CompositorNodeGroup"}
    for node in nodes:
        tree.nodes.remove(node)
    for group in groups:
        if not group.users:
            bpy.data.node_groups.remove(group)
