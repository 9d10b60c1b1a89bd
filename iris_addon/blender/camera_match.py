"""The recovered camera in Blender's compositor: exposure, white balance and response as the node group "IRIS Camera".

The group takes scene-linear radiance and gives what the camera's picture shows, decoded from sRGB: under the view
transform "Standard" the picture on screen, and in a PNG, has the code values of the photo. Linear EXR comes from the
render layers as ever, before the group.

The curve is stored over x^0.35, where responses are close to straight, as 128 linear pieces per channel; it meets the
table of response.json within 1/255 (see the tests). Exposures beyond 1 clip, as they do in the photo.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..response.curve import Response
from .version import compositor_math, compositor_mix, compositor_output, own_compositor_tree

CAMERA_GROUP = "IRIS Camera"
WARP = 0.35
PIECES = 128


def camera_group(response: Response, exposure: NDArray[np.floating]) -> bpy.types.NodeTree:
    """A compositor node group: Image (radiance) and Exposure (a factor per channel) in, Image out.

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
        clipped, warped = compositor_math(tree, "MAXIMUM"), compositor_math(tree, "POWER")
        clipped.inputs[1].default_value, warped.inputs[1].default_value = 0.0, WARP
        below = compositor_math(tree, "MINIMUM")
        below.inputs[1].default_value = 1.0
        tree.links.new(split.outputs[channel], clipped.inputs[0])
        tree.links.new(clipped.outputs[0], below.inputs[0])
        tree.links.new(below.outputs[0], warped.inputs[0])
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
    """Lead ``picture``, a socket of the scene's compositing tree with radiance, through the camera to the output.

    Also sets the view transform the group is made for; the exposure of the view, which the viewport needs, is taken off
    again. Returns the group's node, whose input Exposure is that of the photo to be matched.
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
    s = np.linspace(0.0, 1.0, PIECES + 1)
    z = response.apply(np.repeat(s[:, None] ** (1 / WARP), 3, axis=1))
    mapping.use_clip = False
    mapping.extend = "HORIZONTAL"
    for channel in range(3):
        points = mapping.curves[channel].points
        points[0].location, points[-1].location = (0.0, float(z[0, channel])), (1.0, float(z[-1, channel]))
        for x, y in zip(s[1:-1], z[1:-1, channel], strict=True):
            points.new(float(x), float(y))
        for point in points:
            point.handle_type = "VECTOR"
    mapping.update()


def _lay_out(tree: bpy.types.NodeTree) -> None:
    """Spread the nodes from left to right in the order they were made in; the output last."""
    ordered = sorted(tree.nodes, key=lambda node: node.bl_idname == "NodeGroupOutput")
    for column, node in enumerate(ordered):
        node.location = (180.0 * column, -60.0 * (column % 3))
