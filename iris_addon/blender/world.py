"""Light from outside the mesh as a Blender world."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..result.sh import sh_radiance
from ..result.types import OutsideLight
from .images import LINEAR, image_from_array
from .version import node_tree

WIDTH, HEIGHT = 512, 256  # far finer than order 2 needs: Cycles wraps rows too, so half a texel at each pole is wrong


def make_world(outside: OutsideLight | None, scale: float, to_blender: NDArray[np.floating]) -> bpy.types.World:
    """A world that shines ``scale`` times ``outside``; black without it.

    A constant becomes a plain background, higher orders an equirectangular float image. The image is laid out in
    Blender's own world axes: ``to_blender`` (3, 3) is the rotation from the capture's axes to them, so that turning
    the room later means turning the panorama by a Mapping node.
    """
    world = bpy.data.worlds.new("IRIS Outside")
    tree = node_tree(world)
    background = tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    output.location = (250, 0)
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    background.inputs["Strength"].default_value = scale
    if outside is None:
        background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    elif len(outside.sh) == 1:
        radiance = sh_radiance(outside.sh, np.array([0.0, 0.0, 1.0]))
        background.inputs["Color"].default_value = (*radiance, 1.0)
    else:
        panorama = sh_radiance(outside.sh, equirect_directions(WIDTH, HEIGHT) @ to_blender)
        texture = tree.nodes.new("ShaderNodeTexEnvironment")
        texture.location = (-300, 0)
        texture.image = image_from_array("IRIS Outside", panorama, colorspace=LINEAR, float_buffer=True)
        tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    return world


def equirect_directions(width: int, height: int) -> NDArray[np.float64]:
    """(height, width, 3) unit directions in Blender's axes of the texels of a panorama in Cycles, +Z on top."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    azimuth, polar = -2 * np.pi * (u - 0.5), np.pi * v
    x, y = np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar)
    return np.stack([x, y, np.cos(polar)], -1).astype(np.float64)
