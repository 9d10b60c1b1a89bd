"""The backdrop in Blender: a shell around the room that is visible from inside, through holes of the mesh."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ...model.recovered import Backdrop
from ..images import LINEAR, image_from_array
from ..version import node_tree

BACKDROP = "IRIS Backdrop"
KEY = "iris_backdrop"


def add_backdrop(backdrop: Backdrop, scale: float, collection: bpy.types.Collection) -> bpy.types.Object:
    """The shell with its picture times ``scale``, in the capture's axes; wire in the viewport, not selectable.

    A backdrop with an albedo is a surface of the room, with openings where the albedo is zero: these show the picture
    and let in the world's light. Without an albedo the picture is visible to cameras, through glass and in all
    reflections, sharp or blurred; diffuse surfaces are lit by the world behind it, and it casts no shadow. From outside
    either shell is transparent.
    """
    data = bpy.data.meshes.new(BACKDROP)
    data.from_pydata((backdrop.vertices - backdrop.centre).tolist(), [], backdrop.faces.tolist())
    data.validate()
    data.materials.append(_material(backdrop, scale))
    shell = bpy.data.objects.new(BACKDROP, data)
    shell.location = backdrop.centre
    if backdrop.albedo is None:
        for kind in ("diffuse", "volume_scatter", "shadow"):
            setattr(shell, f"visible_{kind}", False)
    shell.display_type = "WIRE"
    shell.hide_select = True
    shell[KEY] = True
    collection.objects.link(shell)
    return shell


def follow_world(shell: bpy.types.Object, world: bpy.types.World) -> None:
    """Let the strength of the backdrop be that of ``world``: what openings show dims with the light through them."""
    material = shell.data.materials[0]
    emission = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeEmission")
    background = next(node for node in world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    driver = emission.inputs["Strength"].driver_add("default_value").driver
    driver.type = "SUM"  # no Python expression, which Blender would not run in a file from a stranger
    source = driver.variables.new().targets[0]
    source.id_type, source.id = "WORLD", world
    source.data_path = f'node_tree.nodes["{background.name}"].inputs["Strength"].default_value'


def is_backdrop(thing: bpy.types.Object) -> bool:
    """Whether :func:`add_backdrop` made ``thing``."""
    return KEY in thing


def _material(backdrop: Backdrop, scale: float) -> bpy.types.Material:
    material = bpy.data.materials.new(BACKDROP)
    tree = node_tree(material)
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = scale
    tree.links.new(_panorama(tree, BACKDROP, backdrop.picture), emission.inputs["Color"])
    clear = tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0]
    if backdrop.albedo is None:
        within, inside = emission.outputs[0], _looked_at(tree)
    else:
        within, inside = _surface(tree, emission.outputs[0], clear, backdrop.albedo), _from_within(tree)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(_mix(tree, inside, clear, within), output.inputs["Surface"])
    for column, node in enumerate(tree.nodes):
        node.location = (220 * column, 0)
    opens = backdrop.albedo is not None and bool(backdrop.picture.any())
    # The room is lit only by what its openings show.
    material.cycles.emission_sampling = "AUTO" if opens else "NONE"
    return material


def _panorama(tree: bpy.types.NodeTree, name: str, picture: NDArray[np.floating]) -> bpy.types.NodeSocket:
    """Colour of an equirectangular picture (H, 2 H, 3) seen from the origin of the shell, where it was painted.

    A position on the shell is the direction to look up.
    """
    position, texture = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image_from_array(name, picture, colorspace=LINEAR, float_buffer=True)
    tree.links.new(position.outputs["Object"], texture.inputs["Vector"])
    return texture.outputs["Color"]


def _surface(
    tree: bpy.types.NodeTree, emission: bpy.types.NodeSocket, clear: bpy.types.NodeSocket, albedo: NDArray[np.floating]
) -> bpy.types.NodeSocket:
    """A wall where ``albedo`` (H, 2 H, 3) is not zero, and where it is zero an opening that shows ``emission``."""
    color, wall = _panorama(tree, f"{BACKDROP} Albedo", albedo), tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(color, wall.inputs["Color"])
    reflects = _math(tree, "GREATER_THAN", color)
    reflects.inputs[1].default_value = 0.0
    opening = tree.nodes.new("ShaderNodeAddShader")
    for source, target in zip((emission, clear), opening.inputs, strict=True):
        tree.links.new(source, target)
    return _mix(tree, reflects.outputs[0], opening.outputs[0], wall.outputs[0])


def _from_within(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """1 on the side that faces inwards."""
    within = _math(tree, "SUBTRACT")
    within.inputs[0].default_value = 1.0
    tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], within.inputs[1])
    return within.outputs[0]


def _looked_at(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """Above 0 on the side that faces inwards, for camera rays, reflected rays and rays through clear glass.

    Rays through clear glass are singular and not glossy; rough glass shows the world.
    """
    path = tree.nodes.new("ShaderNodeLightPath")
    reflected = _math(tree, "MAXIMUM", path.outputs["Is Glossy Ray"], path.outputs["Is Singular Ray"])
    looks = _math(tree, "MAXIMUM", path.outputs["Is Camera Ray"], reflected.outputs[0])
    return _math(tree, "MULTIPLY", looks.outputs[0], _from_within(tree)).outputs[0]


def _math(tree: bpy.types.NodeTree, operation: str, *operands: bpy.types.NodeSocket) -> bpy.types.Node:
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    for operand, socket in zip(operands, node.inputs, strict=False):
        tree.links.new(operand, socket)
    return node


def _mix(
    tree: bpy.types.NodeTree, factor: bpy.types.NodeSocket, zero: bpy.types.NodeSocket, one: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    node = tree.nodes.new("ShaderNodeMixShader")
    for source, socket in zip((factor, zero, one), node.inputs, strict=True):
        tree.links.new(source, socket)
    return node.outputs[0]
