"""Burley's diffuse lobe in Cycles, whose Principled surface is Lambertian under a dielectric layer.

The solver's lobe is a factor of the light times a factor of the view (:mod:`iris_addon.transport.diffuse`). A base
colour may depend on the view alone, so it takes the view factor, and the light factor's mean. A path's next vertex is
"the view" of the surface it leaves, so this holds for bounced light as well.

Renderers with this lobe add the specular one. Principled takes that off, more at grazing angles than head-on about the
mean that the base colour allows for (:func:`iris_addon.reflectance.ggx.layered_factor`); the group gives it back.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..reflectance.ggx import layered_factor
from ..transport.diffuse import MEAN_COS2, MEAN_SCHLICK
from .images import image_from_array

GROUP = "IRIS Burley Diffuse"
TABLE, TABLE_SIZE = "IRIS Unlayered", (16, 128)
"""Image of what the layer's factor is taken back by: over roughness, upwards, and over the cosine to the viewer."""


def insert_burley(tree: bpy.types.NodeTree, shader: bpy.types.ShaderNodeBsdfPrincipled) -> None:
    """Put the group between the base colour of ``shader`` and what feeds it."""
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree, node.location = burley_group(), (-180, 200)
    for name, socket in (("Color", "Base Color"), ("Roughness", "Roughness"), ("Metallic", "Metallic")):
        for link in shader.inputs[socket].links:
            tree.links.new(link.from_socket, node.inputs[name])
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])


def remove_burley(tree: bpy.types.NodeTree) -> None:
    """Undo :func:`insert_burley`; a tree without the group stays as it is."""
    for node in [n for n in tree.nodes if n.bl_idname == "ShaderNodeGroup" and n.node_tree.name.startswith(GROUP)]:
        source = node.inputs["Color"].links[0].from_socket
        for link in list(node.outputs["Color"].links):
            tree.links.new(source, link.to_socket)
        tree.nodes.remove(node)


def burley_group() -> bpy.types.NodeTree:
    """The node group: Color, Roughness and Metallic in, the base colour as seen from the incoming direction out."""
    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    for name, kind in (("Color", "NodeSocketColor"), ("Roughness", "NodeSocketFloat"), ("Metallic", "NodeSocketFloat")):
        group.interface.new_socket(name, in_out="INPUT", socket_type=kind)
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    source, sink = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    geometry = group.nodes.new("ShaderNodeNewGeometry")
    source.location, geometry.location, sink.location = (-900, 0), (-900, -250), (900, 0)

    facing = group.nodes.new("ShaderNodeVectorMath")
    facing.operation, facing.location = "DOT_PRODUCT", (-700, -250)
    group.links.new(geometry.outputs["Incoming"], facing.inputs[0])
    group.links.new(geometry.outputs["Normal"], facing.inputs[1])
    cosine = _math(group, "ABSOLUTE", facing.outputs["Value"], at=(-520, -250))
    schlick = _math(group, "POWER", _math(group, "SUBTRACT", 1.0, cosine, at=(-340, -250)), 5.0, at=(-160, -250))
    kappa = _math(group, "MULTIPLY_ADD", source.outputs["Roughness"], 2 * MEAN_COS2, -0.5, at=(-340, -50))
    view = _math(group, "MULTIPLY_ADD", kappa, schlick, 1.0, at=(20, -250))
    light = _math(group, "MULTIPLY_ADD", kappa, MEAN_SCHLICK, 1.0, at=(20, -50))
    lobe = _math(group, "MULTIPLY", view, light, at=(200, -150))
    unlayered = _unlayered(group, cosine, source.outputs["Roughness"])
    excess = _math(group, "MULTIPLY_ADD", lobe, unlayered, -1.0, at=(380, -150))
    # A metal has no diffuse part: its base colour is that of its highlight.
    dielectric = _math(group, "SUBTRACT", 1.0, source.outputs["Metallic"], at=(380, -350))
    gain = _math(group, "MULTIPLY_ADD", excess, dielectric, 1.0, at=(560, -150))
    scaled = group.nodes.new("ShaderNodeVectorMath")
    scaled.operation, scaled.location = "SCALE", (720, 0)
    group.links.new(source.outputs["Color"], scaled.inputs[0])
    group.links.new(gain, scaled.inputs["Scale"])
    group.links.new(scaled.outputs["Vector"], sink.inputs["Color"])
    return group


def _unlayered(
    tree: bpy.types.NodeTree, cosine: bpy.types.NodeSocket, roughness: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """One over the factor of the layer, looked up."""
    rows, columns = TABLE_SIZE
    factor = layered_factor(np.linspace(0, 1, rows)[:, None], np.linspace(0, 1, columns)[None])
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image_from_array(TABLE, 1 / factor[::-1], float_buffer=True)
    node.extension, node.location = "EXTEND", (-160, -500)
    at = tree.nodes.new("ShaderNodeCombineXYZ")
    at.location = (-340, -500)
    # Values lie at the centres of texels.
    for axis, value, size, height in (("X", cosine, columns, -430), ("Y", roughness, rows, -600)):
        placed = _math(tree, "MULTIPLY_ADD", value, (size - 1) / size, 0.5 / size, at=(-520, height))
        tree.links.new(placed, at.inputs[axis])
    tree.links.new(at.outputs["Vector"], node.inputs["Vector"])
    return node.outputs["Color"]


def _math(
    tree: bpy.types.NodeTree, operation: str, *values: bpy.types.NodeSocket | float, at: tuple[float, float]
) -> bpy.types.NodeSocket:
    node = tree.nodes.new("ShaderNodeMath")
    node.operation, node.location = operation, at
    for socket, value in zip(node.inputs, values, strict=False):
        if isinstance(value, float):
            socket.default_value = value
        else:
            tree.links.new(value, socket)
    return node.outputs["Value"]
