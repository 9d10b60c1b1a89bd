"""Renders that look like a photo: the recovered camera as node group "IRIS Camera" at the end of the compositing.

The group takes scene-linear radiance and returns what the camera's picture shows, decoded from sRGB: under the view
transform "Standard" the picture on screen, and in a PNG, has the code values of the photo. Linear EXR is written from
the render layers, before the group. :func:`match_photo` adds it to the open scene, behind what the scene composites
already, and :func:`stop_matching` removes it; :func:`add_compositing` makes the whole tree of an exported scene.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.errors import BadInput
from ...model.device import Device
from ...model.response import Response
from ...results.records import exposure_of
from ..render.light_groups import group_lights, mixed_picture
from ..scene_out.scene_state import remove_nodes
from ..version import (
    composites,
    compositor_math,
    compositor_mix,
    compositor_output,
    compositor_tree,
    leave_compositor_tree,
    own_compositor_tree,
)

CAMERA_GROUP = "IRIS Camera"
CURVE_WARP, CURVE_SEGMENTS = 0.35, 128
"""The response is stored over x^0.35, where responses are close to straight, as 128 linear segments per channel. That
agrees with the table of response.json within 1/255. Exposures beyond 1 clip, as they do in the photo."""


def camera_group(response: Response, exposure: NDArray[np.floating]) -> bpy.types.NodeTree:
    """A compositor node group with inputs Image (radiance) and Exposure (a factor per channel), and output Image.

    Args:
        exposure: (3,) default of the input Exposure: factor from radiance to the argument of the response.
    """
    tree = bpy.data.node_groups.new(CAMERA_GROUP, "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="INPUT", socket_type="NodeSocketColor")
    factor = tree.interface.new_socket("Exposure", in_out="INPUT", socket_type="NodeSocketColor")
    factor.default_value = (*exposure, 1.0)
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    source, target = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")

    radiance, gain, exposed = compositor_mix(tree, "MULTIPLY")
    tree.links.new(source.outputs["Image"], radiance)
    tree.links.new(source.outputs["Exposure"], gain)
    split, joined = tree.nodes.new("CompositorNodeSeparateColor"), tree.nodes.new("CompositorNodeCombineColor")
    tree.links.new(exposed, split.inputs[0])
    tree.links.new(split.outputs["Alpha"], joined.inputs["Alpha"])
    for channel in ("Red", "Green", "Blue"):
        positive, warped = compositor_math(tree, "MAXIMUM"), compositor_math(tree, "POWER")
        positive.inputs[1].default_value, warped.inputs[1].default_value = 0.0, CURVE_WARP
        clipped = compositor_math(tree, "MINIMUM")
        clipped.inputs[1].default_value = 1.0
        tree.links.new(split.outputs[channel], positive.inputs[0])
        tree.links.new(positive.outputs[0], clipped.inputs[0])
        tree.links.new(clipped.outputs[0], warped.inputs[0])
        tree.links.new(warped.outputs[0], joined.inputs[channel])
    curves = tree.nodes.new("CompositorNodeCurveRGB")
    _set_curves(curves.mapping, response)
    tree.links.new(joined.outputs["Image"], curves.inputs["Image"])
    decoded = tree.nodes.new("CompositorNodeConvertColorSpace")
    decoded.from_color_space, decoded.to_color_space = "sRGB", "Linear Rec.709"
    tree.links.new(curves.outputs["Image"], decoded.inputs["Image"])
    tree.links.new(decoded.outputs["Image"], target.inputs["Image"])
    _lay_out(tree)
    return tree


def show_through_camera(
    scene: bpy.types.Scene, picture: bpy.types.NodeSocket, response: Response, exposure: NDArray[np.floating]
) -> bpy.types.Node:
    """Connect ``picture``, a socket with radiance in the scene's compositing tree, through the camera to the output.

    Also sets the view transform the group is made for. The view exposure, which the viewport needs, is compensated.

    Returns:
        The group's node, whose input Exposure is that of the matched photo.
    """
    tree = own_compositor_tree(scene)
    node = tree.nodes.new("CompositorNodeGroup")
    node.node_tree = camera_group(response, exposure)
    node.name = node.label = CAMERA_GROUP
    set_photo(node, exposure)
    tree.links.new(picture, node.inputs["Image"])
    view = scene.view_settings
    view.view_transform, view.look, view.gamma = "Standard", "None", 1.0
    unexposed = tree.nodes.new("CompositorNodeExposure")
    unexposed.inputs["Exposure"].default_value = -view.exposure
    tree.links.new(node.outputs["Image"], unexposed.inputs["Image"])
    tree.links.new(unexposed.outputs["Image"], compositor_output(tree))
    scene.render.use_compositing = True
    scene.render.dither_intensity = 0.0
    return node


def set_photo(node: bpy.types.Node, exposure: NDArray[np.floating]) -> None:
    """Expose the camera ``node`` like the photo with the (3,) factors ``exposure``."""
    node.inputs["Exposure"].default_value = (*(float(factor) for factor in exposure), 1.0)


def _set_curves(mapping: bpy.types.CurveMapping, response: Response) -> None:
    s = np.linspace(0.0, 1.0, CURVE_SEGMENTS + 1)
    z = response.apply(np.repeat(s[:, None] ** (1 / CURVE_WARP), 3, axis=1))
    mapping.use_clip = False
    mapping.extend = "HORIZONTAL"
    for channel in range(3):
        points = mapping.curves[channel].points
        for x in s[len(points) - 1 : -1]:  # two points are there at first, and all where a curve is replaced
            points.new(float(x), float(x))
        for point, x, y in zip(points, s, z[:, channel], strict=True):
            point.location, point.handle_type = (float(x), float(y)), "VECTOR"
    mapping.update()


def _lay_out(tree: bpy.types.NodeTree) -> None:
    """Place the nodes from left to right in the order they were made in, the output last."""
    ordered = sorted(tree.nodes, key=lambda node: node.bl_idname == "NodeGroupOutput")
    for column, node in enumerate(ordered):
        node.location = (180.0 * column, -60.0 * (column % 3))


# ---- in the open scene ---------------------------------------------------------------------------------------------

MATCHED = "iris_matched"
"""Custom property of a scene whose renders pass through the recovered camera: its compositing before that."""
LOOK = "iris_look"
"""Custom property of a scene with an applied result: the recovered camera, which the result folder may not outlive."""


def keep_look(
    scene: bpy.types.Scene,
    response: Response,
    exposures: Mapping[str, NDArray[np.floating]],
    devices: Sequence[Device] = (),
) -> None:
    """Store the recovered camera on ``scene``: its response, (3,) exposure × white balance by photo, and further
    cameras."""
    others = [{**_curve(device.response), "photos": list(device.photos)} for device in devices]
    listed = {name: exposure.tolist() for name, exposure in exposures.items()}
    scene[LOOK] = json.dumps({**_curve(response), "exposures": listed, "devices": others})


def kept_look(scene: bpy.types.Scene, photo: str = "") -> tuple[Response, dict[str, NDArray[np.float64]]]:
    """What :func:`keep_look` stored on ``scene``: the response that ``photo`` was taken with, and exposures by photo.

    Raises:
        BadInput: nothing was stored.
    """
    if LOOK not in scene:
        raise BadInput("this scene has no recovered camera", "apply the result again")
    kept = json.loads(scene[LOOK])
    of_photo = next((device for device in kept.get("devices", ()) if photo in device["photos"]), kept)
    samples = np.array(of_photo["samples"])
    response = Response(np.repeat(samples, 3 // len(samples), axis=0), of_photo["family"])
    return response, {name: np.array(exposure) for name, exposure in kept["exposures"].items()}


def _curve(response: Response) -> dict[str, Any]:
    samples = response.samples[:1] if (response.samples == response.samples[0]).all() else response.samples
    return {"family": response.family, "samples": samples.tolist()}


def match_photo(
    scene: bpy.types.Scene, response: Response, exposures: Mapping[str, NDArray[np.floating]], photo: str
) -> None:
    """Make renders of ``scene`` look as ``photo`` would.

    Args:
        exposures: (3,) exposure × white balance by photo. A photo without one gets their median.
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
    """Use exposure and response of another photo, where renders of ``scene`` pass through the camera."""
    tree = compositor_tree(scene) if MATCHED in scene else None
    camera = None if tree is None else tree.nodes.get(CAMERA_GROUP)
    if camera is not None:
        listed = json.loads(scene[MATCHED])["exposures"]
        set_photo(camera, exposure_of(photo, {name: np.array(exposure) for name, exposure in listed.items()}))
        if LOOK in scene and json.loads(scene[LOOK]).get("devices"):
            curves = next(node for node in camera.node_tree.nodes if node.bl_idname == "CompositorNodeCurveRGB")
            _set_curves(curves.mapping, kept_look(scene, photo)[0])


def stop_matching(scene: bpy.types.Scene) -> None:
    """Restore the compositing of ``scene``; does nothing where it was not changed."""
    if MATCHED not in scene:
        return
    before, tree = json.loads(scene[MATCHED]), compositor_tree(scene)
    if tree is not None:
        _remove_camera(tree, before["made"], before.get("source"))
    if not before["composites"]:
        leave_compositor_tree(scene)
    scene.render.use_compositing = before["use_compositing"]
    scene.render.dither_intensity = before["dither_intensity"]
    for name, value in before["view"].items():
        setattr(scene.view_settings, name, value)
    del scene[MATCHED]


def _remove_camera(tree: bpy.types.NodeTree, made: Sequence[str], source: tuple[str, str] | None) -> None:
    remove_nodes(tree, made)
    if source is not None and source[0] in tree.nodes:
        sockets = {socket.identifier: socket for socket in tree.nodes[source[0]].outputs}
        tree.links.new(sockets[source[1]], compositor_output(tree))


# ---- of an exported scene ------------------------------------------------------------------------------------------


def add_compositing(
    scene: bpy.types.Scene,
    emitters: Sequence[bpy.types.Object],
    response: Response,
    exposure: NDArray[np.floating],
) -> None:
    """Composite a solved room: render layers, a light group per emitter → "IRIS Lights" → denoising → "IRIS Camera".

    Replaces the compositing tree of ``scene``.

    Args:
        emitters: lamps and other lights, each an object of ``scene``.
        exposure: (3,) of the photo that renders are to look like.
    """
    names = group_lights(scene, emitters)
    tree = own_compositor_tree(scene)
    tree.nodes.clear()
    show_through_camera(scene, mixed_picture(scene, tree, names), response, exposure)
    for column, node in enumerate(tree.nodes):
        node.location = (320.0 * column, 0.0)
