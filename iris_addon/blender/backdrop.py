"""What cameras see through holes of the mesh: an object that only they and reflections show, and these from within."""

from __future__ import annotations

import bpy

from ..result.types import Backdrop
from .images import LINEAR, image_from_array
from .version import node_tree

BACKDROP = "IRIS Backdrop"
KEY = "iris_backdrop"


def add_backdrop(backdrop: Backdrop, scale: float, collection: bpy.types.Collection) -> bpy.types.Object:
    """The shell with its picture times ``scale``, in the capture's axes; wire in the viewport, not selectable.

    Cameras, glass and all reflections, sharp or blurred, show it. What lights diffuse surfaces is the world behind
    it, and it casts no shadow. From outside one looks through it into the room.
    """
    data = bpy.data.meshes.new(BACKDROP)
    data.from_pydata((backdrop.vertices - backdrop.centre).tolist(), [], backdrop.faces.tolist())
    data.validate()
    data.materials.append(_material(backdrop, scale))
    shell = bpy.data.objects.new(BACKDROP, data)
    shell.location = backdrop.centre
    for kind in ("diffuse", "volume_scatter", "shadow"):
        setattr(shell, f"visible_{kind}", False)
    shell.display_type = "WIRE"
    shell.hide_select = True
    shell[KEY] = True
    collection.objects.link(shell)
    return shell


def is_backdrop(thing: bpy.types.Object) -> bool:
    """Whether :func:`add_backdrop` made ``thing``."""
    return KEY in thing


def _material(backdrop: Backdrop, scale: float) -> bpy.types.Material:
    material = bpy.data.materials.new(BACKDROP)
    tree = node_tree(material)
    nodes = {
        name: tree.nodes.new(f"ShaderNode{name}")
        for name in (
            "TexCoord",
            "TexEnvironment",
            "Emission",
            "LightPath",
            "NewGeometry",
            "BsdfTransparent",
            "MixShader",
        )
    }
    reflected, looks, shown = (tree.nodes.new("ShaderNodeMath") for _ in range(3))
    reflected.operation, looks.operation, shown.operation = "MAXIMUM", "MAXIMUM", "SUBTRACT"
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    for column, node in enumerate((*nodes.values(), reflected, looks, shown, output)):
        node.location = (220 * column, 0)
    nodes["TexEnvironment"].image = image_from_array(BACKDROP, backdrop.picture, colorspace=LINEAR, float_buffer=True)
    nodes["Emission"].inputs["Strength"].default_value = scale
    # The shell's origin is where the picture was painted from, so a place on it is the direction to look up.
    tree.links.new(nodes["TexCoord"].outputs["Object"], nodes["TexEnvironment"].inputs["Vector"])
    tree.links.new(nodes["TexEnvironment"].outputs["Color"], nodes["Emission"].inputs["Color"])
    # Through clear glass rays are singular and not glossy; rough glass shows what the world sends.
    tree.links.new(nodes["LightPath"].outputs["Is Glossy Ray"], reflected.inputs[0])
    tree.links.new(nodes["LightPath"].outputs["Is Singular Ray"], reflected.inputs[1])
    tree.links.new(nodes["LightPath"].outputs["Is Camera Ray"], looks.inputs[0])
    tree.links.new(reflected.outputs[0], looks.inputs[1])
    tree.links.new(looks.outputs[0], shown.inputs[0])
    tree.links.new(nodes["NewGeometry"].outputs["Backfacing"], shown.inputs[1])
    tree.links.new(shown.outputs[0], nodes["MixShader"].inputs["Fac"])
    tree.links.new(nodes["BsdfTransparent"].outputs[0], nodes["MixShader"].inputs[1])
    tree.links.new(nodes["Emission"].outputs[0], nodes["MixShader"].inputs[2])
    tree.links.new(nodes["MixShader"].outputs[0], output.inputs["Surface"])
    material.cycles.emission_sampling = "NONE"
    return material
