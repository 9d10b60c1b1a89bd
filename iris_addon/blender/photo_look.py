"""Renders of the open scene that look like a photo: the recovered camera at the end of its compositing, and out again.

What the scene composites already stays, in front of the camera.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..response.curve import Response
from ..result.response_json import exposure_of
from .camera_match import CAMERA_GROUP, set_photo, show_through_camera
from .node_groups import remove_nodes
from .version import composites, compositor_output, compositor_tree, leave_compositor_tree, own_compositor_tree

MATCHED = "iris_matched"
"""Custom property of a scene whose renders pass through the recovered camera: what it was like before."""


def match_photo(
    scene: bpy.types.Scene, response: Response, exposures: Mapping[str, NDArray[np.floating]], photo: str
) -> None:
    """Let renders of ``scene`` come out as ``photo`` would.

    Args:
        exposures: (3,) exposure × white balance by photo. One that is not there is given their median.
    """
    stop_matching(scene)
    view, render = scene.view_settings, scene.render
    composited = composites(scene)
    before: dict[str, Any] = {
        "exposures": {name: [float(factor) for factor in exposure] for name, exposure in exposures.items()},
        "composites": composited,
        "use_compositing": render.use_compositing,
        "dither_intensity": render.dither_intensity,
        "view": {name: getattr(view, name) for name in ("view_transform", "look", "gamma")},
    }
    tree = own_compositor_tree(scene)
    names = {node.name for node in tree.nodes}
    output = compositor_output(tree)
    picture = next((link.from_socket for link in output.links), None)
    if picture is not None:
        before["source"] = picture.node.name, picture.identifier
    if picture is None or not composited:
        layers = tree.nodes.new("CompositorNodeRLayers")
        layers.scene, layers.location = scene, (-300.0, 0.0)
        picture = layers.outputs["Image"]
    camera = show_through_camera(scene, picture, response, exposure_of(photo, exposures))
    x, y = output.node.location
    for step, node in enumerate((camera, camera.outputs["Image"].links[0].to_node, output.node)):
        node.location = (x + 200.0 * step, y)
    before["made"] = [node.name for node in tree.nodes if node.name not in names]
    scene[MATCHED] = json.dumps(before)


def follow_photo(scene: bpy.types.Scene, photo: str) -> None:
    """Expose like another photo, where renders of ``scene`` pass through the camera."""
    tree = compositor_tree(scene) if MATCHED in scene else None
    camera = None if tree is None else tree.nodes.get(CAMERA_GROUP)
    if camera is not None:
        listed = json.loads(scene[MATCHED])["exposures"]
        set_photo(camera, exposure_of(photo, {name: np.array(exposure) for name, exposure in listed.items()}))


def stop_matching(scene: bpy.types.Scene) -> None:
    """Give ``scene`` back the compositing it had; nothing where it was not changed."""
    if MATCHED not in scene:
        return
    before, tree = json.loads(scene[MATCHED]), compositor_tree(scene)
    if tree is not None:
        _take_out(tree, before["made"], before.get("source"))
    if not before["composites"]:
        leave_compositor_tree(scene)
    scene.render.use_compositing = before["use_compositing"]
    scene.render.dither_intensity = before["dither_intensity"]
    for name, value in before["view"].items():
        setattr(scene.view_settings, name, value)
    del scene[MATCHED]


def _take_out(tree: bpy.types.NodeTree, made: Sequence[str], source: tuple[str, str] | None) -> None:
    remove_nodes(tree, made)
    if source is not None and source[0] in tree.nodes:
        sockets = {socket.identifier: socket for socket in tree.nodes[source[0]].outputs}
        tree.links.new(sockets[source[1]], compositor_output(tree))
