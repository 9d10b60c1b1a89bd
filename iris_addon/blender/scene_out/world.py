"""Light from outside the mesh as a Blender world."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ...edits.scene_edit import OUTSIDE, Panorama
from ...model.recovered import OutsideLight
from ...model.sphere import equirect_directions, sh_radiance
from ..images import LINEAR, image_from_array, load_image
from ..version import node_tree

WIDTH, HEIGHT = (
    512,
    256,
)  # far finer than order 2 needs, because Cycles wraps rows and so misreads half a texel at each pole


def make_world(
    outside: OutsideLight | None,
    scale: float,
    to_blender: NDArray[np.floating],
    panoramas: Sequence[Panorama] = (),
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> bpy.types.World:
    """A world that emits ``scale`` times ``outside`` plus ``panoramas``; black without either.

    A constant becomes a plain background, higher orders an equirectangular float image. The image is laid out in
    Blender's own world axes: ``to_blender`` (3, 3) is the rotation from the capture's axes to them, so that turning
    the room later means turning the panorama by a Mapping node.

    Args:
        up: of the capture, where the top of the panoramas points.

    Raises:
        BadInput: the picture of a panorama cannot be read.
    """
    world = bpy.data.worlds.new(OUTSIDE)
    tree = node_tree(world)
    output = tree.nodes.new("ShaderNodeOutputWorld")
    output.location = (250, 0)
    shader = _sky(tree, None if outside is None else outside.sh, scale, to_blender)
    for panorama in panoramas:
        added = tree.nodes.new("ShaderNodeAddShader")
        tree.links.new(shader.outputs[0], added.inputs[0])
        tree.links.new(_panorama_background(tree, panorama, to_blender @ np.asarray(up)).outputs[0], added.inputs[1])
        shader = added
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return world


def outside_light(world: bpy.types.World | None) -> bpy.types.Node | None:
    """The node whose input Strength dims the light from outside; None where the artist has rebuilt the world."""
    nodes = world.node_tree.nodes if world is not None and world.node_tree is not None else {}
    return nodes.get("Background")


def sky_strength(world: bpy.types.World | None) -> bpy.types.NodeSocket | None:
    """That input; None where the artist has rebuilt the world."""
    background = outside_light(world)
    return None if background is None else background.inputs["Strength"]


GRAY, UNGRAYED = "IRIS Gray", "IRIS Color From Outside"
"""Names of the nodes of :func:`set_gray`."""


def shines(world: bpy.types.World | None) -> bool:
    """Whether the light from outside has a color other than black; False where the artist has rebuilt the world."""
    background = outside_light(world)
    if background is None:
        return False
    color = background.inputs["Color"]
    return bool(color.is_linked or any(color.default_value[:3]))


def is_gray(world: bpy.types.World | None) -> bool:
    """Whether :func:`set_gray` has taken the color from the light from outside."""
    return world is not None and world.node_tree is not None and GRAY in world.node_tree.nodes


def set_gray(world: bpy.types.World | None, on: bool) -> None:
    """Let the light from outside keep its luminance in every direction and lose its color; off gives it back.

    Does nothing to a world that the artist has rebuilt, and to a black one.
    """
    background = outside_light(world)
    if world is None or background is None or on == is_gray(world) or not shines(world):
        return
    tree, color = world.node_tree, background.inputs["Color"]
    if not on:
        for link in [link for link in tree.nodes[GRAY].inputs[0].links if link.from_node.name != UNGRAYED]:
            tree.links.new(link.from_socket, color)
        for node in [node for node in tree.nodes if node.name in (GRAY, UNGRAYED)]:
            tree.nodes.remove(node)
        return
    gray = tree.nodes.new("ShaderNodeRGBToBW")
    gray.name, gray.location = GRAY, (-40, 60)
    if color.is_linked:
        source = color.links[0].from_socket
    else:
        constant = tree.nodes.new("ShaderNodeRGB")
        constant.name, constant.location = UNGRAYED, (-260, 60)
        source = constant.outputs[0]
        source.default_value = color.default_value
    tree.links.new(source, gray.inputs[0])
    tree.links.new(gray.outputs[0], color)


def _sky(
    tree: bpy.types.NodeTree, sh: NDArray[np.floating] | None, scale: float, to_blender: NDArray[np.floating]
) -> bpy.types.Node:
    """A background with the radiance of the harmonics ``sh`` (n, 3) in the capture's axes."""
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = scale
    if sh is None:
        background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    elif len(sh) == 1:
        radiance = sh_radiance(sh, np.array([0.0, 0.0, 1.0]))
        background.inputs["Color"].default_value = (*radiance, 1.0)
    else:
        panorama = sh_radiance(sh, equirect_directions(WIDTH, HEIGHT) @ to_blender)
        texture = tree.nodes.new("ShaderNodeTexEnvironment")
        texture.location = (-300, 0)
        texture.image = image_from_array(OUTSIDE, panorama, colorspace=LINEAR, float_buffer=True)
        tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    return background


def _panorama_background(tree: bpy.types.NodeTree, panorama: Panorama, up: NDArray[np.floating]) -> bpy.types.Node:
    image = load_image(panorama.file, "correct 'file' of the light")
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    background = tree.nodes.new("ShaderNodeBackground")
    for column, node in enumerate((coordinates, mapping, texture, background)):
        node.location = (-900 + 220 * column, -300)
    # The mapping takes directions of the world to those of the picture: the inverse of the picture's rotation.
    turned = Vector((0.0, 0.0, 1.0)).rotation_difference(Vector(up)).to_matrix()
    turned = turned @ Matrix.Rotation(np.radians(panorama.rotation), 3, "Z")
    mapping.vector_type = "POINT"
    mapping.inputs["Rotation"].default_value = turned.inverted().to_euler()
    texture.image = image
    background.inputs["Strength"].default_value = panorama.scale
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    return background
