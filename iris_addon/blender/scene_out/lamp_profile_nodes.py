"""The profile of a lamp as a node group: the radiance towards the viewer over that of an even lamp of the same flux."""

from __future__ import annotations

from itertools import pairwise

import bpy
import numpy as np

from ...model.lamp_profile import PROFILE_DEGREES, LampProfile

PROFILE = "IRIS Lamp Profile"
"""Name of the group and of its node in a lamp's material."""
RAMP, PEAK = "Radiance by Angle", "Highest"
"""Names of the nodes in the group that hold the profile: in proportion, and its largest value."""


def profile_output(tree: bpy.types.NodeTree, profile: LampProfile) -> bpy.types.NodeSocket:
    """The output of a new node in ``tree`` that tells the share of ``profile``."""
    node = tree.nodes.new("ShaderNodeGroup")
    node.name = node.label = PROFILE
    node.node_tree, node.location = _group(profile), (-650, -350)
    return node.outputs[0]


def is_profile(node: bpy.types.Node) -> bool:
    """Whether ``node`` tells the profile of a lamp."""
    return node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None and node.name.startswith(PROFILE)


def profile_of(material: bpy.types.Material) -> LampProfile | None:
    """The profile of a lamp of ``material`` in proportion, as its ramp has it now; None without a usable one."""
    tree = material.node_tree
    node = next((node for node in tree.nodes if is_profile(node)), None) if tree is not None else None
    if node is None:
        return None
    ramp = node.node_tree.nodes.get(RAMP)
    if ramp is None or ramp.bl_idname != "ShaderNodeValToRGB":
        return None
    values = np.array([ramp.color_ramp.evaluate(place)[0] for place in PROFILE_DEGREES / 90.0])
    return LampProfile.of(values) if np.isfinite(values).all() and values.max() > 0 else None


def _group(profile: LampProfile) -> bpy.types.NodeTree:
    group = bpy.data.node_groups.new(PROFILE, "ShaderNodeTree")
    group.interface.new_socket("Share", in_out="OUTPUT", socket_type="NodeSocketFloat")
    kinds = ("NewGeometry", "VectorMath", "Math", "Math", "Math", "ValToRGB", "Math")
    geometry, cosine, either_side, angle, of_right_angle, ramp, peak = (
        group.nodes.new(f"ShaderNode{kind}") for kind in kinds
    )
    out = group.nodes.new("NodeGroupOutput")
    ramp.name = ramp.label = RAMP
    peak.name = peak.label = PEAK
    cosine.operation = "DOT_PRODUCT"
    either_side.operation, angle.operation = "ABSOLUTE", "ARCCOSINE"
    of_right_angle.operation, peak.operation = "DIVIDE", "MULTIPLY"
    of_right_angle.inputs[1].default_value = np.pi / 2
    peak.inputs[1].default_value = highest = float(profile.values.max())
    elements = ramp.color_ramp.elements
    while len(elements) < len(PROFILE_DEGREES):
        elements.new(0.5)
    for element, place, value in zip(elements, PROFILE_DEGREES / 90.0, profile.values / highest, strict=True):
        element.position, element.color = place, (value, value, value, 1.0)
    group.links.new(geometry.outputs["Incoming"], cosine.inputs[0])
    group.links.new(geometry.outputs["True Normal"], cosine.inputs[1])
    group.links.new(cosine.outputs["Value"], either_side.inputs[0])
    in_turn = (either_side, angle, of_right_angle, ramp, peak, out)
    for before, after in pairwise(in_turn):
        group.links.new(before.outputs[0], after.inputs[0])
    for column, node in enumerate((geometry, cosine, *in_turn)):
        node.location = (200 * column, 0)
    return group
